//! Positions and orientations of particles at any time after (or before) their motions were read, with cached steps.
//!
//! ```text
//! n = ⌈|t − t₀| / Δt − 1e-6⌉:  n − 1 full steps, cached as nodes, then one to t itself
//! ```
//! Results have the bits of a fresh [`Rollout::advance`] from `t₀`, whatever times were asked for before. Every eighth step
//! is cached, and the latest one: the next time costs at most two steps, any other at most nine. Of each direction of time fewer than 64
//! nodes are kept: beyond 504 steps their spacing doubles as often as that takes, and any other time costs at most a spacing and one step.
//!
//! [`Extrapolator::reduce`] does less work within a tolerance: particles at rest stay, those with a closed form take one
//! exponential, rigid groups share one map, and only the others take steps.

use crate::blocks::{self, MotionBlock, Run, StateBlock};
use crate::classes::{ClassRule, MotionClass};
use crate::groups::{Groups, UNGROUPED};
use crate::integrator::Integrator;
use crate::lanes::LANES;
use crate::rollout::{PARTICLES, Rollout, TASK};
use crate::step::Substep;
use crate::twist::Motion;
use fearless_simd::{Level, dispatch};
use glam::Vec3;
use gs_core::cast;
use rayon::prelude::*;

/// Steps between cached nodes, as long as these are few.
const NODE_INTERVAL: usize = 8;
/// Number of cached nodes of a direction of time at which every second is dropped; even.
const MOST_NODES: usize = 64;

/// Columns with different numbers of rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what}: {got} rows for {want} particles; give one row each")]
pub struct RowsError {
    /// The column of the wrong length.
    pub what: &'static str,
    /// Number of rows of that column.
    pub got: usize,
    /// Number of particles, one row each.
    pub want: usize,
}

/// Fails unless `what` has one row for each of `want` particles.
pub(crate) fn same_rows(what: &'static str, got: usize, want: usize) -> Result<(), RowsError> {
    if got == want { Ok(()) } else { Err(RowsError { what, got, want }) }
}

/// Particles with their motions, to be asked for at any time; see the [module](self).
#[derive(Clone, Debug)]
pub struct Extrapolator {
    rollout: Rollout,
    t0: f64,
    start: Poses,
    motions: Vec<Motion<f32>>,
    stepped: Stepped,
    reduced: Option<Reduced>,
    now: Poses,
    /// Whether `now` was computed by `reduced`.
    now_is_reduced: bool,
}

/// The cheaper paths, valid up to a horizon.
#[derive(Clone, Debug)]
struct Reduced {
    horizon: f64,
    groups: Option<Groups>,
    /// Particles with a closed form, with their models as motions.
    closed_form: Packed,
    /// All other particles; they take steps.
    stepped: Stepped,
    counts: Counts,
}

/// Number of particles by how they are advanced.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Counts {
    /// Particles advanced with their rigid group.
    pub grouped: usize,
    /// The others by class, in the order of [`MotionClass`]; the last take steps.
    pub classes: [usize; 5],
}

/// Positions and orientations, row by row.
#[derive(Clone, Debug, Default)]
pub(crate) struct Poses {
    pub means: Vec<Vec3>,
    pub quats: Vec<[f32; 4]>,
}

impl Extrapolator {
    /// Particles at `t0`, when their motions were read: positions in world units, orientations `(w, x, y, z)` of unit
    /// length. `t0` and all times asked for must be finite.
    ///
    /// # Errors
    /// If the columns differ in length.
    pub fn new(
        rollout: Rollout,
        t0: f64,
        motions: Vec<Motion<f32>>,
        means: Vec<Vec3>,
        quats: Vec<[f32; 4]>,
    ) -> Result<Self, RowsError> {
        same_rows("motions", motions.len(), means.len())?;
        same_rows("orientations", quats.len(), means.len())?;
        let start = Poses { means, quats };
        let rows = (0..cast::to_u32(motions.len())).collect();
        let stepped = Stepped::new(rows, &motions, &start, rollout.origin);
        Ok(Self { rollout, t0, now: start.clone(), start, motions, stepped, reduced: None, now_is_reduced: false })
    }

