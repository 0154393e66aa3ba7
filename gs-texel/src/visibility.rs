//! Which view sees which texel.
//!
//! A texel must face the camera, project with its whole bilinear footprint into the frame, lie inside the mask, and not be
//! occluded. The [`Rule`] selects the occlusion test. The tests run in that order, cheapest first: on a closed body the first
//! rejects about three quarters of the texels.
//!
//! A visible point within a pixel of an occluding edge still reads the colour of the occluder there, so its **footprint** counts:
//! exact rays alone make a worse texture than a depth map whose four taps must all agree. [`Rule::Neighbours`] reads the taps
//! that show the texel's own part of the surface, and those only. It needs no tolerance in metres, which is too much where two
//! parts of a body meet and too little where a surface slants.

use crate::bvh::Tracer;
use crate::neighbours::Neighbours;
use crate::surface::{Mesh, NONE};
use crate::unproject::{Compat, MaskUse, UnprojectConfig, View};
use crate::zbuffer::{DepthMap, ProjectedMesh};
use glam::{Mat3, Vec3};
use gs_core::Image;
use serde::{Deserialize, Serialize};

/// Occlusion test. `D` is the depth map of the mesh, `z` the depth of the texel, `ε` the tolerance
/// ([`UnprojectConfig::depth_tolerance`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// `|D(p) − z| < ε` with `D` read bilinearly (DUT, DVA).
    Bilinear,
    /// `|D_k − z| < ε` at all four taps of the footprint.
    FourTap,
    /// The nearest face at a tap is near the texel's face along the mesh: a vertex of one is a vertex of the other, or few
    /// edges away where faces are smaller than pixels. Such taps must have more than half of the bilinear weight, and the
    /// colour is theirs alone. The mesh must be welded.
    #[default]
    Neighbours,
    /// A ray to the camera centre is not blocked: exact at the point, blind to its footprint.
    Ray,
    /// [`Rule::Ray`], and rays through the four taps hit a surface within `ε` of `z`: exact, without a depth map.
    RayFootprint,
    /// The face is the nearest one at some pixel (GHG). Wrong for faces that are partly hidden or smaller than a pixel.
    FaceTag,
    /// The surface at the nearest pixel lies within `ε` of the texel in space; the colour is that of the pixel (HoloChar).
    PointDistance,
}

impl Rule {
    /// All rules, in order of declaration.
    pub const ALL: [Self; 7] = [
        Self::Bilinear,
        Self::FourTap,
        Self::Neighbours,
        Self::Ray,
        Self::RayFootprint,
        Self::FaceTag,
        Self::PointDistance,
    ];

    /// Name in settings files and tables, such as `four_tap`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Bilinear => "bilinear",
            Self::FourTap => "four_tap",
            Self::Neighbours => "neighbours",
            Self::Ray => "ray",
            Self::RayFootprint => "ray_footprint",
            Self::FaceTag => "face_tag",
            Self::PointDistance => "point_distance",
        }
    }

    /// Whether the rule reads a depth map.
    pub(crate) fn needs_depth(self) -> bool {
        matches!(self, Self::Bilinear | Self::FourTap | Self::PointDistance)
    }

    /// Whether the rule traces rays.
    pub(crate) fn needs_rays(self) -> bool {
        matches!(self, Self::Ray | Self::RayFootprint)
    }
}

/// The four pixels that a texel reads bilinearly.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Footprint {
    /// Column and row of the first tap.
    x: usize,
    y: usize,
    /// Weights of the second column and row.
    wx: f32,
    wy: f32,
    /// The texel in camera space.
    q: Vec3,
}

impl Footprint {
    #[inline(always)]
    fn weights(&self) -> [f32; 4] {
        let (ux, uy) = (1.0 - self.wx, 1.0 - self.wy);
        [ux * uy, self.wx * uy, ux * self.wy, self.wx * self.wy]
    }
}

/// A texel as one view sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    pub(crate) color: [f32; 3],
    /// Opacity of the mask at the footprint.
    pub(crate) mask: f32,
    /// Cosine between normal and direction to the camera.
    pub(crate) cos: f32,
}

