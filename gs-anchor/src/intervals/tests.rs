use super::*;
use gs_core::Rng;

/// Views in the middle of every interval of equal intervals, with these gradients.
fn observe_all(i: &mut Intervals, grads: &[f32]) {
    for (c, &g) in grads.iter().enumerate() {
        let t = 0.5 * (i.starts.value[c] + i.end(c));
        i.observe(t, g, 1, 1.0);
    }
}

fn config(segments: u32, tau: f32, step: f32, rule: Rule) -> IntervalConfig {
    IntervalConfig { segments, tau, step, rule, ..IntervalConfig::default() }
}

#[test]
fn one_busy_interval_of_eight_shrinks_from_both_sides() {
    let mut i = Intervals::new(&IntervalConfig::default(), 100).unwrap();
    observe_all(&mut i, &[1.0, 1.0, 1.0, 1.0, 9.0, 1.0, 1.0, 1.0]);
    let did = i.adjust(1000, 4000).unwrap();
    let std = 8.0f64.sqrt();
    assert!((f64::from(did.threshold.unwrap()) - (2.0 + 1.5 * std)).abs() < 1e-6, "{did:?}");
    assert_eq!((did.hot, did.clock, did.step), (vec![4], 1000, 4000));
    assert_eq!(i.starts.value, [0.0, 0.125, 0.25, 0.375, 0.50125, 0.62375, 0.75, 0.875]);
    assert_eq!(did.moves[0], Move { boundary: 4, from: 0.5, to: 0.50125 });
    assert_eq!((did.moves.len(), did.rejected.len(), &i.views[..]), (2, 0, &[0.0; 8][..]));
}

#[test]
fn the_ends_of_time_stay() {
    for (busy, moved) in [(0, 1), (7, 7)] {
        let mut i = Intervals::new(&IntervalConfig::default(), 100).unwrap();
        let mut grads = [1.0; 8];
        grads[busy] = 9.0;
        observe_all(&mut i, &grads);
        let moves = i.adjust(1000, 1000).unwrap().moves;
        assert_eq!((moves.len(), moves[0].boundary, i.starts.value[0]), (1, moved, 0.0));
    }
}

#[test]
fn moves_of_a_shared_boundary_cancel() {
    let mut i = Intervals::new(&config(12, 1.0, 0.1, Rule::Clean), 1000).unwrap();
    let mut grads = [1.0; 12];
    grads[5..7].fill(9.0);
    observe_all(&mut i, &grads);
    let did = i.adjust(1000, 1000).unwrap();
    assert_eq!(did.hot, [5, 6]);
    assert_eq!(did.moves.iter().map(|m| m.boundary).collect::<Vec<_>>(), [5, 7]);
    assert_eq!((did.rejected[0].boundary, did.rejected[0].reason.as_str()), (6, "busy on both sides"));
    assert_eq!(i.starts.value[6], 0.5);
}

#[test]
fn intervals_nobody_saw_do_not_count() {
    let mut i = Intervals::new(&config(8, 1.0, 0.01, Rule::Clean), 100).unwrap();
    for (t, g) in [(0.05, 1.0), (0.3, 1.0), (0.55, 1.0), (0.9, 5.0)] {
        i.observe(t, g, 1, 1.0);
    }
    let did = i.adjust(1000, 1000).unwrap();
    assert_eq!(did.means, [Some(1.0), None, Some(1.0), None, Some(1.0), None, None, Some(5.0)]);
    assert_eq!((did.threshold, did.hot), (Some(4.0), vec![7]));
    i.observe(0.5, 1.0, 1, 1.0);
    let did = i.adjust(2000, 2000).unwrap();
    assert_eq!((did.threshold, did.moves.len()), (None, 0), "one value has no deviation");
}

#[test]
fn means_weights_and_what_is_not_finite() {
    let mean = IntervalConfig { statistic: Statistic::Mean, ..IntervalConfig::default() };
    for (config, wanted) in [(mean, 2.0), (IntervalConfig::default(), 20.0)] {
        let mut i = Intervals::new(&config, 10).unwrap();
        i.observe(0.0, 5.0, 10, 4.0);
        i.observe(0.0, f32::NAN, 10, 4.0);
        i.observe(1.0, 1.0, 0, 1.0);
        assert_eq!((i.grad[0], i.views[0], i.grad[7]), (wanted, 2.0, 1.0));
    }
}

