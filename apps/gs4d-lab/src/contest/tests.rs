use super::*;
use gs_synth::{SynthOptions, write};
use std::fs;
use std::path::Path;

/// A contest without entries on a small scene written below `folder`.
fn tiny(folder: &Path, train_views: u32, test_views: u32) -> Contest {
    let data = folder.join("data");
    let small = SynthOptions { val_views: 1, ..SynthOptions::of_views(32, train_views, test_views) };
    write(&data, "static", &small, false).unwrap();
    Contest {
        registry: gs_methods::registry().clone(),
        data,
        root: folder.join("contest"),
        preset: "tiny".into(),
        entries: Vec::new(),
        seeds: vec![0],
        length: Length::Recipe,
        sets: Vec::new(),
    }
}

#[test]
fn entries_are_read_and_bad_ones_named() {
    let entry = Entry::parse(" fourdgs:tiny  schedule.lambda_dssim=0.1 ").unwrap();
    assert_eq!((entry.method.as_str(), entry.preset.as_deref()), ("fourdgs", Some("tiny")));
    assert_eq!(entry.label, "fourdgs:tiny schedule.lambda_dssim=0.1");
    assert_eq!(entry.slug(), "fourdgs_tiny_schedule.lambda_dssim=0.1");
    let long = |value: u32| {
        let sets: String = (0..40).map(|k| format!(" schedule.lr.group{k}.start={value}e-4")).collect();
        Entry::parse(&format!("fags{sets}")).unwrap().slug()
    };
    assert!(long(1).len() == 120 && long(1).starts_with("fags_schedule.lr.group0.start=1e-4_"), "{}", long(1));
    assert_ne!(long(1), long(2));
    assert!(Entry::parse("").is_err());
    assert!(Entry::parse("fourdgs quick").unwrap_err().contains("`quick`"));
}

#[test]
fn entries_are_scored_on_the_same_images() {
    let folder = tempfile::tempdir().unwrap();
    let base = tiny(folder.path(), 3, 2);
    let refused = |second: &str, sets: &[&str]| {
        let entries = ["static3d", second].map(|e| Entry::parse(e).unwrap()).to_vec();
        let sets = sets.iter().map(|s| (*s).to_owned()).collect();
        let contest = Contest { entries, sets, length: Length::Steps(1), ..base.clone() };
        contest.plan().err().map(|e| e.to_string())
    };
    let other = refused("static3d schedule.background=black", &[]).unwrap();
    assert!(
        other.contains("not of the same images as those of static3d: schedule.background is white and black"),
        "{other}"
    );
    let small = refused("static3d data.scale=0.5", &[]).unwrap();
    assert!(small.contains("views differ in number, size or time"), "{small}");
    assert_eq!(refused("static3d init.points=200", &["schedule.background=black"]), None);
    // Random colours are scored over black.
    assert_eq!(refused("static3d schedule.background=random", &["schedule.background=black"]), None);
}

#[test]
fn a_pilot_is_the_same_for_any_seeds() {
    let folder = tempfile::tempdir().unwrap();
    let base = Contest {
        entries: vec![Entry::parse("static3d").unwrap()],
        length: Length::Seconds(5.0),
        ..tiny(folder.path(), 3, 2)
    };
    let pilot = |seeds: &[u64]| {
        let plan = Contest { seeds: seeds.to_vec(), ..base.clone() }.plan().unwrap();
        assert!(plan.pilots && plan.jobs.len() == 1);
        plan.jobs[0].command("gs4d").unwrap()
    };
    assert_eq!(pilot(&[3]), pilot(&[0, 3]));
}

#[test]
fn spread_is_mean_and_sample_deviation() {
    assert_eq!(Spread::of(&[1.0, 3.0]), Some(Spread { mean: 2.0, deviation: 2f64.sqrt() }));
    assert_eq!(Spread::of(&[5.0]), Some(Spread { mean: 5.0, deviation: 0.0 }));
    assert_eq!(Spread::of(&[]), None);
}