/// Share of the bilinear weight that taps on the texel's own part of the surface must exceed.
const LEAST_OWN: f32 = 0.5;

/// What a rule needs of the mesh, the same for all views.
pub(crate) struct OfMesh<'a> {
    pub(crate) tracer: Option<Tracer>,
    pub(crate) neighbours: Option<Neighbours<'a>>,
}

/// A view with what the rule needs of the mesh: a depth map, the nearest faces, or the faces that own a pixel.
pub(crate) struct PreparedView<'a> {
    origin: Vec3,
    rotation: Mat3,
    focal: [f32; 2],
    principal: [f32; 2],
    image: &'a Image,
    mask: Option<&'a Image>,
    /// Whether at least half of the vertices lie in front of the camera.
    pub(crate) used: bool,
    pub(crate) depth: Option<DepthMap>,
    nearest: Option<Vec<u32>>,
    owns_pixel: Option<Vec<bool>>,
    /// Side of a pixel at the mean depth of the mesh, metres; 0 for a view that is not used.
    pub(crate) pixel: f64,
}

impl<'a> PreparedView<'a> {
    /// Projects `mesh`. A view with more than half of the vertices behind it is not used.
    pub(crate) fn new(view: &View<'a>, mesh: &Mesh<'_>, config: &UnprojectConfig) -> Self {
        let c = view.camera;
        let projected = ProjectedMesh::new(mesh.vertices, mesh.faces, c, config.near);
        let behind = projected.corners.iter().filter(|c| c.camera.z <= config.near).count();
        let used = 2 * behind <= mesh.vertices.len();
        let owns_pixel = || {
            let mut owns = vec![false; mesh.faces.len()];
            let map = projected.face_map();
            map.into_iter().filter(|&f| f != NONE).for_each(|f| owns[f as usize] = true);
            owns
        };
        let depth = projected.corners.iter().map(|c| c.camera.z).sum::<f64>() / mesh.vertices.len().max(1) as f64;
        Self {
            origin: c.position().as_vec3(),
            rotation: c.rotation.as_mat3(),
            focal: [c.fx as f32, c.fy as f32],
            principal: [c.cx as f32, c.cy as f32],
            image: view.image,
            mask: view.mask,
            used,
            depth: (used && config.rule.needs_depth()).then(|| projected.depth_map()),
            nearest: (used && config.rule == Rule::Neighbours).then(|| projected.face_map()),
            owns_pixel: (used && config.rule == Rule::FaceTag).then(owns_pixel),
            pixel: if used { depth / c.fx.max(c.fy) } else { 0.0 },
        }
    }

    /// The sample at the point `p` of face `face` with normal `n` (any length); `None` where it is not visible.
    #[inline]
    pub(crate) fn sample(
        &self,
        p: Vec3,
        n: Vec3,
        face: u32,
        config: &UnprojectConfig,
        of_mesh: &OfMesh<'_>,
    ) -> Option<Sample> {
        let to_camera = self.origin - p;
        let cos = n.dot(to_camera) / (n.length_squared() * to_camera.length_squared()).sqrt();
        // False also for NaN, of a normal without length.
        let facing = cos > config.min_cos;
        if !(self.used && facing) {
            return None;
        }
        let at = self.footprint(p, config)?;
        let weights = self.own_weights(&at, face, of_mesh.neighbours.as_ref())?;
        let taps = self.taps_of_mask(&at, config.mask);
        let mask = weights.iter().zip(taps).map(|(w, a)| w * a).sum();
        if mask <= config.mask.min_mask() || !self.unoccluded(&at, p, n, face, config, of_mesh.tracer.as_ref()) {
            return None;
        }
        Some(Sample { color: self.color(&at, weights, taps, config.mask), mask, cos })
    }

