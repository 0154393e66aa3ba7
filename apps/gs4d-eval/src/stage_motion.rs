//! Optical flow between two stages of a model: exact, from its splats, and estimated from their renders.
//!
//! ```text
//! flow(p) = Σ w_i(p) (π(x_i) − π(x̄_i)) / Σ w_i(p)
//! ```
//! with `π` the projection, `x_i` the centre of splat `i` at this stage, `x̄_i` one stage earlier, and `w_i(p)` the weight that
//! splat `i` has in the render at pixel `p`. The rasteriser computes the sums, with displacements for colours.

use glam::{DVec2, DVec3, Vec3};
use gs_core::{Camera, Color, Image, Splats, cast};
use gs_metrics::MetricError;
use gs_metrics::flow::{Flow, farneback};
use serde::{Deserialize, Serialize};

use gs_train::method::MethodError;
use gs_train::renderer::Renderer;

/// The image whose pixels a flow is defined at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Anchor {
    /// The later one: how far the content of a pixel has moved. Masks of the timestamp apply to it.
    #[default]
    Later,
    /// The earlier one: how far the content of a pixel will move.
    Earlier,
}

/// A flow and its coverage.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Displacement from the earlier stage to the later, pixels; 0 where coverage is below [`MIN_COVER`].
    pub flow: Flow,
    /// Accumulated alpha of each pixel, `[H, W]`.
    pub cover: Vec<f32>,
}

/// Least accumulated alpha of a pixel with a flow: that of silhouette edges is unreliable.
pub const MIN_COVER: f32 = 0.5;

impl Motion {
    /// Whether each pixel has a flow.
    pub fn seen(&self) -> Vec<bool> {
        self.cover.iter().map(|&c| c >= MIN_COVER).collect()
    }
}

/// The exact flow of splats from the means `before` to their present ones. Splats that are not in front of the camera at both
/// ends have displacement 0. The background of `renderer` is ignored.
///
/// # Errors
/// As [`Renderer::render`].
pub fn model_motion(
    renderer: &mut Renderer,
    camera: &Camera,
    splats: &Splats,
    before: &[Vec3],
    anchor: Anchor,
) -> Result<Motion, MethodError> {
    let near = renderer.options.near;
    let project = |world: Vec3| -> Option<DVec2> {
        let point = camera.to_camera(DVec3::from(world));
        (point.z > near).then(|| camera.to_pixel(point))
    };
    let moved = |(now, was): (&Vec3, &Vec3)| match project(*now).zip(project(*was)) {
        Some((now, was)) => [cast::to_f32(now.x - was.x), cast::to_f32(now.y - was.y), 1.0],
        None => [0.0, 0.0, 1.0],
    };
    let mut colored = splats.clone();
    colored.color = Color::Rgb(splats.means.iter().zip(before).map(moved).collect());
    if anchor == Anchor::Earlier {
        colored.means.clone_from_slice(before);
    }
    let background = std::mem::take(&mut renderer.options.background);
    let frame = renderer.render(&colored, camera)?;
    let (width, height) = (frame.rgb.width, frame.rgb.height);
    let mut flow = Flow::zeros(width, height);
    let mut cover = Vec::with_capacity(width * height);
    for (k, sum) in frame.rgb.data.chunks_exact(3).enumerate() {
        if sum[2] >= MIN_COVER {
            (flow.u[k], flow.v[k]) = (sum[0] / sum[2], sum[1] / sum[2]);
        }
        cover.push(sum[2]);
    }
    renderer.options.background = background;
    Ok(Motion { flow, cover })
}

