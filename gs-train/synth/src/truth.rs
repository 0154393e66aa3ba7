//! Ground truth of a generated scene: positions of material points, depth, flow and segments, exact to rounding.

use glam::{DVec2, DVec3};
use gs_core::{Camera, Image, cast};

use super::SynthOptions;
use super::body::{Body, MotionClass};
use super::motion::RigidPose;
use super::rates::Rates;
use super::trace::{Hit, Tracer};
use gs_data::{ImageU8, Lens};

/// Ground truth of a scene, for any camera and any normalised time, inside or outside 0..1.
///
/// Bodies are numbered by their index in [`Self::bodies`]; a material point is a position in the frame of its body.
///
/// ```
/// use glam::DVec3;
/// use gs_core::Camera;
///
/// let truth = gs_synth::truth("balls", &Default::default())?;
/// let ball = |t| truth.pose_of(0, t).unwrap().translation; // its radius is 0.28
/// let camera = Camera::look_at(8, 8, 0.7, ball(0.25) + DVec3::Z * 3.0, ball(0.25), DVec3::Y).unwrap();
/// let hit = truth.hit(&camera, 0.25, 4.0, 4.0).unwrap();
/// assert!(hit.body == 0 && (hit.depth - 2.72).abs() < 1e-12);
/// let later = truth.position_of(hit.body, hit.local, 0.5).unwrap(); // of the same material point
/// assert!((later.distance(ball(0.5)) - 0.28).abs() < 1e-12);
/// # Ok::<(), gs_data::DataError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    scene: &'static str,
    dynamic: bool,
    bodies: Vec<Body>,
    options: SynthOptions,
}

/// Optical flow at pixel centres, between two cameras and times.
#[derive(Clone, Debug, PartialEq)]
pub struct FlowMap {
    /// `[H, W, 2]`: displacement `(du, dv)` in pixels; 0 where nothing is visible.
    pub flow: Image,
    /// Whether a body is visible at the pixel at the first time, row-major.
    pub seen: Vec<bool>,
    /// Whether the same material point is visible at the second time too, row-major.
    pub visible_after: Vec<bool>,
}

impl Truth {
    pub(crate) fn new(bodies: Vec<Body>, scene: &'static str, dynamic: bool, options: &SynthOptions) -> Self {
        Self { scene, dynamic, bodies, options: *options }
    }