    /// The bilinear weights of the taps; with [`Rule::Neighbours`] 0 for those that show another part of the surface than
    /// `face`, and `None` if these are half of the footprint or more.
    #[inline]
    fn own_weights(&self, at: &Footprint, face: u32, neighbours: Option<&Neighbours<'_>>) -> Option<[f32; 4]> {
        let weights = at.weights();
        let (Some(nearest), Some(neighbours)) = (&self.nearest, neighbours) else { return Some(weights) };
        let first = at.y * self.image.width + at.x;
        let taps = [first, first + 1, first + self.image.width, first + self.image.width + 1].map(|i| nearest[i]);
        let own: [f32; 4] = std::array::from_fn(|k| if neighbours.are_near(taps[k], face) { weights[k] } else { 0.0 });
        (own.iter().sum::<f32>() > LEAST_OWN).then_some(own)
    }

    /// The footprint of a point, `None` unless all of it lies in the frame.
    #[inline]
    fn footprint(&self, p: Vec3, config: &UnprojectConfig) -> Option<Footprint> {
        let q = self.rotation * (p - self.origin);
        if q.z <= config.near as f32 {
            return None;
        }
        let (width, height) = (self.image.width, self.image.height);
        let pixel = |i: usize, side: usize| {
            let p = self.focal[i] * q[i] / q.z + self.principal[i];
            if config.compat.align_corners { p * (side as f32 - 1.0) / side as f32 } else { p - 0.5 }
        };
        let (u, v) = (pixel(0, width), pixel(1, height));
        // The nearest pixel stands for a whole footprint.
        let (shift, part) = if config.rule == Rule::PointDistance { (0.5, 0.0) } else { (0.0, 1.0) };
        let inside = |v: f32, side: usize| v >= 0.0 && v + 1.0 + shift < side as f32;
        if !(inside(u, width) && inside(v, height)) {
            return None;
        }
        // Not negative, so that cutting is rounding down.
        let (x, y) = ((u + shift) as u32, (v + shift) as u32);
        let (wx, wy) = (part * (u - x as f32), part * (v - y as f32));
        Some(Footprint { x: x as usize, y: y as usize, wx, wy, q })
    }

    /// Mask values at the four taps.
    #[inline]
    fn taps_of_mask(&self, at: &Footprint, mode: MaskUse) -> [f32; 4] {
        let (map, channel) = match (mode, self.mask) {
            (MaskUse::Ignore, _) => return [1.0; 4],
            (_, Some(mask)) => (mask, 0),
            (_, None) if self.image.channels == 4 => (self.image, 3),
            _ => return [1.0; 4],
        };
        let first = (at.y * map.width + at.x) * map.channels + channel;
        let (right, down) = (map.channels, map.width * map.channels);
        let taps = [first, first + right, first + down, first + down + right].map(|i| map.data[i]);
        if mode == MaskUse::Binary { taps.map(|a| if a >= 0.5 { 1.0 } else { 0.0 }) } else { taps }
    }

    /// The colour of the foreground among the weighted taps, `Σ w α c / Σ w α`: the background beyond the silhouette does not
    /// mix in.
    #[inline]
    fn color(&self, at: &Footprint, mut weights: [f32; 4], mask: [f32; 4], mode: MaskUse) -> [f32; 3] {
        if mode == MaskUse::Soft {
            weights.iter_mut().zip(mask).for_each(|(w, a)| *w *= a);
        }
        if mode == MaskUse::Soft || self.nearest.is_some() {
            let total: f32 = weights.iter().sum();
            weights.iter_mut().for_each(|w| *w /= total);
        }
        let c = self.image.channels;
        let first = (at.y * self.image.width + at.x) * c;
        let second = first + self.image.width * c;
        let (top, bottom) = (&self.image.data[first..first + 2 * c], &self.image.data[second..second + 2 * c]);
        std::array::from_fn(|i| {
            weights[0] * top[i] + weights[1] * top[c + i] + weights[2] * bottom[i] + weights[3] * bottom[c + i]
        })
    }

