//! How the cost of a frame and of its gradients grows with splats, pixels and depth complexity, and what the frames of a moving scene cost.

use super::{ROUNDS, differences, in_turns, settings};
use crate::people::{Cell, Findings, LabError};
use gs_core::{Camera, Rng, Splats, SplatsGrad};
use gs_data::Dataset;
use gs_raster::measure::{camera, scene};
use gs_raster::{
    Frame, FrameGrad, RasterOptions, ScreenStats, Workspace, blend_counts, render, render_backward_into, render_into,
};
use gs_synth::{SynthOptions, generate};
use gs_train::evaluate::clamped;
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::registry::{MethodEntry, Registry, section};
use gs_train::scene::SceneInfo;
use gs_train::schedule::Schedule;
use gs_train::timestamp::Timestamp;

/// SH degree of the random scenes.
const DEGREE: u8 = 3;
const SPLATS: [usize; 6] = [1_000, 3_000, 10_000, 30_000, 100_000, 300_000];
const SIDES: [u32; 5] = [100, 200, 400, 800, 1600];
/// Factors of the standard deviations.
const FACTORS: [f32; 4] = [0.5, 1.0, 2.0, 4.0];
/// Number of splats and side of the image where another number grows.
const HELD: (usize, u32) = (30_000, 400);
/// Splats of the methods with a field.
const FIELD_SPLATS: usize = 20_000;
/// Timestamps of the scene that fields are made for, and the side of its images, pixels.
const TIMESTAMPS: (u32, u32) = (50, 16);
/// Normalised times of a first frame and of the next: two timestamps of that scene that follow one another, in one interval of `modec`.
const TIMES: [f32; 2] = [26.0 / 49.0, 27.0 / 49.0];
/// Standard deviation of the noise on shared parameters where fields are to move their splats.
const NOISE: f32 = 0.03;

/// Milliseconds of a frame, and of a frame with its gradients, of random scenes.
pub fn growth() -> Findings {
    let remark = format!(
        "{} threads, medians of {ROUNDS} rounds in which both columns take turns, harmonics of degree {DEGREE}. Depth complexity: \
         standard deviations times a factor f, opacities times 1/(4 f).",
        rayon::current_num_threads()
    );
    let heads = [
        ("what grows", 0),
        ("splats", 0),
        ("pixels", 0),
        ("blended a pixel", 1),
        ("forward, ms", 2),
        ("forward + backward, ms", 2),
    ];
    let mut out = Findings::new("growth", remark, &heads);
    let (n, side) = HELD;
    out.rows.extend(SPLATS.map(|n| row("splats", &scene(n, DEGREE), side)));
    out.rows.extend(SIDES.map(|side| row("pixels", &scene(n, DEGREE), side)));
    out.rows.extend(FACTORS.map(|factor| {
        let mut splats = scene(n, DEGREE);
        splats.scales.iter_mut().for_each(|s| *s *= factor);
        splats.opacities.iter_mut().for_each(|o| *o *= 0.25 / factor);
        row(&format!("depth complexity, f = {factor}"), &splats, side)
    }));
    out
}

fn row(grows: &str, splats: &Splats, side: u32) -> Vec<Cell> {
    let (camera, options, pixels) = (camera(side), RasterOptions::default(), (side * side) as usize);
    let mut workspace = Workspace::new();
    let mut frame = render(splats, &camera, &options, &mut workspace);
    let blended: u64 = blend_counts(splats, &options, &mut workspace).into_iter().map(u64::from).sum();
    let d = FrameGrad { rgb: vec![1.0; 3 * pixels], ..FrameGrad::default() };
    let (mut grad, mut stats) = (SplatsGrad::default(), ScreenStats::default());
    let [forward, both]: [f64; 2] = in_turns(|k, watch| {
        watch.run(1, || {
            render_into(splats, &camera, &options, &mut workspace, &mut frame);
            if k == 1 {
                render_backward_into(splats, &camera, &options, &mut workspace, &d, &mut grad, &mut stats);
            }
        });
    });
    let counts = [splats.len() as f64, pixels as f64, blended as f64 / pixels as f64];
    [Cell::from(grows)].into_iter().chain([counts[0], counts[1], counts[2], forward, both].map(Cell::from)).collect()
}

