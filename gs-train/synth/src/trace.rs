//! The ray tracer of generated scenes: one ray per sample, box filter over a regular `k × k` grid in each pixel, straight
//! alpha. Shading is Lambert's with a light fixed in the world, hence the same from every camera.

use glam::{DVec2, DVec3};
use gs_core::{Camera, cast};
use rayon::prelude::*;

use super::body::{Body, Placed};
use gs_data::{ImageU8, Lens};

/// Unit direction to the light, world.
const LIGHT: DVec3 = DVec3::new(0.36, -0.48, 0.8);

/// First intersection of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Row of the body in [`Truth::bodies`](super::Truth::bodies).
    pub body: usize,
    /// The material point in the body's frame.
    pub local: DVec3,
    /// Point of intersection, world units.
    pub world: DVec3,
    /// Camera-space z of the point, world units.
    pub depth: f64,
    /// Shaded colour, display-encoded RGB in 0..1.
    pub color: [f64; 3],
}

/// Bodies at one time, seen by one camera.
pub(crate) struct Tracer<'a> {
    bodies: Vec<Placed<'a>>,
    camera: &'a Camera,
    lens: Lens,
    eye: DVec3,
    base: DVec3,
    per_u: DVec3,
    per_v: DVec3,
    shading: f64,
}

impl<'a> Tracer<'a> {
    pub(crate) fn new(bodies: &'a [Body], t: f64, camera: &'a Camera, shading: f64) -> Self {
        let eye = camera.position();
        let c2w = camera.rotation.transpose();
        let per_u = c2w.x_axis / camera.fx;
        let per_v = c2w.y_axis / camera.fy;
        let base = c2w.z_axis - per_u * camera.cx - per_v * camera.cy;
        let bodies = bodies.iter().map(|b| Placed::new(b, t, eye)).collect();
        Self { bodies, camera, lens: Lens::default(), eye, base, per_u, per_v, shading }
    }

    /// The same through a lens.
    pub(crate) fn with_lens(self, lens: &Lens) -> Self {
        Self { lens: *lens, ..self }
    }

    /// The intersection at pixel coordinates `(u, v)`. The direction has camera-space z = 1, so its parameter is the depth.
    pub(crate) fn hit(&self, u: f64, v: f64) -> Option<Hit> {
        let at = if self.lens.is_pinhole() { DVec2::new(u, v) } else { self.lens.pinhole_pixel(self.camera, u, v)? };
        let d = self.base + self.per_u * at.x + self.per_v * at.y;
        let mut best: Option<(usize, super::body::LocalHit)> = None;
        for (k, b) in self.bodies.iter().enumerate() {
            if let Some(h) = b.hit(d).filter(|h| best.is_none_or(|(_, old)| h.s < old.s)) {
                best = Some((k, h));
            }
        }
        let (body, h) = best?;
        let placed = &self.bodies[body];
        let facing = LIGHT.dot(placed.pose.rotation * h.normal);
        // A sheet has two sides and no inside: both are lit alike.
        let lambert = if placed.body.is_sheet() { facing.abs() } else { facing.max(0.0) };
        let light = 1.0 - self.shading + self.shading * lambert;
        let color = placed.body.color(h.point).map(|c| c * light);
        Some(Hit { body, local: h.point, world: self.eye + d * h.s, depth: h.s, color })
    }

    /// The image with `k × k` samples per pixel.
    pub(crate) fn render(&self, k: u32) -> ImageU8 {
        let (width, height) = (self.camera.width as usize, self.camera.height as usize);
        let mut data = vec![0u8; width * height * 4];
        data.par_chunks_mut(width * 4).enumerate().for_each(|(j, row)| {
            for (i, pixel) in row.chunks_exact_mut(4).enumerate() {
                pixel.copy_from_slice(&self.pixel(i, j, k));
            }
        });
        ImageU8 { width, height, data }
    }

    fn pixel(&self, i: usize, j: usize, k: u32) -> [u8; 4] {
        // Half a pixel's diagonal, with a margin for rounding.
        let spread = 0.75 / self.camera.fx.min(self.camera.fy);
        let centre = self.base + self.per_u * (i as f64 + 0.5) + self.per_v * (j as f64 + 0.5);
        // Distorted rays may leave the cone.
        if self.lens.is_pinhole() && !self.bodies.iter().any(|b| b.may_meet(centre, spread)) {
            return [0; 4];
        }
        let (mut sum, mut hits) = ([0.0f64; 3], 0u32);
        for s in 0..k * k {
            let u = i as f64 + (f64::from(s % k) + 0.5) / f64::from(k);
            let v = j as f64 + (f64::from(s / k) + 0.5) / f64::from(k);
            if let Some(hit) = self.hit(u, v) {
                sum.iter_mut().zip(hit.color).for_each(|(a, c)| *a += c);
                hits += 1;
            }
        }
        if hits == 0 {
            return [0; 4];
        }
        let to_u8 = |x: f64| cast::to_u8(x * 255.0 + 0.5);
        let [r, g, b] = sum.map(|c| to_u8(c / f64::from(hits)));
        [r, g, b, to_u8(f64::from(hits) / f64::from(k * k))]
    }
}
