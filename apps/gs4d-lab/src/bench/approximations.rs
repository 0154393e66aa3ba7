//! What each approximation saves and what it costs: milliseconds and the difference of pictures without it and with it.

use super::{least_ms, settings};
use crate::people::{Cell, Findings, LabError};
use glam::Vec3;
use gs_core::{Camera, Kernel, Rng, Splats, rot};
use gs_metrics::psnr_from_mse;
use gs_physics::classes::rotation_sensitivity;
use gs_physics::{ClassRule, Extrapolator, Integrator, Motion, Rollout, RowsError, Twist};
use gs_raster::measure::{camera, scene};
use gs_raster::{RasterOptions, Workspace, render, render_into};
use gs_synth::{SynthOptions, generate};
use gs_train::capabilities::FreezeOptions;
use gs_train::evaluate::clamped;
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::registry::Registry;
use gs_train::timestamp::Timestamp;
use gs_train::trainer::{TrainOptions, Trainer};
use std::sync::Arc;

/// Timed calls; the least counts.
const CALLS: usize = 5;
/// Number of splats and side of the image of what the rasteriser leaves out.
const DRAWN: (usize, u32) = (30_000, 400);
/// Number of splats and side of the image of forecasts.
const FORECAST: (usize, u32) = (20_000, 400);
/// Frames of a forecast, and of a scene whose splats rest.
const FRAMES: [u16; 2] = [30, 8];
/// Errors that forecasts may have, world units; the scene has a side of 1.
const SLACKS: [f64; 2] = [1e-3, 1e-2];
/// Tolerances of splats left at rest: pixels, and relative change of shape.
const RESTING: [(f32, f32); 3] = [(0.05, 1e-3), (0.5, 0.05), (2.0, 0.2)];
/// The scene of splats left at rest: side of its images, pixels, and settings beside the preset's few hundred steps.
const TRAINED: (u32, &str) = (
    100,
    "init.points = 5000
    schedule.density.until = 0
    schedule.density.max_splats = 5000",
);

/// What one way of computing takes, and the colours it gives, `[0, 1]`.
struct Shown {
    ms: f64,
    rgb: Vec<f32>,
}

/// A line for each approximation: time without and with it, and what it changes in the picture.
///
/// # Errors
/// If the scene of splats left at rest cannot be trained.
pub fn approximations(registry: &Registry) -> Result<Findings, LabError> {
    let remark = format!(
        "{} threads, the least of {CALLS} calls. Colours are clamped to 0..1. The first rows: a frame of {} random splats at {}x{}. \
         Forecasts: the means and rotations of {} random splats, a mean over {} frames; the picture is the last of them. Splats left \
         at rest: fourdgs, preset tiny, scene balls at {}x{}; the splats of a frame, a mean over {} times.",
        rayon::current_num_threads(),
        DRAWN.0,
        DRAWN.1,
        DRAWN.1,
        FORECAST.0,
        FRAMES[0],
        TRAINED.0,
        TRAINED.0,
        FRAMES[1],
    );
    let heads = [
        ("approximation", 0),
        ("without, ms", 2),
        ("with, ms", 2),
        ("largest error", 5),
        ("mean error", 6),
        ("PSNR, dB", 1),
    ];
    let mut out = Findings::new("approximations", remark, &heads);
    out.rows.extend(drawing_rows(DRAWN.0, DRAWN.1));
    // Every column has a row for each splat.
    out.rows.extend(forecast_rows(FORECAST.0, FORECAST.1).unwrap_or_default());
    out.rows.extend(resting_rows(registry, TRAINED)?);
    Ok(out)
}

fn row(what: &str, without: &Shown, with: &Shown) -> Vec<Cell> {
    let off = without.rgb.iter().zip(&with.rgb).map(|(a, b)| (f64::from(*a) - f64::from(*b)).abs());
    let (largest, sum, squares) =
        off.fold((0.0f64, 0.0, 0.0), |(largest, sum, squares), d| (largest.max(d), sum + d, squares + d * d));
    let n = without.rgb.len().max(1) as f64;
    let numbers = [without.ms, with.ms, largest, sum / n, psnr_from_mse(squares / n)].map(Cell::from);
    [Cell::from(what)].into_iter().chain(numbers).collect()
}

/// A frame of `splats`.
fn drawn(splats: &Splats, side: u32, options: &RasterOptions) -> Shown {
    let (camera, mut workspace) = (camera(side), Workspace::new());
    let mut frame = render(splats, &camera, options, &mut workspace);
    let ms = least_ms(CALLS, || render_into(splats, &camera, options, &mut workspace, &mut frame));
    Shown { ms, rgb: clamped(&frame).data }
}

