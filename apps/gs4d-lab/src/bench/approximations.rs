//! What each approximation saves and what it costs: milliseconds and the difference of pictures without it and with it.

use super::{ROUNDS, differences, in_turns, settings};
use crate::people::{Cell, Findings, LabError};
use glam::Vec3;
use gs_core::{Camera, Kernel, Rng, Splats, rot};
use gs_metrics::psnr_from_mse;
use gs_physics::classes::rotation_sensitivity;
use gs_physics::{ClassRule, Extrapolator, Integrator, Motion, Rollout, RowsError, Twist};
use gs_raster::measure::{camera, scene};
use gs_raster::{Frame, RasterOptions, Workspace, render, render_into};
use gs_synth::{SynthOptions, generate};
use gs_train::capabilities::FreezeOptions;
use gs_train::evaluate::clamped;
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::registry::Registry;
use gs_train::timestamp::Timestamp;
use gs_train::trainer::{TrainOptions, Trainer};
use std::sync::Arc;

/// Number of splats and side of the image of what the rasteriser leaves out.
const RASTERISED: (usize, u32) = (30_000, 400);
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

/// A line for each approximation: time without and with it, and what it changes in the picture.
///
/// # Errors
/// If the scene of splats left at rest cannot be trained.
pub fn approximations(registry: &Registry) -> Result<Findings, LabError> {
    let remark = format!(
        "{} threads, medians of {ROUNDS} rounds in which both ways take turns. Colours are clamped to 0..1. The first rows: a frame of \
         {} random splats at {}x{}. Forecasts: the means and rotations of {} random splats, a mean over {} frames; the picture is the last of \
         them. Splats left at rest: fourdgs, preset tiny, scene balls at {}x{}; the splats of a frame, a mean over {} times.",
        rayon::current_num_threads(),
        RASTERISED.0,
        RASTERISED.1,
        RASTERISED.1,
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
    out.rows.extend(raster_rows(RASTERISED.0, RASTERISED.1));
    // Every column has a row for each splat.
    out.rows.extend(forecast_rows(FORECAST.0, FORECAST.1).unwrap_or_default());
    out.rows.extend(resting_rows(registry, TRAINED)?);
    Ok(out)
}

/// A line of the table: milliseconds and colours, `[0, 1]`, without and with the approximation.
fn row(what: &str, ms: [f64; 2], [without, with]: &[Vec<f32>; 2]) -> Vec<Cell> {
    let [largest, mean, square] = differences(without, with);
    let numbers = [ms[0], ms[1], largest, mean, psnr_from_mse(square)].map(Cell::from);
    [Cell::from(what)].into_iter().chain(numbers).collect()
}

/// A line for a frame of `splats` that is rendered without and with.
fn rendered(what: &str, side: u32, splats: &Splats, ways: [RasterOptions; 2]) -> Vec<Cell> {
    let camera = camera(side);
    let mut frames = [(); 2].map(|()| (Workspace::new(), Frame::default()));
    let ms = in_turns(|k, watch| {
        let (options, (workspace, frame)) = (&ways[k], &mut frames[k]);
        watch.run(1, || render_into(splats, &camera, options, workspace, frame));
    });
    row(what, ms, &frames.map(|(_, frame)| clamped(&frame).data))
}

/// What the rasteriser leaves out.
fn raster_rows(n: usize, side: u32) -> Vec<Vec<Cell>> {
    let usual = RasterOptions::default;
    let frequency = |lambda, beta| Kernel::Frequency { lambdas: vec![lambda; n], betas: vec![beta; n] };
    // The last kernel never decays.
    let [plain, soft, endless] =
        [Kernel::Gaussian, frequency(0.05, 0.5), frequency(0.2, 0.9)].map(|kernel| Splats { kernel, ..scene(n, 3) });
    let of = |what: &str, splats: &Splats, without: RasterOptions, with: RasterOptions| {
        rendered(what, side, splats, [without, with])
    };
    let (least, cut) = (RasterOptions { min_alpha: 1e-6, ..usual() }, RasterOptions { kernel_cut: 25.0, ..usual() });
    vec![
        of("min_alpha 1/255 (default) for 1e-6", &plain, least, usual()),
        of("min_alpha 1/64 for 1/255", &plain, usual(), RasterOptions { min_alpha: 1.0 / 64.0, ..usual() }),
        of("stop 1e-4 (default) for 0", &plain, RasterOptions { stop: 0.0, ..usual() }, usual()),
        of("stop 1e-3 for 1e-4", &plain, usual(), RasterOptions { stop: 1e-3, ..usual() }),
        of("stop 1e-2 for 1e-4", &plain, usual(), RasterOptions { stop: 1e-2, ..usual() }),
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
    let with = |tolerance: f64| -> Result<Vec<Cell>, RowsError> {
        let reduced = stepped.clone().reduce(&ClassRule { tolerance, horizon: 1.0 }, &reach, None)?;
        let [still, .., steps] = reduced.counts().classes;
        let what = format!("forecasts off by {tolerance}: of {n} splats {still} rest, {steps} take steps");
        Ok(forecast(&what, [&stepped, &reduced], &splats, side))
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

/// The frames of a forecast one after another, up to time 1, without and with simpler motions; the pictures are those of the last.
fn forecast(what: &str, ways: [&Extrapolator; 2], splats: &Splats, side: u32) -> Vec<Cell> {
    let frames = f64::from(FRAMES[0]);
    let ms: [f64; 2] = in_turns(|k, watch| {
        let mut particles = ways[k].clone();
        watch.run(1, || {
            (1..=FRAMES[0]).for_each(|frame| {
                particles.at(f64::from(frame) / frames);
            });
        });
    });
    let rgb = ways.map(|particles| {
        let mut particles = particles.clone();
        let (means, turns) = particles.at(1.0);
        let mut moved = Splats { means: means.to_vec(), ..splats.clone() };
        moved.quats.iter_mut().zip(turns).for_each(|(q, turn)| *q = rot::hamilton(*turn, *q));
        clamped(&render(&moved, &camera(side), &RasterOptions::default(), &mut Workspace::new())).data
    });
    row(what, ms.map(|ms| ms / frames), &rgb)
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
    let (model, cameras) = (trainer.model(), [data.train[0].camera.clone()]);
    let mut rows = Vec::new();
    for (pixels, shape) in RESTING {
        let options = FreezeOptions { pixels, shape, ..FreezeOptions::usual(&cameras) };
        let what = format!("static within {pixels} pixels, shape within {shape}");
        rows.push(match model.freeze_static(&options) {
            Some((resting, report)) => {
                let what = format!("{what}: {} of {} splats rest", report.still, report.splats);
                over_time(&what, [model, &resting], &cameras[0])?
            }
            None => over_time(&format!("{what}: none rests"), [model; 2], &cameras[0])?,
        });
    }
    Ok(rows)
}

/// The splats of some times without and with splats at rest, and their pictures one after another.
fn over_time(what: &str, ways: [&Model; 2], camera: &Camera) -> Result<Vec<Cell>, MethodError> {
    let at = |k: u16| Timestamp::normalised((f32::from(k) + 0.5) / f32::from(FRAMES[1]));
    let ms: [f64; 2] = in_turns(|k, watch| {
        watch.run(1, || (0..FRAMES[1]).for_each(|frame| drop(ways[k].splats(&at(frame), camera))));
    });
    let (options, mut workspace) = (RasterOptions::default(), Workspace::new());
    let mut rgb: [Vec<f32>; 2] = Default::default();
    for (model, rgb) in ways.into_iter().zip(&mut rgb) {
        for frame in 0..FRAMES[1] {
            let splats = model.splats(&at(frame), camera)?;
            rgb.extend(clamped(&render(&splats, camera, &options, &mut workspace)).data);
        }
    }
    Ok(row(what, ms.map(|ms| ms / f64::from(FRAMES[1])), &rgb))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_has_the_difference_of_both() {
        let row = row("what", [2.0, 1.0], &[vec![0.0, 0.25, 0.5, 1.0], vec![0.0, 0.5, 0.5, 0.5]]);
        assert_eq!(row[0], Cell::from("what"));
        assert_eq!(row[1..5], [2.0, 1.0, 0.5, 0.1875].map(Cell::from));
        // The mean square is 0.3125 / 4.
        assert!((row[5].number().unwrap() - 11.0721).abs() < 1e-3, "{row:?}");
    }

    #[test]
    fn coarser_thresholds_change_more() {
        let rows = raster_rows(400, 32);
        let mean = |k: usize| rows[k][4].number().unwrap();
        assert!(rows.len() == 7 && 0.0 < mean(0) && mean(0) < mean(1), "{rows:?}");
        assert!(mean(2) <= mean(3) && mean(3) <= mean(4) && mean(5) > 0.0 && mean(6) > 0.0, "{rows:?}");
    }

    #[test]
    fn simpler_motions_stay_near() {
        let rows = forecast_rows(80, 32).unwrap();
        assert_eq!(rows.len(), 2);
        for row in &rows {
            let Cell::Text(what) = &row[0] else { panic!("{row:?}") };
            assert!(what.contains("20 rest") && row[4].number().unwrap() < 0.01, "{row:?}");
        }
    }

    #[test]
    fn a_scene_at_rest_has_a_row_for_each_tolerance() {
        let over = "init.points = 50\nschedule.stages.coarse.steps = 2\nschedule.stages.fine.steps = 4";
        let rows = resting_rows(gs_methods::registry(), (16, over)).unwrap();
        let rests = |row: &Vec<Cell>| matches!(&row[0], Cell::Text(what) if what.contains("rest"));
        assert!(rows.len() == 3 && rows.iter().all(|row| rests(row) && row[1].number().unwrap() > 0.0), "{rows:?}");
    }
}
