use super::*;
use crate::anchors::AnchorShape;
use crate::lattice::cell_of;
use glam::Vec3;
use gs_core::{Params as _, Rng};
use std::collections::BTreeMap;

const SHAPE: AnchorShape = AnchorShape { offsets: 2, features: 3, dynamics: 2 };
const VOXEL: f32 = 0.01;
const AT: AnchorDensifyStep =
    AnchorDensifyStep { step: 1600, clock: 1600, seed: 7, voxel: VOXEL, diagonal: 100.0, views_per_step: 1 };

/// Anchors in a row along x, `spacing` cells apart; scales 1, everything else 0.
fn anchors(n: usize, spacing: usize) -> Anchors {
    let at: Vec<Vec3> = (0..n).map(|i| Vec3::X * (VOXEL * (i * spacing) as f32)).collect();
    Anchors::new(SHAPE, &at, &vec![0.0; n])
}

/// Statistics in which every Gaussian was rendered `rendered` times with mean gradient `grad`, every anchor opaque.
fn statistics(anchors: &Anchors, grad: f32, rendered: f32) -> AnchorDensify {
    let mut adapt = AnchorDensify::new(anchors);
    adapt.opacity.fill(100.0);
    adapt.visits.fill(100.0);
    adapt.grad.fill(grad * rendered);
    adapt.rendered.fill(rendered);
    adapt
}

fn positions(anchors: &Anchors) -> Vec<Vec3> {
    (0..anchors.len()).map(|v| anchors.position(v)).collect()
}

