//! Rigid groups: one motion for all particles of a body, fitted by least squares and integrated once.
//!
//! For particles at `y` (relative to the origin) whose motions have the coefficients `(v_i, w_i)`, each of twist, rate and
//! jerk is refitted to their velocities, with `r = y − ȳ`, `c_i = v_i + w_i × y_i`:
//!
//! ```text
//! min Σ ‖V + W × y_i − c_i‖²:     (Σ ‖r‖² I − r rᵀ + μI) W = Σ r × c_i + μ w̄,    V = c̄ − W × ȳ
//! ```
//! `μ`, 1e-6 of the spread, fills what a line or a point leaves undetermined with the members' own mean `w̄`. Members whose
//! error under the shared motion exceeds the tolerance (bound of [`crate::classes`]) are removed and the rest is fitted
//! again, first those above twice the median error, so that outliers do not bias the fit. A group is advanced by one affine
//! map ([`Group::map`]), composed in `f64`.

use crate::classes::ClassRule;
use crate::extrapolate::{Poses, RowsError, same_rows};
use crate::rollout::{PARTICLES, Rollout};
use crate::step::{Affine, step_map};
use crate::twist::{Motion, Twist};
use glam::{DMat3, DVec3, Vec3};
use gs_core::cast;
use gs_core::rot::hamilton;
use rayon::prelude::*;

/// The label of a particle that belongs to no group.
pub const UNGROUPED: u32 = u32::MAX;
/// Largest number of fits of a group.
const MAX_FITS: usize = 8;
/// Members whose error bound exceeds this times the median are outliers.
const OUTLIER_FACTOR: f64 = 2.0;
/// `μ` over the spread of the members.
const RIDGE: f64 = 1e-6;

/// The shared motion of one rigid body.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// The motion of all members, about the origin.
    pub motion: Motion<f64>,
    /// Number of particles that follow it.
    pub members: usize,
    /// Root mean square difference between its velocities and the members' own at `τ = 0`, world units per unit of time.
    pub residual: f64,
}

/// Rigid bodies and the particles that belong to them.
///
/// ```
/// use glam::Vec3;
/// use gs_physics::{ClassRule, Groups, Motion, Twist, groups::UNGROUPED};
/// let spin = Motion { twist: Twist { v: [0.0; 3], w: [0.0, 0.0, 1.0] }, ..Motion::default() };
/// let mut motions = vec![spin; 21];
/// motions[10].twist.v[0] = 3.0; // an outlier
/// let means: Vec<_> = (0..21).map(|i| Vec3::new((i % 3) as f32 - 1.0, (i / 3) as f32 - 3.0, 0.5)).collect();
/// let rule = ClassRule { tolerance: 0.01, horizon: 1.0 };
/// let groups = Groups::fit(&rule, &[0; 21], &motions, &means, Vec3::ZERO, &[0.1; 21])?;
/// assert!(groups.of[10] == UNGROUPED && groups.members() == 20);
/// assert!((groups.list[0].motion.twist.w[2] - 1.0).abs() < 1e-12);
/// # Ok::<(), gs_physics::RowsError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Groups {
    /// One group per label, in the order of labels; a group that fits none of its particles has no members.
    pub list: Vec<Group>,
    /// Index into `list` for every particle, or [`UNGROUPED`].
    pub of: Vec<u32>,
}

/// Inputs of a fit.
struct Scene<'a> {
    rule: &'a ClassRule,
    motions: &'a [Motion<f32>],
    means: &'a [Vec3],
    origin: Vec3,
    reach: &'a [f32],
}

impl Groups {
    /// Fits one motion to the particles of each label (labels from 0, [`UNGROUPED`] for none). `reach` is the
    /// [`rotation_sensitivity`](crate::classes::rotation_sensitivity) of every particle. Particles whose error would exceed the tolerance within
    /// the horizon become [`UNGROUPED`], and so does a group of one.
    ///
    /// # Errors
    /// If the columns differ in length.
    pub fn fit(
        rule: &ClassRule,
        labels: &[u32],
        motions: &[Motion<f32>],
        means: &[Vec3],
        origin: Vec3,
        reach: &[f32],
    ) -> Result<Self, RowsError> {
        for (what, got) in [("labels", labels.len()), ("motions", motions.len()), ("reaches", reach.len())] {
            same_rows(what, got, means.len())?;
        }
        let scene = Scene { rule, motions, means, origin, reach };
        let count = labels.iter().filter(|l| **l != UNGROUPED).max().map_or(0, |l| *l as usize + 1).min(means.len());
        let mut members = vec![Vec::new(); count];
        for (i, label) in labels.iter().enumerate() {
            if let Some(group) = members.get_mut(*label as usize) {
                group.push(i);
            }
        }
        let mut of = vec![UNGROUPED; labels.len()];
        let mut list = Vec::with_capacity(count);
        for (label, mut members) in members.into_iter().enumerate() {
            list.push(scene.fit_robust(&mut members));
            members.iter().for_each(|i| of[*i] = cast::to_u32(label));
        }
        Ok(Self { list, of })
    }

