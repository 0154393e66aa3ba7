//! Time and error of texel Gaussians of the walking person: base maps, rows to splats and backward, rendering.
//!
//! Each row is printed and appended to `target/speed-error/gs-texel.jsonl`; `work` counts texels. Errors of decoding are
//! those against the same code in `f64`, relative to the largest entry.

use glam::{DVec3, Vec3};
use gs_core::speed::{BenchRow, median_seconds};
use gs_core::{Camera, Rng, SplatsGrad};
use gs_raster::{RasterOptions, Workspace, render};
use gs_texel::Skinning;
use gs_texel::figure::person;
use gs_texel::gaussians::row::{self, Base, Gaussian};
use gs_texel::gaussians::{Channels, Covariance, DecodeOptions, TexelBase, decode, decode_backward, warm_up};
use gs_texel::skin::rotations;
use gs_texel::surface::Topology;
use gs_texel::texels::{TexelOptions, TexelTable};
use std::error::Error;
use std::hint::black_box;

const SIZE: usize = 256;
const RUNS: usize = 15;

fn keep(case: &str, variant: &str, n: usize, error: (f64, &'static str), seconds: f64) {
    let (krate, threads, ms, work) = ("gs-texel", rayon::current_num_threads(), 1e3 * seconds, n as f64);
    let ((error, error_kind), case, variant) = ((Some(error.0), error.1), case.to_owned(), variant.to_owned());
    BenchRow { krate, case, variant, n, threads, ms, work, error, error_kind }.append(env!("CARGO_MANIFEST_DIR"));
}

/// The person in the middle of a step, its texels, and rows of an opaque skin with a little noise.
struct Walker {
    base: TexelBase,
    rows: Vec<f32>,
    channels: Channels,
}

fn walker() -> Result<Walker, Box<dyn Error>> {
    let body = person();
    let t = &body.template;
    let clip = body.clip("walk").ok_or("no walk")?;
    let pose = clip.pose(&body.skeleton, 0.3);
    let (joints, bind) = (body.skeleton.skinning(&pose), t.morphed(&pose.morphs));
    let transforms = Skinning::Lbs.blend(&t.weights, &joints);
    let turns = rotations(&t.weights, &joints, &transforms);
    let kappas = vec![1.0; bind.len()];
    let table = TexelTable::build(&t.faces, &t.uvs, &t.face_uvs, SIZE, &TexelOptions::default())?;
    let base = TexelBase::new(&table, &t.faces, &bind, &transforms, &turns, &kappas)?;
    let seconds = median_seconds(RUNS, || {
        black_box(TexelBase::new(&table, &t.faces, &bind, &transforms, &turns, &kappas).is_ok());
    });
    // A texel's point is the mean of its triangle's corners by weights: again in f64.
    let corner = |k: usize| {
        let corners = t.faces[table.tri[k] as usize].map(|v| bind[v as usize].as_dvec3());
        corners.into_iter().zip(table.weights(k)).map(|(p, w)| p * f64::from(w)).sum::<DVec3>()
    };
    let error = (0..base.len()).map(|k| (base.points[k].as_dvec3() - corner(k)).length()).fold(0.0, f64::max);
    keep("base maps 256", "points, matrices, turns", base.len(), (error, "m, against f64"), seconds);
    let normals = Topology::new(&t.faces, bind.len())?.normals(&bind, &t.faces);
    let normals: Vec<Vec3> =
        table.interp_vec3(&t.faces, &normals).into_iter().map(|n| n.normalize_or(Vec3::Z)).collect();
    let color = |k: usize| {
        let c = t.colour(table.tri[k] as usize, table.weights(k));
        [c.x, c.y, c.z]
    };
    let colors: Vec<[f32; 3]> = (0..table.len()).map(color).collect();
    let channels = Channels::new(1)?;
    let mut rows = warm_up::targets(channels, &colors, &base.points, &normals, [1e-5, 0.5])?;
    for (k, row) in rows.chunks_exact_mut(channels.width()).enumerate() {
        let mut rng = Rng::new(1, "noise", 0, k as u64);
        row[..8].iter_mut().for_each(|v| *v += 0.02 * rng.normal());
        // Some texels are left empty, as training leaves them.
        row[7] = if rng.uniform() < 0.2 { -8.0 } else { 3.0 };
    }
    Ok(Walker { base, rows, channels })
}

fn wide<const N: usize>(v: [f32; N]) -> [f64; N] {
    v.map(f64::from)
}

fn wide_base(b: &Base<f32>) -> Base<f64> {
    let kappa = f64::from(b.kappa);
    let (translation, rotation) = (wide(b.translation), wide(b.rotation));
    Base { point: wide(b.point), linear: b.linear.map(wide), translation, rotation, kappa }
}

/// Largest difference over the largest entry, column by column, the worst of them.
fn apart(columns: &[(Vec<f32>, Vec<f64>)]) -> f64 {
    let of = |(got, want): &(Vec<f32>, Vec<f64>)| {
        let size = want.iter().fold(1e-30f64, |m, v| m.max(v.abs()));
        got.iter().zip(want).map(|(g, w)| (f64::from(*g) - w).abs()).fold(0.0, f64::max) / size
    };
    columns.iter().map(of).fold(0.0, f64::max)
}

fn decoding(w: &Walker) -> Result<(), Box<dyn Error>> {
    let (width, n) = (w.channels.width(), w.base.len());
    for covariance in [Covariance::Polar, Covariance::Affine] {
        let options = DecodeOptions { covariance, ..DecodeOptions::default() };
        let range = options.scale_range.map(f64::ln);
        let splats = decode(&w.rows, w.channels, &w.base, &options)?;
        let mut d = SplatsGrad::zeros_like(&splats);
        let mut rng = Rng::new(2, "cotangents", 0, 0);
        d.means.iter_mut().for_each(|v| *v = Vec3::new(rng.normal(), rng.normal(), rng.normal()));
        d.scales.iter_mut().for_each(|v| *v = Vec3::new(rng.normal(), rng.normal(), rng.normal()));
        d.opacities.iter_mut().for_each(|v| *v = rng.normal());
        let mut grad = vec![0.0; w.rows.len()];
        decode_backward(&w.rows, w.channels, &w.base, &options, &d, &mut grad, None)?;
        let (mut means, mut scales, mut grads) = (Vec::new(), Vec::new(), Vec::new());
        for (k, row) in w.rows.chunks_exact(width).enumerate() {
            let (row, base) = (row.iter().map(|v| f64::from(*v)).collect::<Vec<_>>(), wide_base(&w.base.row(k)));
            let g = row::decode(&row, &base, covariance, range);
            means.extend(g.mean);
            scales.extend(g.scale);
            let (mean, scale) = (wide(d.means[k].to_array()), wide(d.scales[k].to_array()));
            let cotangent = Gaussian { mean, quat: [0.0; 4], scale, opacity: f64::from(d.opacities[k]) };
            let mut grad = vec![0.0; width];
            row::backward(&row, &base, covariance, range, &cotangent, &mut grad);
            grads.extend(grad);
        }
        let flat = |v: &[Vec3]| v.iter().flat_map(|v| v.to_array()).collect::<Vec<f32>>();
        let error = apart(&[(flat(&splats.means), means), (flat(&splats.scales), scales)]);
        let kind = "relative to f64";
        let case = format!("decode 256, {covariance:?}").to_lowercase();
        let seconds = median_seconds(RUNS, || {
            black_box(decode(&w.rows, w.channels, &w.base, &options).is_ok());
        });
        keep(&case, "forward", n, (error, kind), seconds);
        let error = apart(&[(grad.clone(), grads)]);
        let seconds = median_seconds(RUNS, || {
            black_box(decode_backward(&w.rows, w.channels, &w.base, &options, &d, &mut grad, None).is_ok());
        });
        keep(&case, "backward", n, (error, kind), seconds);
    }
    Ok(())
}

/// Time to render the person.
fn rendering(w: &Walker) -> Result<(), Box<dyn Error>> {
    let camera = Camera::look_at(512, 512, 0.8, DVec3::new(0.6, 1.1, 2.6), DVec3::new(0.0, 0.9, 0.0), DVec3::Y)?;
    let splats = decode(&w.rows, w.channels, &w.base, &DecodeOptions::default())?;
    let (options, mut workspace) = (RasterOptions::default(), Workspace::default());
    let seconds = median_seconds(RUNS, || drop(black_box(render(&splats, &camera, &options, &mut workspace))));
    keep("draw the person 512", "all", splats.len(), (0.0, "rms, all Gaussians"), seconds);
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let walker = walker()?;
    decoding(&walker)?;
    rendering(&walker)
}