    /// The occlusion test of the rule.
    #[inline]
    fn unoccluded(
        &self,
        at: &Footprint,
        p: Vec3,
        n: Vec3,
        face: u32,
        config: &UnprojectConfig,
        tracer: Option<&Tracer>,
    ) -> bool {
        let tolerance = config.depth_tolerance;
        let close = |d: f32| (d - at.q.z).abs() < tolerance;
        match config.rule {
            Rule::Bilinear => {
                let taps = self.taps_of_depth(at, config.compat);
                // A tap of no weight does not count, even where it is infinite.
                let weighted = at.weights().into_iter().zip(taps).filter(|t| t.0 > 0.0);
                close(weighted.map(|(w, d)| w * d).sum())
            }
            Rule::FourTap => self.taps_of_depth(at, config.compat).into_iter().all(close),
            // Decided by the weights of the taps.
            Rule::Neighbours => true,
            Rule::Ray => self.ray_is_free(p, n, config, tracer),
            Rule::RayFootprint => {
                self.ray_is_free(p, n, config, tracer)
                    && [(0, 0), (1, 0), (0, 1), (1, 1)].into_iter().all(|(dx, dy)| {
                        let ray = self.ray(at.x + dx, at.y + dy);
                        tracer.and_then(|t| t.hit(self.origin, ray)).is_some_and(|hit| close(hit.t))
                    })
            }
            Rule::FaceTag => self.owns_pixel.as_ref().is_some_and(|t| t[face as usize]),
            Rule::PointDistance => {
                let d = self.taps_of_depth(at, config.compat)[0];
                d.is_finite() && (self.direction(at.x, at.y) * d - at.q).length() < tolerance
            }
        }
    }

    #[inline]
    fn taps_of_depth(&self, at: &Footprint, compat: Compat) -> [f32; 4] {
        let Some(map) = &self.depth else { return [f32::INFINITY; 4] };
        let first = at.y * map.width + at.x;
        let taps = [first, first + 1, first + map.width, first + map.width + 1].map(|i| map.depth[i]);
        if compat == Compat::default() { taps } else { taps.map(|d| compat.depth(d)) }
    }

    fn ray_is_free(&self, p: Vec3, n: Vec3, config: &UnprojectConfig, tracer: Option<&Tracer>) -> bool {
        let from = p + n.normalize_or_zero() * config.ray_offset;
        tracer.is_some_and(|t| !t.occluded(from, self.origin))
    }

    /// Direction through the centre of pixel `(x, y)` with z = 1, in camera space.
    fn direction(&self, x: usize, y: usize) -> Vec3 {
        let [x, y] = [x as f32 + 0.5 - self.principal[0], y as f32 + 0.5 - self.principal[1]];
        Vec3::new(x / self.focal[0], y / self.focal[1], 1.0)
    }

    /// [`Self::direction`] in world space; the ray parameter along it is the depth.
    fn ray(&self, x: usize, y: usize) -> Vec3 {
        self.rotation.transpose() * self.direction(x, y)
    }
}

/// Error rates of a rule against another, over pairs of texel and view.
///
/// ```
/// use gs_texel::visibility::Rates;
///
/// let rates = Rates::of(&[1.0, 0.0, 1.0, 0.0, 1.0], &[1.0, 1.0, 0.0, 0.0, 0.5]);
/// assert_eq!(rates, Rates { visible: 3, false_visible: 1.0 / 3.0, false_hidden: 1.0 / 3.0 });
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Rates {
    /// Number of pairs that are visible to the oracle.
    pub visible: usize,
    /// Pairs visible to the tested rule only, over `visible`.
    pub false_visible: f64,
    /// Pairs visible to the oracle only, over `visible`.
    pub false_hidden: f64,
}

impl Rates {
    /// The rates of `tested` against `oracle`; both hold one weight per pair, above 0 where visible
    /// ([`crate::unproject::Texture::by_view`]).
    pub fn of(tested: &[f32], oracle: &[f32]) -> Self {
        let count =
            |f: &dyn Fn(bool, bool) -> bool| tested.iter().zip(oracle).filter(|(t, o)| f(**t > 0.0, **o > 0.0)).count();
        let visible = count(&|_, o| o);
        let share = |n: usize| n as f64 / visible.max(1) as f64;
        Self { visible, false_visible: share(count(&|t, o| t && !o)), false_hidden: share(count(&|t, o| o && !t)) }
    }
}
