//! Scores of single views against the time of the scene, and by camera.

use super::score_table::{number_or_dash, split_of};
use gs_data::{Dataset, View};
use gs_train::evaluate::{EvalReport, ViewScores};
use gs4d_report::Curve;
use std::collections::BTreeMap;

/// At most so many cameras have a curve each.
const MAX_CURVES: usize = 5;

type Scored<'a> = Vec<(&'a View, &'a ViewScores)>;

/// The scored views by camera; one group if every view has a camera of its own.
fn by_camera<'a>(dataset: &'a Dataset, scores: &'a EvalReport) -> BTreeMap<u32, Scored<'a>> {
    let mut groups: BTreeMap<u32, Scored<'a>> = BTreeMap::new();
    let views = dataset.views(split_of(scores));
    views.iter().zip(&scores.views).for_each(|scored| groups.entry(scored.0.camera_id).or_default().push(scored));
    if groups.len() == views.len() {
        groups = BTreeMap::from([(0, groups.into_values().flatten().collect())]);
    }
    groups
}

/// PSNR against normalised time, a point for every view that is not perfect: a curve for each of a few cameras, or one for all,
/// and one for the views beyond the last training time.
pub(crate) fn curves(dataset: &Dataset, scores: &EvalReport) -> Vec<Curve> {
    let curve = |name: String, views: &mut dyn Iterator<Item = &ViewScores>| Curve {
        name,
        points: views.filter_map(|s| Some((f64::from(s.time), s.psnr?))).collect(),
    };
    let groups = by_camera(dataset, scores);
    let mut curves: Vec<Curve> = if (2..=MAX_CURVES).contains(&groups.len()) {
        let name = |camera: &u32| format!("{} views, camera {camera}", scores.split);
        groups.iter().map(|(camera, scored)| curve(name(camera), &mut scored.iter().map(|s| s.1))).collect()
    } else {
        vec![curve(format!("{} views", scores.split), &mut scores.views.iter())]
    };
    let future = scores.extrapolate.as_deref();
    curves.extend(future.map(|f| curve(format!("{} views", f.split), &mut f.views.iter())));
    curves
}

/// First and last training time, normalised.
pub(crate) fn training_times(dataset: &Dataset) -> Option<[f64; 2]> {
    let times = || dataset.train.iter().map(|v| f64::from(v.time.normalised));
    Some([times().reduce(f64::min)?, times().reduce(f64::max)?])
}

/// Per camera its number, number of views, mean and worst PSNR; empty for a single camera, or a camera for each view.
pub(crate) fn cameras(dataset: &Dataset, scores: &EvalReport) -> Vec<[String; 4]> {
    let row = |(camera, scored): (&u32, &Scored)| {
        let values: Vec<f64> = scored.iter().filter_map(|(_, s)| s.psnr).collect();
        let mean = (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64);
        let worst = values.iter().copied().reduce(f64::min);
        [camera.to_string(), scored.len().to_string(), number_or_dash(mean, 2), number_or_dash(worst, 2)]
    };
    let groups = by_camera(dataset, scores);
    if groups.len() < 2 { Vec::new() } else { groups.iter().map(row).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_synth::{SynthOptions, generate};
    use gs_train::evaluate::MeanScores;

    fn scores(views: &[View], split: &str, extrapolate: Option<Box<EvalReport>>) -> EvalReport {
        let score = |(k, v): (usize, &View)| ViewScores {
            name: v.name.clone(),
            time: v.time.normalised,
            psnr: Some(20.0 + k as f64),
            ssim: 0.5,
            ms_ssim: None,
            perceptual_proxy: 0.1,
            lpips: None,
            laplacian_ratio: None,
            high_band_ratio: None,
            masked: None,
            fitted: None,
            camera: None,
        };
        EvalReport {
            method: "m".into(),
            split: split.into(),
            background: [0.0; 3],
            scale: 1.0,
            protocol: String::new(),
            lpips_weights: None,
            mean: MeanScores {
                psnr: None,
                ssim: None,
                ms_ssim: None,
                perceptual_proxy: None,
                lpips: None,
                laplacian_ratio: None,
                high_band_ratio: None,
                masked: None,
                fitted: None,
            },
            psnr_of_mean_mse: None,
            perfect_views: 0,
            gaussians: 1,
            parameter_bytes: 4,
            train_seconds: None,
            views: views.iter().enumerate().map(score).collect(),
            cameras: None,
            extrapolate,
        }
    }

    #[test]
    fn every_scored_view_is_a_point_of_the_curves() {
        let mut data = generate("balls", &SynthOptions::of_views(16, 4, 6)).unwrap().dataset;
        data.extrapolate = data.test[4..].to_vec();
        let all = |data: &Dataset| {
            let future = scores(&data.extrapolate, "extrapolate", None);
            let report = scores(&data.test, "test", Some(Box::new(future)));
            (curves(data, &report), cameras(data, &report))
        };
        let (lines, rows) = all(&data);
        let shape = |lines: &[Curve]| lines.iter().map(|c| (c.name.clone(), c.points.len())).collect::<Vec<_>>();
        let [test, future] = [("test views", 6), ("extrapolate views", 2)].map(|(n, k)| (n.to_owned(), k));
        assert_eq!((shape(&lines), rows.len()), (vec![test, future.clone()], 0), "a camera for each view");
        assert_eq!(lines[0].points[2], (f64::from(data.test[2].time.normalised), 22.0));

        data.test.iter_mut().enumerate().for_each(|(k, v)| v.camera_id = 7 + u32::from(k >= 4));
        let (lines, rows) = all(&data);
        let of = |camera: u32, views: usize| (format!("test views, camera {camera}"), views);
        assert_eq!(shape(&lines), [of(7, 4), of(8, 2), future]);
        assert_eq!(rows, [["7", "4", "21.50", "20.00"], ["8", "2", "24.50", "24.00"]].map(|r| r.map(str::to_owned)));
        assert_eq!(training_times(&data), Some([0.0, 1.0]));
    }
}