#[test]
fn views_are_counted_where_they_belong() {
    let mut adapt = AnchorDensify::new(&anchors(3, 1));
    let view = AnchorView {
        visible: &[2, 0],
        activations: &[0.5, -0.25, 0.25, 0.5],
        rows: &[4, 0, 1, 0],
        grad_means2d: &[[0.03, 0.0], [0.03, 0.04], [1.0, 1.0], [f32::NAN, 0.0]],
        radii: &[1.0, 2.0, 0.0, 1.0],
        width: 20,
        height: 20,
        weight: 4.0,
    };
    adapt.observe(&view);
    assert_eq!((&adapt.opacity[..], &adapt.visits[..]), (&[0.75, 0.0, 0.5][..], &[1.0, 0.0, 1.0][..]));
    assert_eq!(adapt.rendered, [2.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
    let wanted = [2.0, 0.0, 0.0, 0.0, 1.2, 0.0];
    assert!(adapt.grad.iter().zip(wanted).all(|(g, w)| (g - w).abs() < 1e-6), "{:?}", adapt.grad);
    adapt.observe(&AnchorView { activations: &[f32::NAN, f32::INFINITY, 0.25, 0.5], ..view });
    assert_eq!((&adapt.opacity[..], adapt.visits[2]), (&[1.5, 0.0, 0.5][..], 2.0));
}

#[test]
fn nothing_changes_between_passes() {
    let mut a = anchors(4, 100);
    let mut s = statistics(&a, 1.0, 50.0);
    let before = (a.clone(), s.clone());
    for clock in [1500, 1650, 15_000] {
        assert_eq!(
            s.adapt(&AnchorDensifyRules::default(), &AnchorDensifyStep { clock, ..AT }, &mut a),
            Ok(AnchorDensifyReport::default())
        );
    }
    assert_eq!((a, s), before);
}

#[test]
fn only_anchors_below_both_strict_bounds_are_pruned() {
    let rules = AnchorDensifyRules { min_opacity: 0.25, ..AnchorDensifyRules::default() };
    let mut a = anchors(5, 100);
    let mut s = statistics(&a, 0.0, 0.0);
    // Seen exactly 80 times; opacity exactly at the bound; just below it; never seen; opaque.
    s.visits = vec![80.0, 96.0, 96.0, 0.0, 81.0];
    s.opacity = vec![0.0, 24.0, 23.999, 0.0, 81.0];
    let did = s.adapt(&rules, &AT, &mut a).unwrap();
    assert_eq!((did.added, did.pruned, a.len()), (0, 1, 4));
    assert_eq!(positions(&a).iter().map(|p| (p.x / VOXEL).round() as u32).collect::<Vec<_>>(), [0, 100, 300, 400]);
    assert_eq!(s.visits, [80.0, 0.0, 0.0, 0.0], "judged anchors restart");
    assert_eq!(s.opacity, [0.0; 4]);
}

#[test]
fn more_views_per_step_ask_for_more_visits() {
    let rules = AnchorDensifyRules { min_opacity: 0.25, ..AnchorDensifyRules::default() };
    let mut a = anchors(2, 100);
    let mut s = statistics(&a, 0.0, 0.0);
    s.visits = vec![320.0, 321.0];
    s.opacity = vec![0.0, 0.0];
    let did = s.adapt(&rules, &AnchorDensifyStep { views_per_step: 4, ..AT }, &mut a).unwrap();
    assert_eq!((did.pruned, a.position(0)), (1, Vec3::ZERO));
}

#[test]
fn the_last_anchor_stays() {
    let mut a = anchors(3, 100);
    let mut s = statistics(&a, 0.0, 0.0);
    s.opacity = vec![0.1, 0.3, 0.2];
    assert_eq!(s.adapt(&AnchorDensifyRules::default(), &AT, &mut a).unwrap().pruned, 2);
    assert_eq!(a.position(0).x, 1.0);
}

#[test]
fn new_anchors_lie_on_the_lattice_of_their_level_in_cells_of_candidates() {
    // Anchors 100 cells apart; each Gaussian sits somewhere within 40 cells of its own.
    let mut a = anchors(300, 100);
    let mut rng = Rng::new(3, "offsets", 0, 0);
    a.offsets.value.iter_mut().for_each(|o| *o = rng.range(-0.4, 0.4));
    let k = SHAPE.offsets;
    let centres: Vec<Vec3> =
        (0..a.len() * k).map(|r| a.position(r / k) + Vec3::from_slice(&a.offsets.value[3 * r..])).collect();
    let mut s = statistics(&a, 8.5e-4, 50.0);
    let did = s.adapt(&AnchorDensifyRules::default(), &AT, &mut a).unwrap();
    assert_eq!((did.pruned, did.added as usize), (0, a.len() - 300));
    let mut first = 300;
    for (&n, (cells, share)) in did.per_level.iter().zip([(16u32, 0.5), (4, 0.75), (1, 0.875)]) {
        let side = VOXEL * cells as f32;
        let level = first..first + n as usize;
        for v in level.clone() {
            let p = a.position(v);
            let c = cell_of(p, side).unwrap();
            assert!(
                (p - crate::lattice::position_of(c, side.into())).length() == 0.0,
                "{p} is not on the lattice of {side}"
            );
            assert!(centres.iter().any(|q| cell_of(*q, side) == Some(c)), "{p}: no candidate");
            assert_eq!(a.log_scales.value[6 * v..][..6], [side.ln(); 6]);
            let earlier = (0..v).filter(|&u| cell_of(a.position(u), side) == Some(c));
            assert_eq!(earlier.count(), 0, "{p} was occupied");
        }
        // 600 candidates; few cells are shared or taken.
        assert!((f64::from(n) / 600.0 - share).abs() < 0.07, "{n} of 600 on level {side}");
        first = level.end;
    }
    assert_eq!((first, s.grad.iter().sum::<f32>(), s.visits.len()), (a.len(), 0.0, a.len()));
}

#[test]
fn thresholds_rise_with_the_level() {
    for (grad, levels) in [(1.9e-4, [false; 3]), (3e-4, [true, false, false]), (5e-4, [true, true, false])] {
        let mut a = anchors(64, 100);
        a.offsets.value.iter_mut().enumerate().for_each(|(i, o)| *o = 0.3 * ((i % 7) as f32 - 3.0) / 3.0);
        let mut s = statistics(&a, grad, 50.0);
        let did = s.adapt(&AnchorDensifyRules::default(), &AT, &mut a).unwrap();
        assert_eq!(did.per_level.iter().map(|n| *n > 0).collect::<Vec<_>>(), levels, "{grad}: {did:?}");
    }
}

#[test]
fn gaussians_rendered_seldom_do_not_grow() {
    let mut a = anchors(64, 100);
    a.offsets.value.fill(0.3);
    // Half of 100 · 0.8 exactly: not more than half.
    let mut s = statistics(&a, 1.0, 40.0);
    assert_eq!(s.adapt(&AnchorDensifyRules::default(), &AT, &mut a).unwrap().added, 0);
    assert!(s.rendered.iter().all(|n| *n == 40.0), "and their counts continue");
}

#[test]
fn finer_levels_wait_for_coarser_ones_only_if_set_to() {
    // The Gaussians sit with their anchors in coarse cells, but in other fine ones.
    let grow = |only_after_coarser| {
        let mut a = anchors(64, 16);
        a.offsets.value.chunks_exact_mut(3).for_each(|o| o.copy_from_slice(&[0.03, 0.0, 0.0]));
        let mut s = statistics(&a, 1e-3, 50.0);
        let rules = AnchorDensifyRules { only_after_coarser, ..AnchorDensifyRules::default() };
        s.adapt(&rules, &AT, &mut a).unwrap().per_level
    };
    assert_eq!(grow(true), [0; 3]);
    let [coarse, middle, fine] = grow(false)[..] else { panic!("three levels") };
    assert!(coarse == 0 && middle > 40 && fine > 40, "{coarse} {middle} {fine}");
}

#[test]
fn new_features_are_the_maximum_over_the_parents() {
    // Two anchors, whose four Gaussians share a position far from both.
    let mut a = anchors(2, 400);
    let target = Vec3::new(2.08, 1.6, 0.0);
    for row in 0..4 {
        let offset = target - a.position(row / 2);
        a.offsets.value[3 * row..][..3].copy_from_slice(&offset.to_array());
    }
    a.features.value = vec![1.0, -2.0, 5.0, 0.5, -1.0, 7.0];
    a.features.moment1.fill(1.0);
    let rules = AnchorDensifyRules { levels: 1, ..AnchorDensifyRules::default() };
    let seed = (0..).find(|&seed| (0..4).all(|row| Rng::new(seed, "grow", AT.step, row).uniform() > 0.5)).unwrap();
    let mut s = statistics(&a, 1.0, 50.0);
    assert_eq!(s.adapt(&rules, &AnchorDensifyStep { seed, ..AT }, &mut a).unwrap().added, 1);
    assert_eq!(a.features.value[6..], [1.0, -1.0, 7.0]);
    assert_eq!(a.features.moment1, [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
    assert!(a.position(2).distance(target) < 1e-6 && a.offsets.value[12..].iter().all(|o| *o == 0.0));
}

#[test]
fn the_cap_admits_the_largest_gradients() {
    let mut a = anchors(40, 100);
    a.offsets.value.chunks_exact_mut(3).for_each(|o| o[1] = 0.4);
    let mut s = statistics(&a, 1e-3, 50.0);
    for v in 30..40 {
        s.grad[2 * v..2 * v + 2].fill(1.0);
    }
    let rules = AnchorDensifyRules { max_anchors: 45, levels: 1, ..AnchorDensifyRules::default() };
    assert_eq!(s.adapt(&rules, &AT, &mut a).unwrap().added, 5);
    assert!((40..45).all(|v| a.position(v).x > 28.0), "only the last ten anchors had such gradients");
    s.grad.fill(50.0);
    s.rendered.fill(50.0);
    assert_eq!(s.adapt(&rules, &AT, &mut a).unwrap().added, 0, "no capacity is left");
}

#[test]
fn scales_are_bounded_and_wild_gaussians_ignored() {
    let mut a = anchors(2, 100);
    a.log_scales.value = vec![9.0, 1.0, -1.0, 9.0, 0.05, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    a.offsets.value[0] = f32::NAN;
    a.offsets.value[3] = 1e30;
    let mut s = statistics(&a, 1.0, 50.0);
    s.adapt(&AnchorDensifyRules::default(), &AT, &mut a).unwrap();
    assert_eq!(a.log_scales.value[..6], [100.0f32.ln(), 1.0, -1.0, 0.05, 0.05, -1.0]);
    assert!(positions(&a).iter().all(|p| p.is_finite()));
    s.visits.pop();
    assert!(s.adapt(&AnchorDensifyRules::default(), &AT, &mut a).is_err(), "statistics of other anchors");
}

#[test]
fn the_same_pass_twice_is_the_same() {
    let run = |seed| {
        let mut a = anchors(100, 50);
        a.offsets.value.iter_mut().enumerate().for_each(|(i, o)| *o = (i as f32 * 0.7).sin());
        let mut s = statistics(&a, 1e-3, 60.0);
        s.adapt(&AnchorDensifyRules::default(), &AnchorDensifyStep { seed, ..AT }, &mut a).unwrap();
        (a, s)
    };
    assert_eq!(run(1), run(1));
    assert_ne!(run(1).0, run(2).0);
}

/// Values of an anchor's rows that are a function of its position.
struct Shadow {
    blocks: Vec<Vec<f32>>,
    columns: Vec<Vec<f32>>,
}

fn key(p: Vec3) -> [u32; 3] {
    p.to_array().map(f32::to_bits)
}

/// Fills an anchor's row of every block (but the position), moment and column.
fn stamp(a: &mut Anchors, s: &mut AnchorDensify, v: usize, round: u32) -> Shadow {
    let [x, y, z] = key(a.position(v));
    let mut rng = Rng::new(u64::from(x) << 32 | u64::from(y), "stamp", round, u64::from(z));
    let mut shadow = Shadow { blocks: vec![], columns: vec![] };
    a.visit_mut(&mut |p| {
        let width = p.row_width.unwrap();
        for column in [&mut p.value, &mut p.moment1, &mut p.moment2] {
            let row = &mut column[v * width..][..width];
            if p.name != "anchors.positions" {
                row.iter_mut().for_each(|x| *x = rng.range(-3.0, 0.0));
            }
            shadow.blocks.push(row.to_vec());
        }
    });
    for (name, width, column) in s.columns_mut() {
        let row = &mut column[v * width..][..width];
        let scale = if name == "adapt.grad" { 0.2 } else { 120.0 };
        row.iter_mut().for_each(|x| *x = rng.range(0.0, scale));
        if name == "adapt.opacity" && rng.uniform() < 0.2 {
            row.fill(0.0);
        }
        shadow.columns.push(row.to_vec());
    }
    shadow
}

fn row_of(a: &Anchors, v: usize) -> Vec<Vec<f32>> {
    let mut rows = Vec::new();
    a.visit(&mut |p| {
        let width = p.row_width.unwrap();
        rows.extend([&p.value, &p.moment1, &p.moment2].map(|column| column[v * width..][..width].to_vec()));
    });
    rows
}

#[test]
fn every_row_keeps_its_own_through_any_sequence_of_passes() {
    let rules = AnchorDensifyRules { grad: 2e-3, max_anchors: 1500, ..AnchorDensifyRules::default() };
    let mut a = anchors(60, 37);
    let mut s = AnchorDensify::new(&a);
    let (mut added, mut pruned) = (0, 0);
    for round in 0..25 {
        let shadows: BTreeMap<[u32; 3], Shadow> =
            (0..a.len()).map(|v| (key(a.position(v)), stamp(&mut a, &mut s, v, round))).collect();
        assert_eq!(shadows.len(), a.len(), "no two anchors share a position");
        let at = AnchorDensifyStep { step: 1600 + 100 * round, clock: 1600 + 100 * round, ..AT };
        let did = s.adapt(&rules, &at, &mut a).unwrap();
        (added, pruned) = (added + did.added, pruned + did.pruned);
        assert_eq!(a.len(), shadows.len() + did.added as usize - did.pruned as usize);
        let mut kept = 0;
        for v in 0..a.len() {
            let row = row_of(&a, v);
            let columns: Vec<Vec<f32>> = s.columns().iter().map(|(_, w, c)| c[v * w..][..*w].to_vec()).collect();
            match shadows.get(&key(a.position(v))) {
                Some(shadow) => {
                    kept += 1;
                    assert_eq!(row, shadow.blocks, "round {round}, row {v}");
                    for (new, old) in columns.concat().iter().zip(shadow.columns.concat()) {
                        assert!(*new == old || *new == 0.0, "round {round}, row {v}: {new} was {old}");
                    }
                    let judged = shadow.columns[1][0] > 80.0;
                    assert_eq!(columns[1][0] == 0.0, judged, "round {round}, row {v}");
                }
                None => {
                    assert!(columns.concat().iter().all(|x| *x == 0.0));
                    let moments = row.chunks_exact(3).flat_map(|block| block[1..].concat());
                    assert!(moments.into_iter().all(|m| m == 0.0));
                }
            }
        }
        assert_eq!(kept, shadows.len() - did.pruned as usize);
    }
    assert!(added > 500 && pruned > 100, "{added} added, {pruned} pruned");
}
