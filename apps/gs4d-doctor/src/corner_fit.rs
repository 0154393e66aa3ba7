//! Single wrong poses by matched corners: the matches of a view disagree with its own pose and agree with another one.

use super::hull_fit::{Found, turned_by};
use super::matching::{Matches, SAME_PLACE, angle_between};
use super::refit::{Fit, Seen, refit, share};
use glam::{DVec2, DVec3};
use gs_core::Camera;
use rayon::prelude::*;

/// Views with most matches that are asked about a pose.
const PARTNERS: usize = 6;
/// Fewest matches with neighbours for a first look, and the largest share of them that agrees with a suspect's pose.
const MIN_MATCHES: usize = 20;
const SUSPECT_SHARE: f64 = 0.2;
/// A pose is wrong if at most this share of its matches agrees with it,
const WRONG_SHARE: f64 = 0.15;
/// and at least this share and number with another one; more where things move, since what moves agrees with another pose, too.
const RIGHT: [(f64, f64); 2] = [(0.5, 30.0), (0.65, 60.0)];
/// Most views that are examined.
const MAX_SUSPECTS: usize = 16;
/// So many views are flagged one by one, whatever their share.
const MIN_FLAGGED: usize = 3;
/// Views that are turned to learn what would be found.
const TRIED_VIEWS: usize = 12;

/// What corners say of views, one by one.
pub(super) struct Wrong {
    pub(super) elsewhere: Vec<Elsewhere>,
    /// Number of views that were examined, the most doubtful of `suspects`.
    pub(super) examined: usize,
    suspects: usize,
}

impl Wrong {
    /// Whether more than a quarter of `views` views are wrong, if as many of the suspects are as of those that were examined.
    pub(super) fn doubts_all(&self, views: usize) -> bool {
        self.elsewhere.len() * self.suspects > (views / 4).max(MIN_FLAGGED) * self.examined
    }
}

/// A view whose matches agree with another pose than its own.
#[derive(Clone, Debug)]
pub(super) struct Elsewhere {
    pub(super) view: usize,
    /// Shares of its matches that agree with its own and with the other pose.
    pub(super) shares: [f64; 2],
    /// Angle between both, degrees.
    pub(super) degrees: f64,
}

/// Suspects and what their matches say.
pub(super) struct CornerFit<'m, 'v> {
    matches: &'m Matches<'v>,
    focus: DVec3,
    /// Least share and number of matches that agree with another pose.
    right: (f64, f64),
}

impl<'m, 'v> CornerFit<'m, 'v> {
    pub(super) fn new(matches: &'m Matches<'v>, focus: DVec3, dynamic: bool) -> Self {
        Self { matches, focus, right: RIGHT[usize::from(dynamic)] }
    }

    /// Views with wrong poses, of those of whose matches with neighbours fewest agree with the poses.
    pub(super) fn wrong(&self) -> Wrong {
        let (m, mut examined) = (self.matches, self.suspects());
        let suspects = examined.len();
        examined.truncate(MAX_SUSPECTS);
        examined.sort_unstable();
        let found: Vec<Option<Elsewhere>> =
            examined.par_iter().map(|&i| self.elsewhere(i, &m.cameras[i], &self.partners(i))).collect();
        Wrong { elsewhere: found.into_iter().flatten().collect(), examined: examined.len(), suspects }
    }

    /// Views of whose matches few agree with the poses, the fewest first.
    fn suspects(&self) -> Vec<usize> {
        let m = self.matches;
        let shares: Vec<(usize, f64)> = (0..m.views.len()).map(|i| self.with_neighbours(i)).collect();
        let usual = super::median(&shares.iter().map(|s| s.0 as f64).collect::<Vec<_>>());
        // A view far from where its pose puts it has no matches with those near there.
        let lonely = |n: usize| usual >= MIN_MATCHES as f64 && (n as f64) < 0.25 * usual;
        let suspect = |&i: &usize| lonely(shares[i].0) || shares[i].0 >= MIN_MATCHES && shares[i].1 < SUSPECT_SHARE;
        let mut suspects: Vec<usize> = (0..m.views.len()).filter(suspect).collect();
        suspects.sort_by(|a, b| shares[*a].1.total_cmp(&shares[*b].1));
        suspects
    }

