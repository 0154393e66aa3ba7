//! Time and error of the Grid4D field with Fourier branch and gate (FAGS): its dense part against the roof of the
//! machine, its hash grids, and each exact optimisation on and off.
//!
//! Each row is printed and appended to `target/speed-error/gs-deform.jsonl`. `work` counts floating-point operations of
//! matrix products (two per multiply-add), or splats. The roof is the machine's 1024³ product, one serial call per
//! thread. The dense part is the whole field less its grids, which are measured alone on the same points.

use glam::Vec3;
use gs_core::nn::gemm;
use gs_core::{Geometry, Params, Rng, Time};
use gs_deform::encode::{Columns, HashGrid, HashGridConfig, Slice};
use gs_deform::field::grid4d::ExactConfig;
use gs_deform::reference::Grid4dRef;
use gs_deform::{DeformError, Field, Grid4dConfig, Grid4dField};
use rows::Rows;

mod rows;

const SPLATS: usize = 50_000;
const ROWS: Rows = Rows { n: SPLATS, runs: 9 };

fn at_time(normalised: f32) -> Time {
    Time { normalised, seconds: f64::from(normalised) }
}

/// Splats on a sphere inside the cube, as they lie on surfaces.
fn splats() -> Geometry {
    let mean = |i| {
        let mut rng = Rng::new(1, "splats", 0, i as u64);
        Vec3::new(rng.normal(), rng.normal(), rng.normal()).normalize_or(Vec3::X)
    };
    Geometry {
        means: (0..SPLATS).map(mean).collect(),
        quats: vec![[1.0, 0.2, 0.0, 0.0]; SPLATS],
        scales: vec![Vec3::splat(0.01); SPLATS],
    }
}

/// A field as after some training: features of order one, small motions, gates from nearly closed to half open.
fn field(config: &Grid4dConfig) -> Result<Grid4dField, DeformError> {
    let mut field = Grid4dField::new(&Grid4dConfig { zero_init: false, ..config.clone() }, 1)?;
    let width = config.width;
    field.visit_mut(&mut |p| {
        let mut rng = Rng::new(2, &p.name, 0, 0);
        match p.name.as_str() {
            "field.net.head.weight" => p.value[..width].iter_mut().for_each(|v| *v *= 100.0),
            "field.net.head.bias" => {
                p.value.iter_mut().enumerate().for_each(|(i, v)| *v = if i == 0 { -9.0 } else { 0.0 })
            }
            name if name.starts_with("field.grids") => p.value.iter_mut().for_each(|v| *v = rng.normal()),
            name if name.starts_with("field.net.amplitude") => {
                p.value.iter_mut().for_each(|v| *v = 0.003 * rng.normal());
            }
            _ => {}
        }
    });
    Ok(field)
}

/// Milliseconds of the four grids alone, forward and both ways, as the field runs them.
fn grids(field: &Grid4dField, s: &Geometry) -> [f64; 2] {
    let bound = field.config().bound;
    let points: Vec<[f32; 3]> = s.means.iter().map(|m| ((*m + bound) / (2.0 * bound)).to_array()).collect();
    let pairs = [(0, 1), (1, 2), (0, 2)];
    let planes = pairs.map(|(a, b)| points.iter().map(|p| [p[a], p[b]]).collect::<Vec<_>>());
    let mut all: [HashGrid; 4] = field.grids().map(Clone::clone);
    let mut slices: [Slice; 3] = Default::default();
    let widths = [all[0].width(), 3 * all[1].width()];
    let (mut space, mut time) = (vec![0.0; SPLATS * widths[0]], vec![0.0; SPLATS * widths[1]]);
    let columns = |g: usize| match g {
        0 => Columns { stride: widths[0], offset: 0 },
        g => Columns { stride: widths[1], offset: (g - 1) * widths[1] / 3 },
    };
    let mut run = |back: bool| {
        all[0].forward(&points, &mut space, columns(0));
        for g in 0..3 {
            all[g + 1].slice(0.4, SPLATS, &mut slices[g]);
            all[g + 1].forward_slice(&slices[g], &planes[g], &mut time, columns(g + 1));
        }
        if back {
            all[0].backward(&points, &space, columns(0));
            (0..3).for_each(|g| all[g + 1].backward_slice(&mut slices[g], &planes[g], &time, columns(g + 1)));
        }
    };
    let work = SPLATS as f64;
    [
        ROWS.measured("fags grids", "forward", work, None, || run(false)),
        ROWS.measured("fags grids", "forward and backward", work, None, || run(true)),
    ]
}

/// Everything a step produces.
fn step(field: &mut Grid4dField, s: &Geometry) -> (Geometry, Geometry, Vec<f32>) {
    let (mut tape, mut out, mut d) = (Default::default(), Geometry::default(), Geometry::zeros(s.len()));
    field.clear_grads();
    field.forward(s.view(), at_time(0.37), &mut tape, &mut out);
    let d_out = Geometry { means: s.means.clone(), ..Geometry::zeros(s.len()) };
    field.backward(s.view(), &mut tape, d_out.view(), &mut d);
    let mut grads = Vec::new();
    field.visit(&mut |p| {
        if p.name.starts_with("field.net") {
            grads.extend_from_slice(&p.grad)
        }
    });
    (out, d, grads)
}

fn largest(a: impl Iterator<Item = (f64, f64)>) -> f64 {
    let (difference, size) = a.fold((0.0f64, 1e-30f64), |(d, s), (a, b)| (d.max((a - b).abs()), s.max(b.abs())));
    difference / size
}