#[test]
fn passes_come_when_due() {
    let mut i = Intervals::new(&IntervalConfig { until: 3000, ..IntervalConfig::default() }, 10).unwrap();
    assert!(i.adjust(999, 999).is_none() && i.adjust(4000, 4000).is_none() && i.adjust(3000, 3000).is_some());
    assert!(i.observes_at(500) && !i.observes_at(499));
    let mut off = Intervals::new(&IntervalConfig { on: false, ..IntervalConfig::default() }, 10).unwrap();
    assert!(off.adjust(1000, 1000).is_none() && !off.observes_at(1000));
    let released = Intervals::new(&config(8, 1.5, 0.01, Rule::Ref), 10).unwrap();
    assert!(!released.observes_at(500) && released.observes_at(501) && !released.observes_at(20_000));
}

#[test]
fn ten_thousand_adjustments_leave_an_order_with_room() {
    let mut rng = Rng::new(5, "intervals", 0, 0);
    let mut moved = 0;
    let mut refused = 0;
    for run in 0..100 {
        let n = 2 + rng.below(15);
        let frames = 2 + rng.below(400);
        let config = config(n, rng.range(0.0, 1.0), rng.range(0.01, 0.4), Rule::Clean);
        let mut i = Intervals::new(&config, frames).unwrap();
        let least = i.min_width().min(1.0 / n as f32);
        for pass in 1..=100 {
            for _ in 0..20 {
                i.observe(rng.uniform(), rng.uniform().powi(8), 1, 1.0);
            }
            let did = i.adjust(1000 * (1 + pass % 10), pass).unwrap();
            moved += did.moves.len();
            refused += did.rejected.len();
            assert_eq!(i.starts.value[0], 0.0);
            for c in 0..i.len() {
                // An equal interval that is too narrow from the start may lose nothing, up to the rounding of 1/N.
                let width = i.end(c) - i.starts.value[c];
                assert!(
                    width >= least - 1e-7 && width > 0.0,
                    "run {run}, pass {pass}, interval {c}: {width} < {least}"
                );
            }
            for _ in 0..10 {
                let t = rng.range(-0.2, 1.2);
                let (c, canonical) = (i.locate(t), i.canonical_time(t));
                assert_eq!(canonical, i.starts.value[c]);
                assert!(canonical <= t.max(0.0) && (t < i.end(c) || c + 1 == i.len()));
            }
        }
    }
    assert!(moved > 5000 && refused > 1000, "{moved} moves, {refused} refused");
}

#[test]
fn a_warning_where_no_interval_can_stand_out() {
    for (rule, tau, idle) in [(Rule::Clean, 1.5, 4), (Rule::Clean, 1.0, 2), (Rule::Ref, 1.5, 5), (Rule::Ref, 1.0, 3)] {
        for n in 1..=16 {
            let config = config(n, tau, 0.01, rule);
            assert_eq!(config.warning().is_some(), n <= idle, "{rule:?} {tau} {n}");
        }
    }
    assert!(Intervals::new(&IntervalConfig::default(), 5).unwrap().warning().unwrap().contains("two frames"));
    assert_eq!(Intervals::new(&IntervalConfig::default(), 100).unwrap().warning(), None);
    assert_eq!(IntervalConfig { on: false, segments: 2, ..IntervalConfig::default() }.warning(), None);
}

#[test]
fn settings_out_of_their_domain_are_named() {
    let field = |change: fn(&mut IntervalConfig)| {
        let mut config = IntervalConfig::default();
        change(&mut config);
        Intervals::new(&config, 10).unwrap_err().field
    };
    assert_eq!(field(|c| c.segments = 0), "intervals.segments");
    assert_eq!(field(|c| c.period = 0), "intervals.period");
    assert_eq!(field(|c| c.tau = f32::NAN), "intervals.tau");
    assert_eq!(field(|c| c.step = 0.5), "intervals.step");
    assert_eq!(Intervals::new(&IntervalConfig::default(), 0).unwrap_err().field, "frames");
    assert!(Intervals::new(&config(1, 1.5, 0.01, Rule::Clean), 1).unwrap().adjust(1000, 1).unwrap().moves.is_empty());
    assert!(Intervals::new(&config(1, 1.5, 0.01, Rule::Ref), 1).unwrap().adjust(1000, 1).unwrap().moves.is_empty());
}

