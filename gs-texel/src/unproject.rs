//! Colours of texels from the views that see them: `T_c = Σ_i v_i I_i / Σ_i v_i` (DUT), `v_i` the weight of view `i`, 0 where
//! the texel is hidden ([`crate::visibility`]).
//!
//! Sums are in fixed point, so neither the order of the views nor the number of threads changes a bit.

use crate::bvh::Tracer;
use crate::neighbours::Neighbours;
use crate::surface::{CHUNK, Mesh, MeshError};
use crate::texels::TexelTable;
use crate::visibility::{OfMesh, PreparedView, Rule, Sample};
use gs_core::camera::CameraError;
use gs_core::{Camera, Image};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Inputs of [`unproject`] that are refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum UnprojectError {
    /// The mesh has bad rows, faces or positions.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The camera of a view is invalid.
    #[error("view {view}: {error}")]
    Camera {
        /// Row of the view among the inputs.
        view: usize,
        /// The fault of the camera.
        error: CameraError,
    },
    /// An image or mask does not have the camera's size or the right channels.
    #[error("view {view}: the {what} is {width}x{height} with {channels} channels; {rule}")]
    Shape {
        /// Row of the view among the inputs.
        view: usize,
        /// Which of both: `image` or `mask`.
        what: &'static str,
        /// Its width in pixels.
        width: usize,
        /// Its height in pixels.
        height: usize,
        /// Its number of channels.
        channels: usize,
        /// What its size or channels must be.
        rule: &'static str,
    },
    /// A setting is out of its domain.
    #[error("unprojection setting `{field}` = {value}: it must be {rule}")]
    Setting {
        /// Name of the setting, as in [`UnprojectConfig`].
        field: &'static str,
        /// Its value, out of the domain.
        value: f64,
        /// The values it may have, as text.
        rule: &'static str,
    },
}

/// An input image with its camera. Pixel values must be finite.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// Intrinsics and pose of the image.
    pub camera: &'a Camera,
    /// Straight (not premultiplied) colours: 3 channels, or 4 whose opacity serves as the mask.
    pub image: &'a Image,
    /// Foreground opacity, 1 channel; replaces the image's own.
    pub mask: Option<&'a Image>,
}

/// How the foreground mask gates and weights samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MaskUse {
    /// Read bilinearly: texels above ½ count, and colours are means over the foreground alone.
    #[default]
    Soft,
    /// Thresholded at ½, then read bilinearly as a weight. Colours mix with the background at the silhouette (DUT's
    /// published code).
    Binary,
    /// The mask is not read; its weight is 1.
    Ignore,
}

impl MaskUse {
    /// Mask value that a texel must exceed.
    pub(crate) fn min_mask(self) -> f32 {
        if self == Self::Soft { 0.5 } else { 0.0 }
    }
}

/// The weight `v_i` of a view that sees a texel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FuseWeight {
    /// `v_i` is the mask value.
    #[default]
    Mask,
    /// `v_i` is the mask value times this power, 0 to 64, of the cosine of incidence.
    CosPow(f32),
    /// Only the view of the largest cosine of incidence counts.
    BestView,
}

/// Reproduces details of DUT's published code that cost accuracy. All off by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Compat {
    /// Read images and depth maps at `p (W − 1)/W` instead of `p − ½`.
    pub align_corners: bool,
    /// Depth maps hold clip-space z of near 1 mm and far 1 km: 2 mm less than the true depth.
    pub clip_depth: bool,
    /// Depth maps are 0, not `∞`, where there is no surface.
    pub zero_background: bool,
}

impl Compat {
    /// Everything as in the published code.
    const PUBLISHED: Self = Self { align_corners: true, clip_depth: true, zero_background: true };

    /// A value of the depth map with these settings.
    pub(crate) fn depth(self, z: f32) -> f32 {
        const NEAR: f32 = 0.001;
        const FAR: f32 = 1000.0;
        match (self.clip_depth, self.zero_background) {
            (_, true) if z.is_infinite() => 0.0,
            (true, _) => (FAR + NEAR) / (FAR - NEAR) * z - 2.0 * FAR * NEAR / (FAR - NEAR),
            _ => z,
        }
    }
}

