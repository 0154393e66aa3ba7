//! Motion and rigidity of each part.

use glam::DVec3;
use gs_core::cast;
use gs_physics::centre::velocity_pole;
use gs_physics::classes::{ClassRule, rotation_sensitivity};
use gs_physics::groups::Groups;
use serde::Serialize;

use super::Labels;

/// Splats follow their part's motion if it predicts their position to within this share of the scene's radius
const TOLERANCE: f64 = 0.05;
/// Normalised time over which [`TOLERANCE`] must hold.
const HORIZON: f64 = 0.1;

/// Statistics of a part. Velocities are per unit of normalised time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Part {
    /// Id in masks: label + 1.
    pub id: u32,
    /// Number of splats in the part.
    pub splats: usize,
    /// Their share of all opacity.
    pub share: f64,
    /// Share of its splats that are static.
    pub resting: f64,
    /// Root mean square speed of its splats, world units.
    pub speed: f64,
    /// Spin `|w|` of the shared twist, radians.
    pub spin: f64,
    /// Advance along the axis per radian, world units (0: a pure rotation); absent without spin.
    pub pitch: Option<f64>,
    /// The point of the axis nearest to the origin of twists, world units; absent without spin.
    pub axis_at: Option<[f64; 3]>,
    /// The shared twist about the origin of twists: `v`, then `w`.
    pub twist: [[f64; 3]; 2],
    /// Number of splats whose position the shared motion predicts to within 5 % of the scene's radius over a tenth of the
    /// span.
    pub followers: usize,
    /// Root mean square residual of followers' velocities against the shared twist, world units.
    pub residual: f64,
}

/// Statistics of all parts, in the order of labels.
pub fn table(labels: &Labels) -> Vec<Part> {
    let p = &labels.particles;
    let rule = ClassRule { tolerance: TOLERANCE * f64::from(labels.radius), horizon: HORIZON };
    let sensitivity: Vec<f32> = p.splats.scales.iter().map(|s| rotation_sensitivity(*s)).collect();
    let Ok(groups) = Groups::fit(&rule, &labels.of, &p.motions, &p.splats.means, p.origin, &sensitivity) else {
        return Vec::new();
    };
    let opacity: f64 = p.splats.opacities.iter().map(|o| f64::from(*o)).sum();
    let row = |id: u32| {
        let members: Vec<usize> = (0..labels.of.len()).filter(|i| labels.of[*i] == id).collect();
        let count = members.len().max(1) as f64;
        let share: f64 = members.iter().map(|i| f64::from(p.splats.opacities[*i])).sum();
        let square: f64 = members.iter().map(|i| speed_squared(labels, *i)).sum();
        let group = groups.list.get(id as usize);
        let twist = group.map(|g| g.motion.twist).unwrap_or_default();
        let (v, w) = (DVec3::from(twist.v), DVec3::from(twist.w));
        let spins = w.length() * HORIZON > 1e-3;
        let pole = || (DVec3::from(velocity_pole(&twist)) + p.origin.as_dvec3()).to_array();
        Part {
            id: id + 1,
            splats: members.len(),
            share: share / opacity.max(f64::MIN_POSITIVE),
            resting: members.iter().filter(|i| labels.resting[**i]).count() as f64 / count,
            speed: (square / count).sqrt(),
            spin: w.length(),
            pitch: spins.then(|| w.dot(v) / w.length_squared()),
            axis_at: spins.then(pole),
            twist: [twist.v, twist.w],
            followers: group.map_or(0, |g| g.members),
            residual: group.map_or(0.0, |g| g.residual),
        }
    };
    (0..cast::to_u32(labels.k)).map(row).collect()
}

/// `|v + w × (x − o)|²`.
fn speed_squared(labels: &Labels, i: usize) -> f64 {
    let p = &labels.particles;
    let x = (p.splats.means[i] - p.origin).as_dvec3().to_array();
    DVec3::from(p.motions[i].to_f64().twist.velocity(x)).length_squared()
}
