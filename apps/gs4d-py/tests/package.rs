//! The Python package with the native module of this build, and its own tests.
//!
//! `cargo test -p gs4d-py --features python` runs them by the interpreter `GS4D_PYTHON`, `python3` by default, which needs numpy
//! and pytest; they are skipped by name where it has not.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The folder of this test, where the native module was built too; the program `gs4d` is in the one above.
fn built() -> PathBuf {
    let exe = std::env::current_exe().expect("a path of this test");
    exe.parent().expect("a folder of the build").to_owned()
}

/// Names of the native module: as cargo calls it, and as Python does.
fn names() -> (&'static str, &'static str) {
    match std::env::consts::OS {
        "windows" => ("gs4d_py.dll", "_gs4d.pyd"),
        "macos" => ("libgs4d_py.dylib", "_gs4d.abi3.so"),
        _ => ("libgs4d_py.so", "_gs4d.abi3.so"),
    }
}

/// The package as a wheel would install it.
fn assemble(root: &Path) {
    let package = root.join("gs4d");
    std::fs::create_dir_all(&package).expect("a folder");
    let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("python/gs4d");
    for entry in std::fs::read_dir(&sources).expect("the package's sources") {
        let path = entry.expect("an entry").path();
        if path.extension().is_some_and(|e| e == "py") {
            std::fs::copy(&path, package.join(path.file_name().expect("a name"))).expect("a copy");
        }
    }
    let (from, to) = names();
    std::fs::copy(built().join(from), package.join(to)).unwrap_or_else(|e| panic!("{from}: {e}"));
}

/// Not `println!`, whose output the test harness captures: skipped tests are to be seen.
fn say(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

#[test]
fn the_tests_of_the_package_pass() {
    let python = std::env::var("GS4D_PYTHON").unwrap_or_else(|_| "python3".into());
    let has = Command::new(&python).args(["-c", "import numpy, pytest"]).output();
    if !has.is_ok_and(|output| output.status.success()) {
        say(&format!(
            "SKIPPED Python: {python} with numpy and pytest is not there (GS4D_PYTHON names the interpreter)"
        ));
        return;
    }
    let root = Path::new(env!("CARGO_TARGET_TMPDIR")).join("package");
    assemble(&root);
    let mut tests = Command::new(&python);
    tests
        .args(["-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider", "tests"])
        .current_dir(env!("CARGO_MANIFEST_DIR"));
    tests.env("PYTHONPATH", &root).env("PYTHONDONTWRITEBYTECODE", "1");
    let program = built().join("..").join(format!("gs4d{}", std::env::consts::EXE_SUFFIX));
    if program.is_file() {
        tests.env("GS4D_PROGRAM", program);
    }
    let output = tests.output().expect("an interpreter");
    say(&String::from_utf8_lossy(&output.stdout));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}
