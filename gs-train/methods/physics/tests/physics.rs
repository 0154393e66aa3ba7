//! Methods that learn a law of motion: what they learn of generated mechanics, and what follows from it.

use glam::DVec3;
use gs_core::Time;
use gs_data::{Dataset, ImageCache, Split};
use gs_synth::SynthOptions;
use gs_synth::testkit::dataset;
use gs_train::capabilities::{Particles, RigidBody};
use gs_train::evaluate::evaluate;
use gs_train::testkit::{config, run, start};
use gs_train::timestamp::Timestamp;
use gs_train::trainer::{TrainOptions, Trainer};
use std::collections::BTreeSet;
use std::sync::Arc;

/// A generated scene of four cameras at rest, the last quarter of the time kept for the future.
fn mechanics(name: &str) -> Arc<Dataset> {
    dataset(name, &options())
}

fn options() -> SynthOptions {
    SynthOptions { size: 48, cameras: 4, held_out: 1, moments: 24, supersample: 2, ..Default::default() }
}

/// A ball of 50 splats and more: with ten, it is chance what a run says of its turn, and what images leave open to a turn is taken from
/// its acceleration.
fn larger() -> SynthOptions {
    SynthOptions { size: 80, cameras: 6, ..options() }
}

fn trainer(data: &Arc<Dataset>, method: &str, over: &str) -> Trainer {
    let registry = gs_methods::registry();
    start(registry, data, method, &config(registry, method, "tiny", &[over]), 1)
}

/// Preset `fast` in 0.28 of its length, 4500 of 16000 steps, with few splats.
const PART: &str = "
init.points = 1200
[schedule]
sh_every = 169
density = { from = 84, until = 1856, every = 28, max_splats = 1200 }
stages = { warm_up.steps = 56, follow.steps = 1125, dynamic.steps = 3319 }
lr = { cloud.means.steps = 4500, field.all.steps = 4500 }
";

fn trained(data: &Arc<Dataset>, method: &str, over: &str) -> Trainer {
    let mut trainer = trainer(data, method, over);
    let steps = trainer.steps();
    run(&mut trainer, steps);
    trainer
}

fn score(trainer: &Trainer, data: &Dataset, split: Split) -> f64 {
    let background = trainer.model().background();
    let report = evaluate(trainer.model(), data, split, background, &ImageCache::new(64 << 20, 1.0)).expect("scores");
    report.mean.psnr.expect("finite scores")
}

fn particles(trainer: &Trainer) -> Particles {
    trainer.model().capabilities().particles.expect("a law").particles()
}

/// A trainer after [`PART`].
fn short(data: &Arc<Dataset>, method: &str, over: &str) -> Trainer {
    let registry = gs_methods::registry();
    let mut trainer = start(registry, data, method, &config(registry, method, "fast", &[PART, over]), 1);
    run(&mut trainer, 4500);
    trainer
}

/// The same for a law.
const LAW: &str = "schedule.lr.physics.all = { steps = 4500, ramp = 84 }";

/// The images beyond the last training time, as of that time.
fn held(data: &Dataset) -> Dataset {
    let mut held = data.clone();
    let last = data.train.iter().map(|v| v.time).max_by(|a, b| a.normalised.total_cmp(&b.normalised)).expect("a view");
    held.extrapolate.iter_mut().for_each(|view| view.time = last);
    held
}

#[test]
fn a_thrown_ball_is_forecast() {
    let data = dataset("falling", &larger());
    let trace = short(&data, "trace", LAW);
    let [inside, beyond] = [Split::Test, Split::Extrapolate].map(|s| score(&trace, &data, s));
    let rests = score(&trace, &held(&data), Split::Extrapolate);
    println!("trace {inside:.2} dB inside, {beyond:.2} beyond; {rests:.2} if all rests from the last training time");
    assert!(beyond > rests + 8.0, "{beyond} against {rests}");
    ball_falls(&trace, &larger());
}