/// Frames of a burst of motion within [0.5, 0.625), and rest elsewhere.
fn burst(i: &mut Intervals) {
    for frame in 0..200 {
        let t = frame as f32 / 199.0;
        let busy = (0.5..0.625).contains(&t);
        i.observe(t, if busy { 9.0 } else { 1.0 }, 1, 1.0);
    }
}

#[test]
fn the_released_rule_widens_the_busy_interval() {
    let mut i = Intervals::new(&config(8, 1.5, 0.1, Rule::Ref), 200).unwrap();
    for pass in 1..=2 {
        burst(&mut i);
        let did = i.adjust(1000 * pass, pass).unwrap();
        assert_eq!((did.hot, did.moves.len(), did.means.len()), (vec![3], 2, 7));
    }
    assert!((i.starts.value[2] - 0.275).abs() < 1e-6 && (i.starts.value[4] - 0.475).abs() < 1e-6);
    let mut clean = Intervals::new(&config(8, 1.5, 0.1, Rule::Clean), 200).unwrap();
    burst(&mut clean);
    clean.adjust(1000, 1);
    assert_eq!((clean.starts.value[4], clean.starts.value[5]), (0.5125, 0.6125));
}

#[test]
fn the_released_rule_never_acts_for_five_intervals_or_fewer() {
    for n in 2..=8u32 {
        for busy in 0..n as usize {
            let mut i = Intervals::new(&config(n, 1.5, 0.01, Rule::Ref), 400).unwrap();
            for frame in 0..400 {
                let t = frame as f32 / 399.0;
                let in_busy = i.locate(t) == busy;
                i.observe(t, if in_busy { 1e6 } else { 1.0 }, 1, 1.0);
            }
            let did = i.adjust(1000, 1).unwrap();
            // The first interval is never counted.
            assert_eq!(!did.moves.is_empty(), n >= 6 && busy > 0, "{n} intervals, busy {busy}: {did:?}");
        }
    }
}

#[test]
fn the_released_rule_loses_frames_and_leaves_the_list() {
    let mut i = Intervals::new(&config(8, 1.5, 0.1, Rule::Ref), 200).unwrap();
    let counted = |i: &Intervals| (0..1000).filter(|f| i.slot(*f as f32 / 999.0).is_some()).count();
    assert!((860..=890).contains(&counted(&i)), "one interval of eight is not counted: {}", counted(&i));
    for pass in 1..=3 {
        burst(&mut i);
        i.adjust(1000 * pass, pass);
    }
    assert!((620..=850).contains(&counted(&i)), "{}", counted(&i));
    let off_list = |f: u32| {
        let t = i.canonical_time(f as f32 / 999.0);
        !i.starts.value.contains(&t)
    };
    assert!((0..1000).any(off_list));
}

#[test]
fn boundaries_can_be_given() {
    let with = |starts: &[f32]| IntervalConfig { segments: 4, starts: starts.to_vec(), ..IntervalConfig::default() };
    let given = Intervals::new(&with(&[0.5, 0.53, 0.6]), 100).unwrap();
    assert_eq!((given.starts.value.as_slice(), given.locate(0.55)), (&[0.0, 0.5, 0.53, 0.6][..], 2));
    assert_eq!(Intervals::new(&with(&[]), 100).unwrap().starts.value, [0.0, 0.25, 0.5, 0.75]);
    for wrong in
        [&[0.5, 0.6][..], &[0.6, 0.5, 0.7], &[0.0, 0.5, 0.7], &[0.2, 0.5, 1.0], &[0.2, 0.2, 0.5], &[0.2, f32::NAN, 0.5]]
    {
        let why = Intervals::new(&with(wrong), 100).unwrap_err().to_string();
        assert!(why.contains("intervals.starts"), "{wrong:?}: {why}");
    }
}
