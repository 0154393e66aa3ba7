//! Calls of the program and shared inputs.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;
use tempfile::TempDir;

/// What a call gave.
pub struct Call {
    pub code: i32,
    pub out: String,
    pub err: String,
}

impl Call {
    pub fn of(output: &Output) -> Self {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Self { code: output.status.code().unwrap_or(-1), out: text(&output.stdout), err: text(&output.stderr) }
    }

    /// Stdout as one JSON value.
    pub fn json(&self) -> Value {
        assert_eq!(self.code, 0, "{}", self.err);
        serde_json::from_str(&self.out).unwrap_or_else(|e| panic!("{e}: {}", self.out))
    }

    /// The exit code, and words that must be in the message.
    pub fn fails(&self, code: i32, words: &[&str]) {
        assert_eq!(self.code, code, "{}{}", self.out, self.err);
        for word in words {
            assert!(self.err.contains(word), "`{word}` is not in: {}", self.err);
        }
        assert!(self.out.is_empty(), "a failure prints nothing on stdout: {}", self.out);
    }
}

pub fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gs4d"));
    command.args(arguments);
    command
}

pub fn gs4d(arguments: &[&str]) -> Call {
    Call::of(&command(arguments).output().unwrap())
}

/// A call that must succeed.
pub fn good(arguments: &[&str]) -> Call {
    let call = gs4d(arguments);
    assert_eq!(call.code, 0, "{arguments:?}: {}", call.err);
    call
}

pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Steps of the shared run.
pub const STEPS: u32 = 40;

struct Shared {
    _dir: TempDir,
    data: PathBuf,
    run: PathBuf,
    ply: PathBuf,
}

fn shared() -> &'static Shared {
    // A static is never dropped: its folder stays in that of the build.
    static SHARED: OnceLock<Shared> = OnceLock::new();
    SHARED.get_or_init(|| {
        let dir = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
        let (data, run) = (dir.path().join("data"), dir.path().join("run"));
        let views = ["--train-views", "8", "--val-views", "2", "--test-views", "2"];
        good(&[&["synth", "balls", "-o", text(&data), "--size", "48"][..], &views].concat());
        train(&data, &run, &[]);
        let ply = dir.path().join("scene.ply");
        std::fs::write(&ply, tiny_ply(&[[0.0, 0.0, 3.0]])).unwrap();
        Shared { _dir: dir, data, run, ply }
    })
}

/// A generated data set of 48x48 pixels.
pub fn data() -> &'static Path {
    &shared().data
}

/// A finished run on it.
pub fn run() -> &'static Path {
    &shared().run
}

/// A splat file with one red splat in front of [`CAMERA`].
pub fn ply() -> &'static Path {
    &shared().ply
}

/// Trains the smallest recipe.
pub fn train(data: &Path, run: &Path, more: &[&str]) -> Call {
    let steps = STEPS.to_string();
    let all = ["train", text(data), "-m", "fourdgs", "--preset", "tiny", "--steps", &steps, "-o", text(run), "--quiet"];
    good(&[&all[..], more].concat())
}

/// A camera at the origin that looks along +z.
pub const CAMERA: &str = r#"{"width": 20, "height": 16, "fx": 20, "fy": 20, "cx": 10, "cy": 8, "name": "front",
    "world_to_camera": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}"#;

/// A splat file of the 3DGS layout with red splats of degree 0.
pub fn tiny_ply(means: &[[f32; 3]]) -> Vec<u8> {
    let names = [
        "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1",
        "rot_2", "rot_3",
    ];
    let properties: String = names.iter().map(|n| format!("property float {n}\n")).collect();
    let mut bytes =
        format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n{properties}end_header\n", means.len())
            .into_bytes();
    for m in means {
        let rest = [1.7f32, -1.7, -1.7, 4.0, -1.5, -1.5, -1.5, 1.0, 0.0, 0.0, 0.0];
        bytes.extend(m.iter().chain(&rest).flat_map(|v| v.to_le_bytes()));
    }
    bytes
}
