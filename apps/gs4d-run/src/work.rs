//! Work of rendering and training, done and skipped: counts of the rasteriser over views, sums over the log.

use gs_core::{Camera, Time};
use gs_raster::{Frame, RasterOptions, Workspace, blend_counts, render_into};
use gs_train::capabilities::FreezeOptions;
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::timestamp::Timestamp;
use gs4d_report::ReportRow;
use gs4d_report::inspect::bytes_text;
use serde_json::Value;
use std::collections::BTreeMap;

/// Splats culled, blended and never reached in renders of some views, as rows for the report.
pub(crate) fn drawing_rows(
    method: &Model,
    views: &[(Camera, Time)],
    options: &RasterOptions,
) -> Result<Vec<ReportRow>, MethodError> {
    let (mut workspace, mut frame) = (Workspace::new(), Frame::default());
    let (mut all, mut given, mut listed, mut entries, mut used) = (0usize, 0usize, 0usize, 0usize, 0usize);
    let (mut blended, mut pixels, mut deepest) = (0u64, 0usize, 0u32);
    for (camera, time) in views {
        let splats = method.splats(&Timestamp::new(*time), camera)?;
        render_into(&splats, camera, options, &mut workspace, &mut frame);
        all += method.splat_count();
        given += splats.len();
        listed += workspace.splats_listed();
        entries += workspace.entries();
        used += workspace.entries_used();
        let counts = blend_counts(&splats, options, &mut workspace);
        blended += counts.iter().map(|c| u64::from(*c)).sum::<u64>();
        pixels += counts.len();
        deepest = counts.into_iter().fold(deepest, u32::max);
    }
    if all == 0 {
        return Ok(Vec::new());
    }
    let of = |part: usize, whole: usize| {
        let per_view = part as f64 / views.len() as f64;
        format!("{per_view:.0} a view ({:.1} %)", 100.0 * part as f64 / whole.max(1) as f64)
    };
    let mut rows = Vec::new();
    if given < all {
        rows.push(ReportRow::new(
            "left out by the method",
            of(all - given, all),
            "splats not made for a view: not seen, or masked out",
        ));
    }
    rows.extend([
        ReportRow::new(
            "culled",
            of(given - listed, given),
            "behind, outside, below α 1/255, or hidden by closed tiles",
        ),
        ReportRow::new(
            "blended",
            format!("{:.1} a pixel, at most {deepest}", blended as f64 / pixels.max(1) as f64),
            "splats of α 1/255 or more, up to the one that fills the pixel",
        ),
        ReportRow::new("never reached", of(entries - used, entries), "tile entries behind what is opaque already"),
        ReportRow::new(
            "scratch of rendering",
            bytes_text(workspace.bytes()),
            "held by the rasteriser, reused from frame to frame",
        ),
    ]);
    Ok(rows)
}

/// Splats that could be frozen as static, for methods that can render so.
pub(crate) fn resting_rows(method: &Model, views: &[(Camera, Time)]) -> Vec<ReportRow> {
    let cameras: Vec<Camera> = views.iter().map(|v| v.0.clone()).collect();
    let options = FreezeOptions::usual(&cameras);
    let pixels = options.pixels;
    let Some((_, report)) = method.freeze_static(&options) else { return Vec::new() };
    let share = 100.0 * report.still as f64 / report.splats.max(1) as f64;
    vec![ReportRow::new(
        "rows that could rest",
        format!("{} of {} ({share:.1} %)", report.still, report.splats),
        &format!("within {pixels} pixels of the rendered views; left at rest by `gs4d render --static-within`"),
    )]
}

/// Lines of the log that steps have written.
fn step_lines(log: &[Value]) -> impl DoubleEndedIterator<Item = &Value> {
    log.iter().filter(|l| l["ms_per_step"].is_number())
}

/// Sums over the log.
pub(crate) fn training_rows(log: &[Value]) -> Vec<ReportRow> {
    if step_lines(log).next().is_none() {
        return Vec::new();
    }
    let sum = |key: &str| step_lines(log).filter_map(|l| l[key].as_u64()).sum::<u64>();
    let grown = format!("+{} cloned, +{} split, −{} pruned", sum("cloned"), sum("split"), sum("pruned"));
    vec![
        ReportRow::new("density control", grown, "splats over all steps"),
        ReportRow::new("gradient rows refused", sum("quarantined").to_string(), "not finite, and so not learnt from"),
    ]
}

/// Largest memory of a process that trained, where the system tells, MiB.
pub(crate) fn peak_memory_mib(log: &[Value]) -> Option<f64> {
    step_lines(log).filter_map(|l| l["memory_mib"].as_f64()).reduce(f64::max)
}

