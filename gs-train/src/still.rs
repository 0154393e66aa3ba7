//! Splats that hardly move: found by probing a deformation over time, and left at one pose in rendering, or left out of the field
//! while [`training`]. An approximation, used only where it is asked for.
//!
//! ```text
//! pose = half-way between the smallest and the largest value of means, quats and scales over the probe times
//! ```
//! A splat is static if its centre stays within `pixels` of its pose on every camera's screen (where it comes nearest), and
//! its shape within a share ε, `max |s − s̄| ≤ ε max |s|` and `2 ‖q − q̄‖ ≤ ε ‖q‖`, at the probe times and half-way between
//! them. What happens at other times is not known.

pub mod decisions;
mod pull;
pub mod training;

use crate::capabilities::{FreezeOptions, FreezeReport};
use glam::{Vec3, Vec4};
use gs_core::{Camera, Geometry, GeometryRef, Time};
use rayon::prelude::*;

/// The static splats of a scene and their poses.
#[derive(Clone, Debug)]
pub struct Still {
    pose: Geometry,
    moving: Vec<u32>,
}

impl Still {
    /// Probes a deformation, which writes the geometry of all `n` splats at a time. `None` if all of them move.
    pub fn find(
        n: usize,
        options: &FreezeOptions<'_>,
        mut probe: impl FnMut(Time, &mut Geometry),
    ) -> Option<(Self, FreezeReport)> {
        let (mut low, mut high, mut moved) = <(Geometry, Geometry, Geometry)>::default();
        for (p, t) in probe_times(options.probes).enumerate() {
            probe(t, &mut moved);
            if p == 0 {
                (low, high) = (moved.clone(), moved.clone());
            }
            fold(&mut low, &moved, f32::min);
            fold(&mut high, &moved, f32::max);
        }
        fold(&mut low, &high, |a, b| 0.5 * (a + b));
        let pose = low;
        let look = |t: Time, _: Option<&Camera>, worst: &mut [Worst]| {
            probe(t, &mut moved);
            for (row, worst) in worst.iter_mut().enumerate() {
                let [(mean, shape), (pose_mean, pose_shape)] =
                    [&moved, &pose].map(|g| (g.means[row], (g.scales[row], g.quats[row])));
                worst.see_mean(mean, pose_mean);
                worst.see_shape(shape, pose_shape);
            }
        };
        let (still, report) = judge(n, options, |row| pose.means[row], look);
        let moving: Vec<u32> = (0..n).filter(|&row| !still[row]).map(|row| row as u32).collect();
        (report.still > 0).then_some((Self { pose, moving }, report))
    }

    /// Writes the geometry of all splats: static ones in their pose, the others as `deform` moves these rows of `canonical`.
    pub fn forward(
        &self,
        canonical: GeometryRef<'_>,
        deform: impl FnOnce(GeometryRef<'_>, &mut Geometry),
        out: &mut Geometry,
    ) {
        let mut moved = Geometry::default();
        deform(canonical.pick(&self.moving).view(), &mut moved);
        out.clone_from(&self.pose);
        out.scatter(&moved, &self.moving);
    }
}

/// Combines two geometries of equal length, value by value.
fn fold(to: &mut Geometry, from: &Geometry, f: impl Fn(f32, f32) -> f32) {
    let vec3 = |a: &mut Vec3, b: &Vec3| *a = Vec3::new(f(a.x, b.x), f(a.y, b.y), f(a.z, b.z));
    to.means.iter_mut().zip(&from.means).for_each(|(a, b)| vec3(a, b));
    to.scales.iter_mut().zip(&from.scales).for_each(|(a, b)| vec3(a, b));
    to.quats.as_flattened_mut().iter_mut().zip(from.quats.as_flattened()).for_each(|(a, b)| *a = f(*a, *b));
}

/// The times at which motion is probed, from 0 to 1: so many, at least 2.
pub fn probe_times(probes: usize) -> impl Iterator<Item = Time> {
    let gaps = probes.max(2) - 1;
    (0..=gaps).map(move |p| time(2 * p, gaps))
}

/// So many half gaps after the first probe.
fn time(halves: usize, gaps: usize) -> Time {
    let normalised = halves as f32 / (2 * gaps) as f32;
    Time { normalised, seconds: f64::from(normalised) }
}

/// How far a row was found from its pose.
#[derive(Clone, Copy, Debug, Default)]
pub struct Worst {
    /// World units.
    moved: f32,
    /// A share; none where the shape was never seen.
    shape: Option<f32>,
}

impl Worst {
    /// Enters where its centre is.
    pub fn see_mean(&mut self, exact: Vec3, pose: Vec3) {
        self.moved = self.moved.max(exact.distance(pose));
    }

