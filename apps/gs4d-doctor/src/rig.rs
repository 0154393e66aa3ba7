//! Checks of camera positions: spread, outliers, scale.

use super::{Finding, Verdict, median};
use glam::DVec3;
use gs_data::Dataset;

/// Checks of camera positions: spread, outliers, scale.
pub(super) fn check(data: &Dataset) -> Vec<Finding> {
    let centres: Vec<DVec3> = data.train.iter().map(|v| v.camera.position()).collect();
    let middle = centres.iter().sum::<DVec3>() / centres.len() as f64;
    let away: Vec<f64> = centres.iter().map(|c| c.distance(middle)).collect();
    let (extent, usual) = (away.iter().copied().fold(0.0, f64::max), median(&away));
    let spread = |v: &[f64]| format!("{:.3}", v.iter().copied().fold(0.0, f64::max));
    let mut out = Vec::new();
    if extent < 1e-6 {
        let fix = "give images from several places; gs4d train learns no depth from one";
        out.push(
            Finding::new("poses", "poses.still", Verdict::Warning, "all training views are taken from one place")
                .fix(fix),
        );
    } else {
        let far: Vec<&str> = data
            .train
            .iter()
            .zip(&away)
            .filter(|(_, d)| **d > 8.0 * usual.max(1e-9))
            .map(|(v, _)| v.name.as_str())
            .collect();
        if !far.is_empty() && usual > 0.0 {
            let what = format!(
                "{} of {} cameras stand more than eight times farther out than usual ({} against {usual:.3})",
                far.len(),
                centres.len(),
                spread(&away)
            );
            let fix = "check the units of their translations, or remove these views";
            out.push(Finding::new("poses", "poses.far", Verdict::Problem, what).at(far).fix(fix));
        }
    }
    let size = data.scene_extent();
    if !(1e-3..=1e4).contains(&size) {
        let what = format!(
            "the cameras span {size:.3e} units: learning rates and the near plane are made for scenes of about 1 to 100"
        );
        out.push(
            Finding::new("poses", "poses.scale", Verdict::Warning, what)
                .fix("scale all translations and points by one factor"),
        );
    }
    out
}