/// Settings of [`unproject`]; the default rule is [`Rule::Neighbours`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UnprojectConfig {
    /// When a texel counts as hidden. Default: [`Rule::Neighbours`].
    pub rule: Rule,
    /// `δ`: minimum cosine between normal and direction to the camera, -1 to 1. Default: 0.17.
    pub min_cos: f32,
    /// `ε`: depth (or distance) by which texel and depth map may differ, metres. Default: 0.02.
    pub depth_tolerance: f32,
    /// Near plane of every camera, metres. Default: 0.05.
    pub near: f64,
    /// Distance of a ray's origin from the surface, metres. Default: 1e-4.
    pub ray_offset: f32,
    /// How masks are read. Default: [`MaskUse::Soft`].
    pub mask: MaskUse,
    /// Weight `v_i` of a view. Default: [`FuseWeight::Mask`].
    pub fuse: FuseWeight,
    /// Texels of a smaller total weight count as unseen. Default: 1e-3.
    pub min_weight: f32,
    /// Whether [`Texture::by_view`] is filled. Default: no.
    pub keep_views: bool,
    /// Details of the published code to reproduce. Default: none.
    pub compat: Compat,
}

impl Default for UnprojectConfig {
    fn default() -> Self {
        Self {
            rule: Rule::Neighbours,
            min_cos: 0.17,
            depth_tolerance: 0.02,
            near: 0.05,
            ray_offset: 1e-4,
            mask: MaskUse::Soft,
            fuse: FuseWeight::Mask,
            min_weight: 1e-3,
            keep_views: false,
            compat: Compat::default(),
        }
    }
}

impl UnprojectConfig {
    /// The settings and roundings of DUT's published code.
    pub fn dut_code() -> Self {
        Self {
            rule: Rule::Bilinear,
            mask: MaskUse::Binary,
            min_weight: 0.0,
            compat: Compat::PUBLISHED,
            ..Self::default()
        }
    }

    /// HoloChar's settings: cosine above 0.34, nearest pixel within 20 mm in space, plain mean.
    pub fn holochar() -> Self {
        Self { rule: Rule::PointDistance, min_cos: 0.34, mask: MaskUse::Ignore, ..Self::default() }
    }

    /// DVA's settings: bilinear depth within 20 mm, no bound on the angle, plain mean.
    pub fn dva() -> Self {
        Self { rule: Rule::Bilinear, min_cos: -1.0, mask: MaskUse::Ignore, ..Self::default() }
    }

    /// GHG's settings: all texels of the faces that own a pixel, plain mean.
    pub fn ghg() -> Self {
        Self { rule: Rule::FaceTag, min_cos: -1.0, mask: MaskUse::Ignore, ..Self::default() }
    }

    /// Checks that every number is in its domain.
    ///
    /// # Errors
    /// [`UnprojectError::Setting`] for the first value out of its domain.
    pub fn check(&self) -> Result<(), UnprojectError> {
        let power = if let FuseWeight::CosPow(p) = self.fuse { f64::from(p) } else { 0.0 };
        let rows = [
            ("min_cos", f64::from(self.min_cos), -1.0, 1.0, "from -1 to 1"),
            ("depth_tolerance", f64::from(self.depth_tolerance), 1e-9, 1e9, "from 1e-9 to 1e9"),
            ("near", self.near, 1e-6, 1e9, "from 1e-6 to 1e9"),
            ("ray_offset", f64::from(self.ray_offset), 0.0, 1e9, "from 0 to 1e9"),
            ("fuse", power, 0.0, 64.0, "a power from 0 to 64"),
            ("min_weight", f64::from(self.min_weight), 0.0, 1.0, "from 0 to 1"),
        ];
        let wrong = rows.into_iter().find(|(_, value, lo, hi, _)| !(lo..=hi).contains(&value));
        wrong.map_or(Ok(()), |(field, value, _, _, rule)| Err(UnprojectError::Setting { field, value, rule }))
    }
}

/// Colours and weights of the `K` valid texels of a table, in its row order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Texture {
    /// `T_c`: fused colours, 0 where unseen; `K` rows.
    pub colors: Vec<[f32; 3]>,
    /// `Σ_i v_i`: total weight, 0 where unseen; `K` rows.
    pub weight: Vec<f32>,
    /// Number of views that see each texel, 0 where its weight is too small; `K` rows.
    pub seen: Vec<u16>,
    /// `v_i` of each view at each texel (`K · V` values, views fastest); empty unless [`UnprojectConfig::keep_views`].
    pub by_view: Vec<f32>,
    /// Whether each view has at least half of the vertices in front of it; others see nothing.
    pub used: Vec<bool>,
}

impl Texture {
    /// The colours as an `S × S × 3` map, `unseen` off the charts and at unseen texels.
    pub fn map(&self, table: &TexelTable, unseen: f32) -> Image {
        let rows: Vec<[f32; 3]> =
            self.colors.iter().zip(&self.seen).map(|(&c, &n)| if n > 0 { c } else { [unseen; 3] }).collect();
        table.to_map(&rows, unseen)
    }