#[test]
#[ignore = "two minutes: cargo test -p gs-method-physics --test physics -- --ignored a_field_alone"]
fn a_field_alone_cannot_forecast() {
    let data = dataset("falling", &larger());
    let [law, alone] = [("trace", LAW), ("defgs", "")].map(|(method, over)| {
        let beyond = score(&short(&data, method, over), &data, Split::Extrapolate);
        println!("{method} {beyond:.2} dB beyond");
        beyond
    });
    assert!(law > alone + 8.0, "{law} against {alone}");
}

/// The same where the law is read at all times, with the gradients as published.
#[test]
#[ignore = "a minute: cargo test -p gs-method-physics --test physics -- --ignored a_path_is_refitted"]
fn a_path_is_refitted_to_a_law_at_all_times() {
    let rough = "init.points = 600\nlaw.spin_up_weight = 3e-4\nphysics = { settle = 0.0, turn_gradients = false }
        schedule.stages = { follow.steps = 0, dynamic.steps = 4444 }";
    ball_falls(&short(&mechanics("falling"), "trace", &format!("{LAW}\n{rough}")), &options());
}

/// The ball falls as it does in the scene, and no other body moves.
fn ball_falls(trace: &Trainer, options: &SynthOptions) {
    let truth = gs_synth::truth("falling", options).expect("a scene");
    let bodies = trace.model().capabilities().particles.expect("a law").bodies(&[0.75, 1.0]);
    let speed = |b: &&RigidBody| DVec3::from_array(b.velocity).length();
    let ball = bodies.iter().max_by(|a, b| speed(a).total_cmp(&speed(b))).expect("a body");
    let rates = truth.rates_of(0, particles(trace).at).expect("rigid");
    let centre = DVec3::from_array(ball.centroid);
    let off = [
        DVec3::from_array(ball.velocity).distance(rates.velocity(centre)) / rates.velocity(centre).length(),
        DVec3::from_array(ball.acceleration).distance(rates.acceleration(centre)) / rates.acceleration(centre).length(),
    ];
    println!("{} through {} frames, velocity and acceleration off by {off:.3?}", ball.path, ball.frames);
    assert!(off[0] < 0.03 && off[1] < 0.08, "{off:?}: {ball:?}");
    assert!(ball.deviations[0] <= ball.deviations[1] && ball.deviations[1] < 0.1, "{ball:?}");
    let far = trace.model().capabilities().particles.expect("a law").bodies(&[1e6, 1e12]);
    assert_eq!(far[0].deviations[0], far[0].deviations[1], "as far as splats go");
    assert!(bodies.iter().all(|b| b.centroid == ball.centroid || speed(&b) < 0.1), "{bodies:?}");
}

#[test]
fn a_field_alone_follows_while_the_cloud_and_the_law_rest() {
    let data = mechanics("falling");
    let stages = "stages.warm_up.steps = 20\nstages.follow.steps = 30\nstages.follow.window_parts = 0\nstages.dynamic.steps = 10";
    let mut trainer = trainer(&data, "trace", &format!("[schedule]\ndensity.from = 5\ndensity.every = 10\n{stages}"));
    let values = |trainer: &Trainer, of: &dyn Fn(&str) -> bool| {
        let mut all = Vec::new();
        trainer.model().visit(&mut |p| {
            if of(&p.name) {
                all.extend(p.value.iter().map(|v| v.to_bits()));
            }
        });
        all
    };
    let (field, sizes) = (|name: &str| name.starts_with("field."), |name: &str| name.starts_with("field.scales"));
    run(&mut trainer, 20);
    let all = |trainer: &Trainer| [values(trainer, &|n| !field(n)), values(trainer, &field), values(trainer, &sizes)];
    let before = all(&trainer);
    let reports = run(&mut trainer, 30);
    assert!(reports.iter().all(|r| r.stage == "follow"));
    let after = all(&trainer);
    assert!(after[0] == before[0], "cloud and law rest, and no splat comes or goes");
    assert!(after[1] != before[1], "the field learns");
    assert!(!after[2].is_empty() && after[2] == before[2], "but no sizes");
    run(&mut trainer, 1);
    let sizes = values(&trainer, &|n| n.starts_with("field.scales"));
    let moved = sizes.iter().zip(&before[2]).map(|(a, b)| (f32::from_bits(*a) - f32::from_bits(*b)).abs());
    let rate = trainer.schedule().lr["field"]["all"].start;
    let longest = moved.fold(0.0, f32::max);
    assert!(
        longest > 0.0 && longest <= 1.01 * rate,
        "a first step of Adam, not one after 30 without a gradient: {longest}"
    );
    run(&mut trainer, 9);
    let last = all(&trainer);
    assert!(last[0] != before[0] && last[2] != before[2], "then all learns");
}