    /// Number of particles that follow any group.
    pub fn members(&self) -> usize {
        self.list.iter().map(|g| g.members).sum()
    }

    /// Writes the poses of all members `tau` after `start` to their rows of `now`.
    pub(crate) fn place(&self, rollout: &Rollout, tau: f64, start: &Poses, now: &mut Poses) {
        let maps: Vec<_> = self.list.iter().map(|g| Change::new(g.map(rollout, [0.0, tau]))).collect();
        let rows = now.means.par_chunks_mut(PARTICLES).zip(now.quats.par_chunks_mut(PARTICLES));
        let first = start.means.par_chunks(PARTICLES).zip(start.quats.par_chunks(PARTICLES));
        rows.zip(first).zip(self.of.par_chunks(PARTICLES)).for_each(|(((means, quats), (x0, q0)), of)| {
            for (i, label) in of.iter().enumerate() {
                if let Some(map) = maps.get(*label as usize) {
                    means[i] = x0[i] + (map.linear * (x0[i] - rollout.origin) + map.translation);
                    quats[i] = hamilton(map.rotation, q0[i]);
                }
            }
        });
    }
}

impl Group {
    /// The affine map of positions about the origin over `span`, and the rotation `(w, x, y, z)`.
    pub fn map(&self, rollout: &Rollout, span: [f64; 2]) -> (Affine, [f64; 4]) {
        let start = (Affine::IDENTITY, [1.0, 0.0, 0.0, 0.0]);
        rollout.steps(span).into_iter().fold(start, |(map, q), (tau, h)| {
            let (step, rotation) = step_map(&self.motion, tau, h, rollout.rule);
            (map.then(&step), hamilton(rotation, q))
        })
    }
}

/// A map less the identity, so that a group at rest keeps its bits.
struct Change {
    linear: glam::Mat3,
    translation: Vec3,
    rotation: [f32; 4],
}

impl Change {
    fn new((map, q): (Affine, [f64; 4])) -> Self {
        let rows = map.a.map(DVec3::from_array);
        let linear = (DMat3::from_cols(rows[0], rows[1], rows[2]).transpose() - DMat3::IDENTITY).as_mat3();
        Self { linear, translation: DVec3::from_array(map.b).as_vec3(), rotation: q.map(cast::to_f32) }
    }
}

impl Scene<'_> {
    /// Fits the members, removes outliers, and fits again.
    fn fit_robust(&self, members: &mut Vec<usize>) -> Group {
        let mut motion = Motion::default();
        for _ in 0..MAX_FITS {
            motion = self.fit(members);
            let bounds: Vec<f64> = members.iter().map(|i| self.bound(&motion, *i)).collect();
            let limit = self.rule.tolerance.max(OUTLIER_FACTOR * median(bounds.clone()));
            if bounds.iter().all(|b| *b <= limit) {
                break;
            }
            let mut bounds = bounds.into_iter();
            members.retain(|_| bounds.next().is_some_and(|b| b <= limit));
        }
        members.retain(|i| self.bound(&motion, *i) <= self.rule.tolerance);
        if members.len() < 2 {
            members.clear();
        }
        let square = |i: &usize| {
            let y = self.at(*i).to_array();
            let (shared, own) = (motion.twist.velocity(y), self.motions[*i].to_f64().twist.velocity(y));
            DVec3::from_array(shared).distance_squared(DVec3::from_array(own))
        };
        let mean = members.iter().map(square).sum::<f64>() / members.len().max(1) as f64;
        Group { motion, members: members.len(), residual: mean.sqrt() }
    }

    fn at(&self, i: usize) -> DVec3 {
        (self.means[i] - self.origin).as_dvec3()
    }

    /// Bound on the error of particle `i` under the shared motion.
    fn bound(&self, motion: &Motion<f64>, i: usize) -> f64 {
        let y = self.at(i).to_array();
        self.rule.bound(&self.motions[i].to_f64().shifted(y), &motion.shifted(y), f64::from(self.reach[i]))
    }

    fn fit(&self, members: &[usize]) -> Motion<f64> {
        let of = |part: fn(&Motion<f64>) -> Twist<f64>| {
            let sample = |i: &usize| (self.at(*i), part(&self.motions[*i].to_f64()));
            fit_twist(&members.iter().map(sample).collect::<Vec<_>>())
        };
        Motion { twist: of(|m| m.twist), rate: of(|m| m.rate), jerk: of(|m| m.jerk) }
    }
}