    /// Views with wrong poses by the matches that `partners` gives for each.
    #[cfg(test)]
    pub(super) fn wrong_among(&self, partners: &dyn Fn(usize) -> Vec<(usize, Vec<[DVec2; 2]>)>) -> Vec<Elsewhere> {
        let views = 0..self.matches.views.len();
        views.filter_map(|i| self.elsewhere(i, &self.matches.cameras[i], &partners(i))).collect()
    }

    /// Number of matches of a view with its neighbours, and the share that agrees with the poses.
    fn with_neighbours(&self, i: usize) -> (usize, f64) {
        let m = self.matches;
        let of = m.of_view(i);
        let n = of.iter().map(|o| o.1.len()).sum();
        (n, share(&m.cameras[i], &self.seen(&of), m.tolerance))
    }

    fn seen<'s>(&'s self, of: &'s [(usize, Vec<[DVec2; 2]>)]) -> Vec<Seen<'s>> {
        of.iter().map(|(j, points)| Seen { camera: &self.matches.cameras[*j], points }).collect()
    }

    /// The views from other places with most matches, wherever the poses put them: matches with views from the same
    /// place, as of a camera at rest, say nothing of a pose.
    fn partners(&self, i: usize) -> Vec<(usize, Vec<[DVec2; 2]>)> {
        let place = |k: usize| self.matches.cameras[k].position();
        let mut all = self.matches.with_all(i);
        all.retain(|p| place(p.0).distance(place(i)) > SAME_PLACE);
        all.sort_by_key(|p| std::cmp::Reverse(p.1.len()));
        all.truncate(PARTNERS);
        all
    }

    /// What the matches of a view say of a camera it is given.
    fn elsewhere(&self, view: usize, camera: &Camera, partners: &[(usize, Vec<[DVec2; 2]>)]) -> Option<Elsewhere> {
        let (m, seen) = (self.matches, self.seen(partners));
        let count: usize = partners.iter().map(|p| p.1.len()).sum();
        let own = share(camera, &seen, m.tolerance);
        if own > WRONG_SHARE || (count as f64) < self.right.1 {
            return None;
        }
        let near = partners.iter().take(4).map(|p| m.cameras[p.0].clone());
        let starts: Vec<Camera> = std::iter::once(camera.clone()).chain(near).collect();
        let reach = camera.position().distance(self.focus);
        let Fit { camera: there, share } = refit(&starts, &seen, m.tolerance, reach)?;
        let degrees = angle_between(&there, camera).to_degrees();
        (share >= self.right.0 && share * count as f64 >= self.right.1).then_some(Elsewhere {
            view,
            shares: [own, share],
            degrees,
        })
    }

    /// Turns views of the data by an angle, one at a time, and counts those that would be flagged.
    pub(super) fn turns_found(&self, degrees: f64) -> Found {
        let tried: Vec<usize> = gs_data::evenly(self.matches.views.len(), TRIED_VIEWS).collect();
        let found = |k: usize| {
            let i = tried[k];
            let camera = turned_by(&self.matches.cameras[i], degrees.to_radians(), 2.4 * k as f64);
            let near = self.matches.of_view(i);
            let matched: usize = near.iter().map(|p| p.1.len()).sum();
            matched >= MIN_MATCHES
                && share(&camera, &self.seen(&near), self.matches.tolerance) < SUSPECT_SHARE
                && self.elsewhere(i, &camera, &near).is_some()
        };
        Found { found: (0..tried.len()).into_par_iter().filter(|k| found(*k)).count(), tried: tried.len() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_whole_is_doubted_by_the_share_of_what_was_examined() {
        let doubts = |wrong: usize, examined: usize, suspects: usize, views: usize| {
            let elsewhere = vec![Elsewhere { view: 0, shares: [0.0, 1.0], degrees: 10.0 }; wrong];
            Wrong { elsewhere, examined, suspects }.doubts_all(views)
        };
        assert!(!doubts(3, 8, 8, 12) && doubts(4, 8, 8, 12));
        assert!(!doubts(4, 16, 200, 200) && doubts(5, 16, 200, 200));
        assert!(!doubts(16, 16, 50, 200), "no more suspects than a quarter");
        assert!(!doubts(0, 0, 0, 40));
    }
}
