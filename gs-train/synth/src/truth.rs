//! What a generated scene really is: positions of material points, depth, flow and segments, exact to rounding.

use glam::{DVec2, DVec3};
use gs_core::{Camera, Image};

use super::SynthOptions;
use super::body::{Body, MotionClass};
use super::motion::RigidPose;
use super::rates::Rates;
use super::trace::{Hit, Tracer};
use gs_data::{ImageU8, Lens};

/// The truth of a scene. Times are normalised.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    scene: &'static str,
    dynamic: bool,
    bodies: Vec<Body>,
    options: SynthOptions,
}

/// Flow at pixel centres.
#[derive(Clone, Debug, PartialEq)]
pub struct FlowMap {
    /// Displacement `(du, dv)` in pixels, 2 channels; 0 where nothing is seen.
    pub flow: Image,
    /// Whether a body is seen at the pixel at the first moment.
    pub seen: Vec<bool>,
    /// Whether the same material point is also the one seen at the second moment.
    pub visible_after: Vec<bool>,
}

impl Truth {
    pub(crate) fn new(bodies: Vec<Body>, scene: &'static str, dynamic: bool, options: &SynthOptions) -> Self {
        Self { scene, dynamic, bodies, options: *options }
    }

    /// Name of the scene.
    pub fn scene(&self) -> &'static str {
        self.scene
    }

    /// Whether it moves.
    pub fn dynamic(&self) -> bool {
        self.dynamic
    }

    /// What it was generated with.
    pub fn options(&self) -> &SynthOptions {
        &self.options
    }

    /// The bodies.
    pub fn bodies(&self) -> &[Body] {
        &self.bodies
    }

    /// World position at time `t` of the material point `local` of a body (for a sheet: its rest position `(x, y, ·)`).
    /// None if there is no such body.
    pub fn position_of(&self, body: usize, local: DVec3, t: f64) -> Option<DVec3> {
        self.bodies.get(body).map(|b| b.position_of(local, t))
    }

    /// Pose of a body's frame at time `t`.
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

    /// What a camera sees at pixel coordinates `(u, v)` at time `t`.
    pub fn hit(&self, camera: &Camera, t: f64, u: f64, v: f64) -> Option<Hit> {
        self.tracer(camera, t).hit(u, v)
    }

    /// The picture a camera takes at time `t`.
    pub fn picture(&self, camera: &Camera, t: f64) -> ImageU8 {
        self.tracer(camera, t).picture(self.options.supersample)
    }

    /// The photograph taken at time `t` by a camera whose lens shows the plane `z = 1` distorted; empty where the lens shows
    /// nothing.
    pub fn photograph(&self, camera: &Camera, lens: &Lens, t: f64) -> ImageU8 {
        self.tracer(camera, t).through(lens).picture(self.options.supersample)
    }

    /// Camera-space z at pixel centres, 1 channel; 0 where nothing is seen.
    pub fn depth(&self, camera: &Camera, t: f64) -> Image {
        let mut depth = Image::zeros(camera.width as usize, camera.height as usize, 1);
        depth.data = self.centres(camera, t).into_iter().map(|h| h.map_or(0.0, |h| h.depth as f32)).collect();
        depth
    }

    /// Index of the body seen at each pixel centre, row-major.
    pub fn segments(&self, camera: &Camera, t: f64) -> Vec<Option<u32>> {
        self.centres(camera, t).into_iter().map(|h| h.map(|h| h.body as u32)).collect()
    }

    /// Label of what is seen at each pixel centre, in parts of 255: 0 for nothing, `k / 255` for the `k`-th body; 1 channel.
    pub(super) fn labels(&self, camera: &Camera, t: f64) -> Image {
        let mut labels = Image::zeros(camera.width as usize, camera.height as usize, 1);
        labels.data = self.segments(camera, t).into_iter().map(|s| s.map_or(0.0, |k| (k + 1) as f32 / 255.0)).collect();
        labels
    }

    /// 1 at pixel centres that see a body which moves in this way, else 0; 1 channel.
    pub fn mask(&self, camera: &Camera, t: f64, class: MotionClass) -> Image {
        let mut mask = Image::zeros(camera.width as usize, camera.height as usize, 1);
        let of = |h: Option<Hit>| f32::from(h.is_some_and(|h| self.bodies[h.body].class() == class));
        mask.data = self.centres(camera, t).into_iter().map(of).collect();
        mask
    }

    /// Where the material points that `before` sees at pixel centres at time `t0` are in the image of `after` at `t1`.
    pub fn flow(&self, before: &Camera, t0: f64, after: &Camera, t1: f64) -> FlowMap {
        /// Two depths this close are one surface; the slab is 0.1 thick.
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
            map.flow.data[2 * k] = (to.x - from.x) as f32;
            map.flow.data[2 * k + 1] = (to.y - from.y) as f32;
            let again = target.hit(to.x, to.y);
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