    /// Advances every particle by the simplest motion within the tolerance of `rule`, or with its group where it has one.
    /// `reach` is the [`rotation_sensitivity`](crate::classes::rotation_sensitivity) of every particle. Times beyond the horizon of `rule` are
    /// still integrated in steps.
    ///
    /// # Errors
    /// If the columns differ in length.
    pub fn reduce(mut self, rule: &ClassRule, reach: &[f32], groups: Option<Groups>) -> Result<Self, RowsError> {
        let found = rule.classify_all(&self.motions, &self.start.means, self.rollout.origin, reach)?;
        if let Some(groups) = &groups {
            same_rows("labels", groups.of.len(), found.len())?;
        }
        let mut counts = Counts::default();
        let (mut closed_form, mut stepped, mut models) = (Vec::new(), Vec::new(), self.motions.clone());
        for (row, found) in found.iter().enumerate() {
            if groups.as_ref().is_some_and(|g| g.of[row] != UNGROUPED) {
                counts.grouped += 1;
                continue;
            }
            counts.classes[found.class as usize] += 1;
            match found.class {
                MotionClass::Static => {}
                MotionClass::General => stepped.push(cast::to_u32(row)),
                _ => {
                    models[row] = found.model.to_f32();
                    closed_form.push(cast::to_u32(row));
                }
            }
        }
        let origin = self.rollout.origin;
        let closed_form = Packed::new(closed_form, &models, &self.start, origin);
        let stepped = Stepped::new(stepped, &self.motions, &self.start, origin);
        self.reduced = Some(Reduced { horizon: rule.horizon, groups, closed_form, stepped, counts });
        Ok(self)
    }

    /// Number of particles by how they are advanced; all take steps without [`Extrapolator::reduce`].
    pub fn counts(&self) -> Counts {
        let all = Counts { grouped: 0, classes: [0, 0, 0, 0, self.motions.len()] };
        self.reduced.as_ref().map_or(all, |r| r.counts)
    }

    /// Positions (world units) and orientations `(w, x, y, z)` at time `t`, one row per particle.
    pub fn at(&mut self, t: f64) -> (&[Vec3], &[[f32; 4]]) {
        let tau = t - self.t0;
        let reduced = self.reduced.as_mut().filter(|r| tau.abs() <= r.horizon * (1.0 + 1e-9));
        // Rows at rest are written by nobody, so they are reset whenever the set of written rows changes.
        if tau == 0.0 || self.now_is_reduced != reduced.is_some() {
            self.now.means.clone_from(&self.start.means);
            self.now.quats.clone_from(&self.start.quats);
        }
        self.now_is_reduced = reduced.is_some();
        match reduced {
            Some(reduced) => reduced.advance(&self.rollout, tau, &self.start, &mut self.now),
            None => self.stepped.advance(&self.rollout, tau, &self.start, &mut self.now),
        }
        (&self.now.means, &self.now.quats)
    }

    /// The motions given to [`Extrapolator::new`], one per particle.
    pub fn motions(&self) -> &[Motion<f32>] {
        &self.motions
    }
}

impl Reduced {
    fn advance(&mut self, rollout: &Rollout, tau: f64, start: &Poses, now: &mut Poses) {
        if tau == 0.0 {
            return;
        }
        if let Some(groups) = &self.groups {
            groups.place(rollout, tau, start, now);
        }
        let run = Run { rule: Integrator::Se3Mid, substeps: &[Substep::averaged(tau)], steps_before: 0 };
        self.closed_form.place(run, &self.closed_form.start, start, now);
        self.stepped.advance(rollout, tau, start, now);
    }
}

/// A subset of the particles, packed in blocks.
#[derive(Clone, Debug, Default)]
struct Packed {
    /// Indices of the particles, ascending.
    rows: Vec<u32>,
    motions: Vec<MotionBlock>,
    start: Vec<StateBlock>,
}