    /// Share of the valid texels that at least one view sees, 0 to 1.
    pub fn coverage(&self) -> f64 {
        self.seen.iter().filter(|&&n| n > 0).count() as f64 / self.seen.len().max(1) as f64
    }
}

/// Colours the texels of `table` on a posed mesh from `views`. The mesh must have the faces the table was built from.
///
/// # Errors
/// If the mesh, a camera, an image or a setting does not fit or is not finite. No view at all is no error: nothing is seen.
///
/// ```
/// use glam::DVec3;
/// use gs_core::{Camera, Image};
/// use gs_texel::unproject::{UnprojectConfig, View, unproject};
/// use gs_texel::{figure::plate, surface::{Mesh, Topology}, texels::TexelTable};
///
/// let t = plate(1.0, 4).template;
/// let normals = Topology::new(&t.faces, t.vertices.len())?.normals(&t.vertices, &t.faces);
/// let mesh = Mesh { vertices: &t.vertices, normals: &normals, faces: &t.faces };
/// let table = TexelTable::build(&t.faces, &t.uvs, &t.face_uvs, 32, &Default::default())?;
/// let camera = Camera::look_at(64, 64, 0.8, DVec3::Z * 2.0, DVec3::ZERO, DVec3::Y)?;
/// let image = Image::from_data(64, 64, 3, vec![0.25; 64 * 64 * 3]).unwrap();
/// let view = View { camera: &camera, image: &image, mask: None };
/// let texture = unproject(&mesh, &table, &[view], &UnprojectConfig::default())?;
/// assert_eq!(texture.coverage(), 1.0);
/// assert!(texture.colors.as_flattened().iter().all(|c| (c - 0.25).abs() < 1e-6));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn unproject(
    mesh: &Mesh<'_>,
    table: &TexelTable,
    views: &[View<'_>],
    config: &UnprojectConfig,
) -> Result<Texture, UnprojectError> {
    check(mesh, table, views, config)?;
    let views: Vec<PreparedView<'_>> = views.par_iter().map(|view| PreparedView::new(view, mesh, config)).collect();
    let tracer = config.rule.needs_rays().then(|| Tracer::new(mesh.vertices, mesh.faces)).transpose()?;
    let neighbours = (config.rule == Rule::Neighbours).then(|| neighbours(mesh, &views)).transpose()?;
    let fusion = Fusion { mesh, table, views: &views, of_mesh: OfMesh { tracer, neighbours }, config };
    let kept = if config.keep_views { views.len() } else { 0 };
    let mut texture = Texture::default();
    let chunk = |chunk: usize| {
        let rows = chunk * CHUNK..table.len().min((chunk + 1) * CHUNK);
        let mut by_view = vec![0.0; rows.len() * kept];
        let one = |(i, row)| fusion.texel(row, &mut by_view[i * kept..(i + 1) * kept]);
        let texels: Vec<Fused> = rows.enumerate().map(one).collect();
        (texels, by_view)
    };
    let chunks: Vec<(Vec<Fused>, Vec<f32>)> = (0..table.len().div_ceil(CHUNK)).into_par_iter().map(chunk).collect();
    for (texels, by_view) in chunks {
        texture.colors.extend(texels.iter().map(|t| t.color));
        texture.weight.extend(texels.iter().map(|t| t.weight));
        texture.seen.extend(texels.iter().map(|t| t.seen));
        texture.by_view.extend(by_view);
    }
    texture.used = views.iter().map(|v| v.used).collect();
    Ok(texture)
}