#[test]
fn trials_stand_once_made_and_the_budget_sets_the_steps() {
    let folder = tempfile::tempdir().unwrap();
    let contest = Contest {
        entries: vec![Entry::parse("static3d").unwrap(), Entry::parse("static3d init.points=200").unwrap()],
        seeds: vec![0, 1],
        length: Length::Steps(20),
        sets: vec!["run.log_every=2".into()],
        ..tiny(folder.path(), 6, 2)
    };
    let stop = AtomicBool::new(false);
    let mut trials = 0;
    let mut count = |t: Event| trials += u32::from(matches!(t, Event::Trial(_)));
    let first = contest.run(&stop, &mut count).unwrap().standings;
    assert_eq!(first.iter().map(|s| (s.steps, s.trials.len())).collect::<Vec<_>>(), [(Some(20), 2), (Some(20), 2)]);
    let again = contest.run(&stop, &mut count).unwrap().standings;
    assert_eq!((trials, first == again), (4, true));
    assert_eq!(contest.collect().unwrap().standings, first);
    assert!(first[0].spread(|s| s.mean.psnr).unwrap().deviation > 0.0, "seeds differ");

    for other in [
        Contest { length: Length::Steps(21), ..contest.clone() },
        Contest { sets: [&contest.sets[..], &["data.scale=0.5".into()]].concat(), ..contest.clone() },
    ] {
        let results = other.run(&stop, &mut |_| {}).unwrap();
        let foreign = |m: &TrialError| matches!(*m.source, RunError::OtherSettings { .. });
        assert!(results.missing.len() == 4 && results.missing.iter().all(foreign), "{:?}", results.missing);
    }
    let timed = Contest { length: Length::Seconds(2.0), root: folder.path().join("timed"), ..contest };
    let timed = timed.run(&stop, &mut |_| {}).unwrap().standings;
    assert!(timed[0].steps > Some(20), "{:?} steps in two seconds", timed[0].steps);
}

#[test]
fn a_contest_stops_when_asked_and_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let contest = Contest {
        entries: vec![Entry::parse("static3d").unwrap()],
        seeds: vec![3],
        length: Length::Steps(12),
        ..tiny(folder.path(), 4, 1)
    };
    let stop = AtomicBool::new(false);
    let mut halt = |t: Event| {
        if let Event::Step(p) = t {
            stop.store(p.step >= 5, std::sync::atomic::Ordering::Relaxed);
        }
    };
    assert!(matches!(contest.run(&stop, &mut halt), Err(ContestError::Interrupted(_))));
    let results = contest.collect().unwrap();
    assert!(results.standings[0].trials.is_empty() && results.missing[0].to_string().contains("step 5 of 12"));
    let done = contest.run(&AtomicBool::new(false), &mut |_| {}).unwrap();
    assert_eq!(done.standings[0].trials.len(), 1);
}

