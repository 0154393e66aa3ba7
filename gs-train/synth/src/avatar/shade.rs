//! Rendering of a textured mesh: a regular grid of `k × k` samples in every pixel.
//!
//! The nearest face at each sample comes from [`gs_texel::zbuffer::face_map`] of a camera with `k` times the pixels; its
//! barycentric coordinates from the ray. Alpha is coverage, colour the mean over covered samples (straight alpha), zero where
//! nothing is visible. Surfaces are two-sided; texels below the alpha cut-off of their material are holes, other opacities count as 1.

use std::sync::Arc;

use glam::{DVec3, Vec3, Vec4};
use gs_core::{Camera, Image, cast};
use gs_texel::Template;
use gs_texel::bvh::Tracer;
use gs_texel::surface::{NONE, Topology};
use gs_texel::zbuffer::face_map;
use serde::{Deserialize, Serialize};

use gs_data::ImageU8;

/// Near plane, metres.
const NEAR: f64 = 1e-3;
/// Distance of a shadow's ray from the surface it begins on, and its length, metres: beyond any person.
const SHADOW_FROM: f32 = 1e-3;
const SHADOW_TO: f32 = 10.0;
/// A ray continues behind a hole at this share of its depth.
const HOLE_STEP: f32 = 1e-5;
/// Most holes that a ray passes.
const MAX_HOLES: usize = 64;

/// A static directional light and ambient light. Display-encoded colours are multiplied
/// by `ambient + (1 − ambient) max(0, n · direction)`, by `ambient` in shadow.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Light {
    /// Direction to the light, world; any length but 0.
    pub direction: [f64; 3],
    /// Factor on the colour of points that face away, 0..1.
    pub ambient: f64,
    /// Whether the surface casts shadows on itself, with sharp edges; holes in it cast them, too.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub shadows: bool,
}

/// The posed surface of a frame.
pub(super) struct Stage<'a> {
    template: &'a Template,
    surface: Vec<Vec3>,
    normals: Vec<Vec3>,
    light: Option<Light>,
    /// For holes, shadows, and [`Stage::truth`].
    tracer: Option<Arc<Tracer>>,
}

/// Ground truth at pixel centres; zero where nothing is visible.
pub(super) struct Maps {
    /// `[H, W, 1]`: camera-space z.
    pub(super) depth: Image,
    /// `[H, W, 3]`: unit normals, world, interpolated between vertices.
    pub(super) normal: Image,
    /// `[H, W, 3]`: positions, world.
    pub(super) position: Image,
}

impl<'a> Stage<'a> {
    /// `surface` holds the template's vertices in the world, finite.
    pub(super) fn new(template: &'a Template, topology: &Topology, surface: Vec<Vec3>, light: Option<Light>) -> Self {
        let normals = topology.normals(&surface, &template.faces);
        let holed = template.materials.iter().any(|m| m.cutout.is_some());
        let mut stage = Self { template, surface, normals, light, tracer: None };
        if holed || light.is_some_and(|l| l.shadows) {
            stage.tracer = stage.trace();
        }
        stage
    }

    /// None never occurs: readers and generators make faces in range.
    fn trace(&self) -> Option<Arc<Tracer>> {
        Tracer::new(&self.surface, &self.template.faces).ok().map(Arc::new)
    }

    /// The image with `k × k` samples per pixel.
    pub(super) fn picture(&self, camera: &Camera, k: u32) -> ImageU8 {
        let fine = camera.scaled(f64::from(k));
        let faces = face_map(&self.surface, &self.template.faces, &fine, NEAR);
        let seen: Vec<DVec3> = self.surface.iter().map(|p| camera.to_camera(p.as_dvec3())).collect();
        let (width, height, k) = (camera.width as usize, camera.height as usize, k as usize);
        let mut image = ImageU8 { width, height, data: Vec::with_capacity(width * height * 4) };
        for y in 0..height {
            for x in 0..width {
                let (mut sum, mut covered) = (DVec3::ZERO, 0usize);
                for s in 0..k * k {
                    let (i, j) = (x * k + s % k, y * k + s / k);
                    let face = faces[j * width * k + i];
                    if face != NONE
                        && let Some(c) = self.sample(&fine, &seen, face, [i, j])
                    {
                        sum += c.truncate().as_dvec3();
                        covered += 1;
                    }
                }
                image.data.extend_from_slice(&straight(sum, covered, k * k));
            }
        }
        image
    }