    /// Name of the scene in [`super::SCENES`].
    pub fn scene(&self) -> &'static str {
        self.scene
    }

    /// Whether any body of the scene moves.
    pub fn dynamic(&self) -> bool {
        self.dynamic
    }

    /// The options it was generated with.
    pub fn options(&self) -> &SynthOptions {
        &self.options
    }

    /// All bodies of the scene, moving and static.
    pub fn bodies(&self) -> &[Body] {
        &self.bodies
    }

    /// World position at time `t` of the material point `local` of a body (for a sheet: its rest position `(x, y, ·)`).
    /// None if there is no such body.
    pub fn position_of(&self, body: usize, local: DVec3, t: f64) -> Option<DVec3> {
        self.bodies.get(body).map(|b| b.position_of(local, t))
    }

    /// Pose of a body's frame at time `t`; none if there is no such body.
    pub fn pose_of(&self, body: usize, t: f64) -> Option<RigidPose> {
        self.bodies.get(body).map(|b| b.motion.at(t))
    }

    /// The spatial twist of a body about `origin` at time `t`, with its first two derivatives, per unit of normalised time;
    /// none if there is no such body or it deforms.
    pub fn twist_of(&self, body: usize, t: f64, origin: DVec3) -> Option<gs_physics::Motion<f64>> {
        self.rates_of(body, t).map(|r| r.twist(origin))
    }

    /// Velocities and accelerations of a body at time `t`; none if there is no such body or it deforms.
    pub fn rates_of(&self, body: usize, t: f64) -> Option<Rates> {
        self.bodies.get(body).filter(|b| !b.is_sheet()).map(|b| b.motion.rates(t))
    }

    /// First intersection of the ray through the pixel coordinates `(u, v)` at time `t`; none if it meets no body.
    pub fn hit(&self, camera: &Camera, t: f64, u: f64, v: f64) -> Option<Hit> {
        self.tracer(camera, t).hit(u, v)
    }

    /// The image of a pinhole camera at time `t`: RGBA, straight alpha.
    pub fn picture(&self, camera: &Camera, t: f64) -> ImageU8 {
        self.tracer(camera, t).render(self.options.supersample)
    }

    /// The image at time `t` of a camera with lens distortion: RGBA, straight alpha; transparent where the lens has no inverse.
    pub fn distorted_image(&self, camera: &Camera, lens: &Lens, t: f64) -> ImageU8 {
        self.tracer(camera, t).with_lens(lens).render(self.options.supersample)
    }

    /// `[H, W, 1]`: camera-space z at pixel centres, world units; 0 where nothing is visible.
    pub fn depth(&self, camera: &Camera, t: f64) -> Image {
        let mut depth = Image::zeros(camera.width as usize, camera.height as usize, 1);
        depth.data = self.centres(camera, t).into_iter().map(|h| h.map_or(0.0, |h| cast::to_f32(h.depth))).collect();
        depth
    }

    /// Index of the body visible at each pixel centre, row-major.
    pub fn segments(&self, camera: &Camera, t: f64) -> Vec<Option<u32>> {
        self.centres(camera, t).into_iter().map(|h| h.map(|h| cast::to_u32(h.body))).collect()
    }

    /// `[H, W, 1]`: label of the body visible at each pixel centre over 255, `k / 255` for the `k`-th body counted from 1; 0 for none.
    pub(super) fn labels(&self, camera: &Camera, t: f64) -> Image {
        let mut labels = Image::zeros(camera.width as usize, camera.height as usize, 1);
        labels.data = self.segments(camera, t).into_iter().map(|s| s.map_or(0.0, |k| (k + 1) as f32 / 255.0)).collect();
        labels
    }

    /// `[H, W, 1]`: 1 at pixel centres where a body with this kind of motion is visible, else 0.
    pub fn mask(&self, camera: &Camera, t: f64, class: MotionClass) -> Image {
        let mut mask = Image::zeros(camera.width as usize, camera.height as usize, 1);
        let of = |h: Option<Hit>| f32::from(h.is_some_and(|h| self.bodies[h.body].class() == class));
        mask.data = self.centres(camera, t).into_iter().map(of).collect();
        mask
    }

    /// Optical flow of the material points visible to `before` at pixel centres at time `t0`, to the image of `after` at `t1`.
    pub fn flow(&self, before: &Camera, t0: f64, after: &Camera, t1: f64) -> FlowMap {
        /// Largest difference of depths of one surface, world units; the slab is 0.1 thick.
        const SAME_SURFACE: f64 = 1e-6;
        let (width, height) = (before.width as usize, before.height as usize);
        let target = self.tracer(after, t1);
        let mut map = FlowMap { flow: Image::zeros(width, height, 2), seen: Vec::new(), visible_after: Vec::new() };
        for (k, hit) in self.centres(before, t0).into_iter().enumerate() {
            map.seen.push(hit.is_some());
            let Some(hit) = hit else {
                map.visible_after.push(false);
                continue;
            };
            let moved = after.to_camera(self.bodies[hit.body].position_of(hit.local, t1));
            let to = after.to_pixel(moved);
            let from = DVec2::new((k % width) as f64 + 0.5, (k / width) as f64 + 0.5);
            map.flow.data[2 * k] = cast::to_f32(to.x - from.x);
            map.flow.data[2 * k + 1] = cast::to_f32(to.y - from.y);
            let inside = moved.z > 0.0
                && to.cmpge(DVec2::ZERO).all()
                && to.x < f64::from(after.width)
                && to.y < f64::from(after.height);
            let again = inside.then(|| target.hit(to.x, to.y)).flatten();
            map.visible_after
                .push(again.is_some_and(|h| h.body == hit.body && (h.depth - moved.z).abs() < SAME_SURFACE));
        }
        map
    }

    fn tracer<'a>(&'a self, camera: &'a Camera, t: f64) -> Tracer<'a> {
        Tracer::new(&self.bodies, t, camera, self.options.shading)
    }

    fn centres(&self, camera: &Camera, t: f64) -> Vec<Option<Hit>> {
        let tracer = self.tracer(camera, t);
        let n = camera.width as usize * camera.height as usize;
        let width = camera.width as usize;
        (0..n).map(|k| tracer.hit((k % width) as f64 + 0.5, (k / width) as f64 + 0.5)).collect()
    }
}