#[test]
fn several_contests_at_once_give_what_each_gives_alone() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("moving");
    write(&data, "balls", &SynthOptions { val_views: 1, ..SynthOptions::of_views(32, 6, 1) }, false).unwrap();
    let base = Contest { data, seeds: vec![0, 1], length: Length::Steps(6), ..tiny(folder.path(), 4, 1) };
    let contest = |root: &str, entries: &[&str]| {
        let entries = entries.iter().map(|e| Entry::parse(e).unwrap()).collect();
        Contest { root: folder.path().join(root), entries, ..base.clone() }
    };
    let all = [contest("a", &["static3d", "static3d init.points=200"]), contest("b", &["fourdgs"])];
    let stop = AtomicBool::new(false);
    let halt = |_: usize, event: Event| {
        if matches!(event, Event::Step(_)) {
            stop.store(true, std::sync::atomic::Ordering::Relaxed);
        }
    };
    assert!(matches!(run_all(&all, 2, &stop, &halt), Err(ContestError::Interrupted(_))));
    let begun = std::sync::Mutex::new(Vec::new());
    let note = |of: usize, event: Event| {
        if let Event::Trial(trial) = event {
            begun.lock().unwrap().push((of, trial.to_owned()));
        }
    };
    let together = run_all(&all, 2, &AtomicBool::new(false), &note).unwrap();
    let mut begun = begun.into_inner().unwrap();
    begun.sort();
    assert_eq!(begun.len(), 6, "none was done, and each is begun once: {begun:?}");

    let alone = [contest("c", &["static3d", "static3d init.points=200"]), contest("d", &["fourdgs"])];
    for (together, alone) in together.iter().zip(&alone) {
        let alone = alone.run(&AtomicBool::new(false), &mut |_| {}).unwrap();
        assert!(together.missing.is_empty() && together.standings.len() == alone.standings.len());
        for (a, b) in together.standings.iter().zip(&alone.standings) {
            assert_eq!((&a.label, a.steps, a.trials.len()), (&b.label, b.steps, 2));
            let scores = |s: &Standing| s.trials.iter().map(|t| (t.seed, t.scores.views.clone())).collect::<Vec<_>>();
            assert_eq!(scores(a), scores(b));
        }
    }
    let refused = [contest("e", &["static3d"]), contest("f", &["static3d nosuch=1"])];
    let error = run_all(&refused, 2, &AtomicBool::new(false), &|_, _| panic!("nothing is trained"));
    assert!(matches!(error, Err(ContestError::Trial(_))) && !folder.path().join("e").exists());
}

#[test]
fn missing_foreign_and_unfinished_trials_are_named_and_the_others_stand() {
    let folder = tempfile::tempdir().unwrap();
    let contest = Contest {
        entries: vec![Entry::parse("static3d").unwrap(), Entry::parse("static3d init.points=200").unwrap()],
        seeds: vec![0, 1],
        length: Length::Steps(6),
        ..tiny(folder.path(), 4, 1)
    };
    let go = AtomicBool::new(false);
    let whole = contest.run(&go, &mut |_| {}).unwrap().standings;
    let at = |k: usize, t: usize| whole[k].trials[t].run.clone();
    fs::remove_dir_all(at(0, 1)).unwrap();
    let scores = fs::read_to_string(at(1, 0).join("metrics.json")).unwrap();
    fs::write(at(1, 0).join("metrics.json"), scores.replace("\"step\": 6", "\"step\": 5")).unwrap();
    let config = at(1, 1).join("config.resolved.toml");
    fs::write(&config, fs::read_to_string(&config).unwrap().replace("seed = 1", "seed = 2")).unwrap();

    let results = contest.collect().unwrap();
    let missing: Vec<String> = results.missing.iter().map(TrialError::to_string).collect();
    for (text, words) in missing.iter().zip([
        ["static3d / seed-1: ", "is no run folder"],
        ["static3d init.points=200 / seed-0: ", "step 6 of 6"],
        ["static3d init.points=200 / seed-1: ", "other settings"],
    ]) {
        assert!(words.iter().all(|w| text.contains(w)), "{text}");
    }
    assert_eq!(missing.len(), 3);
    assert_eq!((results.standings[0].trials.len(), &results.standings[0].trials[0]), (1, &whole[0].trials[0]));
    assert_eq!((results.standings[1].trials.len(), results.standings[1].steps), (0, Some(6)));
    assert!(results.standings[1].spread(|s| s.mean.psnr).is_none());
}