/// Three of 24 parts of time are open in the end, which show almost no motion. Were the steps of the warm-up counted for the field,
/// its first steps would be up to 3.4 times as long as its rate, and all units of its last hidden layer would die: nothing would
/// depend on time.
#[test]
fn a_network_outlives_a_window_that_opens_slowly() {
    let data = mechanics("screw");
    let registry = gs_methods::registry();
    let slow =
        "[schedule.stages]\nwarm_up.steps = 300\nfollow.steps = 0\ndynamic = { window_parts = 24, window_until = 0.5 }";
    let config = config(registry, "trace", "fast", &["init.points = 600", slow]);
    let mut trainer = start(registry, &data, "trace", &config, 1);
    run(&mut trainer, 1000);
    let means = |t: f32| {
        let at = Timestamp::new(Time::new(t).expect("time"));
        trainer.model().splats(&at, &data.train[0].camera).expect("splats").means
    };
    // How far the field has a splat go from the first to the last moment it knows.
    let way = means(0.0).iter().zip(means(0.4)).map(|(a, b)| a.distance(b)).fold(0.0, f32::max);
    assert!(way > 0.05, "{way}");
}

#[test]
fn a_forecast_does_not_depend_on_what_was_asked_before() {
    let data = mechanics("wheel");
    let short = "[schedule.stages.warm_up]\nsteps = 20\n[schedule.stages.dynamic]\nsteps = 40";
    for method in ["trace", "trace-4dgs", "defgs-nvfi"] {
        let trainer = trained(&data, method, short);
        let (camera, other) = (&data.train[0].camera, trained(&data, method, short));
        let at = |t: f32| Timestamp::new(Time::new(t).expect("time"));
        let times = [1.5, 0.8, 1.0, 0.2, 1.5, 3.0, 0.9];
        let asked: Vec<_> = times.iter().map(|t| trainer.model().splats(&at(*t), camera).expect("splats")).collect();
        for (t, splats) in times.iter().zip(asked).rev() {
            assert_eq!(other.model().splats(&at(*t), camera).expect("splats"), splats, "{method} at {t}");
        }
    }
}

/// A run of `trace`, preset `tiny`, with TOML laid over it, or why there is none.
fn begun(data: &Arc<Dataset>, over: &str) -> Result<Trainer, String> {
    let registry = gs_methods::registry();
    let config = config(registry, "trace", "tiny", &["init.from = \"random\"", over]);
    Trainer::new(registry, data.clone(), "trace", &config, TrainOptions::default()).map_err(|e| e.to_string())
}

#[test]
fn more_first_points_than_splats_allowed_are_refused() {
    let data = mechanics("falling");
    let points = |n: u32| format!("init.points = {n}\nschedule.density.max_splats = 200");
    let said = begun(&data, &points(201)).err().expect("a refusal");
    let named = ["201 initial points (init.points)", "schedule.density.max_splats = 200"];
    assert!(named.iter().all(|part| said.contains(part)), "{said}");
    assert_eq!(begun(&data, &points(200)).expect("a run").model().splat_count(), 200);
}