impl Packed {
    /// Packs `rows` of `motions` and `poses`.
    fn new(rows: Vec<u32>, motions: &[Motion<f32>], poses: &Poses, origin: Vec3) -> Self {
        let block = |rows: &[u32]| {
            let pick = |r: &u32| *r as usize;
            let m: Vec<_> = rows.iter().map(|r| motions[pick(r)]).collect();
            let x: Vec<_> = rows.iter().map(|r| poses.means[pick(r)]).collect();
            let q: Vec<_> = rows.iter().map(|r| poses.quats[pick(r)]).collect();
            (blocks::pack_motions(&m), blocks::pack_states(&x, &q, origin))
        };
        let (motions, start) = rows.chunks(LANES).map(block).unzip();
        Self { rows, motions, start }
    }

    /// Advances `states` by a run of steps.
    fn roll(&self, run: Run<'_>, states: &mut [StateBlock]) {
        states.par_chunks_mut(TASK).zip(self.motions.par_chunks(TASK)).for_each(|(states, motions)| {
            for (state, motions) in states.iter_mut().zip(motions) {
                dispatch!(Level::new(), simd => blocks::roll(simd, run, motions, state, None));
            }
        });
    }

    /// Advances `states` by a run of steps and writes the end to its rows of `now`; `first` are the positions at the start.
    fn place(&self, run: Run<'_>, states: &[StateBlock], first: &Poses, now: &mut Poses) {
        let tasks = self.split(now);
        let packed = self.motions.par_chunks(TASK).zip(self.start.par_chunks(TASK).zip(states.par_chunks(TASK)));
        tasks.into_par_iter().zip(packed).for_each(|(task, (motions, (start, states)))| {
            let blocks = motions.iter().zip(start.iter().zip(states));
            for (rows, (motions, (start, state))) in task.rows.chunks(LANES).zip(blocks) {
                let mut end = *state;
                dispatch!(Level::new(), simd => blocks::roll(simd, run, motions, &mut end, None));
                for (lane, row) in rows.iter().enumerate() {
                    let (row, at) = (*row as usize, *row as usize - task.begin);
                    let to = (&mut task.means[at], &mut task.quats[at]);
                    blocks::unpack_lane(start, &end, lane, first.means[row], to);
                }
            }
        });
    }

    /// Cuts `now` between tasks: rows ascend, so no two tasks share one.
    fn split<'a>(&'a self, now: &'a mut Poses) -> Vec<Task<'a>> {
        let (mut means, mut quats, mut begin) = (&mut now.means[..], &mut now.quats[..], 0);
        let mut cut = |rows: &'a [u32]| {
            let end = rows.last().map_or(begin, |r| *r as usize + 1);
            let (m, q) = (means.split_off_mut(..end - begin), quats.split_off_mut(..end - begin));
            let task = Task { rows, begin, means: m.unwrap_or_default(), quats: q.unwrap_or_default() };
            begin = end;
            task
        };
        self.rows.chunks(PARTICLES).map(&mut cut).collect()
    }
}

/// Rows of one task, and the range of all rows, from `begin` on, that they lie in.
struct Task<'a> {
    rows: &'a [u32],
    begin: usize,
    means: &'a mut [Vec3],
    quats: &'a mut [[f32; 4]],
}

/// States of all particles after a number of full steps from the start.
#[derive(Clone, Debug, Default)]
struct Node {
    steps: usize,
    states: Vec<StateBlock>,
}

/// Nodes of one direction of time.
#[derive(Clone, Debug)]
struct Nodes {
    /// Nodes after every `interval`-th step, in order; fewer than [`MOST_NODES`].
    cached: Vec<Node>,
    /// Steps between them.
    interval: usize,
    /// The last full step of the previous call.
    latest: Node,
}

impl Default for Nodes {
    fn default() -> Self {
        Self { cached: Vec::new(), interval: NODE_INTERVAL, latest: Node::default() }
    }
}