    /// The shaded colour of a point of a face, rounded to 8 bits as in images.
    pub(super) fn color(&self, face: u32, bary: [f32; 3]) -> [f32; 3] {
        let lit = self.lit(face, bary, self.template.colour(face as usize, bary));
        lit.truncate().to_array().map(|v| (255.0 * v + 0.5).clamp(0.0, 255.0).floor() / 255.0)
    }

    /// Colour of a sample that a face covers; none if the ray passes through holes and meets nothing.
    fn sample(&self, fine: &Camera, seen: &[DVec3], face: u32, [i, j]: [usize; 2]) -> Option<Vec4> {
        let ray = pixel_ray(fine, i, j);
        let bary = self.bary(seen, face, ray);
        let colour = self.template.colour(face as usize, bary);
        if !self.is_hole(face, colour) {
            return Some(self.lit(face, bary, colour));
        }
        let (tracer, eye) = (self.tracer.as_ref()?, fine.position());
        let direction = fine.rotation.transpose() * ray;
        let z: f64 = self.at(seen, face, bary).z;
        let mut from = (eye + direction * z * (1.0 + f64::from(HOLE_STEP))).as_vec3();
        for _ in 0..MAX_HOLES {
            let hit = tracer.hit(from, direction.as_vec3())?;
            let bary = [hit.bary[0], hit.bary[1], 1.0 - hit.bary[0] - hit.bary[1]];
            let colour = self.template.colour(hit.face as usize, bary);
            if !self.is_hole(hit.face, colour) {
                return Some(self.lit(hit.face, bary, colour));
            }
            from += direction.as_vec3() * (hit.t + cast::to_f32(z) * HOLE_STEP);
        }
        None
    }

    fn is_hole(&self, face: u32, colour: Vec4) -> bool {
        let material = self.template.face_materials.get(face as usize);
        let material = material.and_then(|&m| self.template.materials.get(usize::from(m)));
        material.and_then(|m| m.cutout).is_some_and(|least| colour.w < least)
    }

    /// Barycentric coordinates where a ray of the camera meets the plane of a face: `b_i ∝ d · (p_j × p_k)`, exact under perspective.
    fn bary(&self, seen: &[DVec3], face: u32, ray: DVec3) -> [f32; 3] {
        let [a, b, c] = self.template.faces[face as usize].map(|v| seen[v as usize]);
        let w = DVec3::new(ray.dot(b.cross(c)), ray.dot(c.cross(a)), ray.dot(a.cross(b)));
        let sum = w.x + w.y + w.z;
        // A face seen edge-on covers a sample by rounding alone: take its centroid.
        if sum == 0.0 { [1.0 / 3.0; 3] } else { (w / sum).as_vec3().to_array() }
    }

    /// Interpolates values at vertices on a face.
    fn at(&self, values: &[DVec3], face: u32, bary: [f32; 3]) -> DVec3 {
        let corners = self.template.faces[face as usize].map(|v| values[v as usize]);
        corners.iter().zip(bary).map(|(&p, b)| p * f64::from(b)).sum()
    }

    fn normal(&self, face: u32, bary: [f32; 3]) -> Vec3 {
        let corners = self.template.faces[face as usize].map(|v| self.normals[v as usize]);
        corners.iter().zip(bary).map(|(&n, b)| n * b).sum::<Vec3>().normalize_or_zero()
    }

