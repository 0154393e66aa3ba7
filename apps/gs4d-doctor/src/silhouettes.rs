//! Cameras against silhouettes: what alpha or masks carve together must fill each of them. Under wrong poses nothing is left,
//! or what is left is elsewhere.

use super::suspects::Suspect;
use super::{Finding, Verdict, median};
use gs_data::Dataset;
use gs_data::hull::{Carved, carve};

/// Share of the views that must agree on a cell: lower than for points, so that a few wrong views show up themselves.
const AGREEMENT: f64 = 0.8;
/// Shares of silhouettes that are filled: as it should be, and as it must not be.
const GOOD: f64 = 0.8;
const BAD: f64 = 0.5;
/// A silhouette is odd that fits the hull worse than the middle one by so many median deviations, and by so much.
const SPREADS: f64 = 6.0;
const LEAST_ODD: f64 = 0.08;

/// The hull and how well it fits each silhouette.
pub(super) struct Silhouettes {
    /// The carved cells and the silhouettes they are carved by.
    pub(super) carved: Carved,
    /// Share of each silhouette that cells cover, and its intersection with them over their union.
    fits: Vec<[f64; 2]>,
    /// The reading of poses that fills them best, if not the present one, and how well.
    better: Option<(Suspect, f64)>,
}

/// Carves the training views; none where they have neither alpha nor masks.
pub(super) fn look(data: &Dataset) -> Option<Silhouettes> {
    let carved = carve(data, AGREEMENT, |c| c.clone()).ok().flatten()?;
    let fits = carved.fits();
    let now = filled(&fits);
    let mut better: Option<(Suspect, f64)> = None;
    if now < GOOD {
        for s in Suspect::ALL {
            let other = carve(data, AGREEMENT, |c| s.camera(c)).ok().flatten().map_or(0.0, |c| filled(&c.fits()));
            if other > better.map_or(now.max(BAD), |b| b.1) {
                better = Some((s, other));
            }
        }
    }
    Some(Silhouettes { carved, fits, better: better.filter(|b| b.1 > now + 0.25) })
}

impl Silhouettes {
    /// Views whose silhouette fits the hull much worse than usual.
    fn odd(&self) -> Vec<String> {
        let overlaps: Vec<f64> = self.fits.iter().map(|f| f[1]).collect();
        let middle = median(&overlaps);
        let away: Vec<f64> = overlaps.iter().map(|o| (o - middle).abs()).collect();
        let limit = middle - (SPREADS * median(&away)).max(LEAST_ODD);
        let names = self.carved.names.iter().zip(&overlaps).filter(|(_, o)| **o < limit);
        names.map(|(n, _)| n.clone()).collect()
    }

    /// What they say of the poses.
    pub(super) fn findings(&self) -> Vec<Finding> {
        let (share, count) = (filled(&self.fits), self.fits.len());
        let text = format!("what {count} silhouettes carve fills {:.0} % of each, in the mean", 100.0 * share);
        if let Some((s, other)) = self.better {
            let what = format!("{text}; with poses {} it would be {:.0} %", s.what(), 100.0 * other);
            return vec![Finding::new("poses", "poses.convention", Verdict::Problem, what).fix(s.fix())];
        }
        let odd = self.odd();
        if share >= GOOD && !odd.is_empty() {
            let what = format!(
                "{text}, but {} are not of its shape: their poses or times are not those of the others",
                odd.len()
            );
            let finding = Finding::new("poses", "poses.view", Verdict::Problem, what);
            return vec![finding.at(odd).fix("correct these poses, or remove these views from the file")];
        }
        if share >= GOOD {
            return vec![Finding::ok("poses", text)];
        }
        let verdict = if share < BAD { Verdict::Problem } else { Verdict::Warning };
        let what = format!("{text}: poses, focal length, box or alpha do not belong together");
        let fix = "compare the pictures of the hull with the photographs; check alpha and the units of the poses, or set \
                   the box: gs4d init DATA --bound SIDE";
        vec![Finding::new("poses", "poses.silhouettes", verdict, what).fix(fix)]
    }
}

/// The mean share of silhouettes that cells cover.
fn filled(fits: &[[f64; 2]]) -> f64 {
    fits.iter().map(|f| f[0]).sum::<f64>() / fits.len().max(1) as f64
}
