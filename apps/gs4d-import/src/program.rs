//! Programs of other people as child processes: arguments as lists, no shell, a short environment, no input, and an end when the
//! caller asks for one.

use crate::error::ImportError;
use std::ffi::OsString;
use std::io::{ErrorKind, Read, Write};
use std::path::PathBuf;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

/// Variables that a child process keeps.
const KEPT: [&str; 15] = [
    "PATH",
    "HOME",
    "LD_LIBRARY_PATH",
    "DYLD_LIBRARY_PATH",
    "TMPDIR",
    "TMP",
    "TEMP",
    "SYSTEMROOT",
    "SystemRoot",
    "USERPROFILE",
    "APPDATA",
    "LOCALAPPDATA",
    "OMP_NUM_THREADS",
    "CUDA_VISIBLE_DEVICES",
    "XDG_CACHE_HOME",
];
/// Lines that an error quotes.
const TAIL: usize = 6;
/// Time between two looks at the flag that ends a child.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// Bytes of one read.
const PIECE: usize = 1 << 16;

/// A program that the user installs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Program {
    /// Name on the PATH.
    pub(crate) name: &'static str,
    /// How to install it.
    pub(crate) install: &'static str,
}

const FFMPEG_PACKAGE: &str = "apt install ffmpeg, brew install ffmpeg, or see https://ffmpeg.org/download.html";

/// Reads videos.
pub(crate) const FFMPEG: Program = Program { name: "ffmpeg", install: FFMPEG_PACKAGE };
/// Says what a video is; part of ffmpeg.
pub(crate) const FFPROBE: Program = Program { name: "ffprobe", install: FFMPEG_PACKAGE };
/// Finds cameras.
pub(crate) const COLMAP: Program = Program {
    name: "colmap",
    install: "apt install colmap, brew install colmap, or see https://colmap.github.io/install.html",
};

/// A call of a program.
pub(crate) struct Call {
    program: Program,
    arguments: Vec<OsString>,
    folder: PathBuf,
    task: String,
}

/// What becomes of the output.
pub(crate) enum Sink<'a> {
    /// Lines of both streams.
    Lines(&'a mut dyn FnMut(&str)),
    /// Bytes of the standard output, as they come.
    Bytes(&'a mut dyn FnMut(&[u8])),
}

/// Runs programs one after the other and keeps what they say.
pub(crate) struct Runner<'a> {
    /// Set by the caller to end the child.
    pub(crate) stop: &'a AtomicBool,
    /// File that gets all commands and lines.
    pub(crate) log: PathBuf,
}

impl Call {
    /// A call in a folder; `task` completes "failed while it was to …".
    pub(crate) fn new(program: Program, folder: impl Into<PathBuf>, task: impl Into<String>) -> Self {
        Self { program, arguments: Vec::new(), folder: folder.into(), task: task.into() }
    }

    /// Adds arguments.
    pub(crate) fn args<T: Into<OsString>>(mut self, arguments: impl IntoIterator<Item = T>) -> Self {
        self.arguments.extend(arguments.into_iter().map(Into::into));
        self
    }

    fn start(&self) -> Result<Child, ImportError> {
        let mut command = Command::new(self.program.name);
        command.args(&self.arguments).current_dir(&self.folder).env_clear();
        command.envs(KEPT.iter().filter_map(|name| Some((name, std::env::var_os(name)?))));
        command.env("LC_ALL", "C").env("QT_QPA_PLATFORM", "offscreen");
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // Ctrl-C reaches this process alone, which ends the child.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let Program { name, install } = self.program;
        command.spawn().map_err(|e| match e.kind() {
            ErrorKind::NotFound | ErrorKind::PermissionDenied if self.folder.is_dir() => {
                ImportError::Missing { program: name, install }
            }
            _ => ImportError::os("start a program in", &self.folder)(e),
        })
    }
}

/// Ends the child, whatever happens to the caller.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A piece of output, and whether it is of the standard output.
type Piece = (bool, Vec<u8>);