    fn lit(&self, face: u32, bary: [f32; 3], colour: Vec4) -> Vec4 {
        let Some(light) = self.light else { return colour };
        let to_light = DVec3::from_array(light.direction).normalize_or_zero();
        let normal = self.normal(face, bary);
        let facing = normal.as_dvec3().dot(to_light).max(0.0);
        let dark = facing > 0.0 && light.shadows && self.in_shadow(face, bary, normal, to_light.as_vec3());
        let factor = cast::to_f32(if dark { light.ambient } else { light.ambient + (1.0 - light.ambient) * facing });
        (colour.truncate() * factor).extend(colour.w)
    }

    /// Whether the surface hides the light from a point of a face.
    fn in_shadow(&self, face: u32, bary: [f32; 3], normal: Vec3, to_light: Vec3) -> bool {
        let corners = self.template.faces[face as usize].map(|v| self.surface[v as usize]);
        let from = corners.iter().zip(bary).map(|(&p, b)| p * b).sum::<Vec3>() + normal * SHADOW_FROM;
        self.tracer.as_ref().is_some_and(|t| t.occluded(from, from + to_light * SHADOW_TO))
    }

    /// Depth, normal and position at pixel centres, by ray tracing, independent of the depth buffer; holes count as
    /// surface.
    pub(super) fn truth(&self, camera: &Camera) -> Maps {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let map = |channels| Image::zeros(width, height, channels);
        let mut maps = Maps { depth: map(1), normal: map(3), position: map(3) };
        let Some(tracer) = self.tracer.clone().or_else(|| self.trace()) else { return maps };
        let eye = camera.position().as_vec3();
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            let direction = camera.rotation.transpose() * pixel_ray(camera, x, y);
            let Some(hit) = tracer.hit(eye, direction.as_vec3()) else { continue };
            let bary = [hit.bary[0], hit.bary[1], 1.0 - hit.bary[0] - hit.bary[1]];
            let corners = self.template.faces[hit.face as usize].map(|v| self.surface[v as usize]);
            let position: Vec3 = corners.iter().zip(bary).map(|(&p, b)| p * b).sum();
            maps.depth.pixel_mut(x, y)[0] = cast::to_f32(camera.to_camera(position.as_dvec3()).z);
            maps.normal.pixel_mut(x, y).copy_from_slice(&self.normal(hit.face, bary).to_array());
            maps.position.pixel_mut(x, y).copy_from_slice(&position.to_array());
        }
        maps
    }
}

/// Camera-space direction through the centre of a pixel, z = 1.
fn pixel_ray(camera: &Camera, i: usize, j: usize) -> DVec3 {
    DVec3::new((i as f64 + 0.5 - camera.cx) / camera.fx, (j as f64 + 0.5 - camera.cy) / camera.fy, 1.0)
}