impl Nodes {
    /// Makes the node after all of `full` the latest, and caches those at its intervals on the way.
    fn advance(&mut self, packed: &Packed, rule: Integrator, full: &[Substep<f64>]) {
        let mut node = self.before(full.len(), &packed.start);
        while node.steps < full.len() {
            let stop = (node.steps / self.interval * self.interval + self.interval).min(full.len());
            packed.roll(Run { rule, substeps: &full[node.steps..stop], steps_before: node.steps }, &mut node.states);
            node.steps = stop;
            if stop.is_multiple_of(self.interval) && self.cached.len() < stop / self.interval {
                self.cache(node.clone());
            }
        }
        self.latest = node;
    }

    /// Keeps a node; every second is dropped where they would be too many.
    fn cache(&mut self, node: Node) {
        self.cached.push(node);
        if self.cached.len() == MOST_NODES {
            self.interval *= 2;
            self.cached.retain(|node| node.steps.is_multiple_of(self.interval));
        }
    }

    /// The nearest node at or before `steps` steps; the latest one is taken out, a cached one or the start copied.
    fn before(&mut self, steps: usize, start: &[StateBlock]) -> Node {
        let cached = &self.cached[..self.cached.len().min(steps / self.interval)];
        let nearest = cached.last().map_or(0, |n| n.steps);
        if self.latest.steps > nearest && self.latest.steps <= steps {
            return std::mem::take(&mut self.latest);
        }
        cached.last().cloned().unwrap_or_else(|| Node { steps: 0, states: start.to_vec() })
    }
}

/// Particles that are integrated in steps.
#[derive(Clone, Debug, Default)]
struct Stepped {
    packed: Packed,
    /// Nodes after the start, and before it.
    nodes: [Nodes; 2],
}

impl Stepped {
    fn new(rows: Vec<u32>, motions: &[Motion<f32>], start: &Poses, origin: Vec3) -> Self {
        Self { packed: Packed::new(rows, motions, start, origin), nodes: Default::default() }
    }