/// The window opens over 70 % of the run, so every view is drawn where 30 % of it are as many steps as there are views.
#[test]
fn a_run_too_short_to_draw_every_view_is_refused_with_a_length_that_does() {
    let data = dataset("falling", &SynthOptions { size: 24, cameras: 3, moments: 16, ..options() });
    let of = |steps: u32| {
        let dynamic = format!("{{ steps = {steps}, window_parts = 8, window_until = 0.7 }}");
        format!("init.points = 50\n[schedule.stages]\nwarm_up.steps = 0\ndynamic = {dynamic}")
    };
    let views = data.train.len();
    let enough = (30 * views as u32).div_ceil(9);
    let said = begun(&data, &of(30)).err().expect("a refusal");
    let named = [
        format!("30 steps would never draw some of the {views} training views"),
        format!("--steps {enough} draws them all"),
    ];
    assert!(named.iter().all(|part| said.contains(part)), "{said}");
    let mut long = begun(&data, &of(enough)).expect("a run");
    let drawn: BTreeSet<String> = run(&mut long, enough).into_iter().map(|report| report.view).collect();
    assert_eq!(drawn.len(), views, "views drawn in {enough} steps");
}

/// Short enough to see that a setting acts, not what it is worth.
const SHORT: &str = "[schedule.stages.warm_up]\nsteps = 20\n[schedule.stages.dynamic]\nsteps = 60\n";

/// The rows of the paper's Table 9: parts left out, steps and orders.
#[test]
fn parts_of_the_law_can_be_left_out() {
    let data = mechanics("falling");
    let of = |over: &str| trained(&data, "trace", &format!("{over}\n{SHORT}"));
    let at = |t: f32| Timestamp::new(Time::new(t).expect("time"));
    let ahead = |trainer: &Trainer| trainer.model().splats(&at(1.0), &data.train[0].camera).expect("splats").means;
    let outputs = |trainer: &Trainer| {
        let mut last = 0;
        trainer.model().visit(&mut |p| last = if p.name.starts_with("physics.") { p.value.len() } else { last });
        last
    };
    let has_field = |trainer: &Trainer| {
        let mut found = false;
        trainer.model().visit(&mut |p| found |= p.name.starts_with("field."));
        found
    };
    let full = of("");
    assert!(has_field(&full) && outputs(&full) == 12);
    let variants = [
        ("ablate = \"field\"", 12),
        ("ablate = \"field\"\n[schedule.stages.follow]\nsteps = 10\nwindow_parts = 0", 12),
        ("ablate = \"physics\"", 6),
        ("ablate = \"equivalent\"", 15),
        ("[physics]\nstep_frames = 1.0", 12),
        ("[physics]\nstep_frames = 3.0", 12),
        ("[law]\norder = 1", 6),
        ("[law]\norder = 3", 18),
    ];
    for (over, rows) in variants {
        let other = of(over);
        assert_eq!((outputs(&other), has_field(&other)), (rows, !over.contains("field")), "{over}");
        let (means, particles) = (ahead(&other), particles(&other));
        assert!(means.iter().all(|x| x.is_finite()) && means != ahead(&full), "{over}");
        assert_eq!(particles.at == 0.0, over.contains("field"), "{over}: who rules from the first moment on");
        let rates = particles.twists.iter().any(|[_, _, rate, ..]| *rate != [0.0; 3]);
        let jerks = particles.twists.iter().any(|[_, _, _, _, jerk, _]| *jerk != [0.0; 3]);
        let order = if over.contains("order = 1") {
            1
        } else if over.contains("order = 3") {
            3
        } else {
            2
        };
        if !over.contains("ablate") {
            assert_eq!((rates, jerks), (order > 1, order > 2), "{over}");
        }
    }
}
