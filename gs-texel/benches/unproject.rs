//! Time and error of the per-frame work on texels: depth maps, rays, unprojection by every rule,
//! in-painting. The figure is two spheres of 18.8 thousand triangles, painted
//! `½ + 0.4 sin(12x) cos(12y)` and rendered from four sides.
//!
//! Each row is printed and appended to `target/speed-error/gs-texel.jsonl`; `work` counts pixels, rays or texels.

#[path = "../tests/texel/scenes.rs"]
mod scenes;

use criterion::Criterion;
use glam::{DVec3, Vec3};
use gs_core::speed::{BenchRow, Stopwatch};
use gs_core::{Camera, Image};
use gs_texel::bvh::Tracer;
use gs_texel::inpaint::{InpaintMethod, inpaint};
use gs_texel::texels::TexelTable;
use gs_texel::unproject::{Compat, UnprojectConfig, unproject};
use gs_texel::visibility::Rule;
use gs_texel::zbuffer::DepthMap;
use scenes::{TexturedMesh, psnr, render, ring, two_spheres, views, waves};
use std::hint::black_box;
use std::time::Duration;

type Failure = Box<dyn std::error::Error>;

/// A row without its time.
struct Row {
    case: String,
    variant: String,
    n: usize,
    error: Option<f64>,
    error_kind: &'static str,
}

/// Measures `f`, prints the row with the median, and records it.
fn measure(c: &mut Criterion, row: Row, mut f: impl FnMut()) {
    let mut laps = Stopwatch::default();
    c.bench_function(&format!("{}/{}", row.case, row.variant), |b| b.iter_custom(|calls| laps.run(calls, &mut f)));
    let Some(ms) = laps.median_ms() else { return };
    let (krate, threads, work) = ("gs-texel", rayon::current_num_threads(), row.n as f64);
    let Row { case, variant, n, error, error_kind } = row;
    BenchRow { krate, case, variant, n, threads, ms, work, error, error_kind }.append(env!("CARGO_MANIFEST_DIR"));
}

/// Amplitude of the error of so many decibels.
fn rms(db: f64) -> Option<f64> {
    Some(10f64.powf(-db / 20.0))
}

/// Largest distance between what the tracer hits and what the nearest of all triangles is, in `f64`; infinite if one is hit
/// and the other is not.
fn off_brute_force(tracer: &Tracer, vertices: &[Vec3], faces: &[[u32; 3]], origin: Vec3, rays: &[Vec3]) -> f64 {
    let nearest = |d: DVec3| {
        let of = |f: &[u32; 3]| {
            let [a, b, c] = f.map(|v| vertices[v as usize].as_dvec3());
            let (ab, ac, from) = (b - a, c - a, origin.as_dvec3() - a);
            let (p, q) = (d.cross(ac), from.cross(ab));
            let det = ab.dot(p);
            let (u, v, t) = (from.dot(p) / det, d.dot(q) / det, ac.dot(q) / det);
            (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0).then_some(t)
        };
        faces.iter().filter_map(of).min_by(f64::total_cmp)
    };
    let off = |&d: &Vec3| match (tracer.hit(origin, d), nearest(d.as_dvec3())) {
        (Some(hit), Some(t)) => (f64::from(hit.t) - t).abs() * d.as_dvec3().length(),
        (None, None) => 0.0,
        _ => f64::INFINITY,
    };
    rays.iter().map(off).fold(0.0, f64::max)
}

