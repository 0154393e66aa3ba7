//! Comparisons of runs: one table, one page, refusals.

use crate::support::{data, good, gs4d, run, text, train};
use std::fs;

#[test]
fn runs_of_the_same_data_are_compared() {
    let dir = tempfile::tempdir().unwrap();
    let (other, page) = (dir.path().join("other"), dir.path().join("compare.html"));
    train(data(), &other, &["--seed", "5"]);
    let call = ["compare", text(run()), text(&other), "-o", text(&page)];
    let output = good(&call);
    for part in ["run (fourdgs)", "other (fourdgs)", "ms/frame", "other against run: ", "are one recipe", "48×48"] {
        assert!(output.out.contains(part), "`{part}` is not in {}", output.out);
    }
    let html = fs::read_to_string(&page).unwrap();
    for part in ["Paired differences", "Where they disagree most", "Course of training", "Content-Security-Policy"] {
        assert!(html.contains(part), "{part}");
    }
    assert!(!html.contains("run.method"), "no setting differs");
    assert!(!html.contains("https://") && html.matches("src=\"").count() == html.matches("src=\"data:image/").count());

    gs4d(&call).fails(6, &["exists already", "-f"]);
    assert_eq!(fs::read_to_string(&page).unwrap(), html, "nothing is overwritten unasked");
    let json = good(&[&call[..], &["-f", "--json", "--against", "first", "--views", "1"]].concat()).json();
    assert_ne!(fs::read_to_string(&page).unwrap(), html);
    assert_eq!((json["runs"].as_array().unwrap().len(), json["views"].as_array().unwrap().len()), (2, 2));
    let psnr = |k: usize| json["runs"][k]["scores"]["mean"]["psnr"].as_f64().unwrap();
    let difference = json["differences"][0]["over_views"]["mean"].as_f64().unwrap();
    assert!((difference - (psnr(1) - psnr(0))).abs() < 1e-9, "{difference}");
    assert!(json["runs"][1]["psnr_to_first"].as_f64().unwrap() > 10.0 && json["runs"][0]["psnr_to_first"].is_null());

    // A checkpoint is as good as its run, and equal to it.
    let file = run().join("checkpoints/step-000040.gs4d");
    let json = good(&["compare", text(run()), text(&file), "--json", "--split", "val"]).json();
    assert_eq!(json["differences"][0]["over_views"]["mean"], 0.0);
    assert!(
        json["runs"][1]["psnr_to_first"].is_null() && json["conditions"].as_str().unwrap().starts_with("2 val views")
    );
}

#[test]
fn runs_of_other_data_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let (small, other) = (dir.path().join("small"), dir.path().join("other"));
    let views = ["--train-views", "8", "--val-views", "2", "--test-views", "2"];
    good(&[&["synth", "balls", "-o", text(&small), "--size", "32"][..], &views].concat());
    train(&small, &other, &[]);
    let page = dir.path().join("compare.html");
    let call = ["compare", text(run()), text(&other), "-o", text(&page)];
    gs4d(&call).fails(3, &["not of the same data", "size (48×48, 32×32)", "data digest"]);
    assert!(!page.exists());
    let on_the_small = good(&["compare", text(run()), text(&other), "--data", text(&small)]).err;
    assert!(on_the_small.contains(&format!("{} was trained on other data", run().display())), "{on_the_small}");
    assert_eq!(on_the_small.matches("was trained on other data").count(), 1, "{on_the_small}");
    gs4d(&["compare", text(run())]).fails(2, &["RUN"]);
    gs4d(&["compare", text(run()), text(&small)]).fails(3, &["no run folder"]);
    gs4d(&["compare", text(run()), text(run()), "--against", "first"]).fails(2, &["--out"]);
}

#[test]
fn the_folder_of_a_file_is_made() {
    let dir = tempfile::tempdir().unwrap();
    let out = |name: &str| text(&dir.path().join(name).join("new").join(name)).to_owned();
    let (page, player, splats, scene, jobs) = (out("a.html"), out("b.html"), out("c.ply"), out("d.gs4d"), out("e.txt"));
    let run = text(run());
    good(&["compare", run, run, "-o", &page]);
    good(&["export", run, "-o", &player, "--no-eval", "--times", "0..1:2", "-q"]);
    good(&["export", run, "-o", &splats, "--no-eval", "-q"]);
    good(&["export", run, "-o", &scene, "--no-eval", "-q"]);
    good(&["compare", "methods", text(data()), "-e", "static3d", "-o", &out("trials"), "--plan", &jobs]);
    for file in [page, player, splats, scene, jobs] {
        assert!(fs::metadata(&file).is_ok_and(|m| m.len() > 0), "{file}");
    }
    // A folder that cannot be made is an error before anything is rendered.
    let below_a_file = dir.path().join("a.html/new/a.html/c.html");
    let call = gs4d(&["compare", run, run, "-o", text(&below_a_file)]);
    call.fails(6, &["create the folder", "a.html"]);
    assert!(!call.err.contains("rendering"), "{}", call.err);
}
