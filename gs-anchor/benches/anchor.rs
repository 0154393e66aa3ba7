//! Time and error of anchors at the published sizes: decoding, deformation per interval, visibility.
//!
//! Each row is printed and appended to `target/speed-error/gs-anchor.jsonl`. `work` counts floating-point operations of
//! matrix products (two per multiply-add), or anchors where there are none.

use criterion::Criterion;
use glam::{DVec3, Vec3};
use gs_anchor::reference::{AnchorRef, Blocks, DecoderRef, GadRef, GaussianRef, RestRef};
use gs_anchor::{AnchorShape, Anchors, DecodeTape, Decoder, DecoderConfig, Gad, GadConfig, GadTape};
use gs_anchor::{LocalAnchors, LocalAnchorsGrad, VisibilityOptions, Visible, visible};
use gs_core::speed::{BenchRow, Stopwatch};
use gs_core::{Camera, Params, Rng, Splats, SplatsGrad, Time};
use gs_deform::{Aabb, PlaneNetConfig};
use gs_raster::{RasterOptions, Workspace, render};
use std::time::Duration;

/// Number of anchors in view.
const ANCHORS: usize = 12_000;
/// Anchors compared with the reference.
const COMPARED: usize = 300;
const SHAPE: AnchorShape = AnchorShape { offsets: 10, features: 32, dynamics: 2 };
const T: Time = Time { normalised: 0.37, seconds: 0.37 };
type Failure = Box<dyn std::error::Error>;

/// A row of the table, without its time.
struct Row {
    case: &'static str,
    variant: &'static str,
    work: f64,
    error: f64,
    error_kind: &'static str,
}

/// Measures `f`, prints the row with the median, and records it.
fn measure(c: &mut Criterion, row: &Row, mut f: impl FnMut()) {
    let mut laps = Stopwatch::default();
    c.bench_function(&format!("{}/{}/{ANCHORS}", row.case, row.variant), |b| {
        b.iter_custom(|calls| laps.run(calls, &mut f))
    });
    let Some(ms) = laps.median_ms() else { return };
    let line = BenchRow {
        krate: "gs-anchor",
        case: row.case.to_owned(),
        variant: row.variant.to_owned(),
        n: ANCHORS,
        threads: rayon::current_num_threads(),
        ms,
        work: row.work,
        error: Some(row.error),
        error_kind: row.error_kind,
    };
    line.append(env!("CARGO_MANIFEST_DIR"));
}

/// Anchors on a sphere with random values, as after some training.
fn anchors() -> Anchors {
    let point = |row| {
        let mut rng = Rng::new(1, "points", 0, row);
        0.8 * Vec3::new(rng.normal(), rng.normal(), rng.normal()).normalize_or(Vec3::X)
    };
    let positions: Vec<Vec3> = (0..ANCHORS as u64).map(point).collect();
    let mut anchors = Anchors::new(SHAPE, &positions, &vec![-3.5; ANCHORS]);
    anchors.visit_mut(&mut |p| {
        let mut rng = Rng::new(2, &p.name, 0, 0);
        if p.name != "anchors.positions" {
            p.value.iter_mut().for_each(|v| *v += 0.5 * rng.normal());
        }
    });
    anchors
}

/// Largest difference relative to the largest wanted value.
fn worst(got: &[f64], want: &[f64]) -> f64 {
    let largest = want.iter().fold(1e-30f64, |m, v| m.max(v.abs()));
    got.iter().zip(want).fold(0.0f64, |m, (g, w)| m.max((g - w).abs())) / largest
}

fn wide(v: &[f32]) -> Vec<f64> {
    v.iter().map(|&v| f64::from(v)).collect()
}

/// One splat, with a cotangent of one for every value.
fn flat(g: &GaussianRef) -> Vec<f64> {
    [&[g.activation][..], &g.mean, &g.scale, &g.quat, &g.color].concat()
}

const ONES: GaussianRef =
    GaussianRef { activation: 1.0, mean: [1.0; 3], scale: [1.0; 3], quat: [1.0; 4], color: [1.0; 3] };

fn ones(splats: &Splats) -> SplatsGrad {
    let mut d = SplatsGrad::zeros_like(splats);
    d.means.fill(Vec3::ONE);
    d.scales.fill(Vec3::ONE);
    d.quats.fill([1.0; 4]);
    d.opacities.fill(1.0);
    d.color.fill(1.0);
    d
}

