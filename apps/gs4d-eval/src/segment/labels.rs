//! A part label for every splat, by clustering of motions.

use glam::Vec3;
use gs_core::cast;
use gs_physics::segment::{
    Feature, FeatureOptions, KMeansOptions, MergeOptions, Ogc, OgcOptions, features, kmeans, merged,
};
use gs_physics::{Motion, Twist};
use serde::Serialize;

use super::SegmentError;
use crate::particles::Particles;
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::timestamp::Timestamp;
use gs4d_report::needs::neutral_camera;

/// How many parts the splats are grouped into.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Count {
    /// At most this many, 1 or more.
    Fixed(usize),
    /// As many as do not share a twist ([`gs_physics::segment`]): clusters with one are merged.
    Auto,
}

/// Number of K-means clusters before merging.
const INITIAL_CLUSTERS: usize = 16;
/// Number of OGC objects before merging (published: 8).
const INITIAL_OBJECTS: usize = 8;

/// How splats are grouped into parts by their motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// How many parts there are.
    pub count: Count,
    /// What parts are told by; `None`: by twists where every particle has a lasting one of its own, else by paths, as TRACE compares
    /// itself with fields.
    pub by: Option<Source>,
    /// Feature vector by which twists are compared.
    pub feature: Feature,
    /// Normalised time at which motions are compared; `None`: the time of the model's particles, or `observed`.
    pub at: Option<f32>,
    /// Last training time, normalised: no motion after it was seen.
    pub observed: f32,
    /// Displacement below which a splat is static, as a share of the scene's radius.
    pub static_path: f32,
    /// Weight `β` of positions (over the scene's radius) in the features; 0 leaves them out.
    pub positions: f32,
    /// Number of times at which paths are sampled, at least 2, from 0 to `observed`, or to `at` if that is later.
    pub moments: usize,
    /// Seed of the random numbers.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            count: Count::Auto,
            by: None,
            feature: Feature::Polar,
            at: None,
            observed: 1.0,
            static_path: 0.01,
            positions: 0.0,
            moments: 16,
            seed: 0,
        }
    }
}

impl Options {
    /// What parts of a model with these particles are found by.
    pub fn source(&self, learnt: Option<&Particles>) -> Source {
        let twists = learnt.is_some_and(|p| p.lasting);
        self.by.unwrap_or(if twists { Source::Twists } else { Source::Paths })
    }
}

/// The motion that labels are computed from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Source {
    /// Learnt twists of the model's particles.
    Twists,
    /// Paths of the splats' means.
    Paths,
}

/// A label per splat of [`Model::all_splats`].
#[derive(Clone, Debug, PartialEq)]
pub struct Labels {
    /// The part of each splat, `0 …`, heaviest (by opacity) first.
    pub of: Vec<u32>,
    /// Number of parts; labels are below it.
    pub k: usize,
    /// The motion they were computed from.
    pub source: Source,
    /// The splats at [`Options::at`] and their motions; for [`Source::Paths`] translations at their velocity there.
    pub particles: Particles,
    /// Whether each splat is static.
    pub resting: Vec<bool>,
    /// Root mean square distance of the splats from the origin of twists, by opacity, world units.
    pub radius: f32,
    /// For [`Count::Auto`]: velocity difference of each merged pair, and of the next pair, which was not merged.
    pub distances: (Vec<f64>, Option<f64>),
}

/// Labels the splats of a model.
///
/// # Errors
/// If their number changes over time, there are none, their paths are not finite, or twists are asked for that are not learnt.
pub fn segment(method: &Model, options: &Options) -> Result<Labels, SegmentError> {
    let camera = neutral_camera();
    let no_paths = || SegmentError::NoPaths(method.name().to_owned());
    let learnt = Particles::of(method);
    let at = options.at.unwrap_or_else(|| learnt.as_ref().map_or(options.observed, |p| cast::to_f32(p.at)));
    let steps = options.moments.max(2);
    let end = at.max(options.observed);
    let times: Vec<f32> = (0..steps).map(|k| end * k as f32 / (steps - 1) as f32).collect();
    let means = |t: &f32| Ok(method.all_splats(&Timestamp::normalised(*t), &camera)?.means);
    let frames = times.iter().map(means).collect::<Result<Vec<Vec<Vec3>>, MethodError>>()?;
    let lasting = frames.iter().all(|f| f.len() == frames[0].len()) && !frames[0].is_empty();
    if !lasting || learnt.as_ref().is_some_and(|p| p.motions.len() != frames[0].len()) {
        return Err(no_paths());
    }
    let splats = method.all_splats(&Timestamp::normalised(at), &camera)?;
    if options.source(learnt.as_ref()) == Source::Twists {
        let p = learnt.ok_or_else(|| SegmentError::NoTwists(method.name().to_owned()))?;
        let motions = if options.at.is_some() { p.motions_at(method, at.into()) } else { p.motions.clone() };
        let particles = Particles { at: at.into(), splats, motions, ..p };
        let resting = at_rest(&frames, options.static_path * radius(&particles));
        return Ok(of_particles(particles, resting, options));
    }
    let motions = velocities(method, at, end)?;
    let origin = centre(&splats.means, &splats.opacities);
    let particles = Particles { at: at.into(), splats, motions, origin, lasting: false };
    let resting = at_rest(&frames, options.static_path * radius(&particles));
    of_paths(particles, resting, &frames, options).ok_or_else(no_paths)
}