/// Error of moved means against the f64 reference, relative to the largest displacement.
fn against_reference(field: &Grid4dField, s: &Geometry) -> f64 {
    let (reference, mut out, t) = (Grid4dRef::new(field), Geometry::default(), at_time(0.37));
    field.forward(s.view(), t, &mut Default::default(), &mut out);
    let mut pairs = Vec::new();
    for r in 0..100 {
        let (m, q, z) = (s.means[r].to_array(), s.quats[r], s.scales[r].to_array());
        let flat: Vec<f64> = m.iter().chain(&q).chain(&z).map(|&v| f64::from(v)).collect();
        let want = reference.moved(m.map(f64::from), std::array::from_fn(|k| flat[k]), t);
        pairs.extend((0..3).map(|k| (f64::from(out.means[r][k] - m[k]), want[k] - flat[k])));
    }
    largest(pairs.into_iter())
}

/// The field as a training step uses it, and the share of the roof its dense part reaches.
fn training(s: &Geometry, roof: f64) -> Result<(), DeformError> {
    let mut field = field(&Grid4dConfig::default())?;
    // Random values at resolution 2048 feel the rounding of coordinates; grids up to 32 show the decoder's own error.
    let error = Some((against_reference(&field, s), "displacement relative to f64"));
    let canonical = HashGridConfig { end: [32.0; 3], ..field.config().canonical };
    let coarse = self::field(&Grid4dConfig { canonical, ..Grid4dConfig::default() })?;
    let dense_error = Some((against_reference(&coarse, s), "displacement relative to f64, grids to 32"));
    let [grid_forward, grid_both] = grids(&field, s);
    let [space, time] = [field.grids()[0].width(), 3 * field.grids()[1].width()];
    let (width, head) = (field.config().width, field.config().head_width());
    let flops = 2.0 * (SPLATS * (space * width + time * width + width * head + head * space)) as f64;
    let (mut tape, mut out, mut d) = (Default::default(), Geometry::default(), Geometry::zeros(s.len()));
    let d_out = Geometry { means: s.means.clone(), ..Geometry::zeros(s.len()) };
    let forward =
        ROWS.measured("fags", "forward", flops, error, || field.forward(s.view(), at_time(0.37), &mut tape, &mut out));
    let both = ROWS.measured("fags", "forward and backward", 3.0 * flops, error, || {
        field.forward(s.view(), at_time(0.37), &mut tape, &mut out);
        field.backward(s.view(), &mut tape, d_out.view(), &mut d);
    });
    for (variant, ms, work) in
        [("forward", forward - grid_forward, flops), ("both ways", both - grid_both, 3.0 * flops)]
    {
        ROWS.keep("fags dense part", variant, work, dense_error, ms);
        println!("    {:.0} % of the roof of {roof:.0} GFLOP/s", 100.0 * work / ms / 1e6 / roof);
    }
    ROWS.measured("fags", "smoothness, a tenth of the splats", SPLATS as f64, None, || {
        field.regularise(s.view(), at_time(0.37), 1);
    });
    Ok(())
}

/// Each exact saving off, beside all on: what it costs, and how far results differ.
fn savings(s: &Geometry) -> Result<(), DeformError> {
    let on = Grid4dConfig::default();
    let (_, want_d, want) = step(&mut field(&on)?, s);
    for (variant, exact) in [
        ("all savings", on.exact),
        ("without time slicing", ExactConfig { time_slicing: false, ..on.exact }),
        ("without Fourier collapse", ExactConfig { fourier_collapse: false, ..on.exact }),
    ] {
        let mut field = field(&Grid4dConfig { exact, ..on.clone() })?;
        let (_, d, grads) = step(&mut field, s);
        let layers = grads.iter().zip(&want).map(|(a, b)| (f64::from(*a), f64::from(*b)));
        let means = d
            .means
            .iter()
            .zip(&want_d.means)
            .flat_map(|(a, b)| (0..3).map(move |k| (f64::from(a[k]), f64::from(b[k]))));
        let error = Some((largest(layers).max(largest(means)), "gradients against all savings"));
        let (mut tape, mut out, mut d) = (Default::default(), Geometry::default(), Geometry::zeros(s.len()));
        let d_out = Geometry { means: s.means.clone(), ..Geometry::zeros(s.len()) };
        ROWS.measured("fags savings", variant, SPLATS as f64, error, || {
            field.forward(s.view(), at_time(0.37), &mut tape, &mut out);
            field.backward(s.view(), &mut tape, d_out.view(), &mut d);
        });
    }
    Ok(())
}

/// The same splats at another time: all of the field anew, or only what depends on time.
fn many_times(s: &Geometry) -> Result<(), DeformError> {
    let on = Grid4dConfig::default();
    let (mut tape, mut out, mut want) = (Default::default(), Geometry::default(), Geometry::default());
    for (variant, cached_attention) in [("evaluated anew", false), ("warm tape", true)] {
        let field = field(&Grid4dConfig { exact: ExactConfig { cached_attention, ..on.exact }, ..on.clone() })?;
        field.forward(s.view(), at_time(0.6), &mut tape, &mut want);
        field.forward_again(s.view(), at_time(0.6), &mut tape, &mut out);
        let same = largest(out.means.iter().zip(&want.means).map(|(a, b)| (f64::from(a.x), f64::from(b.x))));
        let error = Some((same, "against the field's own forward"));
        ROWS.measured("fags again", variant, SPLATS as f64, error, || {
            field.forward_again(s.view(), at_time(0.6), &mut tape, &mut out);
        });
    }
    Ok(())
}

fn main() -> Result<(), DeformError> {
    let s = splats();
    let roof = gemm::roof();
    roof.append(env!("CARGO_MANIFEST_DIR"));
    training(&s, roof.rate())?;
    savings(&s)?;
    many_times(&s)
}
