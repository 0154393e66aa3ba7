//! The path that explains best what is seen of a body.

use super::path::Path;
use super::seen::Seen;
use super::solve::{Minimum, minimise};
use glam::DVec3;

/// Passes of least squares whose weights follow the fit.
const PASSES: usize = 4;
/// Older times belong to the same path while errors of velocities stay below this times those of the latest alone.
const SAME: f64 = 1.5;
/// Errors below this share of the radius (per window of time) are rounding.
const ROUNDING: f64 = 1e-5;
/// Share of the disagreement between particles that their common twist may be off by.
const DOUBT: f64 = 1.0 / 3.0;
/// Largest correlation of errors of neighbouring frames.
const MOST_ALIKE: f64 = 0.9;

/// Errors of place, velocity and `ρ w` at one time; those of twists relative to how much particles disagree then.
type Errors = [DVec3; 3];

/// A path and how well it explains what is seen.
pub(super) struct Candidate {
    pub path: Path,
    pub minimum: Minimum,
    /// Root mean square errors, each of three coordinates.
    pub residuals: [f64; 3],
    /// The window of time that was fitted.
    pub unit: f64,
    /// Factor on `(JᵀJ)⁻¹`: errors over those of them that are independent and not taken by a parameter.
    pub variance: f64,
}

/// The latest times of a body.
pub(super) struct Window<'a> {
    seen: &'a Seen,
    pub times: usize,
    unit: f64,
}

impl<'a> Window<'a> {
    pub(super) fn new(seen: &'a Seen, times: usize) -> Self {
        Self { seen, times, unit: seen.taus[0] - seen.taus[times - 1] }
    }

    /// The best path.
    pub(super) fn best(&self) -> Candidate {
        let all = Path::ALL.map(|path| self.along(path));
        let Some(most) = all.last() else { return self.along(Path::Rest) };
        let alike = self.alike(most);
        let count = self.times as f64 / alike;
        let kinds = self.kinds();
        let score = |c: &Candidate| {
            let logs: f64 = kinds.iter().map(|k| 2.0 * c.residuals[*k].max(self.floor(*k)).ln()).sum();
            3.0 * count * logs + c.path.count() as f64 * (3.0 * kinds.len() as f64 * count).ln()
        };
        let best =
            all.into_iter().filter(|c| c.path.plausible(&c.minimum.at)).min_by(|a, b| score(a).total_cmp(&score(b)));
        let best = best.unwrap_or_else(|| self.along(Path::Rest));
        let errors = (3 * self.kinds().len() * self.times) as f64;
        let free = (errors / alike - best.path.count() as f64).max(1.0);
        Candidate { variance: errors / free, ..best }
    }

    /// Largest errors that longer windows may have, by those of this one; places are known too well to say when motion changed.
    pub(super) fn limits(&self, best: &Candidate) -> [f64; 3] {
        let limit = |kind: usize| SAME * best.residuals[kind].max(self.floor(kind));
        [f64::INFINITY, limit(1), limit(2)]
    }

    /// The best path of one kind.
    fn along(&self, path: Path) -> Candidate {
        let mean = |k: usize| self.rows().map(|r| r[k]).sum::<DVec3>() / self.times as f64;
        let mut at = path.begin(mean(1) * (self.unit / self.seen.radius), mean(2) * self.unit);
        // Places come in once velocities have a path.
        let mut scales = [f64::INFINITY, 1.0, 1.0];
        for _ in 0..PASSES {
            let residuals = self.fit(path, at, &scales);
            scales = [f64::INFINITY; 3];
            self.kinds().iter().for_each(|k| scales[*k] = residuals.1[*k].max(self.floor(*k)));
            at = residuals.0.at;
        }
        let (minimum, residuals) = self.fit(path, at, &scales);
        Candidate { path, minimum, residuals, unit: self.unit, variance: 1.0 }
    }

    /// Least squares of errors over `scales`, and the root mean square errors that are left.
    fn fit(&self, path: Path, at: Vec<f64>, scales: &[f64; 3]) -> (Minimum, [f64; 3]) {
        let scaled = |e: Errors| [0, 1, 2].map(|kind| e[kind] / scales[kind]);
        // A centre of mass that nothing tells stays at the centroid.
        let minimum = minimise(at, |p| {
            let all = self.errors(path, p).into_iter().flat_map(scaled).chain([path.offset(p)]);
            all.flat_map(|v| v.to_array()).collect()
        });
        let left = self.errors(path, &minimum.at);
        let square = |kind: usize| left.iter().map(|e| e[kind].length_squared()).sum::<f64>() / (3 * self.times) as f64;
        (minimum, [0, 1, 2].map(|kind| square(kind).sqrt()))
    }

    fn errors(&self, path: Path, p: &[f64]) -> Vec<Errors> {
        let Seen { taus, radius, doubts, .. } = self.seen;
        let p = path.unscaled(p, *radius, self.unit);
        let (motion, poses) = (path.motion(&p), path.poses(&p, &taus[..self.times], taus[0] - taus[1]));
        let one = |(k, ([place, u, w], pose)): (usize, (&[DVec3; 3], &super::Pose))| {
            let twist = motion.at(taus[k]);
            let velocity = DVec3::from_array(twist.velocity(place.to_array()));
            let spin = (*w - DVec3::from_array(twist.w)) * *radius;
            [*place - pose.centre, (*u - velocity) / doubts[k], spin / doubts[k]]
        };
        let mut all: Vec<Errors> = self.rows().zip(&poses).enumerate().map(one).collect();
        // The place at τ = 0 is off like all others.
        let mean = all.iter().map(|e| e[0]).sum::<DVec3>() / self.times as f64;
        all.iter_mut().for_each(|e| e[0] -= mean);
        all
    }

    fn rows(&self) -> impl Iterator<Item = &[DVec3; 3]> {
        self.seen.rows[..self.times].iter()
    }

    /// Kinds of errors that count: where places follow from velocities, images have shown the places.
    fn kinds(&self) -> &'static [usize] {
        if self.seen.carried { &[0, 2] } else { &[0, 1, 2] }
    }

    /// Number of frames that errors stay alike, by the correlation of neighbouring ones along a path.
    fn alike(&self, along: &Candidate) -> f64 {
        let left = self.errors(along.path, &along.minimum.at);
        let product = |a: &Errors, b: &Errors| {
            (0..3).map(|k| a[k].dot(b[k]) / along.residuals[k].powi(2).max(f64::MIN_POSITIVE)).sum::<f64>()
        };
        let neighbours: f64 = left.windows(2).map(|w| product(&w[0], &w[1])).sum();
        let squares: f64 = left.iter().map(|a| product(a, a)).sum();
        let r = (neighbours / squares.max(f64::MIN_POSITIVE)).clamp(0.0, MOST_ALIKE);
        (1.0 + r) / (1.0 - r)
    }

    /// Errors that are taken for granted: rounding, and those of a law whose particles disagree.
    fn floor(&self, kind: usize) -> f64 {
        let Seen { radius, disagreement, carried, .. } = *self.seen;
        let (rounding, doubt) = (ROUNDING * radius, DOUBT * disagreement);
        match kind {
            // The root mean square of an error of velocity times the time since.
            0 if carried => rounding.max(doubt * self.unit / 3f64.sqrt()),
            0 => rounding,
            // A smooth body hardly shows how it turns.
            2 if carried => (rounding / self.unit).max(disagreement),
            _ => (rounding / self.unit).max(doubt),
        }
    }
}