    /// Enters its scales and rotation.
    pub fn see_shape(&mut self, exact: (Vec3, [f32; 4]), pose: (Vec3, [f32; 4])) {
        self.shape = Some(self.shape.unwrap_or(0.0).max(shape_change(exact, pose)));
    }
}

/// Which of `n` rows stay within the tolerances at the probe times and half-way between them, and the report of it, no anchors counted.
/// `look` enters how far all rows are from their poses at a time, shapes as one of the cameras sees them; `center` is where the
/// pose of a row is. A row whose shape is never seen is not static.
pub fn judge(
    n: usize,
    options: &FreezeOptions<'_>,
    center: impl Fn(usize) -> Vec3 + Sync,
    mut look: impl FnMut(Time, Option<&Camera>, &mut [Worst]),
) -> (Vec<bool>, FreezeReport) {
    let FreezeOptions { pixels, probes, cameras, shape, .. } = *options;
    let gaps = probes.max(2) - 1;
    let mut worst = vec![Worst::default(); n];
    let mut look_at = |halves: usize, worst: &mut [Worst]| {
        look(time(halves, gaps), cameras.get(halves * cameras.len() / (2 * gaps + 1)), worst);
    };
    let within = |worst: &[Worst]| -> Vec<Option<[f32; 2]>> {
        let bound = |(row, w): (usize, &Worst)| {
            let (way, change) = (screen_bound(w.moved, center(row), cameras), w.shape?);
            (way <= pixels && change <= shape).then_some([way, change])
        };
        worst.par_iter().enumerate().map(bound).collect()
    };
    (0..=gaps).for_each(|p| look_at(2 * p, &mut worst));
    let first = within(&worst);
    (0..gaps).for_each(|p| look_at(2 * p + 1, &mut worst));
    let found = within(&worst);
    let most = |k: usize| found.iter().flatten().map(|b| b[k]).fold(0.0, f32::max);
    let report = FreezeReport {
        splats: n,
        still: found.iter().flatten().count(),
        bound_pixels: most(0),
        probes: gaps + 1,
        shape: most(1),
        between: first.iter().zip(&found).filter(|(first, found)| first.is_some() && found.is_none()).count(),
        anchors: 0,
    };
    (found.iter().map(Option::is_some).collect(), report)
}

/// The larger of `max |s − s̄| / max |s|` and `2 ‖q − q̄‖ / ‖q‖`.
fn shape_change(exact: (Vec3, [f32; 4]), pose: (Vec3, [f32; 4])) -> f32 {
    let size = |v: Vec3| v.abs().max_element();
    let [q, r] = [exact.1, pose.1].map(Vec4::from_array);
    let scale = size(exact.0 - pose.0) / size(exact.0).max(f32::MIN_POSITIVE);
    scale.max(2.0 * (q - r).length() / q.length().max(f32::MIN_POSITIVE))
}

/// Bound on the screen displacement, pixels, of a point within `moved` (world units) of `mean`: the largest over all cameras. 0 if
/// it does not move; infinite without cameras or if the point may cross a camera's plane `z = 0`. Cameras that it stays behind do
/// not count.
/// ```text
/// pixels ≤ f / (z − δ) · (1 + tan(fov/2)) · δ
/// ```
pub fn screen_bound(moved: f32, mean: Vec3, cameras: &[Camera]) -> f32 {
    if moved == 0.0 {
        return 0.0;
    }
    if cameras.is_empty() {
        return f32::INFINITY;
    }
    let moved = f64::from(moved);
    cameras.iter().fold(0.0f32, |largest, c| {
        let depth = (c.rotation * mean.as_dvec3() + c.translation).z;
        if depth + moved <= 0.0 {
            return largest; // behind the camera wherever it goes
        }
        if depth - moved <= 0.0 {
            return f32::INFINITY;
        }
        let (width, height) = (f64::from(c.width), f64::from(c.height));
        let tan = (c.cx.max(width - c.cx) / c.fx).max(c.cy.max(height - c.cy) / c.fy);
        largest.max((c.fx.max(c.fy) / (depth - moved) * (1.0 + tan) * moved) as f32)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera::look_at(200, 160, 0.8, glam::DVec3::Z * 4.0, glam::DVec3::ZERO, glam::DVec3::Y).unwrap()
    }

    /// Row `i` swings by `i` hundredths of a world unit; the last one only between the probe times.
    fn swing(t: Time, moved: &mut Geometry) {
        *moved = Geometry { quats: vec![[1.0, 0.0, 0.0, 0.0]; 6], scales: vec![Vec3::ONE; 6], ..Geometry::zeros(6) };
        let phase = std::f32::consts::TAU * t.normalised;
        for i in 0..5 {
            moved.means[i].x = 0.01 * i as f32 * phase.sin();
        }
        moved.means[5].y = (4.0 * phase).sin();
    }

    #[test]
    fn what_moves_least_rests_first_and_stays_within_its_bound() {
        let cameras = [camera()];
        let mut counts = Vec::new();
        for pixels in [0.0, 1.0, 5.0, 100.0] {
            let options = FreezeOptions { pixels, probes: 9, ..FreezeOptions::usual(&cameras) };
            let (still, report) = Still::find(6, &options, swing).unwrap();
            assert!(report.bound_pixels <= pixels && (report.between == 1 || pixels == 0.0), "{report:?}");
            let (mut out, mut exact) = <(Geometry, Geometry)>::default();
            for step in 0..=16 {
                let t = Time::new(step as f32 / 16.0).unwrap();
                swing(t, &mut exact);
                let picked = |_: GeometryRef<'_>, to: &mut Geometry| *to = exact.view().pick(&still.moving);
                still.forward(exact.view(), picked, &mut out);
                for (a, b) in out.means.iter().zip(&exact.means) {
                    let pixel = |m: &Vec3| {
                        let p = cameras[0].rotation * m.as_dvec3() + cameras[0].translation;
                        glam::DVec2::new(cameras[0].fx * p.x / p.z, cameras[0].fy * p.y / p.z)
                    };
                    assert!(pixel(a).distance(pixel(b)) <= f64::from(pixels) + 1e-4, "{pixels} at {step}");
                }
            }
            counts.push(report.still);
        }
        assert_eq!((counts[0], counts[3]), (1, 5), "{counts:?}");
        assert!(counts.is_sorted() && counts[1] < counts[2], "{counts:?}");
    }

    #[test]
    fn bounds_know_cameras_and_shapes() {
        let c = camera();
        assert_eq!(screen_bound(0.0, Vec3::ZERO, &[]), 0.0);
        assert_eq!(screen_bound(0.1, Vec3::ZERO, &[]), f32::INFINITY);
        assert_eq!(screen_bound(0.1, Vec3::Z * 9.0, std::slice::from_ref(&c)), 0.0, "behind the camera");
        assert_eq!(screen_bound(0.1, Vec3::Z * 4.0, &[c]), f32::INFINITY, "at the camera");
        let q = [1.0, 0.0, 0.0, 0.0];
        assert_eq!(shape_change((Vec3::ONE, q), (Vec3::new(1.0, 1.5, 1.0), q)), 0.5);
        assert_eq!(shape_change((Vec3::ONE, q), (Vec3::ONE, [0.5, 0.0, 0.0, 0.0])), 1.0);
    }
}