/// RGBA with straight alpha, from the sum of the colours of the covered ones of `all` samples.
fn straight(sum: DVec3, covered: usize, all: usize) -> [u8; 4] {
    if covered == 0 {
        return [0; 4];
    }
    let byte = |v: f64| cast::to_u8(255.0 * v + 0.5);
    let c = sum / covered as f64;
    [byte(c.x), byte(c.y), byte(c.z), byte(covered as f64 / all as f64)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec2;
    use gs_texel::{Material, Wrap};

    /// Two squares facing `+z`: one at `z = 0` whose texture is opaque left of its middle, one behind it at `z = -1`.
    fn squares(cutout: Option<f32>) -> Template {
        let square = |z: f32| [[-1., -1., z], [1., -1., z], [1., 1., z], [-1., 1., z]].map(Vec3::from_array);
        let uvs = [[0., 1.], [1., 1.], [1., 0.], [0., 0.]].map(Vec2::from_array);
        let texture = Image { width: 2, height: 1, channels: 4, data: vec![1., 0., 0., 1., 0., 0., 1., 0.] };
        let wrap = [Wrap::Clamp; 2];
        let holed = Material { texture: Some(Arc::new(texture)), wrap, cutout, ..Material::default() };
        let green = Material { factor: Vec4::new(0.0, 1.0, 0.0, 1.0), ..Material::default() };
        let faces = vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        Template {
            vertices: [square(0.0), square(-1.0)].concat(),
            face_uvs: vec![[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3]],
            faces,
            uvs: uvs.to_vec(),
            face_materials: vec![0, 0, 1, 1],
            materials: vec![holed, green],
            ..Template::default()
        }
    }

    fn camera() -> Camera {
        Camera::look_at(40, 40, 0.6, DVec3::Z * 6.0, DVec3::ZERO, DVec3::Y).unwrap()
    }

    fn stage(template: &Template, light: Option<Light>) -> Stage<'_> {
        let topology = Topology::new(&template.faces, template.vertices.len()).unwrap();
        Stage::new(template, &topology, template.vertices.clone(), light)
    }

    #[test]
    fn alpha_is_coverage_and_colour_is_not_darkened_at_the_border() {
        let template = squares(None);
        let image = stage(&template, None).picture(&camera(), 8);
        // The square is `2 f / 6` pixels wide.
        let side = 2.0 * camera().fx / 6.0;
        let covered: f64 = image.data.chunks_exact(4).map(|p| f64::from(p[3]) / 255.0).sum();
        assert!((covered - side * side).abs() < 0.02 * side * side, "{covered} {}", side * side);
        assert!(image.data.chunks_exact(4).any(|p| p[3] > 0 && p[3] < 255));
        // Left of the middle of the texture's first texel it is pure red: wherever it is covered at all.
        for y in 0..40 {
            for x in 0..12 {
                let p = image.pixel(x, y);
                assert!(if p[3] == 0 { p == [0; 4] } else { p[0] == 255 && p[1] == 0 && p[2] == 0 }, "{p:?}");
            }
        }
    }

    #[test]
    fn holes_show_what_is_behind() {
        let (solid, holed) = (squares(None), squares(Some(0.5)));
        let right = |t: &Template| stage(t, None).picture(&camera(), 4).pixel(26, 20);
        assert_eq!(right(&solid)[2], 255);
        assert_eq!(right(&holed), [0, 255, 0, 255]);
        assert_eq!(stage(&holed, None).picture(&camera(), 4).pixel(12, 20), [255, 0, 0, 255]);
    }

    #[test]
    fn light_falls_off_with_the_cosine() {
        let template = squares(None);
        let at = |direction: [f64; 3]| {
            let light = Light { direction, ambient: 0.25, shadows: false };
            stage(&template, Some(light)).picture(&camera(), 2).pixel(12, 20)[0]
        };
        assert_eq!(at([0.0, 0.0, 3.0]), 255);
        assert_eq!(at([0.0, 3f64.sqrt(), 1.0]), (255.0f64 * (0.25 + 0.75 * 0.5)).round() as u8);
        assert_eq!(at([0.0, 0.0, -1.0]), 64);
    }

    #[test]
    fn a_surface_hides_the_light_from_what_lies_behind_it() {
        let template = squares(None);
        let lit = |shadows: bool, x: f32| {
            let light = Light { direction: [1.0, 0.0, 1.0], ambient: 0.25, shadows };
            // The point (x, -1/2) of the square behind.
            let right = 0.5 * (x + 0.5);
            let bary = [0.75 - right, right, 0.25];
            stage(&template, Some(light)).color(2, bary)[1]
        };
        let full = 0.25 + 0.75 * 0.5f32.sqrt();
        // The square in front is one unit nearer, so its shadow lies one unit to the left.
        for x in [-0.45f32, -0.2, -0.05, 0.05, 0.5, 0.95] {
            let want = if x < 0.0 { 0.25 } else { full };
            assert!((lit(true, x) - want).abs() < 3e-3, "{x}: {}", lit(true, x));
            assert!((lit(false, x) - full).abs() < 3e-3);
        }
    }
}