/// Labels particles by their twists; `resting` has one entry per particle.
pub fn of_particles(particles: Particles, resting: Vec<bool>, options: &Options) -> Labels {
    let radius = radius(&particles);
    let Particles { splats, motions, .. } = &particles;
    let places: Vec<Vec3> = splats.means.iter().map(|x| (*x - particles.origin) / radius).collect();
    let wanted = FeatureOptions {
        feature: options.feature,
        normalise: true,
        resting: Some(&resting),
        positions: (options.positions > 0.0).then_some((options.positions, &places[..])),
        radius,
    };
    let (rows, width) = features(motions, &wanted);
    let k = if let Count::Fixed(k) = options.count { k.max(1) } else { INITIAL_CLUSTERS };
    let clusters = KMeansOptions { k, seed: options.seed, ..KMeansOptions::default() };
    let found = kmeans(&rows, width, Some(&splats.opacities), &clusters);
    finish(particles, resting, radius, Source::Twists, (found.labels, found.k), options)
}

/// Labels particles by their paths; `None` if those are not finite.
fn of_paths(particles: Particles, resting: Vec<bool>, frames: &[Vec<Vec3>], options: &Options) -> Option<Labels> {
    let k = if let Count::Fixed(k) = options.count { k.max(1) } else { INITIAL_OBJECTS };
    let found = Ogc::learn(frames, &OgcOptions { k, seed: options.seed, ..OgcOptions::default() })?;
    let radius = radius(&particles);
    Some(finish(particles, resting, radius, Source::Paths, (found.labels, found.k), options))
}

/// Merges clusters that share a twist, for [`Count::Auto`].
fn finish(
    particles: Particles,
    resting: Vec<bool>,
    radius: f32,
    source: Source,
    (of, k): (Vec<u32>, usize),
    options: &Options,
) -> Labels {
    let plain = Labels { of, k, source, particles, resting, radius, distances: (Vec::new(), None) };
    if options.count != Count::Auto {
        return plain;
    }
    let Particles { splats, motions, origin, .. } = &plain.particles;
    let still: Vec<Motion<f32>> =
        motions.iter().zip(&plain.resting).map(|(m, rests)| if *rests { Motion::default() } else { *m }).collect();
    let weights = Some(&splats.opacities[..]);
    let bodies = merged(&splats.means, &still, *origin, weights, (&plain.of, plain.k), &MergeOptions::default());
    let distances = (bodies.distances, bodies.next);
    Labels { of: bodies.labels, k: bodies.bodies.len(), distances, ..plain }
}

/// Opacity-weighted root mean square distance of particles from the origin of twists.
pub(super) fn radius(particles: &Particles) -> f32 {
    gs_physics::segment::radius(&particles.splats.means, particles.origin, Some(&particles.splats.opacities))
}

/// Weighted centroid.
fn centre(points: &[Vec3], weights: &[f32]) -> Vec3 {
    let sum: glam::DVec3 = points.iter().zip(weights).map(|(x, w)| x.as_dvec3() * f64::from(*w)).sum();
    let weight: f64 = weights.iter().map(|w| f64::from(*w)).sum();
    (sum / weight.max(f64::MIN_POSITIVE)).as_vec3()
}

/// Whether each splat stays within `radius` of its first position.
fn at_rest(frames: &[Vec<Vec3>], radius: f32) -> Vec<bool> {
    let near = |i: usize| frames.iter().all(|f| f[i].distance(frames[0][i]) < radius);
    (0..frames[0].len()).map(near).collect()
}

/// The velocity of every splat as a motion, by differences over a hundredth of the span, at its borders 0 and `end` over half as
/// much: a method need not move splats beyond them.
fn velocities(method: &Model, at: f32, end: f32) -> Result<Vec<Motion<f32>>, MethodError> {
    const STEP: f32 = 0.005;
    let from = (at - STEP).max(at.min(0.0));
    let to = (at + STEP).min(end.max(from + STEP));
    let camera = neutral_camera();
    let means = |t| method.all_splats(&Timestamp::normalised(t), &camera).map(|s| s.means);
    let (before, after) = (means(from)?, means(to)?);
    let motion = |(b, a): (&Vec3, &Vec3)| {
        let v = ((*a - *b) / (to - from)).to_array();
        Motion { twist: Twist { v, w: [0.0; 3] }, ..Motion::default() }
    };
    Ok(before.iter().zip(&after).map(motion).collect())
}