/// Parts of a step with their milliseconds, means over all steps, the longest first; parts below 0.5 % are summed up.
pub(crate) fn step_phases(log: &[Value]) -> Vec<(String, f64)> {
    let (mut sums, mut steps) = (BTreeMap::<&str, f64>::new(), 0.0);
    for line in step_lines(log) {
        // Lines without means tell of their last step alone.
        let (parts, of) = match line["ms"].as_object() {
            Some(means) => (Some(means), line["steps"].as_f64().unwrap_or(1.0)),
            None => (line["ms_last"].as_object(), 1.0),
        };
        steps += of;
        for (name, ms) in parts.into_iter().flatten().filter(|(name, _)| *name != "total") {
            *sums.entry(name).or_default() += of * ms.as_f64().unwrap_or(0.0);
        }
    }
    let (steps, all) = (steps.max(1.0), sums.values().sum::<f64>());
    let (small, large): (Vec<_>, Vec<_>) = sums.into_iter().partition(|(_, ms)| *ms < 0.005 * all);
    let mut phases: Vec<_> = large.into_iter().map(|(name, ms)| (name.replace('_', " "), ms / steps)).collect();
    phases.sort_by(|a, b| b.1.total_cmp(&a.1));
    if !small.is_empty() {
        phases.push(("all else".to_owned(), small.iter().map(|p| p.1).sum::<f64>() / steps));
    }
    phases
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_synth::{self as synth, SynthOptions};
    use gs_train::registry::section;
    use gs_train::scene::SceneInfo;
    use serde_json::json;

    #[test]
    fn a_camera_that_looks_away_culls_all() {
        let options = SynthOptions { size: 32, train_views: 4, test_views: 1, ..SynthOptions::default() };
        let data = synth::generate("static", &options).unwrap().dataset;
        let entry = gs_methods::registry().find("static3d").unwrap();
        let config = entry.config("tiny").unwrap();
        let scene = SceneInfo::of(&data, &section("static3d", &config, "init").unwrap(), 0).unwrap();
        let method = entry.model(&config, &scene).unwrap();
        let camera = &data.test[0].camera;
        let mut away = camera.clone();
        away.rotation = glam::DMat3::from_diagonal(glam::DVec3::new(-1.0, 1.0, -1.0)) * away.rotation;
        away.translation = glam::DVec3::new(-1.0, 1.0, -1.0) * away.translation;
        let at = Timestamp::normalised(0.0).t;
        let values = |camera: &Camera| {
            let rows = drawing_rows(&method, &[(camera.clone(), at)], &RasterOptions::default()).unwrap();
            (rows[0].value.clone(), rows[1].value.clone())
        };
        let all = format!("{} a view (100.0 %)", method.splat_count());
        assert_eq!(values(&away), (all.clone(), "0.0 a pixel, at most 0".to_owned()));
        let (culled, blended) = values(camera);
        assert!(culled != all && !blended.starts_with("0.0"), "{blended}");
        assert!(drawing_rows(&method, &[], &RasterOptions::default()).unwrap().is_empty());
        assert!(resting_rows(&method, &[(camera.clone(), at)]).is_empty(), "it has no such way");
    }

    #[test]
    fn a_log_is_summed() {
        let line = |cloned: u32| {
            json!({"step": 1, "ms_per_step": 2.0, "cloned": cloned, "split": 1, "pruned": 2, "quarantined": 0,
                "ms_last": {"field": 0.5, "raster_forward": 0.25, "adapt": 0.001, "total": 1.0}, "memory_mib": 20.0})
        };
        let log = [line(3), json!({"step": 1, "eval": {}}), line(4)];
        let rows = training_rows(&log);
        assert_eq!(rows[0].value, "+7 cloned, +2 split, −4 pruned");
        assert_eq!(peak_memory_mib(&log), Some(20.0));
        let phases = step_phases(&log);
        let expected = [("field", 0.5), ("raster forward", 0.25), ("all else", 0.001)];
        assert_eq!(phases, expected.map(|(name, ms)| (name.to_owned(), ms)), "the longest first, the total left out");
        let mut mean = line(1);
        (mean["steps"], mean["ms"], mean["memory_mib"]) = (json!(8), json!({"field": 3.0}), json!(12.0));
        let phases = step_phases(&[log[0].clone(), mean.clone(), log[2].clone()]);
        assert_eq!(phases[0], ("field".to_owned(), (8.0 * 3.0 + 2.0 * 0.5) / 10.0), "a line of eight steps");
        assert_eq!(peak_memory_mib(&[log[0].clone(), mean]), Some(20.0), "of the process before");
        let other = [json!({"eval": 1})];
        assert!(training_rows(&other).is_empty() && step_phases(&other).is_empty());
    }
}
