//! The Python package as a wheel with the native module of this build, installed by pip, and its own tests.
//!
//! `cargo test -p gs4d-py --features python` runs them by the interpreter `GS4D_PYTHON`, `python3` by default, which needs numpy,
//! pytest and pip; they are skipped by name where it has not. Nothing is installed among its packages.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The folder of this test, where the native module was built too; the program `gs4d` is in the one above.
fn built() -> PathBuf {
    let exe = std::env::current_exe().expect("a path of this test");
    exe.parent().expect("a folder of the build").to_owned()
}

/// Cargo's name of the native module.
fn module() -> String {
    format!("{}gs4d_py{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX)
}

/// Runs the interpreter in the folder of the package; its standard output.
fn run(python: &mut Command) -> String {
    let output = python.current_dir(env!("CARGO_MANIFEST_DIR")).output().expect("an interpreter");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{python:?}: {text}{}", String::from_utf8_lossy(&output.stderr));
    text
}

/// Packs the wheel and installs it in `root`.
fn install(python: &str, root: &Path) {
    let _ = std::fs::remove_dir_all(root);
    std::fs::create_dir_all(root).expect("a folder");
    let mut pack = Command::new(python);
    pack.arg("tests/pack_wheel.py").arg(built().join(module())).arg(env!("CARGO_PKG_VERSION")).arg(root);
    let wheel = run(&mut pack);
    let mut pip = Command::new(python);
    pip.args(["-m", "pip", "install", "-q", "--no-index", "--no-deps", "--no-compile", "--disable-pip-version-check"]);
    run(pip.arg("--target").arg(root.join("packages")).arg(wheel.trim()));
}

/// Not `println!`, whose output the test harness captures: skipped tests are to be seen.
fn say(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

#[test]
fn the_tests_of_the_package_pass() {
    let python = std::env::var("GS4D_PYTHON").unwrap_or_else(|_| "python3".into());
    let has = Command::new(&python).args(["-c", "import numpy, pip, pytest"]).output();
    if !has.is_ok_and(|output| output.status.success()) {
        say(&format!(
            "SKIPPED Python: {python} with numpy, pip and pytest is not there (GS4D_PYTHON names the interpreter)"
        ));
        return;
    }
    let root = Path::new(env!("CARGO_TARGET_TMPDIR")).join("package");
    install(&python, &root);
    let mut tests = Command::new(&python);
    tests.args(["-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider", "tests"]);
    tests.env("PYTHONPATH", root.join("packages")).env("PYTHONDONTWRITEBYTECODE", "1");
    let program = built().join("..").join(format!("gs4d{}", std::env::consts::EXE_SUFFIX));
    if program.is_file() {
        tests.env("GS4D_PROGRAM", program);
    }
    say(&run(&mut tests));
}
