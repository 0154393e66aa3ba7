//! How the cost of a frame and of its gradients grows with splats, pixels and depth complexity, and what a new time costs.

use super::{least_ms, settings};
use crate::people::{Cell, Findings, LabError};
use gs_core::{Camera, Splats, SplatsGrad};
use gs_data::Dataset;
use gs_raster::measure::{camera, scene};
use gs_raster::{
    FrameGrad, RasterOptions, ScreenStats, Workspace, blend_counts, render, render_backward_into, render_into,
};
use gs_synth::{SynthOptions, generate};
use gs_train::model::Model;
use gs_train::registry::{MethodEntry, Registry, section};
use gs_train::scene::SceneInfo;
use gs_train::schedule::Schedule;
use gs_train::timestamp::Timestamp;

/// Timed calls; the least counts.
const CALLS: usize = 5;
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

/// Milliseconds of a frame, and of a frame with its gradients, of random scenes.
pub fn growth() -> Findings {
    let remark = format!(
        "{} threads, the least of {CALLS} calls, harmonics of degree {DEGREE}. Depth complexity: standard deviations times a \
         factor f, opacities times 1/(4 f).",
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
    let forward = least_ms(CALLS, || render_into(splats, &camera, &options, &mut workspace, &mut frame));
    let d = FrameGrad { rgb: vec![1.0; 3 * pixels], ..FrameGrad::default() };
    let (mut grad, mut stats) = (SplatsGrad::default(), ScreenStats::default());
    let both = least_ms(CALLS, || {
        render_into(splats, &camera, &options, &mut workspace, &mut frame);
        render_backward_into(splats, &camera, &options, &mut workspace, &d, &mut grad, &mut stats);
    });
    let counts = [splats.len() as f64, pixels as f64, blended as f64 / pixels as f64];
    [Cell::from(grows)].into_iter().chain([counts[0], counts[1], counts[2], forward, both].map(Cell::from)).collect()
}

/// Milliseconds that each method with a field takes for its splats at a new time and at the same time again, and those of
/// drawing them.
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
        "{} threads, the least of {CALLS} calls, preset fast, parameters as a run begins with, no gradients; drawing at {side}x{side}.",
        rayon::current_num_threads(),
        side = HELD.1
    );
    let heads = [
        ("method", 0),
        ("splats", 0),
        ("splats at a new time, ms", 2),
        ("at the same again, ms", 2),
        ("drawing, ms", 2),
    ];
    let mut out = Findings::new("frames", remark, &heads);
    for entry in registry.iter().filter(|entry| !entry.needs_avatar) {
        let schedule: Schedule = section(entry.name, &entry.config("fast")?, "schedule")?;
        if schedule.at(schedule.steps()).dynamic {
            let model = untrained(entry, &data, splats)?;
            out.rows.push(frame_row(&model, &data.train[0].camera.scaled(f64::from(HELD.1) / f64::from(size)))?);
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
    let last = model.schedule().steps();
    model.begin_step(last);
    Ok(model)
}

fn frame_row(model: &Model, camera: &Camera) -> Result<Vec<Cell>, LabError> {
    let splats_at = |t: f32| model.splats(&Timestamp::normalised(t), camera);
    let (splats, mut call) = (splats_at(0.0)?, 0);
    let new = least_ms(CALLS, || {
        call += 1;
        drop(splats_at(call as f32 / (CALLS + 2) as f32));
    });
    let again = least_ms(CALLS, || drop(splats_at(0.5)));
    let (options, mut workspace) = (RasterOptions::default(), Workspace::new());
    let mut frame = render(&splats, camera, &options, &mut workspace);
    let drawing = least_ms(CALLS, || render_into(&splats, camera, &options, &mut workspace, &mut frame));
    let numbers = [model.splat_count() as f64, new, again, drawing].map(Cell::from);
    Ok([Cell::from(model.name())].into_iter().chain(numbers).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(cell: &Cell) -> f64 {
        if let Cell::Number(Some(n)) = cell { *n } else { panic!("{cell:?} is no number") }
    }

    #[test]
    fn more_is_blended_where_splats_are_larger() {
        let blended = [0.5, 2.0].map(|factor| {
            let mut splats = scene(300, 0);
            splats.scales.iter_mut().for_each(|s| *s *= factor);
            let row = row("factor", &splats, 32);
            assert_eq!((&row[0], number(&row[1]), number(&row[2])), (&Cell::from("factor"), 300.0, 1024.0));
            assert!(number(&row[4]) > 0.0 && number(&row[5]) > 0.0, "{row:?}");
            number(&row[3])
        });
        assert!(blended[0] < blended[1], "{blended:?}");
    }

    #[test]
    fn methods_without_a_field_are_left_out() {
        let all = gs_methods::registry();
        let of = |name| *all.find(name).unwrap();
        let found = frames_of(&Registry::new(vec![of("static3d"), of("fourdgs")]), 200).unwrap();
        assert_eq!(found.rows.len(), 1);
        assert_eq!((&found.rows[0][0], number(&found.rows[0][1])), (&Cell::from("fourdgs"), 200.0));
        assert!(found.rows[0][2..].iter().all(|cell| number(cell) > 0.0), "{:?}", found.rows);
    }
}