fn forward(mut from: impl Read + Send + 'static, is_out: bool, to: SyncSender<Piece>) {
    std::thread::spawn(move || {
        let mut buffer = vec![0; PIECE];
        while let Ok(n) = from.read(&mut buffer) {
            if n == 0 || to.send((is_out, buffer[..n].to_vec())).is_err() {
                break;
            }
        }
    });
}

/// Splits bytes into lines and keeps the last ones.
#[derive(Default)]
struct Lines {
    unfinished: Vec<u8>,
    tail: Vec<String>,
}

impl Lines {
    fn take(&mut self, bytes: &[u8], said: &mut Vec<String>) {
        for &byte in bytes {
            if byte == b'\n' || byte == b'\r' {
                self.end(said);
            } else {
                self.unfinished.push(byte);
            }
        }
    }

    fn end(&mut self, said: &mut Vec<String>) {
        let line = String::from_utf8_lossy(&std::mem::take(&mut self.unfinished)).trim_end().to_owned();
        if line.trim().is_empty() {
            return;
        }
        if self.tail.len() == TAIL {
            self.tail.remove(0);
        }
        self.tail.push(line.clone());
        said.push(line);
    }
}

impl Runner<'_> {
    /// Fails where a program is not installed.
    pub(crate) fn find(&self, program: Program, argument: &str) -> Result<(), ImportError> {
        let call = Call::new(program, ".", "say its version").args([argument]);
        self.run(call, Sink::Lines(&mut |_| {})).or_else(|e| match e {
            ImportError::Failed { .. } => Ok(()),
            e => Err(e),
        })
    }

    /// Runs a call to its end.
    ///
    /// # Errors
    /// [`ImportError::Missing`], [`ImportError::Failed`], [`ImportError::Stopped`].
    pub(crate) fn run(&self, call: Call, mut sink: Sink<'_>) -> Result<(), ImportError> {
        let mut child = Killed(call.start()?);
        let (sender, pieces) = sync_channel(16);
        child.0.stderr.take().into_iter().for_each(|e| forward(e, false, sender.clone()));
        child.0.stdout.take().into_iter().for_each(|o| forward(o, true, sender.clone()));
        drop(sender);
        let words: Vec<_> = call.arguments.iter().map(|a| a.to_string_lossy()).collect();
        self.note(&format!("\n$ {} {}", call.program.name, words.join(" ")));
        let tail = self.listen(&pieces, &mut sink, &call.task)?;
        let status = self.wait(&mut child.0, &call)?;
        if self.stop.load(Ordering::Relaxed) {
            return Err(ImportError::Stopped { task: call.task });
        }
        if status.success() {
            return Ok(());
        }
        let Program { name: program, install } = call.program;
        Err(ImportError::Failed { program, install, task: call.task, status, tail, log: self.log.clone() })
    }

    /// Hears all output; gives the last lines.
    fn listen(&self, pieces: &Receiver<Piece>, sink: &mut Sink<'_>, task: &str) -> Result<Vec<String>, ImportError> {
        let mut streams = [Lines::default(), Lines::default()];
        loop {
            if self.stop.load(Ordering::Relaxed) {
                return Err(ImportError::Stopped { task: task.to_owned() });
            }
            let mut said = Vec::new();
            let piece = pieces.recv_timeout(LOOK_EVERY);
            match (&piece, &mut *sink) {
                (Err(RecvTimeoutError::Timeout), _) => continue,
                (Err(RecvTimeoutError::Disconnected), _) => streams.iter_mut().for_each(|s| s.end(&mut said)),
                (Ok((true, bytes)), Sink::Bytes(each)) => each(bytes),
                (Ok((is_out, bytes)), _) => streams[usize::from(*is_out)].take(bytes, &mut said),
            }
            self.note(&said.join("\n"));
            if let Sink::Lines(each) = sink {
                said.iter().for_each(|line| each(line));
            }
            if piece.is_err() {
                let [errors, mut out] = streams.map(|s| s.tail);
                out.extend(errors);
                return Ok(out.split_off(out.len().saturating_sub(TAIL)));
            }
        }
    }

    /// Waits for a child that has closed its output.
    fn wait(&self, child: &mut Child, call: &Call) -> Result<ExitStatus, ImportError> {
        loop {
            if self.stop.load(Ordering::Relaxed) {
                return Err(ImportError::Stopped { task: call.task.clone() });
            }
            match child.try_wait().map_err(ImportError::os("wait for a program in", &call.folder))? {
                Some(status) => return Ok(status),
                None => std::thread::sleep(LOOK_EVERY / 10),
            }
        }
    }

    /// Lines of the log. A log that cannot be written stops nothing.
    fn note(&self, line: &str) {
        if line.is_empty() {
            return;
        }
        let file = std::fs::OpenOptions::new().create(true).append(true).open(&self.log);
        let _ = file.and_then(|mut f| writeln!(f, "{line}"));
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    const SH: Program = Program { name: "sh", install: "" };

    fn run(script: &str, stop: &AtomicBool, sink: Sink<'_>) -> (Result<(), ImportError>, String) {
        let dir = tempfile::tempdir().unwrap();
        let runner = Runner { stop, log: dir.path().join("log") };
        let done = runner.run(Call::new(SH, dir.path(), "run").args(["-c", script]), sink);
        (done, std::fs::read_to_string(dir.path().join("log")).unwrap_or_default())
    }

    #[test]
    fn lines_of_both_streams_are_heard_and_kept() {
        let mut heard = Vec::new();
        let script = "echo one; printf 'two\\rthree' ; echo oops >&2; exit 3";
        let (done, log) = run(script, &AtomicBool::new(false), Sink::Lines(&mut |l| heard.push(l.to_owned())));
        heard.sort();
        assert_eq!(heard, ["one", "oops", "three", "two"]);
        let text = done.unwrap_err().to_string();
        assert!(text.contains("exit status: 3") && text.contains("| oops") && log.contains("$ sh -c"), "{text} {log}");
    }

    #[test]
    fn bytes_come_as_they_are() {
        let mut bytes = Vec::new();
        let (done, _) = run(
            "printf 'a\\n\\0b'; echo said >&2",
            &AtomicBool::new(false),
            Sink::Bytes(&mut |b| bytes.extend_from_slice(b)),
        );
        assert!(done.is_ok() && bytes == b"a\n\0b");
    }

    #[test]
    fn a_child_ends_when_it_is_asked_to_and_has_neither_input_nor_environment() {
        let stop = AtomicBool::new(false);
        let begun = std::time::Instant::now();
        let (done, _) = std::thread::scope(|s| {
            let waiting = s.spawn(|| run("exec sleep 30", &stop, Sink::Lines(&mut |_| {})));
            std::thread::sleep(Duration::from_millis(150));
            stop.store(true, Ordering::Relaxed);
            waiting.join().unwrap()
        });
        assert!(matches!(done, Err(ImportError::Stopped { .. })) && begun.elapsed() < Duration::from_secs(10));
        let mut heard = Vec::new();
        let script = "cat; echo \"[$CARGO_MANIFEST_DIR]\"";
        run(script, &AtomicBool::new(false), Sink::Lines(&mut |l| heard.push(l.to_owned()))).0.unwrap();
        assert_eq!(heard, ["[]"]);
    }

    #[test]
    fn a_missing_program_is_named_with_its_package() {
        let program = Program { name: "gs4d-no-such-program", install: "apt install it" };
        let (stop, log) = (AtomicBool::new(false), PathBuf::from("/nowhere/log"));
        let runner = Runner { stop: &stop, log };
        let missing = |program: Program| {
            let e = runner.find(program, "-version").unwrap_err();
            assert!(matches!(e, ImportError::Missing { install: "apt install it", .. }), "{e}");
        };
        missing(program);
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("no-program");
        std::fs::write(&file, "text").unwrap();
        missing(Program { name: file.display().to_string().leak(), ..program });
    }
}