/// Farneback's flow between the renders of two stages (RGB in `[0, 1]`), at the pixels of `anchor`.
///
/// # Errors
/// If the images have different sizes, or values that are not finite.
pub fn estimated_motion(earlier: &Image, later: &Image, anchor: Anchor) -> Result<Flow, MetricError> {
    if anchor == Anchor::Earlier {
        return farneback(earlier, later);
    }
    let mut flow = farneback(later, earlier)?;
    flow.u.iter_mut().chain(&mut flow.v).for_each(|d| *d = -*d);
    Ok(flow)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::{Kernel, Rng};
    use gs_metrics::flow::end_point_error;
    use gs_raster::RasterOptions;

    const SIDE: u32 = 96;
    const DEPTH: f32 = 4.0;
    /// Standard deviation of the wall's splats, world units.
    const SIGMA: f32 = 0.05;

    fn camera() -> Camera {
        Camera::look_at(SIDE, SIDE, 0.7, DVec3::new(0.0, 0.0, -f64::from(DEPTH)), DVec3::ZERO, -DVec3::Y).unwrap()
    }

    /// A wall of random colours that fills the picture, at depth [`DEPTH`], shifted.
    fn wall(shift: Vec3) -> Splats {
        let mut rng = Rng::new(5, "glmd.wall", 0, 0);
        let n = 64;
        let mut splats = Splats { kernel: Kernel::Gaussian, ..Splats::default() };
        let mut colors = Vec::new();
        for k in 0..n * n {
            let at = |i: usize| (i as f32 + 0.5) / n as f32 * 4.0 - 2.0;
            splats.means.push(Vec3::new(at(k % n), at(k / n), 0.0) + shift);
            splats.quats.push([1.0, 0.0, 0.0, 0.0]);
            splats.scales.push(Vec3::splat(SIGMA));
            splats.opacities.push(0.9);
            colors.push([0, 1, 2].map(|_| rng.uniform()));
        }
        splats.color = Color::Rgb(colors);
        splats
    }

    fn renderer() -> Renderer {
        Renderer::new(RasterOptions { background: [0.3; 3], ..RasterOptions::default() })
    }

    fn uniform(d: [f32; 2]) -> Flow {
        let n = (SIDE * SIDE) as usize;
        Flow { width: SIDE as usize, height: SIDE as usize, u: vec![d[0]; n], v: vec![d[1]; n] }
    }

    /// A wall that slides parallel to the image moves every pixel by `f d / z`; the model's flow is that to rounding, from either
    /// end, and the estimator sees it to a fraction of a pixel.
    #[test]
    fn a_sliding_wall_has_its_analytic_flow() {
        let (c, shift) = (camera(), Vec3::new(0.07, -0.04, 0.0));
        let want = c.rotation.as_mat3() * shift * c.fx as f32 / DEPTH;
        let want = uniform([want.x, want.y]);
        assert!(want.u[0].hypot(want.v[0]) > 2.0, "it moves");
        let (was, now) = (wall(Vec3::ZERO), wall(shift));
        for anchor in [Anchor::Later, Anchor::Earlier] {
            let mut p = renderer();
            let motion = model_motion(&mut p, &c, &now, &was.means, anchor).unwrap();
            assert!(motion.seen().iter().all(|s| *s) && p.options.background == [0.3; 3]);
            let error = end_point_error(&motion.flow, &want).unwrap();
            let worst = motion.flow.u.iter().zip(&motion.flow.v).map(|(u, v)| (u - want.u[0]).hypot(v - want.v[0]));
            let worst = worst.fold(0.0, f32::max);
            println!("model flow, {anchor:?}: mean error {error:.1e} px, worst {worst:.1e} px");
            assert!(worst < 1e-4, "{worst} px");
            let mut image = |s: &Splats| p.render(s, &c).unwrap().rgb.clone();
            let seen = estimated_motion(&image(&was), &image(&now), anchor).unwrap();
            let error = end_point_error(&seen, &want).unwrap();
            println!("Farneback, {anchor:?}: mean error {error:.3} px");
            assert!(error < 0.25, "{error} px");
        }
    }

    /// What moves towards the camera spreads from the middle as `x z / (z − d) − x`.
    #[test]
    fn an_approach_spreads_from_the_middle() {
        let (c, forward) = (camera(), Vec3::new(0.0, 0.0, -0.5));
        let motion = model_motion(&mut renderer(), &c, &wall(forward), &wall(Vec3::ZERO).means, Anchor::Later).unwrap();
        let factor = 1.0 - (DEPTH - 0.5) / DEPTH;
        // A splat shows within two of its standard deviations, with the flow of its centre.
        let reach = 2.0 * SIGMA * c.fx as f32 / (DEPTH - 0.5) * factor;
        for (x, y) in [(20, 48), (70, 30), (48, 80), (5, 90)] {
            let [u, v] = motion.flow.at(x, y);
            let want = [x, y].map(|p| (p as f32 + 0.5 - 0.5 * SIDE as f32) * factor);
            let (error, length) = ((u - want[0]).hypot(v - want[1]), want[0].hypot(want[1]));
            assert!(error < reach && length > 4.0 * reach, "{u} {v} at {x} {y}, {want:?} wanted");
        }
    }

    #[test]
    fn nothing_moves_by_nothing_and_nothing_is_seen_of_nothing() {
        let (c, still) = (camera(), wall(Vec3::ZERO));
        let motion = model_motion(&mut renderer(), &c, &still, &still.means, Anchor::Later).unwrap();
        assert!(motion.flow.magnitudes().iter().all(|m| *m == 0.0) && motion.seen().iter().all(|s| *s));
        let empty = model_motion(&mut renderer(), &c, &Splats::default(), &[], Anchor::Earlier).unwrap();
        assert!(empty.cover.iter().all(|c| *c == 0.0) && !empty.seen().contains(&true));
        let behind: Vec<Vec3> = still.means.iter().map(|m| *m + Vec3::Z * -9.0).collect();
        let motion = model_motion(&mut renderer(), &c, &still, &behind, Anchor::Later).unwrap();
        assert!(motion.flow.magnitudes().iter().all(|m| *m == 0.0), "what was behind the camera has no flow");
    }
}
