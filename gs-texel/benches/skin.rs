//! Time and error of skinning: blended matrices (linear and dual), the rotations nearest to them, points and gradients.
//!
//! The body is a cylinder whose upper bone is twisted by a right angle about its axis, where everything is known: at weight
//! `w` of the upper bone the linear blend is `(1 − w) I + w R(90°)`, its nearest rotation turns by `atan2(w, 1 − w)`, the dual
//! blend by `2 atan2(w sin 45°, 1 − w + w cos 45°)`. Errors are the largest of any vertex, beside the body of 1 m.
//!
//! Each row is printed and appended to `target/speed-error/gs-texel.jsonl`; `work` counts vertices.

use glam::{DQuat, DVec3, Vec3};
use gs_core::speed::{BenchRow, median_seconds};
use gs_texel::figure::{Cylinder, cylinder, person};
use gs_texel::skin::{rotations, skin, skin_backward};
use gs_texel::{Character, Skinning};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};
use std::hint::black_box;

const RUNS: usize = 21;

fn keep(case: &str, variant: &str, n: usize, error: Option<f64>, error_kind: &'static str, seconds: f64) {
    let (krate, threads, ms, work) = ("gs-texel", rayon::current_num_threads(), 1e3 * seconds, n as f64);
    let (case, variant) = (case.to_owned(), variant.to_owned());
    BenchRow { krate, case, variant, n, threads, ms, work, error, error_kind }.append(env!("CARGO_MANIFEST_DIR"));
}

fn about_y(angle: f64) -> DQuat {
    DQuat::from_axis_angle(DVec3::Y, angle)
}

/// Weight of the upper bone, per vertex.
fn upper(body: &Character) -> Vec<f64> {
    let weights = &body.template.weights;
    let of = |i| weights.row(i).filter(|(j, _)| *j == 1).map(|(_, w)| f64::from(w)).sum::<f64>();
    (0..weights.len()).map(of).collect()
}

/// Largest distance of a vertex from the closed form.
fn worst(got: &[Vec3], from: &[Vec3], weights: &[f64], want: impl Fn(DVec3, f64) -> DVec3) -> f64 {
    let rows = got.iter().zip(from).zip(weights);
    rows.map(|((got, &v), &w)| (got.as_dvec3() - want(v.as_dvec3(), w)).length()).fold(0.0, f64::max)
}

fn linear(v: DVec3, w: f64, angle: f64) -> DVec3 {
    v * (1.0 - w) + about_y(angle) * v * w
}

fn dual(v: DVec3, w: f64) -> DVec3 {
    about_y(2.0 * (w * FRAC_PI_4.sin()).atan2(1.0 - w + w * FRAC_PI_4.cos())) * v
}

fn cylinders() {
    let body = cylinder(&Cylinder { bands: [256, 256], ..Cylinder::default() });
    let (points, weights, n) = (&body.template.vertices, &body.template.weights, body.template.vertices.len());
    let Some(clip) = body.clip("twist") else { return };
    let joints = body.skeleton.skinning(&clip.pose(&body.skeleton, 1.0));
    let share = upper(&body);
    let case = "skin a twisted cylinder";
    let (kind, blends) = ("m, closed form", [Skinning::Lbs, Skinning::Dqs].map(|s| s.blend(weights, &joints)));
    let errors = [
        worst(&skin(points, &blends[0]), points, &share, |v, w| linear(v, w, FRAC_PI_2)),
        worst(&skin(points, &blends[1]), points, &share, dual),
    ];
    for (skinning, error) in [Skinning::Lbs, Skinning::Dqs].into_iter().zip(errors) {
        let seconds = median_seconds(RUNS, || drop(black_box(skinning.blend(weights, &joints))));
        keep(case, &format!("{skinning:?} matrices").to_lowercase(), n, Some(error), kind, seconds);
    }
    let seconds = median_seconds(RUNS, || drop(black_box(skin(points, &blends[0]))));
    keep(case, "points", n, Some(errors[0]), kind, seconds);
    let error = worst(&skin_backward(&blends[0], points), points, &share, |g, w| linear(g, w, -FRAC_PI_2));
    let seconds = median_seconds(RUNS, || drop(black_box(skin_backward(&blends[0], points))));
    keep(case, "gradients", n, Some(error), kind, seconds);
    let turns = rotations(weights, &joints, &blends[0]);
    let off = |(q, w): (&[f32; 4], &f64)| {
        let q = q.map(f64::from);
        DQuat::from_xyzw(q[1], q[2], q[3], q[0]).normalize().angle_between(about_y(w.atan2(1.0 - w)))
    };
    let error = turns.iter().zip(&share).map(off).fold(0.0, f64::max);
    let seconds = median_seconds(RUNS, || drop(black_box(rotations(weights, &joints, &blends[0]))));
    keep(case, "nearest rotations", n, Some(error), "rad, closed form", seconds);
}

/// What a frame of the built-in person costs, against the same sums in `f64`.
fn people() {
    let body = person();
    let Some(clip) = body.clip("walk") else { return };
    let n = body.template.vertices.len();
    let pose = clip.pose(&body.skeleton, 0.3);
    let (joints, bind) = (body.skeleton.skinning(&pose), body.template.morphed(&pose.morphs));
    let want = |i: usize| {
        let v = bind[i].as_dvec3();
        let of = |(j, w): (u32, f32)| joints[j as usize].transform_point3(v) * f64::from(w);
        body.template.weights.row(i).map(of).sum::<DVec3>()
    };
    let posed = body.posed(&pose, Skinning::Lbs);
    let error = posed.iter().enumerate().map(|(i, p)| (p.as_dvec3() - want(i)).length()).fold(0.0, f64::max);
    let seconds = median_seconds(RUNS, || {
        let pose = clip.pose(&body.skeleton, 0.3);
        drop(black_box(body.posed(&pose, Skinning::Lbs)));
    });
    keep("the person at a moment", "clip, joints, morphs, lbs", n, Some(error), "m, against f64", seconds);
}

fn main() {
    cylinders();
    people();
}
