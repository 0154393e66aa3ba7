//! What the tests work with: calls of the program, a served viewer, and a browser with folders for data, runs and screenshots.

use crate::chromium::{self, Chromium};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use tempfile::TempDir;

/// Whether the side of that name shows its picture at rest.
pub fn at_rest(side: char) -> String {
    format!(
        "/ (rest|fine)$/.test(document.body.dataset.{side}) && sides.{side}.want === null && sides.{side}.is >= REST"
    )
}

/// The pixels shown, as text.
pub const PIXELS: &str = "$('a').toDataURL()";
/// Distinct colours shown.
pub const COLORS: &str = "new Set(new Uint32Array($('a').getContext('2d').getImageData(0, 0, $('a').width, $('a').height).data.buffer)).size";

/// A served viewer.
pub struct Viewer {
    child: Child,
    pub url: String,
}

impl Drop for Viewer {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn gs4d(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gs4d"));
    command.args(arguments);
    command
}

pub fn good(arguments: &[&str]) {
    let output = gs4d(arguments).output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
}

pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

impl Viewer {
    /// A call that prints the address of a viewer.
    pub fn start(arguments: &[&str]) -> Self {
        let mut child = gs4d(arguments).stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
        let url = lines.find_map(|l| l.split_once("http://").map(|(_, url)| format!("http://{url}"))).unwrap();
        std::thread::spawn(move || lines.for_each(drop));
        Self { child, url }
    }
}

/// Folders for data and runs, a browser, and where screenshots go.
pub struct Desk {
    pub dir: TempDir,
    pub browser: Chromium,
    pub shots: PathBuf,
}

impl Desk {
    pub fn new() -> Option<Self> {
        let Some(program) = chromium::find() else {
            println!("SKIPPED: no chromium on the path");
            return None;
        };
        let shots = Path::new(env!("CARGO_TARGET_TMPDIR")).join("browser");
        std::fs::create_dir_all(&shots).unwrap();
        Some(Self { dir: tempfile::tempdir().unwrap(), browser: Chromium::start(&program), shots })
    }

    /// Balls that bounce, 64×64 pixels.
    pub fn balls(&self) -> PathBuf {
        let data = self.dir.path().join("balls");
        let views = ["--size", "64", "--train-views", "16", "--val-views", "0", "--test-views", "3"];
        good(&[&["synth", "balls", "-o", text(&data)][..], &views].concat());
        data
    }

    /// A filmed person.
    pub fn film(&self) -> PathBuf {
        let data = self.dir.path().join("film");
        let small = ["--cams", "8x1", "--frames", "4", "--size", "64", "--points", "500"];
        good(&[&["synth", "avatar", "-o", text(&data)][..], &small].concat());
        data
    }

    pub fn train(&self, data: &Path, method: &str, more: &[&str]) -> PathBuf {
        let run = self.dir.path().join(format!("run-{method}"));
        let recipe = ["-m", method, "--preset", "tiny", "--quiet", "-o", text(&run)];
        good(&[&["train", text(data)][..], &recipe, more].concat());
        run
    }

    pub fn shot(&mut self, name: &str) {
        let file = self.shots.join(format!("{name}.png"));
        self.browser.shot(&file);
    }

    /// Opens an address and waits for its first picture.
    pub fn open(&mut self, url: &str) {
        self.browser.resize(1000, 800);
        self.browser.open(url);
        self.browser.until("document.readyState === 'complete' && typeof sides !== 'undefined'");
        self.browser.until(&at_rest('a'));
    }

    /// Waits for the next picture at rest; whether it is another one.
    pub fn changed(&mut self, before: &serde_json::Value) -> bool {
        self.browser.until(&at_rest('a'));
        self.browser.eval(PIXELS) != *before
    }

    pub fn no_complaints(&mut self, of: &str) {
        assert!(self.browser.complaints.is_empty(), "{of}: {:?}", self.browser.complaints);
        assert_eq!(
            self.browser.eval("$('notice').hidden"),
            true,
            "{of}: {}",
            self.browser.eval("$('notice').textContent")
        );
    }

    /// Presses a button of the group Compare.
    pub fn compare(&mut self, mode: &str) {
        self.browser.eval(&format!("document.querySelector('#compare button[value=\"{mode}\"]').click()"));
    }

    /// Presses the thumbnail of a layer.
    pub fn layer(&mut self, name: &str) {
        self.browser.eval(&format!("document.querySelector('[data-layer=\"{name}\"]').click()"));
    }

    /// Drags across the scene.
    pub fn drag(&mut self) {
        let [x, y] = self.browser.middle("stage");
        let places: Vec<_> = (0..8).map(|k| [x + 12.0 * f64::from(k), y + 4.0 * f64::from(k)]).collect();
        self.browser.drag(&places);
        self.browser.until("performance.now() - moving > 200");
    }
}
