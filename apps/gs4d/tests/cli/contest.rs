//! Contests: fair trials, kept once made.

use crate::support::{Call, data, good, gs4d, text};
use std::fs;

#[test]
fn trials_are_scored_kept_and_never_mixed_up() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("contest");
    let base = [
        "compare",
        "methods",
        text(data()),
        "--preset",
        "tiny",
        "-e",
        "static3d",
        "-e",
        "static3d schedule.lambda_dssim=0",
    ];
    let contest = |call: fn(&[&str]) -> Call, more: &[&str]| call(&[&base[..], &["-o", text(&root)], more].concat());
    let call = contest(good, &["--steps", "12", "--seeds", "0,1", "--json"]);
    let entries = call.json()["entries"].as_array().unwrap().clone();
    assert_eq!(entries.len(), 2);
    for entry in &entries {
        assert_eq!((entry["steps"].as_u64(), entry["trials"].as_array().unwrap().len()), (Some(12), 2));
        assert!(entry["over_seeds"]["psnr"]["mean"].as_f64().unwrap() > 5.0, "{entry}");
    }
    assert!(root.join("static3d/seed-1/metrics.json").is_file());
    let read = |name: &str| std::fs::read_to_string(root.join(name)).unwrap();
    let table: Vec<String> = read("compare.csv").lines().map(str::to_owned).collect();
    assert!(
        table.len() == 3 && table[0].starts_with("entry,steps,seeds,") && table[1].starts_with("\"static3d\",12,2,")
    );
    let of_header = table[0].split(',').count();
    assert!(table.iter().all(|l| l.split(',').count() == of_header), "{table:?}");
    let page = read("compare.html");
    assert!(page.contains("static3d schedule.lambda_dssim=0") && page.contains("Course of training"));
    let psnr = |k: usize, seed: u64| {
        let run = entries[k]["trials"].as_array().unwrap().iter().find(|t| t["seed"] == seed).unwrap()["run"].clone();
        let metrics = std::fs::read_to_string(format!("{}/metrics.json", run.as_str().unwrap())).unwrap();
        serde_json::from_str::<serde_json::Value>(&metrics).unwrap()["mean"]["psnr"].as_f64().unwrap()
    };
    for k in [0, 1] {
        let want = [0, 1].map(|seed| psnr(k, seed) - psnr(0, seed));
        let trials = entries[k]["trials"].as_array().unwrap();
        let less: Vec<f64> = trials.iter().map(|t| t["psnr_less_the_first"].as_f64().unwrap()).collect();
        // No view is without error, so the mean difference is the difference of the means.
        let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
        assert!(less.iter().zip(want).all(|(a, b)| near(*a, b)), "the same seeds: {less:?} {want:?}");
        let mean = entries[k]["psnr_less_the_first"]["mean"].as_f64().unwrap();
        assert!(near(mean, (want[0] + want[1]) / 2.0), "{mean}");
    }

    let again = contest(good, &["--steps", "12", "--seeds", "0,1"]);
    assert!(!again.err.contains("seed-0"), "nothing is trained twice: {}", again.err);
    assert!(again.out.contains("static3d schedule.lambda_dssim=0") && again.out.contains("+0.00"), "{}", again.out);
    let tables = || ["compare.json", "compare.csv", "compare.html"].map(read);
    let before = tables();
    let other = contest(gs4d, &["--steps", "13"]);
    assert!(other.code == 6 && other.err.contains("other settings") && other.err.contains("-o"), "{}", other.err);
    assert!(other.out.is_empty() && tables() == before, "without a trial that stands nothing is written");
    fs::write(root.join("compare.csv"), "mine").unwrap();
    contest(gs4d, &["--steps", "12"]).fails(6, &["compare.csv", "gs4d did not write it", "-f"]);
    assert_eq!(read("compare.csv"), "mine");
    contest(good, &["--steps", "12", "--seeds", "0,1", "-f"]);
    assert_eq!(read("compare.csv"), before[1]);
    assert!(!again.out.contains("not alike"));
    let mixed = contest(good, &["--steps", "12", "--seeds", "0,1,2", "--threads", "7"]).out;
    assert!(mixed.contains("; not alike: ") && mixed.contains(", 7 threads"), "{mixed}");
}