#[test]
fn a_trial_that_fails_leaves_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let contest = Contest {
        entries: vec![Entry::parse("static3d init.points=200").unwrap(), Entry::new("static3d")],
        length: Length::Steps(4),
        ..tiny(folder.path(), 4, 1)
    };
    let taken = contest.root.join("static3d_init.points=200/seed-0");
    fs::create_dir_all(&taken).unwrap();
    fs::write(taken.join("notes.txt"), "mine").unwrap();
    let mut failed = Vec::new();
    let mut note = |e: Event| {
        if let Event::Failed(trial) = e {
            failed.push(trial.to_string());
        }
    };
    let results = contest.run(&AtomicBool::new(false), &mut note).unwrap();
    assert_eq!(results.standings.iter().map(|s| s.trials.len()).collect::<Vec<_>>(), [0, 1]);
    assert_eq!((results.missing.len(), results.missing[0].trial.as_str()), (1, "static3d init.points=200 / seed-0"));
    assert_eq!(failed, [results.missing[0].to_string()]);
}

#[test]
fn data_that_an_entry_cannot_learn_from_are_told_before_anything_is_trained() {
    let folder = tempfile::tempdir().unwrap();
    let contest = Contest { length: Length::Steps(4), ..tiny(folder.path(), 4, 1) };
    let refused = |entry: &str| {
        let entries = vec![Entry::new("static3d"), Entry::parse(entry).unwrap()];
        let contest = Contest { entries, ..contest.clone() };
        assert!(matches!(contest.plan(), Err(ContestError::Trial(_))), "{entry}");
        match contest.run(&AtomicBool::new(false), &mut |_| panic!("nothing is trained")) {
            Err(ContestError::Trial(e)) => *e.source,
            other => panic!("{entry}: {other:?}"),
        }
    };
    assert!(matches!(refused("dut"), RunError::Method(_)), "it needs data of a filmed person");
    assert!(matches!(refused("static3d data.layout=colmap"), RunError::Data(_)));
    assert!(!contest.root.exists());
}

#[test]
fn a_plan_has_a_line_per_trial_that_a_shell_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let odd = "it's \"$HOME\" a|b";
    let contest = Contest {
        data: odd.into(),
        root: "out".into(),
        entries: vec![
            Entry::new("static3d"),
            Entry::parse("fourdgs:fast init.points=9").unwrap(),
            Entry::new("static3d"),
        ],
        seeds: vec![0, 7],
        length: Length::Steps(6),
        sets: vec!["data.images=my images".into()],
        ..tiny(folder.path(), 1, 1)
    };
    let plan = contest.plan().unwrap();
    assert_eq!((plan.pilots, plan.jobs.len()), (false, 4), "an entry given twice is planned once");
    let line = plan.jobs[3].command("nice gs4d").unwrap();
    let sets = "--set 'data.images=my images' --set init.points=9";
    let data = r#"'it'\''s "$HOME" a|b'"#;
    assert_eq!(
        line,
        format!(
            "nice gs4d train {data} --method fourdgs --preset fast --steps 6 --seed 7 {sets} --continue --out out/fourdgs_fast_init.points=9/seed-7"
        )
    );
    let broken = Contest { root: "a\nb".into(), ..contest };
    assert!(matches!(broken.plan().unwrap().jobs[0].command("gs4d"), Err(ContestError::Word { .. })));
}

#[test]
fn pilots_are_planned_before_the_trials_of_a_time_budget() {
    let folder = tempfile::tempdir().unwrap();
    let contest =
        Contest { entries: vec![Entry::new("static3d")], length: Length::Seconds(0.5), ..tiny(folder.path(), 4, 1) };
    let plan = contest.plan().unwrap();
    assert!(plan.pilots && plan.jobs[0].trial == "static3d / pilot");
    assert!(plan.jobs[0].command("gs4d").unwrap().contains(" --steps 50 --time-budget 0.5s --seed 0 "));
    assert_eq!(contest.collect().unwrap().missing[0].trial, "static3d / pilot");

    let go = AtomicBool::new(false);
    let standing = contest.run(&go, &mut |_| {}).unwrap().standings.remove(0);
    let plan = contest.plan().unwrap();
    let steps = format!(" --steps {} --seed 0 ", standing.steps.unwrap());
    assert!(!plan.pilots && plan.jobs[0].command("gs4d").unwrap().contains(&steps));
}
