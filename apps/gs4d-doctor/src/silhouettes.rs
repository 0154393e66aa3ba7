//! Checks of poses by silhouettes: the visual hull carved by alpha or masks must cover each silhouette. Under wrong poses the
//! hull is empty or in the wrong place.

use super::pose_readings::PoseReading;
use super::{Finding, Verdict, median};
use gs_data::Dataset;
use gs_data::hull::{Carved, carve};

/// Share of the views that must agree on a hull cell: lower than for initial points, so that a few wrong views do not empty
/// the hull but show up as outliers.
const AGREEMENT: f64 = 0.8;
/// Mean covered share of silhouettes: above the first poses are good, below the second they are wrong.
const GOOD_SHARE: f64 = 0.8;
const BAD_SHARE: f64 = 0.5;
/// A silhouette is an outlier if its IoU with the hull is below the median by this many median absolute deviations, and by
/// this much.
const MAX_DEVIATIONS: f64 = 6.0;
const MIN_DEFICIT: f64 = 0.08;

/// The visual hull and its fit to each silhouette.
pub(super) struct Silhouettes {
    /// The hull's cells and the silhouettes that carved them.
    pub(super) carved: Carved,
    /// Per silhouette: the share that the hull covers, and the IoU with the hull.
    fits: Vec<[f64; 2]>,
    /// The reading of the poses that covers more, if there is one, and the share it covers.
    better: Option<(PoseReading, f64)>,
}

/// Carves the training views; none where they have neither alpha nor masks.
pub(super) fn check(data: &Dataset) -> Option<Silhouettes> {
    let carved = carve(data, AGREEMENT, |c| c.clone()).ok().flatten()?;
    let fits = carved.fits();
    let now = filled(&fits);
    let mut better: Option<(PoseReading, f64)> = None;
    if now < GOOD_SHARE {
        for s in PoseReading::ALL {
            let other = carve(data, AGREEMENT, |c| s.camera(c)).ok().flatten().map_or(0.0, |c| filled(&c.fits()));
            if other > better.map_or(now.max(BAD_SHARE), |b| b.1) {
                better = Some((s, other));
            }
        }
    }
    Some(Silhouettes { carved, fits, better: better.filter(|b| b.1 > now + 0.25) })
}

impl Silhouettes {
    /// Names of views whose silhouette is an outlier.
    fn odd(&self) -> Vec<String> {
        let overlaps: Vec<f64> = self.fits.iter().map(|f| f[1]).collect();
        let middle = median(&overlaps);
        let away: Vec<f64> = overlaps.iter().map(|o| (o - middle).abs()).collect();
        let limit = middle - (MAX_DEVIATIONS * median(&away)).max(MIN_DEFICIT);
        let names = self.carved.names.iter().zip(&overlaps).filter(|(_, o)| **o < limit);
        names.map(|(n, _)| n.clone()).collect()
    }

    /// Findings on the poses.
    pub(super) fn findings(&self) -> Vec<Finding> {
        let (share, count) = (filled(&self.fits), self.fits.len());
        let text = format!("what {count} silhouettes carve fills {:.0} % of each, in the mean", 100.0 * share);
        if let Some((s, other)) = self.better {
            let what = format!("{text}; with poses {} it would be {:.0} %", s.what(), 100.0 * other);
            return vec![Finding::new("poses", "poses.convention", Verdict::Problem, what).fix(s.fix())];
        }
        let odd = self.odd();
        if share >= GOOD_SHARE && !odd.is_empty() {
            let what = format!(
                "{text}, but {} are not of its shape: their poses or times are not those of the others",
                odd.len()
            );
            let finding = Finding::new("poses", "poses.view", Verdict::Problem, what);
            return vec![finding.at(odd).fix("correct these poses, or remove these views from the file")];
        }
        if share >= GOOD_SHARE {
            return vec![Finding::ok("poses", text)];
        }
        let verdict = if share < BAD_SHARE { Verdict::Problem } else { Verdict::Warning };
        let what = format!("{text}: poses, focal length, box or alpha do not belong together");
        let fix = "compare the figures of the hull with the images; check alpha and the units of the poses, or set \
                   the box: gs4d init DATA --bound SIDE";
        vec![Finding::new("poses", "poses.silhouettes", verdict, what).fix(fix)]
    }
}

/// Mean over silhouettes of the share that the hull covers.
fn filled(fits: &[[f64; 2]]) -> f64 {
    fits.iter().map(|f| f[0]).sum::<f64>() / fits.len().max(1) as f64
}