#[test]
fn bad_entries_are_refused_before_anything_is_trained() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("contest");
    // By its older name.
    let with = |entry: &str| gs4d(&["contest", text(data()), "-o", text(&root), "-e", "static3d:tiny", "-e", entry]);
    with("nosuch").fails(2, &["nosuch", "static3d"]);
    assert!(with("static3d nosuch=1").err.contains("gs4d compare methods"));
    with("static3d:quick").fails(2, &["quick", "tiny"]);
    with("static3d nosuch=1").fails(2, &["nosuch"]);
    with("static3d quick").fails(2, &["KEY=VALUE"]);
    with("dut").fails(2, &["`dut` needs a filmed person"]);
    let twice = ["compare", "methods", text(data()), "-o", text(&root), "-e", "static3d:tiny", "--seeds", "0,1,0"];
    gs4d(&twice).fails(2, &["seed 0 is given twice"]);
    assert!(!root.exists());
}

#[test]
fn entries_of_different_lengths_are_told() {
    let dir = tempfile::tempdir().unwrap();
    let (root, jobs) = (dir.path().join("contest"), dir.path().join("jobs.txt"));
    let base = ["compare", "methods", text(data()), "-e", "static3d", "-e", "fourdgs", "-f", "-o", text(&root)];
    let said = |more: &[&str]| good(&[&base[..], &["--plan", text(&jobs)], more].concat()).err;
    assert!(said(&[]).contains("warning: entries train for different numbers of steps (static3d "));
    assert_eq!([said(&["--steps", "9"]), said(&["--time-budget", "9s", "-q"])].concat(), "");
}

#[test]
fn scores_of_other_data_are_neither_kept_nor_taken_for_those_of_a_trial() {
    let dir = tempfile::tempdir().unwrap();
    let [own, other, root] = ["own", "other", "contest"].map(|name| dir.path().join(name));
    let views = ["--size", "32", "--train-views", "4", "--val-views", "0", "--test-views", "2"];
    good(&[&["synth", "balls", "-o", text(&own)][..], &views].concat());
    good(&[&["synth", "static", "-o", text(&other)][..], &views].concat());
    let base = ["compare", "methods", text(&own), "-e", "static3d", "--preset", "tiny", "--steps", "4"];
    let contest = |call: fn(&[&str]) -> Call| call(&[&base[..], &["-o", text(&root), "--json"]].concat());
    let first = contest(good).out;
    let run = root.join("static3d/seed-0");
    let metrics = || fs::read_to_string(run.join("metrics.json")).unwrap();
    let before = metrics();

    let call = good(&["eval", text(&run), "--data", text(&other)]);
    assert!(call.err.contains("are not those that the run knows"), "{}", call.err);
    assert!(!call.out.contains("-> ") && metrics() == before, "{}", call.out);
    assert_eq!(contest(good).out, first);
    // Scores that name other data are made anew.
    let digest = serde_json::from_str::<serde_json::Value>(&before).unwrap()["data_digest"].clone();
    fs::write(run.join("metrics.json"), before.replace(digest.as_str().unwrap(), "0123456789abcdef")).unwrap();
    assert_eq!(contest(good).json()["entries"], serde_json::from_str::<serde_json::Value>(&first).unwrap()["entries"]);
    assert_eq!(metrics(), before);

    fs::copy(own.join("test/r_000.png"), own.join("test/r_001.png")).unwrap();
    assert!(good(&["eval", text(&run)]).err.contains("is left as it is"));
    assert_eq!(metrics(), before);
    let call = contest(gs4d);
    let advice = format!("gs4d resume {} --accept-changed-data", run.display());
    assert!(call.code == 3 && call.err.contains("data.changed") && call.err.contains(&advice), "{}", call.err);
    good(&["resume", text(&run), "--accept-changed-data", "-q"]);
    assert_ne!(contest(good).out, first);
}