/// The (upper) median; zero for no values.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    let rank = values.len() / 2;
    match values.is_empty() {
        true => 0.0,
        false => *values.select_nth_unstable_by(rank, f64::total_cmp).1,
    }
}

/// The twist nearest to the velocities of `(position, twist)` samples, by least squares; zero for none.
fn fit_twist(samples: &[(DVec3, Twist<f64>)]) -> Twist<f64> {
    if samples.is_empty() {
        return Twist::default();
    }
    let n = samples.len() as f64;
    let velocity = |(y, t): &(DVec3, Twist<f64>)| DVec3::from_array(t.velocity(y.to_array()));
    let centroid = samples.iter().map(|s| s.0).sum::<DVec3>() / n;
    let mean = samples.iter().map(velocity).sum::<DVec3>() / n;
    let own = samples.iter().map(|s| DVec3::from_array(s.1.w)).sum::<DVec3>() / n;
    let (mut inertia, mut momentum, mut spread) = (DMat3::ZERO, DVec3::ZERO, 0.0);
    for s in samples {
        let r = s.0 - centroid;
        inertia += DMat3::from_diagonal(DVec3::splat(r.length_squared())) - outer(r);
        momentum += r.cross(velocity(s) - mean);
        spread += r.length_squared();
    }
    let ridge = RIDGE * spread;
    let w = match ridge > 0.0 {
        true => (inertia + DMat3::from_diagonal(DVec3::splat(ridge))).inverse() * (momentum + ridge * own),
        false => own,
    };
    Twist { v: (mean - w.cross(centroid)).to_array(), w: w.to_array() }
}