/// What the rasteriser leaves out.
fn drawing_rows(n: usize, side: u32) -> Vec<Vec<Cell>> {
    let usual = RasterOptions::default;
    let kernel = |lambda, beta| Kernel::Frequency { lambdas: vec![lambda; n], betas: vec![beta; n] };
    // The last kernel never decays.
    let (soft, endless) = (kernel(0.05, 0.5), kernel(0.2, 0.9));
    let of = |what: &str, kernel: &Kernel, without: RasterOptions, with: RasterOptions| {
        let splats = Splats { kernel: kernel.clone(), ..scene(n, 3) };
        row(what, &drawn(&splats, side, &without), &drawn(&splats, side, &with))
    };
    let gaussian = |what: &str, without, with| of(what, &Kernel::Gaussian, without, with);
    let (least, cut) = (RasterOptions { min_alpha: 1e-6, ..usual() }, RasterOptions { kernel_cut: 25.0, ..usual() });
    vec![
        gaussian("min_alpha 1/255 (default) for 1e-6", least, usual()),
        gaussian("min_alpha 1/64 for 1/255", usual(), RasterOptions { min_alpha: 1.0 / 64.0, ..usual() }),
        gaussian("stop 1e-4 (default) for 0", RasterOptions { stop: 0.0, ..usual() }, usual()),
        gaussian("stop 1e-3 for 1e-4", usual(), RasterOptions { stop: 1e-3, ..usual() }),
        gaussian("stop 1e-2 for 1e-4", usual(), RasterOptions { stop: 1e-2, ..usual() }),
        of(
            "box_sigmas 3 for none, frequency kernel λ = 0.05, β = 0.5",
            &soft,
            usual(),
            RasterOptions { box_sigmas: 3.0, ..usual() },
        ),
        of("kernel_cut 9 (default) for 25, frequency kernel λ = 0.2, β = 0.9", &endless, cut, usual()),
    ]
}

/// Simpler motions in forecasts.
fn forecast_rows(n: usize, side: u32) -> Result<Vec<Vec<Cell>>, RowsError> {
    let splats = scene(n, 0);
    let rollout = Rollout { rule: Integrator::Se3Mid, dt: 1.0 / f64::from(FRAMES[0]), origin: Vec3::ZERO };
    let at_rest = vec![[1.0, 0.0, 0.0, 0.0]; n];
    let stepped = Extrapolator::new(rollout, 0.0, motions(n), splats.means.clone(), at_rest)?;
    let reach: Vec<f32> = splats.scales.iter().map(|s| rotation_sensitivity(*s)).collect();
    let without = forecast(&stepped, &splats, side);
    let with = |tolerance: f64| -> Result<Vec<Cell>, RowsError> {
        let reduced = stepped.clone().reduce(&ClassRule { tolerance, horizon: 1.0 }, &reach, None)?;
        let [still, .., steps] = reduced.counts().classes;
        let what = format!("forecasts off by {tolerance}: of {n} splats {still} rest, {steps} take steps");
        Ok(row(&what, &without, &forecast(&reduced, &splats, side)))
    };
    SLACKS.into_iter().map(with).collect()
}

/// A quarter of the particles each that rests, is thrown, spins and tumbles, all slightly disturbed.
fn motions(n: usize) -> Vec<Motion<f32>> {
    let motion = |row: usize| {
        let mut rng = Rng::new(1, "bench motions", 0, row as u64);
        let (mut v, mut w, mut turn) = ([0.0f32; 3], [0.0; 3], [0.0; 3]);
        match row % 4 {
            0 => {}
            1 => v = [0.1, -0.2, 0.1],
            2 => w = [0.0, 0.0, 1.0],
            _ => (w, turn) = ([1.0, 0.0, 1.0], [0.0, 1.0, 0.0]),
        }
        let (twist, rate) = (Twist { v, w }, Twist { v: [0.0; 3], w: turn });
        let whole = Motion { twist, rate, jerk: Twist::default() };
        Motion::from_array(whole.to_array().map(|value| value + 2e-5 * rng.normal()))
    };
    (0..n).map(motion).collect()
}

/// The frames of a forecast one after another, up to time 1.
fn forecast(particles: &Extrapolator, splats: &Splats, side: u32) -> Shown {
    let frames = f64::from(FRAMES[0]);
    let ms = least_ms(CALLS, || {
        let mut particles = particles.clone();
        (1..=FRAMES[0]).for_each(|k| {
            particles.at(f64::from(k) / frames);
        });
    });
    let mut particles = particles.clone();
    let (means, turns) = particles.at(1.0);
    let mut moved = Splats { means: means.to_vec(), ..splats.clone() };
    moved.quats.iter_mut().zip(turns).for_each(|(q, turn)| *q = rot::hamilton(*turn, *q));
    let frame = render(&moved, &camera(side), &RasterOptions::default(), &mut Workspace::new());
    Shown { ms: ms / frames, rgb: clamped(&frame).data }
}

