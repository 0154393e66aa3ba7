//! A whole run whose boundaries move: recorded in its event log, summed up, and shown in its report.

use gs_method_anchor::journal::Journal;
use gs_synth::{self as synth, SynthOptions};
use gs4d_run::{Outcome, Request, Training, folder, settings};
use std::sync::atomic::AtomicBool;

const SETS: [&str; 13] = [
    "init.points=150",
    "schedule.stages.global.steps=10",
    "schedule.stages.local.steps=60",
    "intervals.segments=3",
    "intervals.from=1",
    "intervals.until=30",
    "intervals.period=10",
    "intervals.tau=0.5",
    "intervals.step=0.2",
    "adapt.observe_from=0",
    "adapt.from=5",
    "adapt.every=10",
    "adapt.grad=2e-5",
];

#[test]
fn a_report_shows_where_boundaries_went() {
    let dir = tempfile::tempdir().expect("a folder");
    let (data, root) = (dir.path().join("data"), dir.path().join("run"));
    let small = SynthOptions::of_views(32, 24, 1);
    synth::write(&data, "sheet", &small, false).expect("data");
    let request = Request {
        method: "modec".into(),
        preset: "tiny".into(),
        data: Some(data),
        sets: SETS.map(str::to_owned).to_vec(),
        ..Request::default()
    };
    let mut training =
        Training::begin(&root, false, settings::resolve(gs_methods::registry(), &request).expect("settings"))
            .expect("a run");
    assert_eq!(training.train(&AtomicBool::new(false), &mut |_, _| ()).expect("training"), Outcome::Finished);
    training.report(&training.score().expect("scores")).expect("a report");

    let journal = Journal::of(&training.folder().log_lines(folder::JOURNAL).expect("the journal"));
    assert_eq!(
        journal.passes.iter().map(|p| p.step).collect::<Vec<_>>(),
        [20, 30, 40],
        "10, 20, 30 of the local stage"
    );
    assert!(!journal.growth.is_empty() && journal.passes.iter().any(|p| !p.intervals.moves.is_empty()), "{journal:?}");
    let mut starts = Vec::new();
    training.trainer().model().visit(&mut |p| {
        if p.name == "intervals.starts" {
            starts.clone_from(&p.value);
        }
    });
    assert_eq!(journal.passes[2].starts, starts);
    let ends: Vec<f64> = journal.curves().iter().map(|c| c.points[c.points.len() - 1].1).collect();
    assert_eq!(ends, starts[1..].iter().map(|&s| f64::from(s)).collect::<Vec<_>>());

    let html = training.folder().read(folder::REPORT).expect("the page");
    for shown in
        ["Intervals and anchors", "Boundaries, normalised time", "<summary>3 passes</summary>", "boundaries moved"]
    {
        assert!(html.contains(shown), "{shown}");
    }
    let last = format!("{:.4} {:.4}", starts[1], starts[2]);
    assert!(html.contains(&last), "{last}");
}
