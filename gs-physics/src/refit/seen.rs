//! What is seen of a body: at every time the centroid of its particles and the twist they have in common.

use super::Tracks;
use crate::groups::median;
use crate::segment::TwistSums;
use glam::DVec3;

/// Fewest times of a fit.
pub(super) const FEWEST: usize = 6;
/// Passes that weigh particles by how far they are from the common twist.
const PASSES: usize = 4;
/// Least disagreement at one time, of that of all times.
const LEAST_DOUBT: f64 = 0.25;

/// A body at every time, latest first.
pub(super) struct Seen {
    pub taus: Vec<f64>,
    /// Centroid at `τ = 0`, world units.
    pub centroid: DVec3,
    /// Root mean square distance of particles from it.
    pub radius: f64,
    /// Centroids relative to that at `τ = 0`, their velocities, angular velocities.
    pub rows: Vec<[DVec3; 3]>,
    /// How much particles disagree at each time, relative to all times.
    pub doubts: Vec<f64>,
    /// Root mean square difference between velocities of particles and those of their common twist.
    pub disagreement: f64,
    /// Root mean square speed of particles.
    pub speed: f64,
    /// Whether all follows from the motions at `τ = 0`.
    pub carried: bool,
}

/// Places relative to the origin, and velocities there, of the particles at one time.
type Moving = Vec<(DVec3, DVec3)>;

/// The common twist at one time: centroid, its velocity, angular velocity.
struct Common {
    row: [DVec3; 3],
    /// Squared differences of velocities, particle by particle.
    errors: Vec<f64>,
}

impl Seen {
    pub(super) fn new(tracks: &Tracks, members: &[usize], weights: &[f32]) -> Option<Self> {
        let count = tracks.taus.len();
        let zero = tracks.taus.iter().position(|tau| *tau == 0.0)?;
        if members.len() < 3 || count < FEWEST {
            return None;
        }
        let frames: Vec<Moving> = (0..count).map(|k| moving(tracks, members, k)).collect();
        let given: Vec<f64> = members.iter().map(|i| f64::from(weights[*i])).collect();
        let finite = frames.iter().flatten().all(|(x, u)| x.is_finite() && u.is_finite());
        let weighty = given.iter().all(|w| *w >= 0.0) && given.iter().sum::<f64>() > 0.0;
        if !finite || !weighty {
            return None;
        }
        let mut own = given.clone();
        for _ in 0..PASSES {
            let squares = of_particles(&common(&frames, &own));
            // Cauchy's weights about the median.
            let typical = median(squares.clone()).max(f64::MIN_POSITIVE);
            own = given.iter().zip(&squares).map(|(w, s)| w / (1.0 + s / typical)).collect();
        }
        let all = common(&frames, &own);
        let mean = |of: &mut dyn Iterator<Item = f64>| weighted(&own, of).sqrt();
        let (first, disagreement) = (all[zero].row[0], mean(&mut of_particles(&all).into_iter()));
        let radius = mean(&mut frames[zero].iter().map(|(x, _)| x.distance_squared(first)));
        let doubt = |c: &Common| mean(&mut c.errors.iter().copied()) / disagreement.max(f64::MIN_POSITIVE);
        let doubts = all.iter().map(|c| if disagreement > 0.0 { doubt(c).max(LEAST_DOUBT) } else { 1.0 }).collect();
        let fast = |f: &Moving| weighted(&own, &mut f.iter().map(|(_, u)| u.length_squared()));
        let speed = (frames.iter().map(fast).sum::<f64>() / count as f64).sqrt();
        let rows = all.iter().map(|c| [c.row[0] - first, c.row[1], c.row[2]]).collect();
        let centroid = first + tracks.origin.as_dvec3();
        let (taus, carried) = (tracks.taus.clone(), tracks.carried);
        (radius > 0.0).then_some(Self { taus, centroid, radius, rows, doubts, disagreement, speed, carried })
    }
}

fn moving(tracks: &Tracks, members: &[usize], k: usize) -> Moving {
    let origin = tracks.origin.as_dvec3();
    let one = |i: &usize| {
        let x = tracks.means[k][*i].as_dvec3() - origin;
        (x, DVec3::from_array(tracks.motions[k][*i].to_f64().twist.velocity(x.to_array())))
    };
    members.iter().map(one).collect()
}

fn common(frames: &[Moving], weights: &[f64]) -> Vec<Common> {
    let one = |frame: &Moving| {
        let centroid =
            frame.iter().zip(weights).map(|((x, _), w)| *x * *w).sum::<DVec3>() / weights.iter().sum::<f64>();
        let mut sums = TwistSums::default();
        frame.iter().zip(weights).for_each(|((x, u), w)| sums.add(*w, *x - centroid, *u));
        let twist = sums.twist();
        let velocity = |x: DVec3| DVec3::from_array(twist.velocity((x - centroid).to_array()));
        let errors = frame.iter().map(|(x, u)| u.distance_squared(velocity(*x))).collect();
        Common { row: [centroid, twist.v.into(), twist.w.into()], errors }
    };
    frames.iter().map(one).collect()
}

/// Mean over all times, particle by particle.
fn of_particles(all: &[Common]) -> Vec<f64> {
    let mean = |i: usize| all.iter().map(|c| c.errors[i]).sum::<f64>() / all.len() as f64;
    (0..all[0].errors.len()).map(mean).collect()
}

fn weighted(weights: &[f64], values: &mut dyn Iterator<Item = f64>) -> f64 {
    values.zip(weights).map(|(v, w)| v * w).sum::<f64>() / weights.iter().sum::<f64>()
}