    /// Writes the poses of its particles `tau` after `start` to their rows of `now`.
    fn advance(&mut self, rollout: &Rollout, tau: f64, start: &Poses, now: &mut Poses) {
        let substeps = rollout.substeps([0.0, tau]);
        let Some((last, full)) = substeps.split_last() else { return };
        if self.packed.rows.is_empty() {
            return;
        }
        let nodes = &mut self.nodes[usize::from(tau < 0.0)];
        nodes.advance(&self.packed, rollout.rule, full);
        let run = Run { rule: rollout.rule, substeps: std::slice::from_ref(last), steps_before: full.len() };
        self.packed.place(run, &nodes.latest.states, start, now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::truth;
    use gs_core::Rng;

    fn particles(n: usize) -> (Vec<Motion<f32>>, Poses) {
        let mut rng = Rng::new(1, "extrapolate", 0, 0);
        let motions = (0..n).map(|_| Motion::from_array(std::array::from_fn(|_| rng.normal()))).collect();
        let means = (0..n).map(|_| Vec3::new(rng.normal(), rng.normal(), rng.normal())).collect();
        (motions, Poses { means, quats: vec![[1.0, 0.0, 0.0, 0.0]; n] })
    }

    /// Asks for these times in order, of `n` particles, and asserts the bits of a fresh roll-out to each.
    fn asked(n: usize, times: &[f64]) -> Extrapolator {
        let rollout = Rollout { rule: Integrator::Se3Mid, dt: 1.0 / 90.0, origin: Vec3::new(0.3, 0.0, -0.2) };
        let (motions, start) = particles(n);
        let (means, quats) = (start.means.clone(), start.quats.clone());
        let mut asked = Extrapolator::new(rollout, 0.7, motions.clone(), means, quats).unwrap();
        for &t in times {
            let (mut means, mut quats) = (start.means.clone(), start.quats.clone());
            rollout.advance(&motions, [0.0, t - 0.7], &mut means, &mut quats);
            let got = asked.at(t);
            assert!(got.0 == means && got.1 == quats, "{t}");
        }
        asked
    }

    #[test]
    fn any_time_in_any_order_has_the_bits_of_a_fresh_roll_out() {
        // Past the 64th step, where quaternions are normalised; back; before the start; the start itself.
        let times =
            [0.705, 0.9, 0.75, 1.5, 1.51, 1.2, 0.7, -0.2, 0.1, 1.5, 0.7 + 8.0 / 90.0, 0.7 + 72.0 / 90.0, 0.6999];
        // 72 steps ahead and 81 back: ten and ten cached nodes at most.
        assert!(asked(1100, &times).stepped.nodes.iter().all(|n| (9..=10).contains(&n.cached.len())));
    }

    /// 2007 steps ahead and 1953 back: the spacing of nodes doubles twice, from 8 to 32 steps.
    #[test]
    fn far_times_keep_few_nodes() {
        let far = asked(9, &[23.0, 5.0, 22.9, 14.3, -21.0, -3.0, 23.1, 0.9]);
        let kept = far.stepped.nodes.each_ref().map(|n| (n.interval, n.cached.len()));
        assert!(kept.iter().all(|(interval, nodes)| *interval == 32 && (60..MOST_NODES).contains(nodes)), "{kept:?}");
    }

    /// Particles of every class and of two rigid groups: reduced answers are off by no more than the tolerance (and the
    /// integrator's own error), particles that take steps keep their bits, and beyond the horizon all do.
    #[test]
    fn reductions_stay_within_their_tolerance() {
        let n = 1200;
        let (mut motions, start) = particles(n);
        for (i, m) in motions.iter_mut().enumerate() {
            match i % 6 {
                0 => *m = Motion::default(),
                1 => *m = Motion { twist: m.twist, ..Motion::default() },
                2 => (m.twist.w, m.rate.w, m.jerk.w) = ([0.0; 3], [0.0; 3], [0.0; 3]),
                3 => (m.rate, m.jerk) = (m.twist.scaled(0.5), m.twist.scaled(-0.2)),
                4 => *m = truth::wheel().motion.to_f32(),
                _ => {}
            }
        }
        let labels: Vec<u32> = (0..n).map(|i| if i % 6 == 4 { (i / 600) as u32 } else { UNGROUPED }).collect();
        let rollout = Rollout { rule: Integrator::Se3Magnus4, dt: 1.0 / 60.0, origin: Vec3::ZERO };
        let (rule, reach) = (ClassRule { tolerance: 1e-4, horizon: 0.8 }, vec![0.02; n]);
        let groups = Groups::fit(&rule, &labels, &motions, &start.means, rollout.origin, &reach).unwrap();
        let plain = Extrapolator::new(rollout, 0.0, motions, start.means.clone(), start.quats.clone()).unwrap();
        let mut reduced = plain.clone().reduce(&rule, &reach, Some(groups)).unwrap();
        let mut plain = plain;
        assert_eq!(reduced.counts(), Counts { grouped: 200, classes: [200, 200, 200, 200, 200] });
        assert_eq!(plain.counts().classes, [0, 0, 0, 0, n]);
        for t in [0.0, 0.33, 0.8, 0.0, -0.6, 0.9, 0.2, 0.0] {
            let (got, want) = (reduced.at(t), plain.at(t));
            let far = |i: &usize| (got.0[*i] - want.0[*i]).length();
            let worst = (0..n).map(|i| far(&i)).fold(0.0, f32::max);
            assert!(worst <= 1e-4, "{t}: {worst}");
            let turned = (0..n).map(|i| (0..4).map(|c| got.1[i][c] * want.1[i][c]).sum::<f32>().abs());
            assert!(turned.fold(1.0, f32::min) > 1.0 - 1e-5, "{t}");
            let same = |i: usize| got.0[i] == want.0[i] && got.1[i] == want.1[i];
            assert!((0..n).all(|i| same(i) || (t != 0.9 && t != 0.0 && i % 6 != 0 && i % 6 != 5)), "{t}");
        }
    }

    #[test]
    fn rows_must_match() {
        let rollout = Rollout { rule: Integrator::Rk2, dt: 0.1, origin: Vec3::ZERO };
        let error = Extrapolator::new(rollout, 0.0, vec![Motion::default()], vec![Vec3::ZERO; 2], vec![]).unwrap_err();
        assert_eq!(error, RowsError { what: "motions", got: 1, want: 2 });
    }
}