/// Splats left at rest.
fn resting_rows(registry: &Registry, (side, over): (u32, &str)) -> Result<Vec<Vec<Cell>>, LabError> {
    let data = Arc::new(generate("balls", &SynthOptions::of_views(side, 30, 0))?.dataset);
    let entry = registry.find("fourdgs")?;
    let config = settings(entry, "tiny", over)?;
    let mut trainer = Trainer::new(registry, data.clone(), entry.name, &config, TrainOptions::default())?;
    for _ in 0..trainer.steps() {
        trainer.step()?;
    }
    let cameras = [data.train[0].camera.clone()];
    let without = over_time(trainer.model(), &cameras[0])?;
    let mut rows = Vec::new();
    for (pixels, shape) in RESTING {
        let options = FreezeOptions { pixels, shape, ..FreezeOptions::usual(&cameras) };
        let what = format!("static within {pixels} pixels, shape within {shape}");
        rows.push(match trainer.model().freeze_static(&options) {
            Some((resting, report)) => {
                let what = format!("{what}: {} of {} splats rest", report.still, report.splats);
                row(&what, &without, &over_time(&resting, &cameras[0])?)
            }
            None => row(&format!("{what}: none rests"), &without, &without),
        });
    }
    Ok(rows)
}

/// The splats of some times, and their pictures one after another.
fn over_time(model: &Model, camera: &Camera) -> Result<Shown, MethodError> {
    let splats_at = |k: u16| model.splats(&Timestamp::normalised((f32::from(k) + 0.5) / f32::from(FRAMES[1])), camera);
    let ms = least_ms(CALLS, || (0..FRAMES[1]).for_each(|k| drop(splats_at(k)))) / f64::from(FRAMES[1]);
    let (options, mut workspace, mut rgb) = (RasterOptions::default(), Workspace::new(), Vec::new());
    for k in 0..FRAMES[1] {
        rgb.extend(clamped(&render(&splats_at(k)?, camera, &options, &mut workspace)).data);
    }
    Ok(Shown { ms, rgb })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(cell: &Cell) -> f64 {
        if let Cell::Number(Some(n)) = cell { *n } else { panic!("{cell:?} is no number") }
    }

    #[test]
    fn a_row_has_the_difference_of_both() {
        let of = |ms, rgb: [f32; 4]| Shown { ms, rgb: rgb.to_vec() };
        let row = row("what", &of(2.0, [0.0, 0.25, 0.5, 1.0]), &of(1.0, [0.0, 0.5, 0.5, 0.5]));
        assert_eq!(row[0], Cell::from("what"));
        assert_eq!(row[1..5], [2.0, 1.0, 0.5, 0.1875].map(Cell::from));
        // The mean square is 0.3125 / 4.
        assert!((number(&row[5]) - 11.0721).abs() < 1e-3, "{row:?}");
    }

    #[test]
    fn coarser_thresholds_change_more() {
        let rows = drawing_rows(400, 32);
        let mean = |k: usize| number(&rows[k][4]);
        assert!(rows.len() == 7 && 0.0 < mean(0) && mean(0) < mean(1), "{rows:?}");
        assert!(mean(2) <= mean(3) && mean(3) <= mean(4) && mean(5) > 0.0 && mean(6) > 0.0, "{rows:?}");
    }

    #[test]
    fn simpler_motions_stay_near() {
        let rows = forecast_rows(80, 32).unwrap();
        assert_eq!(rows.len(), 2);
        for row in &rows {
            let Cell::Text(what) = &row[0] else { panic!("{row:?}") };
            assert!(what.contains("20 rest") && number(&row[4]) < 0.01, "{row:?}");
        }
    }

    #[test]
    fn a_scene_at_rest_has_a_row_for_each_tolerance() {
        let over = "init.points = 50\nschedule.stages.coarse.steps = 2\nschedule.stages.fine.steps = 4";
        let rows = resting_rows(gs_methods::registry(), (16, over)).unwrap();
        let rests = |row: &Vec<Cell>| matches!(&row[0], Cell::Text(what) if what.contains("rest"));
        assert!(rows.len() == 3 && rows.iter().all(|row| rests(row) && number(&row[1]) > 0.0), "{rows:?}");
    }
}