/// Milliseconds that each method with a field takes for the splats of a first frame, where it has kept nothing, for those of the next
/// frame, and for rendering them; and the error of what it has kept.
///
/// # Errors
/// If a method cannot be built.
pub fn frames(registry: &Registry) -> Result<Findings, LabError> {
    frames_of(registry, FIELD_SPLATS)
}

fn frames_of(registry: &Registry, splats: usize) -> Result<Findings, LabError> {
    let (timestamps, size) = TIMESTAMPS;
    let data = generate("sheet", &SynthOptions::of_views(size, timestamps, 0))?.dataset;
    let remark = format!(
        "{} threads, medians of {ROUNDS} rounds in which the columns take turns, preset fast, parameters as a run begins with, no \
         gradients; rendered at {side}x{side}. The next frame is one of {timestamps} timestamps later. Error: largest difference of \
         colours from the same frame with nothing kept, with noise of {NOISE} on the shared parameters: as they begin, nothing moves.",
        rayon::current_num_threads(),
        side = HELD.1
    );
    let heads = [
        ("method", 0),
        ("splats", 0),
        ("splats of a first frame, ms", 2),
        ("of the next, ms", 2),
        ("its error", 5),
        ("rendering, ms", 2),
    ];
    let mut out = Findings::new("frames", remark, &heads);
    for entry in registry.iter().filter(|entry| !entry.needs_avatar) {
        let schedule: Schedule = section(entry.name, &entry.config("fast")?, "schedule")?;
        if schedule.at(schedule.steps()).dynamic {
            let mut model = untrained(entry, &data, splats)?;
            let camera = data.train[0].camera.scaled(f64::from(HELD.1) / f64::from(size));
            out.rows.push(frame_row(&mut model, &camera)?);
        }
    }
    Ok(out)
}

/// The method with random points, as in the last step of its schedule: its field takes part.
fn untrained(entry: &MethodEntry, data: &Dataset, splats: usize) -> Result<Model, LabError> {
    let preset = entry.config("fast")?;
    let of_anchor = preset.get("anchors").and_then(|anchors| anchors.get("offsets")?.as_integer());
    let points = splats / of_anchor.map_or(1, |n| n.max(1) as usize);
    let mut over = format!("[init]\nfrom = \"random\"\npoints = {points}\nbound = 1.3\n");
    if of_anchor.is_none() {
        over.push_str(&format!("[schedule.density]\nmax_splats = {points}\n"));
    }
    let config = settings(entry, "fast", &over)?;
    let scene = SceneInfo::of(data, &section(entry.name, &config, "init")?, 0)?;
    let mut model = entry.model(&config, &scene)?;
    begin_anew(&mut model);
    Ok(model)
}

/// To the last step of the schedule, with nothing kept of earlier frames.
fn begin_anew(model: &mut Model) {
    let last = model.schedule().steps();
    model.begin_step(last);
}

fn frame_row(model: &mut Model, camera: &Camera) -> Result<Vec<Cell>, LabError> {
    let [first, next] = TIMES.map(Timestamp::normalised);
    let (options, mut workspace, mut frame) = (RasterOptions::default(), Workspace::new(), Frame::default());
    let splats = model.splats(&next, camera)?;
    let [of_first, of_next, rendering]: [f64; 3] = in_turns(|k, watch| {
        match k {
            0 => {
                begin_anew(model);
                watch.run(1, || drop(model.splats(&first, camera)))
            }
            1 => watch.run(1, || drop(model.splats(&next, camera))),
            _ => watch.run(1, || render_into(&splats, camera, &options, &mut workspace, &mut frame)),
        };
    });
    let count = model.splat_count() as f64;
    move_splats(model);
    let error = error_of_next(camera, |anew, t| {
        if anew {
            begin_anew(model);
        }
        model.splats(&Timestamp::normalised(t), camera)
    })?;
    let numbers = [count, of_first, of_next, error, rendering].map(Cell::from);
    Ok([Cell::from(model.name())].into_iter().chain(numbers).collect())
}

