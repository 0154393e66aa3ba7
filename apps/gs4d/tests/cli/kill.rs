//! Kills at any moment: whatever has its final name is whole, and the same call begun again succeeds and leaves nothing behind.
//!
//! `cargo test --release -p gs4d --test cli kill -- --ignored --test-threads 1` kills every verb that writes 50 times
//! (`GS4D_KILLS` sets another number).
#![cfg(unix)]

use crate::support::{command, data, good, run, text};
use crate::whole::{assert_swept, assert_whole};
use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::time::Instant;

fn kills() -> u32 {
    std::env::var("GS4D_KILLS").ok().and_then(|n| n.parse().ok()).unwrap_or(50)
}

/// Kills the call at moments spread over its length; after each kill every file in `out` is whole.
fn killed(name: &str, arguments: &[&str], out: &Path, prepare: impl Fn()) {
    let start = || command(arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    prepare();
    let begun = Instant::now();
    let whole = start().wait().unwrap();
    assert!(whole.success(), "{name}: {arguments:?} fails by itself");
    let length = begun.elapsed();
    let (mut landed, kills) = (0, kills());
    for k in 0..kills {
        prepare();
        let mut child = start();
        std::thread::sleep(length.mul_f64(f64::from(k) / f64::from(kills)));
        landed += u32::from(child.try_wait().unwrap().is_none());
        let _ = child.kill();
        child.wait().unwrap();
        assert_whole(out, &format!("{name}, kill {k}"));
    }
    good(arguments);
    assert_swept(out, name);
    eprintln!("{name}: {landed} of {kills} kills before the end of {length:.1?}");
    assert!(landed > kills / 2, "{name} was hardly ever killed in time");
}

#[test]
#[ignore = "minutes: kills every verb 50 times"]
fn every_verb_that_writes() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let nothing = || ();
    let train = ["train", text(data()), "-m", "fourdgs", "--preset", "tiny", "--steps", "60", "-q", "-f"];
    let often = ["--set", "run.checkpoint_every=1"];
    let own = at("train");
    killed("train", &[&train[..], &often, &["-o", text(&own)]].concat(), &own, nothing);

    let resumed = at("resume");
    let again = || {
        let _ = fs::remove_dir_all(&resumed);
        good(&[&train[..], &["--time-budget", "0.001s", "-o", text(&resumed)]].concat());
    };
    killed("resume", &["resume", text(&resumed), "-q"], &resumed, again);

    let files = at("files");
    fs::create_dir(&files).unwrap();
    let out = |name: &str| text(&files.join(name)).to_owned();
    killed("compact", &["compact", text(run()), "-o", &out("a.gs4d"), "-f", "-q"], &files, nothing);
    killed("export", &["export", text(run()), "--times", "0..1:8", "-o", &out("plys"), "-f", "-q"], &files, nothing);
    let orbit = ["--camera", "orbit", "--times", "0..1:40"];
    killed(
        "render",
        &[&["render", text(run())][..], &orbit, &["-o", &out("orbit"), "-f", "-q"]].concat(),
        &files,
        nothing,
    );
    killed("forecast", &["forecast", text(run()), "--until", "3", "-o", &out("future"), "-f", "-q"], &files, nothing);
    killed("compare", &["compare", text(run()), text(run()), "-o", &out("c.html"), "-f", "-q"], &files, nothing);
    killed("synth", &["synth", "sheet", "--size", "32", "-o", &out("sheet"), "-f", "-q"], &files, nothing);
    killed("eval", &["eval", text(&resumed), "-q"], &resumed, nothing);

    let entries = ["-e", "static3d", "-e", "fourdgs", "--preset", "tiny", "--steps", "20"];
    let contest = at("contest");
    let clean = |folder: &Path| drop(fs::remove_dir_all(folder));
    killed(
        "contest",
        &[&["contest", text(data())][..], &entries, &["-o", text(&contest), "-q"]].concat(),
        &contest,
        || {
            clean(&contest);
        },
    );
    let rounds =
        ["-m", "fourdgs", "--preset", "tiny", "--steps-first", "20", "--steps-later", "10", "--rounds", "0.3,0.6"];
    let continual = at("continual");
    killed(
        "continual",
        &[&["continual", text(data())][..], &rounds, &["-o", text(&continual), "-q"]].concat(),
        &continual,
        || {
            clean(&continual);
        },
    );
}
