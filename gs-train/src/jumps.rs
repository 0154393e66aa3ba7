//! How far splats jump on the screen at times where what moves them changes: a scene moves steadily, so a jump is an error of the
//! motion, and is seen as a jerk.

use crate::method::MethodError;
use crate::model::Model;
use crate::timestamp::Timestamp;
use glam::DVec2;
use gs_core::{Camera, Splats};

/// Half the time between before and after, normalised.
const HALF: f32 = 1e-4;
/// Splats below this opacity do not count.
const INVISIBLE: f32 = 1.0 / 255.0;

/// The jump of the splats in a frame at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jump {
    /// Normalised time.
    pub t: f32,
    /// Mean distance over the splats in the frame, weighted by opacity, pixels.
    pub mean: f64,
    /// The distance that a hundredth of the splats in the frame exceed, pixels.
    pub most: f64,
}

/// The jumps at the borders that a method has ([`Inspect::borders`](crate::capabilities::Inspect::borders)), as `camera` sees them.
/// Borders at which no splat is in the frame are left out.
///
/// # Errors
/// If the method cannot give its splats.
pub fn jumps(method: &Model, camera: &Camera) -> Result<Vec<Jump>, MethodError> {
    let borders = method.capabilities().inspect.map_or_else(Vec::new, |i| i.borders());
    let at = |t: f32| method.all_splats(&Timestamp::normalised(t), camera);
    let jump = |t: f32| Ok(Jump::between(t, &at(t - HALF)?, &at(t + HALF)?, camera));
    let all: Result<Vec<Option<Jump>>, MethodError> = borders.into_iter().map(jump).collect();
    Ok(all?.into_iter().flatten().collect())
}

impl Jump {
    /// Between two states of the same splats.
    fn between(t: f32, before: &Splats, after: &Splats, camera: &Camera) -> Option<Self> {
        let pixel = |s: &Splats, i: usize| {
            let p = camera.to_camera(s.means[i].as_dvec3());
            (p.z > 0.0).then(|| camera.to_pixel(p))
        };
        let size = DVec2::new(f64::from(camera.width), f64::from(camera.height));
        let inside = |p: DVec2| p.cmpge(DVec2::ZERO).all() && p.cmplt(size).all();
        let (mut ways, mut sum, mut weight) = (Vec::new(), 0.0, 0.0);
        for i in 0..before.len().min(after.len()) {
            let opacity = before.opacities[i].max(after.opacities[i]);
            let Some((a, b)) =
                pixel(before, i).zip(pixel(after, i)).filter(|(a, _)| opacity >= INVISIBLE && inside(*a))
            else {
                continue;
            };
            let way = a.distance(b);
            (sum, weight) = (sum + f64::from(opacity) * way, weight + f64::from(opacity));
            ways.push(way);
        }
        ways.sort_by(f64::total_cmp);
        let most = *ways.get(ways.len().saturating_sub(1) * 99 / 100)?;
        Some(Self { t, mean: sum / weight, most })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DVec3, Vec3};

    #[test]
    fn a_jump_is_measured_where_splats_are_seen() {
        let camera = Camera::look_at(100, 100, 1.0, DVec3::Z * -5.0, DVec3::ZERO, DVec3::Y).expect("camera");
        let splats = |x: f32| Splats {
            means: vec![Vec3::new(x, 0.0, 0.0), Vec3::ZERO, Vec3::new(9.0 * x, 0.0, 0.0), Vec3::splat(1e3)],
            opacities: vec![0.5, 0.5, 1e-3, 1.0],
            ..Splats::default()
        };
        let jump = Jump::between(0.5, &splats(0.0), &splats(0.1), &camera).expect("two splats are seen");
        let pixels = camera.fx * 0.1 / 5.0;
        assert!((jump.mean - 0.5 * pixels).abs() < 1e-5 && jump.t == 0.5, "{jump:?} {pixels}");
        assert_eq!(Jump::between(0.5, &splats(0.0), &splats(0.0), &camera).expect("seen").most, 0.0);
        assert_eq!(Jump::between(0.5, &Splats::default(), &Splats::default(), &camera), None);
    }
}