fn check(
    mesh: &Mesh<'_>,
    table: &TexelTable,
    views: &[View<'_>],
    config: &UnprojectConfig,
) -> Result<(), UnprojectError> {
    config.check()?;
    mesh.check()?;
    if let Some(&face) = table.tri.iter().max().filter(|&&f| f as usize >= mesh.faces.len()) {
        let want = face as usize + 1;
        return Err(MeshError::Rows { what: "faces", got: mesh.faces.len(), want }.into());
    }
    for (view, v) in views.iter().enumerate() {
        v.camera.check().map_err(|error| UnprojectError::Camera { view, error })?;
        let side = (v.camera.width as usize, v.camera.height as usize);
        let shape = |what, image: &Image, channels: &[usize], rule| {
            let (width, height, c) = image.shape();
            let good = (width, height) == side && channels.contains(&c) && image.data.len() == width * height * c;
            let wrong = UnprojectError::Shape { view, what, width, height, channels: c, rule };
            if good { Ok(()) } else { Err(wrong) }
        };
        shape("image", v.image, &[3, 4], "it must have the camera's size and 3 or 4 channels")?;
        if let Some(mask) = v.mask {
            shape("mask", mask, &[1], "it must have the camera's size and 1 channel")?;
        }
    }
    Ok(())
}

/// Faces near one another: those that a footprint of the coarsest view may show together.
fn neighbours<'a>(mesh: &Mesh<'a>, views: &[PreparedView<'_>]) -> Result<Neighbours<'a>, MeshError> {
    let side = |a: u32, b: u32| f64::from(mesh.vertices[a as usize].distance(mesh.vertices[b as usize]));
    let sides = mesh.faces.iter().map(|&[a, b, c]| side(a, b) + side(b, c) + side(c, a));
    let edge = sides.sum::<f64>() / (3 * mesh.faces.len()).max(1) as f64;
    let pixel = views.iter().map(|v| v.pixel).fold(0.0, f64::max);
    // A tap is up to a pixel and a half from the texel, along the diagonal of the footprint.
    let reach = (1.5 * pixel / edge).ceil();
    let edges = if reach.is_finite() { (reach as usize).saturating_sub(1) } else { 0 };
    Neighbours::within(edges, mesh.faces, mesh.vertices.len())
}

/// The colour of one texel, fused over views.
#[derive(Clone, Copy, Default)]
struct Fused {
    color: [f32; 3],
    weight: f32,
    seen: u16,
}

/// Weights and weighted colours are summed as multiples of 2⁻³⁶.
const FIXED_ONE: f64 = (1u64 << 36) as f64;

/// What the colour of a texel is computed from.
struct Fusion<'a> {
    mesh: &'a Mesh<'a>,
    table: &'a TexelTable,
    views: &'a [PreparedView<'a>],
    of_mesh: OfMesh<'a>,
    config: &'a UnprojectConfig,
}

impl Fusion<'_> {
    /// Fuses the samples of all views at row `k`. Their weights go to `by_view`, unless it is empty.
    fn texel(&self, k: usize, by_view: &mut [f32]) -> Fused {
        let face = self.table.tri[k];
        let p = self.table.at(self.mesh.faces, self.mesh.vertices, k);
        let n = self.table.at(self.mesh.faces, self.mesh.normals, k);
        let mut sum = Sum::default();
        for (i, view) in self.views.iter().enumerate() {
            let Some(sample) = view.sample(p, n, face, self.config, &self.of_mesh) else { continue };
            let weight = sum.add(&sample, self.config);
            if let Some(w) = by_view.get_mut(i) {
                *w = weight;
            }
        }
        sum.mean(self.config)
    }
}

/// Fixed-point sums over views.
#[derive(Default)]
struct Sum {
    colors: [i64; 3],
    weight: i64,
    seen: u16,
    best: Option<Sample>,
}

impl Sum {
    /// Adds a view and returns its weight.
    fn add(&mut self, s: &Sample, config: &UnprojectConfig) -> f32 {
        self.seen += 1;
        let weight = match config.fuse {
            FuseWeight::CosPow(p) => s.mask * s.cos.max(0.0).powf(p),
            FuseWeight::Mask | FuseWeight::BestView => s.mask,
        };
        if config.fuse == FuseWeight::BestView {
            let key = |s: &Sample| [s.cos, s.mask, s.color[0], s.color[1], s.color[2]];
            let better = |old: Sample| key(s).partial_cmp(&key(&old)) == Some(std::cmp::Ordering::Greater);
            if s.mask >= config.min_weight && self.best.is_none_or(better) {
                self.best = Some(*s);
            }
            return weight;
        }
        let weighted = |c: f32| (f64::from(weight) * f64::from(c) * FIXED_ONE) as i64;
        self.colors.iter_mut().zip(s.color).for_each(|(sum, c)| *sum = sum.saturating_add(weighted(c)));
        self.weight += weighted(1.0);
        weight
    }

    fn mean(&self, config: &UnprojectConfig) -> Fused {
        if let Some(best) = self.best {
            return Fused { color: best.color, weight: best.mask, seen: self.seen };
        }
        let weight = (self.weight as f64 / FIXED_ONE) as f32;
        if self.weight == 0 || weight < config.min_weight {
            return Fused::default();
        }
        let color = self.colors.map(|c| (c as f64 / self.weight as f64) as f32);
        Fused { color, weight, seen: self.seen }
    }
}