fn flat_anchor(a: &AnchorRef) -> Vec<f64> {
    [&a.position[..], &a.offsets, &a.features, &a.scales].concat()
}

fn local_row(d: &LocalAnchorsGrad, v: usize) -> Vec<f64> {
    let (k, c) = (3 * SHAPE.offsets, SHAPE.features);
    let position = d.positions[v].to_array();
    wide(&[&position[..], &d.offsets[v * k..][..k], &d.features[v * c..][..c], &d.scales[v * 6..][..6]].concat())
}

/// Worst splat and worst anchor's gradient against the reference.
fn decode_errors(
    decoder: &Decoder,
    local: &LocalAnchors,
    eye: DVec3,
    out: &Splats,
    d: &LocalAnchorsGrad,
) -> (f64, f64) {
    let reference = DecoderRef::new(decoder);
    let mut grads: Blocks = reference.blocks.iter().map(|(n, b)| (n.clone(), vec![0.0; b.len()])).collect();
    let (mut n, mut splats, mut gradients) = (0, 0.0f64, 0.0f64);
    for v in 0..COMPARED {
        let anchor = AnchorRef::new(local, v);
        for g in reference.decode(&anchor, eye.to_array()).iter().filter(|g| g.activation > 0.0) {
            let (mean, scale) = (out.means[n].to_array(), out.scales[n].to_array());
            let rgb = &out.color.as_flat()[3 * n..][..3];
            let got = [&[out.opacities[n]][..], &mean, &scale, &out.quats[n], rgb].concat();
            splats = splats.max(worst(&wide(&got), &flat(g)));
            n += 1;
        }
        let back = reference.backward(&anchor, eye.to_array(), &vec![ONES; SHAPE.offsets], &mut grads);
        gradients = gradients.max(worst(&local_row(d, v), &flat_anchor(&back)));
    }
    (splats, gradients)
}

fn decode(c: &mut Criterion, anchors: &Anchors, camera: &Camera) -> Result<Splats, Failure> {
    let mut decoder = Decoder::new(&DecoderConfig::default(), SHAPE, 1)?;
    let (mut local, mut tape, mut out, mut d) = Default::default();
    anchors.activate(&mut local);
    let eye = camera.position();
    decoder.forward(&local, Visible::All, eye, &mut tape, &mut out);
    let d_out = ones(&out);
    LocalAnchorsGrad::reset(&mut d, &local);
    decoder.backward(&local, &mut tape, &d_out, &mut d);
    let (splats, gradients) = decode_errors(&decoder, &local, eye, &out, &d);
    println!("    {} splats of {ANCHORS} anchors", out.len());
    // Inputs of 35, three hidden layers of 32, eleven outputs per Gaussian.
    let flops = 2.0 * (ANCHORS * (35 * 96 + 32 * 11 * SHAPE.offsets)) as f64;
    let work = |tape: &mut DecodeTape, out: &mut Splats| decoder.forward(&local, Visible::All, eye, tape, out);
    let row = |variant, work, error, error_kind| Row { case: "decode", variant, work, error, error_kind };
    measure(c, &row("forward", flops, splats, "splats relative to f64"), || work(&mut tape, &mut out));
    measure(c, &row("forward and backward", 3.0 * flops, gradients, "gradients relative to f64"), || {
        decoder.forward(&local, Visible::All, eye, &mut tape, &mut out);
        d.reset(&local);
        decoder.backward(&local, &mut tape, &d_out, &mut d);
    });
    Ok(out)
}