fn outer(r: DVec3) -> DMat3 {
    DMat3::from_cols(r * r.x, r * r.y, r * r.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrator::Integrator;
    use crate::truth;
    use gs_core::Rng;

    const ORIGIN: Vec3 = Vec3::new(0.5, 0.25, -1.0);

    fn normal(rng: &mut Rng) -> Vec3 {
        Vec3::new(rng.normal(), rng.normal(), rng.normal())
    }

    fn motion() -> Motion<f64> {
        let m = truth::tumble().motion;
        Motion { jerk: Twist { v: [0.2, 0.1, -0.4], w: [0.3, -0.2, 0.1] }, ..m }
    }

    fn rule(tolerance: f64) -> ClassRule {
        ClassRule { tolerance, horizon: 0.8 }
    }

    #[test]
    fn a_noisy_body_is_refitted_without_outliers() {
        let mut rng = Rng::new(1, "groups", 0, 0);
        let means: Vec<Vec3> = (0..400).map(|_| normal(&mut rng)).collect();
        let noisy = |rng: &mut Rng| {
            Motion::from_array(motion().to_array().map(|v| (v + 2e-3 * f64::from(rng.normal())) as f32))
        };
        let mut motions: Vec<_> = (0..400).map(|_| noisy(&mut rng)).collect();
        for m in motions.iter_mut().step_by(20) {
            m.twist.v[0] += 3.0;
        }
        let groups = Groups::fit(&rule(0.1), &[0; 400], &motions, &means, ORIGIN, &[0.05; 400]).unwrap();
        let group = &groups.list[0];
        assert!(group.members == 380 && groups.members() == 380, "{group:?}");
        assert!((0..400).all(|i| (groups.of[i] == UNGROUPED) == (i % 20 == 0)));
        assert!((group.residual - 6.8e-3).abs() < 1e-3, "{group:?}");
        for (got, want) in group.motion.to_array().iter().zip(motion().to_array()) {
            assert!((got - want).abs() < 1e-3, "{got} {want}");
        }
    }

    #[test]
    fn exact_bodies_are_found_exactly_even_lines_points_and_pairs() {
        let mut rng = Rng::new(2, "groups", 0, 0);
        let shapes: [Vec<Vec3>; 4] = [
            (0..50).map(|_| normal(&mut rng)).collect(),
            (0..5).map(|k| Vec3::new(1.0, 2.0, 3.0) * k as f32 * 0.1).collect(),
            vec![Vec3::ONE; 4],
            vec![Vec3::ZERO, Vec3::X],
        ];
        for means in shapes {
            let n = means.len();
            let motions = vec![motion().to_f32(); n];
            let groups = Groups::fit(&rule(1e-5), &vec![0; n], &motions, &means, ORIGIN, &vec![0.1; n]).unwrap();
            assert_eq!(groups.members(), n);
            for (got, want) in groups.list[0].motion.to_array().iter().zip(motions[0].to_f64().to_array()) {
                assert!((got - want).abs() < 1e-7, "{n}: {got} {want}");
            }
        }
        let alone =
            Groups::fit(&rule(1.0), &[0, UNGROUPED, 7], &[motion().to_f32(); 3], &[Vec3::X; 3], ORIGIN, &[0.0; 3]);
        let alone = alone.unwrap();
        assert!(alone.members() == 0 && alone.of == [UNGROUPED; 3], "{alone:?}");
        let error = Groups::fit(&rule(1.0), &[], &[], &[Vec3::X], ORIGIN, &[]).unwrap_err();
        assert_eq!((error.what, error.got, error.want), ("labels", 0, 1));
    }

    /// T12: the map of a group moves its members as their own steps do, to 4 units in the last place of their positions
    /// relative to the origin; over many steps, to 16.
    #[test]
    fn a_groups_map_is_its_members_steps() {
        let mut rng = Rng::new(3, "groups", 0, 0);
        let means: Vec<Vec3> = (0..300).map(|_| normal(&mut rng)).collect();
        let motions = vec![motion().to_f32(); 300];
        let groups = Groups::fit(&rule(1e-3), &[0; 300], &motions, &means, ORIGIN, &[0.1; 300]).unwrap();
        for rule in [Integrator::Rk2, Integrator::Se3Mid, Integrator::Se3Magnus4] {
            let rollout = Rollout { rule, dt: 1.0 / 30.0, origin: ORIGIN };
            for (tau, ulps) in [(1.0 / 30.0, 4.0), (-1.0 / 30.0, 4.0), (0.8, 16.0)] {
                let mut own = Poses { means: means.clone(), quats: vec![[1.0, 0.0, 0.0, 0.0]; 300] };
                let start = own.clone();
                let mut shared = own.clone();
                rollout.advance(&motions, [0.0, tau], &mut own.means, &mut own.quats);
                groups.place(&rollout, tau, &start, &mut shared);
                for (i, start) in means.iter().enumerate() {
                    let size = (*start - ORIGIN).length().max(own.means[i].length()).max(1.0) * f32::EPSILON;
                    let off = (own.means[i] - shared.means[i]).abs().max_element();
                    assert!(off <= ulps * size, "{rule:?} {tau}: {off} is {} ulp", off / size);
                    let turned = (0..4).map(|c| (own.quats[i][c] - shared.quats[i][c]).abs()).fold(0.0, f32::max);
                    assert!(turned <= ulps * f32::EPSILON, "{rule:?} {tau}: {turned}");
                }
            }
        }
    }

    #[test]
    fn a_group_at_rest_keeps_its_bits() {
        let means = vec![Vec3::new(0.1, 0.2, 0.3), Vec3::new(1e3, -7.0, 0.7)];
        let groups = Groups::fit(&rule(0.0), &[0; 2], &[Motion::default(); 2], &means, ORIGIN, &[0.1; 2]).unwrap();
        let start = Poses { means: means.clone(), quats: vec![[0.5; 4]; 2] };
        let mut now = Poses { means: vec![Vec3::ZERO; 2], quats: vec![[0.0; 4]; 2] };
        groups.place(&Rollout { rule: Integrator::Se3Mid, dt: 0.1, origin: ORIGIN }, 0.7, &start, &mut now);
        assert!(groups.members() == 2 && now.means == means && now.quats == start.quats);
    }
}
