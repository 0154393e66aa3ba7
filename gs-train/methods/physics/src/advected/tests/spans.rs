//! From where to where the dynamics act in training: by the time of the image and by the step of the stage.

use super::*;

#[test]
fn training_reads_the_field_on_either_side_and_never_past_its_end() {
    let mut m = method(CONFIG, true);
    let mut sides = [0, 0];
    for step in 200..400 {
        begin(&mut m, step);
        let Span { from, to } = m.training_span(0.3, 0);
        assert!((f64::abs(from - to) - 0.1).abs() < 1e-7);
        sides[usize::from(from < to)] += 1;
        assert!(
            (m.training_span(0.58, 0).from - 0.6).abs() < 1e-7 || (m.training_span(0.58, 0).from - 0.48).abs() < 1e-7
        );
    }
    assert!(sides.iter().all(|n| *n > 25), "{sides:?}");
    let alike = (200..400).filter(|step| {
        begin(&mut m, *step);
        m.training_span(0.3, 0) == m.training_span(0.3, 1)
    });
    assert!((50..150).contains(&alike.count()), "each view of a step draws for itself");
    let still = |t| m.training_span(t, 0).from == t;
    assert!(still(0.0) && still(0.09) && !still(0.11));
    assert!((m.training_span(0.75, 0).from - 0.6).abs() < 1e-7);
    let late = method(PhysicsConfig { start: 0.4, ..CONFIG }, true);
    assert!(late.training_span(0.29, 0).from == 0.29 && late.training_span(0.31, 0).from >= 0.3 - 1e-7);
    // A law that begins after the last time of the field is learnt where it draws.
    let after = method(PhysicsConfig { start: 0.9, ..CONFIG }, true);
    for t in [0.65, 0.7] {
        assert_eq!(after.training_span(t, 0), after.render_span(t));
        assert!((after.training_span(t, 0).from - 0.6).abs() < 1e-7);
    }
    let bare = method(PhysicsConfig { field: false, ..CONFIG }, true);
    assert_eq!(bare.training_span(0.3, 0), Span { from: 0.0, to: 0.3 });
}

#[test]
fn a_field_alone_is_read_at_the_time_of_the_photograph() {
    let mut m = method(CONFIG, true);
    let mut schedule = schedule();
    schedule.stages.get_mut("dynamic").unwrap().field_alone = true;
    m.begin_step(&schedule.at(500));
    for t in [0.0, 0.3, 0.7] {
        assert_eq!(m.training_span(t, 0), Span { from: t, to: t });
    }
    learn(&mut m, 0.7);
    assert!(m.dynamics.0.grad.iter().all(|g| *g == 0.0));
}

#[test]
fn the_reach_opens_over_the_stage() {
    let mut m = method(PhysicsConfig { reach: 3, ..CONFIG }, true);
    // The stage has steps 121 to 1000.
    let mut lengths = |steps: std::ops::Range<u32>| {
        let mut lengths = [0; 4];
        for step in steps {
            begin(&mut m, step);
            let Span { from, to } = m.training_span(0.3, 0);
            lengths[(f64::abs(from - to) / 0.1).round() as usize] += 1;
        }
        lengths
    };
    let first = lengths(121..141);
    assert!(first[2] + first[3] <= 2, "{first:?}");
    let whole = lengths(850..1001);
    assert!(whole[0] == 0 && whole[1..].iter().all(|n| *n > 25), "{whole:?}");
}

/// The stage has steps 121 to 1000, and in a run of 1880 steps twice as many.
#[test]
fn the_reach_of_steps_that_are_made_stays_in_a_longer_stage() {
    let of = |reach_until: f32, long: bool, step: u32| {
        let mut m = method(PhysicsConfig { reach: 5, reach_until, ..CONFIG }, true);
        let mut schedule = schedule();
        schedule.stages.get_mut("dynamic").unwrap().steps *= if long { 2 } else { 1 };
        m.begin_step(&schedule.at(step));
        m.reach()
    };
    for step in [121, 300, 561, 1000] {
        assert_eq!(of(0.5, true, step), of(1.0, false, step), "step {step}");
    }
    assert_eq!([1001, 1880].map(|step| of(0.5, true, step)), [5.0; 2], "open to the end");
}

/// The stage has steps 121 to 1000.
#[test]
fn at_the_end_of_the_stage_dynamics_set_out_from_the_last_field_time() {
    let share = |config: PhysicsConfig, t: f64, steps: std::ops::Range<u32>| {
        let mut m = method(config, true);
        let from_end = |step: &u32| {
            begin(&mut m, *step);
            m.training_span(t, 0).from == m.times.last_field
        };
        steps.clone().filter(from_end).count() as f64 / steps.len() as f64
    };
    let settles = PhysicsConfig { settle: 0.25, ..CONFIG };
    assert_eq!(share(settles, 0.2, 200..780), 0.0, "before");
    assert_eq!(share(settles, 0.2, 781..1001), 1.0, "every step that the dynamics render");
    let half = share(PhysicsConfig { direct: 0.5, ..settles }, 0.2, 781..1001);
    assert!((0.35..0.65).contains(&half), "{half}");
    // T_def is 0.6, a frame 0.05.
    let near = PhysicsConfig { settle_frames: 4.0, ..settles };
    assert_eq!([0.35, 0.4].map(|t| share(near, t, 781..1001)), [0.0, 1.0]);
}