fn deform(c: &mut Criterion, anchors: &mut Anchors) -> Result<(), Failure> {
    let published = GadConfig::default();
    let config = GadConfig { net: PlaneNetConfig { zero_init: false, ..published.net }, ..published };
    let mut gad = Gad::new(&config, SHAPE, Aabb::cube(1.0), 1)?;
    let (mut tape, mut out, mut d) = (GadTape::default(), LocalAnchors::default(), LocalAnchorsGrad::default());
    gad.forward(anchors, T, &mut tape, &mut out);
    d.reset(&out);
    d.positions.fill(Vec3::ONE);
    [&mut d.offsets, &mut d.features, &mut d.scales].into_iter().for_each(|d| d.fill(1.0));
    gad.backward(anchors, &mut tape, &d, 1.0);
    let reference = GadRef::new(&gad);
    let mut grad = reference.net.zero_grad();
    let (mut values, mut gradients) = (0.0f64, 0.0f64);
    for v in 0..COMPARED {
        let rest = RestRef::new(anchors, v);
        values = values.max(worst(&flat_anchor(&AnchorRef::new(&out, v)), &flat_anchor(&reference.moved(&rest, T))));
        let d = AnchorRef { position: [1.0; 3], offsets: vec![1.0; 30], features: vec![1.0; 32], scales: [1.0; 6] };
        let want = reference.backward(&rest, T, &d, &mut grad).logits;
        let got = anchors.dynamics.as_ref().map_or(&[][..], |p| &p.grad[2 * v..][..2]);
        gradients = gradients.max(worst(&wide(got), &want));
    }
    // Features of 32, trunk of 128, four hidden layers of 128, 71 outputs.
    let flops = 2.0 * (ANCHORS * (32 * 128 + 128 * 512 + 128 * (3 + 32 + 30 + 6))) as f64;
    let row = |variant, work, error, error_kind| Row { case: "gad, width 128", variant, work, error, error_kind };
    measure(c, &row("forward", flops, values, "anchors relative to f64"), || {
        gad.forward(anchors, T, &mut tape, &mut out);
    });
    measure(c, &row("forward and backward", 3.0 * flops, gradients, "logits' gradients relative to f64"), || {
        gad.forward(anchors, T, &mut tape, &mut out);
        gad.backward(anchors, &mut tape, &d, 1.0);
    });
    let kept = out.clone();
    gad.forward(anchors, T, &mut GadTape::default(), &mut out);
    let same = if kept == out { 0.0 } else { 1.0 };
    measure(c, &row("kept per interval", ANCHORS as f64, same, "difference from fresh"), || out.clone_from(&kept));
    Ok(())
}

/// A camera with part of the sphere in view: the filter against decoding everything.
fn visibility(c: &mut Criterion, anchors: &Anchors, camera: &Camera, all: &Splats) -> Result<(), Failure> {
    let decoder = Decoder::new(&DecoderConfig::default(), SHAPE, 1)?;
    let (mut local, mut seen, mut tape, mut some) = Default::default();
    anchors.activate(&mut local);
    visible::conservative(&local, camera, &VisibilityOptions::default(), &mut seen);
    decoder.forward(&local, Visible::List(&seen), camera.position(), &mut tape, &mut some);
    let image = |s: &Splats| render(s, camera, &RasterOptions::default(), &mut Workspace::new()).rgb.data;
    let error = worst(&wide(&image(&some)), &wide(&image(all)));
    println!("    {} of {ANCHORS} anchors listed", seen.len());
    let row = |case, variant, error| Row {
        case,
        variant,
        work: ANCHORS as f64,
        error,
        error_kind: "picture with and without",
    };
    measure(c, &row("visible", "clean", error), || {
        visible::conservative(&local, camera, &VisibilityOptions::default(), &mut seen);
    });
    measure(c, &row("decode", "forward, what is visible", error), || {
        decoder.forward(&local, Visible::List(&seen), camera.position(), &mut tape, &mut some);
    });
    visible::published(anchors, camera, &mut seen);
    decoder.forward(&local, Visible::List(&seen), camera.position(), &mut tape, &mut some);
    let error = worst(&wide(&image(&some)), &wide(&image(all)));
    measure(c, &row("visible", "published", error), || {
        visible::published(anchors, camera, &mut seen);
    });
    Ok(())
}

fn main() -> Result<(), Failure> {
    let mut c = Criterion::default()
        .sample_size(15)
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_millis(900))
        .without_plots()
        .configure_from_args();
    let mut anchors = anchors();
    let camera = Camera::look_at(320, 240, 0.7, DVec3::new(0.4, 0.2, -1.6), DVec3::new(0.3, 0.2, 0.0), DVec3::Y)?;
    let all = decode(&mut c, &anchors, &camera)?;
    visibility(&mut c, &anchors, &camera, &all)?;
    deform(&mut c, &mut anchors)
}