/// Adds noise to the shared parameters that learn. As they begin, last layers are zero and planes of time are the same at all times, so that
/// no splat moves.
fn move_splats(model: &mut Model) {
    let (schedule, mut rng) = (model.schedule().clone(), Rng::new(1, "bench fields", 0, 0));
    model.visit_mut(&mut |p| {
        if p.row_width.is_none() && schedule.update(p, schedule.steps(), 1.0).is_some() {
            p.value.iter_mut().for_each(|v| *v += NOISE * rng.normal());
        }
    });
}

/// Largest difference of colours, `[0, 1]`, of a frame that follows on another from the same with nothing kept. `splats` gives those of a
/// normalised time, with nothing kept where its first argument is true.
fn error_of_next(
    camera: &Camera,
    mut splats: impl FnMut(bool, f32) -> Result<Splats, MethodError>,
) -> Result<f64, MethodError> {
    let [first, next] = TIMES;
    splats(true, first)?;
    let pictures = [splats(false, next)?, splats(true, next)?]
        .map(|splats| clamped(&render(&splats, camera, &RasterOptions::default(), &mut Workspace::new())).data);
    let [largest, ..] = differences(&pictures[0], &pictures[1]);
    Ok(largest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_is_blended_where_splats_are_larger() {
        let blended = [0.5, 2.0].map(|factor| {
            let mut splats = scene(300, 0);
            splats.scales.iter_mut().for_each(|s| *s *= factor);
            let row = row("factor", &splats, 32);
            assert_eq!(row[..3], [Cell::from("factor"), Cell::from(300.0), Cell::from(1024.0)]);
            assert!(row[4..].iter().all(|cell| cell.number().unwrap() > 0.0), "{row:?}");
            row[3].number().unwrap()
        });
        assert!(blended[0] < blended[1], "{blended:?}");
    }

    #[test]
    fn methods_without_a_field_are_left_out() {
        let all = gs_methods::registry();
        let of = |name| *all.find(name).unwrap();
        let found = frames_of(&Registry::new(vec![of("static3d"), of("grid4d")]), 200).unwrap();
        assert_eq!((found.rows.len(), found.rows[0].len()), (1, found.heads.len()));
        assert_eq!(found.rows[0][..2], [Cell::from("grid4d"), Cell::from(200.0)]);
        assert_eq!(found.rows[0][4], Cell::from(0.0), "what is kept has the same bits");
        assert!([2, 3, 5].iter().all(|k| found.rows[0][*k].number().unwrap() > 0.0), "{:?}", found.rows);
    }

    #[test]
    fn what_is_kept_beyond_its_time_is_an_error() {
        let moved = |t: f32| {
            let mut splats = scene(300, 0);
            splats.means.iter_mut().for_each(|mean| mean.x += t);
            splats
        };
        let exact = error_of_next(&camera(32), |_, t| Ok(moved(t))).unwrap();
        let stale = error_of_next(&camera(32), |anew, t| Ok(moved(if anew { t } else { TIMES[0] }))).unwrap();
        assert!(exact == 0.0 && stale > 0.01, "{exact} {stale}");
    }

    #[test]
    fn fields_move_their_splats_where_an_error_is_looked_for() {
        let data = generate("sheet", &SynthOptions::of_views(16, 3, 0)).unwrap().dataset;
        let mut model = untrained(gs_methods::registry().find("grid4d").unwrap(), &data, 50).unwrap();
        let means = |model: &Model| {
            TIMES.map(|t| model.splats(&Timestamp::normalised(t), &data.train[0].camera).unwrap().means)
        };
        let [first, next] = means(&model);
        assert_eq!(first, next, "the last layer is zero");
        move_splats(&mut model);
        begin_anew(&mut model);
        let [first, next] = means(&model);
        assert_ne!(first, next);
    }
}