fn geometry(c: &mut Criterion, figure: &TexturedMesh, camera: &Camera) -> Result<(), Failure> {
    let map = DepthMap::new(&figure.vertices, &figure.faces, camera, 0.05);
    let covered = map.depth.iter().filter(|d| d.is_finite()).count();
    let mut tracer = Tracer::new(&figure.vertices, &figure.faces)?;
    let origin = camera.position().as_vec3();
    let ray = |i: usize| camera.ray((i % map.width) as f64 + 0.5, (i / map.width) as f64 + 0.5).as_vec3();
    let every = 7;
    let worst = (0..map.depth.len()).step_by(every).fold(0.0f64, |worst, i| {
        let (z, hit) = (map.depth[i], tracer.hit(origin, ray(i)));
        let depth = |t: f32| camera.to_camera((origin + ray(i) * t).as_dvec3()).z;
        hit.filter(|_| z.is_finite()).map_or(worst, |h| worst.max((depth(h.t) - f64::from(z)).abs()))
    });
    let row = |case: &str, variant: &str, n, error, error_kind| Row {
        case: case.into(),
        variant: variant.into(),
        n,
        error,
        error_kind,
    };
    let kind = "m, worst, against rays";
    measure(c, row("depth map 1024", "covered pixels", covered, Some(worst), kind), || {
        black_box(DepthMap::new(&figure.vertices, &figure.faces, camera, 0.05));
    });
    measure(c, row("tracer", "build", figure.faces.len(), None, ""), || {
        black_box(Tracer::new(&figure.vertices, &figure.faces).is_ok());
    });
    let rays: Vec<Vec3> = (0..map.depth.len()).step_by(every).map(ray).collect();
    let probes: Vec<Vec3> = rays.iter().step_by(500).copied().collect();
    let kind = "m, worst of 300 rays, against all triangles";
    let bent: Vec<Vec3> = figure.vertices.iter().map(|v| *v + 0.1 * (4.0 * v.y).sin() * Vec3::X).collect();
    tracer.refit(&bent)?;
    let refit = Some(off_brute_force(&tracer, &bent, &figure.faces, origin, &probes));
    measure(c, row("tracer", "refit", figure.faces.len(), refit, kind), || {
        black_box(tracer.refit(&bent).is_ok());
    });
    tracer.refit(&figure.vertices)?;
    let closest = Some(off_brute_force(&tracer, &figure.vertices, &figure.faces, origin, &probes));
    measure(c, row("tracer", "closest, one thread", rays.len(), closest, kind), || {
        black_box(rays.iter().filter(|&&d| tracer.hit(origin, d).is_some()).count());
    });
    let twice = Some(figure.table(512).report.overlaps as f64);
    measure(c, row("texel table", "512", 512 * 512, twice, "texels owned twice"), || {
        black_box(figure.table(512));
    });
    Ok(())
}

fn rules(c: &mut Criterion, figure: &TexturedMesh, table: &TexelTable) -> Result<(), Failure> {
    let color = waves(12.0);
    for side in [512, 1024, 2048] {
        let cameras = ring(4, side);
        let images: Vec<Image> = cameras.iter().map(|c| render(figure, c, &color)).collect();
        let views = views(&cameras, &images);
        let mut run = |variant: &str, config: UnprojectConfig| -> Result<(), Failure> {
            let texture = unproject(&figure.mesh(), table, &views, &config)?;
            let row = Row {
                case: format!("unproject 4x{side} to {}", table.size),
                variant: variant.into(),
                n: table.len(),
                error: rms(psnr(&texture, figure, table, &color)),
                error_kind: "rms, seen texels",
            };
            measure(c, row, || drop(black_box(unproject(&figure.mesh(), table, &views, &config))));
            Ok(())
        };
        for rule in Rule::ALL {
            run(rule.name(), UnprojectConfig { rule, ..UnprojectConfig::default() })?;
        }
        let compat = Compat { align_corners: true, ..Compat::default() };
        run("bilinear, align corners", UnprojectConfig { rule: Rule::Bilinear, compat, ..Default::default() })?;
    }
    Ok(())
}

fn holes(c: &mut Criterion, figure: &TexturedMesh, table: &TexelTable) -> Result<(), Failure> {
    let truth: Vec<[f32; 3]> =
        table.interp_vec3(&figure.faces, &figure.vertices).iter().map(|p| waves(4.0)(p.as_dvec3())).collect();
    let known: Vec<bool> = (0..table.len()).map(|k| (table.uv(k) - 0.5).length() > 0.06).collect();
    let ways = [
        (InpaintMethod::Nearest, "nearest"),
        (InpaintMethod::Delaunay, "delaunay"),
        (InpaintMethod::Natural, "natural"),
        (InpaintMethod::PushPull, "push-pull"),
        (InpaintMethod::Harmonic, "harmonic"),
    ];
    for (how, variant) in ways {
        let mut rows = truth.clone();
        let done = inpaint(table, &mut rows, &known, how)?;
        let sum: f64 = rows.iter().zip(&truth).map(|(a, b)| f64::from(a[0] - b[0]).powi(2)).sum();
        let row = Row {
            case: "in-paint a disc".into(),
            variant: variant.into(),
            n: done.filled,
            error: Some((sum / done.filled as f64).sqrt()),
            error_kind: "rms, k = 4",
        };
        measure(c, row, || drop(black_box(inpaint(table, &mut rows, &known, how))));
    }
    Ok(())
}

fn main() -> Result<(), Failure> {
    let mut c = Criterion::default()
        .without_plots()
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_millis(800))
        .sample_size(10)
        .configure_from_args();
    let figure = two_spheres();
    let table = figure.table(512);
    geometry(&mut c, &figure, &ring(4, 1024)[0])?;
    rules(&mut c, &figure, &table)?;
    holes(&mut c, &figure, &table)
}
