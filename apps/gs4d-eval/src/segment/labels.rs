//! A label for every splat.

use glam::Vec3;
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

/// How many parts are sought.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Count {
    /// So many, or fewer if fewer are found.
    Fixed(usize),
    /// As many as do not share a twist ([`gs_physics::segment::choose`]).
    Auto,
}

/// Clusters made before those that share a twist are merged.
const FINE: usize = 16;
/// Objects that OGC begins with where nobody says how many there are (published: 8).
const OBJECTS: usize = 8;

/// How labels are found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// How many parts.
    pub count: Count,
    /// The row of numbers that twists are compared by.
    pub feature: Feature,
    /// The moment, normalised; none: the one that the method's particles are given at, or the last observed one.
    pub at: Option<f32>,
    /// The last time that was learnt from, normalised.
    pub observed: f32,
    /// Splats that never leave a ball of this part of the scene's radius rest.
    pub static_path: f32,
    /// Weight `β` of positions (over the scene's radius) in the features; 0 leaves them out.
    pub positions: f32,
    /// Moments at which paths are looked at, at least 2.
    pub moments: usize,
    /// Seed of every draw.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            count: Count::Auto,
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

/// What labels were made from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Source {
    /// Twists that the method has learnt.
    Twists,
    /// Where splats go.
    Paths,
}

/// A label per splat of [`Method::tracked`].
#[derive(Clone, Debug, PartialEq)]
pub struct Labels {
    /// The part of each splat, `0 …`, heaviest (by opacity) first.
    pub of: Vec<u32>,
    /// Parts there are.
    pub k: usize,
    /// What they were made from.
    pub source: Source,
    /// The splats at the moment, and how they move there; for [`Source::Paths`] each flies straight at its present velocity.
    pub particles: Particles,
    /// Whether each splat rests.
    pub resting: Vec<bool>,
    /// Root mean square distance of the splats from the origin of twists, by opacity, world units.
    pub radius: f32,
    /// [`Count::Auto`]: velocity that parted each pair that was merged, and the pair that was not.
    pub distances: (Vec<f64>, Option<f64>),
}

/// Labels for a method.
///
/// # Errors
/// If its splats are not the same ones at every moment, or there is none.
pub fn segment(method: &Model, options: &Options) -> Result<Labels, SegmentError> {
    let camera = neutral_camera();
    let none = || SegmentError::NoPaths(method.name().to_owned());
    let learnt = Particles::of(method);
    let at = options.at.unwrap_or_else(|| learnt.as_ref().map_or(options.observed, |p| p.at as f32));
    let steps = options.moments.max(2);
    let times: Vec<f32> = (0..steps).map(|k| at * k as f32 / (steps - 1) as f32).collect();
    let means = |t: &f32| Ok(method.all_splats(&Timestamp::normalised(*t), &camera)?.means);
    let frames = times.iter().map(means).collect::<Result<Vec<Vec<Vec3>>, MethodError>>()?;
    let lasting = frames.iter().all(|f| f.len() == frames[0].len()) && !frames[0].is_empty();
    if !lasting || learnt.as_ref().is_some_and(|p| p.motions.len() != frames[0].len()) {
        return Err(none());
    }
    let splats = method.all_splats(&Timestamp::normalised(at), &camera)?;
    if let Some(p) = learnt {
        let later = f64::from(at) - p.at;
        let motions = p.motions.iter().map(|m| m.from(later as f32)).collect();
        let particles = Particles { at: at.into(), splats, motions, ..p };
        let resting = at_rest(&frames, options.static_path * radius(&particles));
        return Ok(of_particles(particles, resting, options));
    }
    let motions = straight(method, at)?;
    let origin = centre(&splats.means, &splats.opacities);
    let particles = Particles { at: at.into(), splats, motions, origin };
    let resting = at_rest(&frames, options.static_path * radius(&particles));
    of_paths(particles, resting, &frames, options).ok_or_else(none)
}

/// Labels of particles by their twists; `resting` is as long as they are.
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
    let k = if let Count::Fixed(k) = options.count { k.max(1) } else { FINE };
    let clusters = KMeansOptions { k, seed: options.seed, ..KMeansOptions::default() };
    let found = kmeans(&rows, width, Some(&splats.opacities), &clusters);
    settled(particles, resting, radius, Source::Twists, (found.labels, found.k), options)
}

/// Labels by where splats go; none if their paths are not finite.
fn of_paths(particles: Particles, resting: Vec<bool>, frames: &[Vec<Vec3>], options: &Options) -> Option<Labels> {
    let k = if let Count::Fixed(k) = options.count { k.max(1) } else { OBJECTS };
    let found = Ogc::learn(frames, &OgcOptions { k, seed: options.seed, ..OgcOptions::default() })?;
    let radius = radius(&particles);
    Some(settled(particles, resting, radius, Source::Paths, (found.labels, found.k), options))
}

/// Merges what shares a twist, if the count is free.
fn settled(
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

/// How far particles are from the origin of their twists, by opacity; never 0.
pub(super) fn radius(particles: &Particles) -> f32 {
    let weights = &particles.splats.opacities;
    let far = |x: &Vec3| f64::from(x.distance_squared(particles.origin));
    let sum: f64 = particles.splats.means.iter().zip(weights).map(|(x, w)| far(x) * f64::from(*w)).sum();
    let weight: f64 = weights.iter().map(|w| f64::from(*w)).sum();
    let radius = (sum / weight.max(f64::MIN_POSITIVE)).sqrt() as f32;
    if radius > 0.0 && radius.is_finite() { radius } else { 1.0 }
}

fn centre(points: &[Vec3], weights: &[f32]) -> Vec3 {
    let sum: glam::DVec3 = points.iter().zip(weights).map(|(x, w)| x.as_dvec3() * f64::from(*w)).sum();
    let weight: f64 = weights.iter().map(|w| f64::from(*w)).sum();
    (sum / weight.max(f64::MIN_POSITIVE)).as_vec3()
}

/// Whether each splat stays within `reach` of where it was first.
fn at_rest(frames: &[Vec<Vec3>], reach: f32) -> Vec<bool> {
    let near = |i: usize| frames.iter().all(|f| f[i].distance(frames[0][i]) < reach);
    (0..frames[0].len()).map(near).collect()
}

/// The velocity of every splat at a moment as a motion, by a central difference of a hundredth of the span.
fn straight(method: &Model, at: f32) -> Result<Vec<Motion<f32>>, MethodError> {
    const STEP: f32 = 0.005;
    let camera = neutral_camera();
    let means = |t| method.all_splats(&Timestamp::normalised(t), &camera).map(|s| s.means);
    let (before, after) = (means(at - STEP)?, means(at + STEP)?);
    let motion = |(b, a): (&Vec3, &Vec3)| {
        let v = ((*a - *b) / (2.0 * STEP)).to_array();
        Motion { twist: Twist { v, w: [0.0; 3] }, ..Motion::default() }
    };
    Ok(before.iter().zip(&after).map(motion).collect())
}
