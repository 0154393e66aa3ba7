//! The rigid bodies of a scene, each with its path, and the particles that follow them.

use super::{Body, Tracks};
use crate::groups::UNGROUPED;
use crate::segment::{FeatureOptions, KMeansOptions, MergeOptions, features, kmeans, merged, radius};
use crate::twist::Motion;
use glam::{DVec3, Vec3};
use gs_core::cast;
use rayon::prelude::*;

/// Clusters of twists before those of one body are merged.
const CLUSTERS: usize = 16;
/// Twists that differ by this share of the usual speed are of one body: what is learnt of its parts is no better than this.
const ALIKE: f64 = 0.2;
/// Fewest particles of a body.
const FEWEST: usize = 8;
/// Fits of all bodies, each after particles were told apart by the one before.
const ROUNDS: usize = 2;
/// A particle follows a body if its velocities are off by no more than this times what is usual in that body.
const USUAL: f64 = 6.0;
/// Particles of a rigid body disagree with their common twist by less than this share of their speed.
const RIGID: f64 = 0.15;
/// Those of a slow body, by less than this share of the speed of the fastest body.
const STILL: f64 = 0.08;
/// Particles that went less far than this share of the scene's radius are at rest.
const REST: f32 = 0.01;

/// Rigid bodies and the particles that follow them.
#[derive(Clone, Debug, Default)]
pub struct Bodies {
    /// The bodies.
    pub list: Vec<Body>,
    /// Index into `list` for every particle, or [`UNGROUPED`] for those that go their own way.
    pub of: Vec<u32>,
}

impl Bodies {
    /// Finds bodies by the twists that particles have at the latest time, and fits a path to each. A particle follows the body that
    /// explains its velocities best, if it is no more off than others of that body are. `weights` (opacities): one per particle.
    pub fn fit(tracks: &Tracks, weights: &[f32]) -> Self {
        let n = weights.len();
        let mut bodies = Self { list: Vec::new(), of: vec![UNGROUPED; n] };
        let rows = tracks.means.iter().map(Vec::len).chain(tracks.motions.iter().map(Vec::len));
        if n == 0 || tracks.taus.is_empty() || rows.into_iter().any(|m| m != n) {
            return bodies;
        }
        let mut of = labels(tracks, weights);
        for _ in 0..ROUNDS {
            let count = of.iter().filter(|l| **l != UNGROUPED).max().map_or(0, |l| *l as usize + 1);
            let members = |label: usize| (0..n).filter(|i| of[*i] as usize == label).collect::<Vec<_>>();
            let all = (0..count).into_par_iter().map(members).filter(|m| m.len() >= FEWEST);
            bodies.list = all.filter_map(|m| Body::fit(tracks, &m, weights)).collect();
            let fastest = bodies.list.iter().map(|b| b.speed).fold(0.0, f64::max);
            bodies.list.retain(|b| b.disagreement <= (RIGID * b.speed).max(STILL * fastest));
            of = bodies.assign(tracks);
        }
        bodies.of = of;
        bodies
    }

    /// Number of particles that follow a body.
    pub fn members(&self) -> usize {
        self.of.iter().filter(|l| **l != UNGROUPED).count()
    }

    /// Gives members the motion of their body about `origin`.
    pub fn apply(&self, origin: Vec3, motions: &mut [Motion<f32>]) {
        let shared: Vec<_> = self.list.iter().map(|b| b.motion(origin.as_dvec3()).to_f32()).collect();
        for (motion, label) in motions.iter_mut().zip(&self.of) {
            *motion = shared.get(*label as usize).copied().unwrap_or(*motion);
        }
    }

    /// The body that explains the velocities of each particle best.
    fn assign(&self, tracks: &Tracks) -> Vec<u32> {
        let origin = tracks.origin.as_dvec3();
        let motions: Vec<_> = self.list.iter().map(|b| b.motion(origin)).collect();
        let row = |i: usize| {
            let share = |(label, body): (usize, &Body)| {
                let off = |k: usize| {
                    let x = (tracks.means[k][i].as_dvec3() - origin).to_array();
                    let [own, shared] = [tracks.motions[k][i].to_f64().twist, motions[label].at(tracks.taus[k])];
                    DVec3::from_array(own.velocity(x)).distance_squared(shared.velocity(x).into())
                };
                let square = (0..body.times).map(off).sum::<f64>() / body.times as f64;
                (square.sqrt(), cast::to_u32(label), body.disagreement)
            };
            let all = self.list.iter().enumerate().map(share).filter(|(off, _, usual)| *off <= USUAL * usual);
            all.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(UNGROUPED, |(_, label, _)| label)
        };
        (0..self.of.len()).into_par_iter().map(row).collect()
    }
}

/// Bodies by the twists of their particles.
fn labels(tracks: &Tracks, weights: &[f32]) -> Vec<u32> {
    let (now, motions) = (&tracks.means[0], &tracks.motions[0]);
    let radius = radius(now, tracks.origin, None);
    let little = (REST * radius).powi(2);
    let resting: Vec<bool> =
        (0..now.len()).map(|i| tracks.means.iter().all(|m| m[i].distance_squared(now[i]) <= little)).collect();
    let options = FeatureOptions { resting: Some(&resting), radius, ..FeatureOptions::default() };
    let (rows, width) = features(motions, &options);
    let found = kmeans(&rows, width, Some(weights), &KMeansOptions { k: CLUSTERS, ..KMeansOptions::default() });
    let clusters = (&found.labels[..], found.k);
    merged(
        now,
        motions,
        tracks.origin,
        Some(weights),
        clusters,
        &MergeOptions { tolerance: ALIKE, ..MergeOptions::default() },
    )
    .labels
}
