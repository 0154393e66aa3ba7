//! Colours of the texels from the cameras that see them: `T_c = Σ_i v_i I_i / Σ_i v_i` (DUT).
//!
//! Sums are of whole numbers, so neither the order of the views nor the number of threads changes a bit.

mod update;

pub use update::Redone;

use crate::bvh::Tracer;
use crate::surface::{CHUNK, Mesh, MeshError};
use crate::texels::TexelTable;
use crate::visibility::{Eye, Rule, Sighting};
use crate::zbuffer::DepthMap;
use glam::Vec3;
use gs_core::camera::CameraError;
use gs_core::{Camera, Image};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// What cannot be unprojected.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum UnprojectError {
    /// The mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A camera.
    #[error("view {view}: {error}")]
    Camera {
        /// Row of the view.
        view: usize,
        /// What is wrong.
        error: CameraError,
    },
    /// An image or mask that does not fit its camera.
    #[error("view {view}: the {what} is {width}x{height} with {channels} channels; {rule}")]
    Shape {
        /// Row of the view.
        view: usize,
        /// Image or mask.
        what: &'static str,
        /// Its width.
        width: usize,
        /// Its height.
        height: usize,
        /// Its channels.
        channels: usize,
        /// What it must be.
        rule: &'static str,
    },
    /// A setting out of its domain.
    #[error("unprojection setting `{field}` = {value}: it must be {rule}")]
    Setting {
        /// Its name.
        field: &'static str,
        /// Its value.
        value: f64,
        /// Its domain.
        rule: &'static str,
    },
    /// An update of another mesh, table or set of views.
    #[error("the texture to be updated is of {was} {what}, now there are {now}; unproject anew")]
    Other {
        /// Texels, vertices or views.
        what: &'static str,
        /// Then.
        was: usize,
        /// Now.
        now: usize,
    },
}

/// An image with its camera. Images are finite (readers see to that).
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// Straight colours, 3 channels, or 4 with opacity as the mask.
    pub image: &'a Image,
    /// Foreground, 1 channel, in place of the image's opacity.
    pub mask: Option<&'a Image>,
}

/// How the mask is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MaskUse {
    /// As it is: texels above ½ count, colours are those of the foreground alone.
    #[default]
    Soft,
    /// Cut at ½, then read bilinearly as a weight; colours mix with what lies beyond the silhouette (the authors' code).
    Binary,
    /// Not at all.
    Ignore,
}

impl MaskUse {
    /// Opacity a texel must exceed.
    pub(crate) fn least(self) -> f32 {
        if self == Self::Soft { 0.5 } else { 0.0 }
    }
}

/// The weight `v_i` of a view that sees a texel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FuseWeight {
    /// The mask.
    #[default]
    Mask,
    /// The mask times this power of the cosine of incidence.
    CosPow(f32),
    /// The view of the largest cosine alone.
    BestView,
}

/// Behaviour of the authors' code that costs accuracy; all off unless it is to be reproduced.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Compat {
    /// Images and depth maps are read at `p (W − 1)/W` instead of `p − ½`.
    pub align_corners: bool,
    /// Depth maps hold clip-space z of near 1 mm and far 1 km: 2 mm less than the truth.
    pub clip_depth: bool,
    /// Depth maps are 0 where nothing is.
    pub zero_background: bool,
}

impl Compat {
    /// Everything as in the authors' code.
    pub const AUTHORS: Self = Self { align_corners: true, clip_depth: true, zero_background: true };

    /// A value of the depth map as that code has it.
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

/// Settings of the unprojection.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UnprojectConfig {
    /// How occlusion is decided.
    pub rule: Rule,
    /// `δ`: least cosine between normal and direction to the camera.
    pub min_cos: f32,
    /// `ε`: depth (or distance) by which texel and depth map may differ, metres.
    pub depth_tolerance: f32,
    /// Nothing nearer to a camera counts, metres.
    pub near: f64,
    /// Rays start this far above the surface, metres.
    pub ray_offset: f32,
    /// How the mask is used.
    pub mask: MaskUse,
    /// How views are weighted.
    pub fuse: FuseWeight,
    /// Texels of a smaller total weight are unseen.
    pub min_weight: f32,
    /// Keep the weight of every view at every texel.
    pub keep_views: bool,
    /// Behaviour of the authors' code.
    pub compat: Compat,
}

impl Default for UnprojectConfig {
    fn default() -> Self {
        Self {
            rule: Rule::FourTap,
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
    /// As the authors of DUT run it, with all their roundings.
    pub fn dut_code() -> Self {
        Self {
            rule: Rule::Bilinear,
            mask: MaskUse::Binary,
            min_weight: 0.0,
            compat: Compat::AUTHORS,
            ..Self::default()
        }
    }

    /// HoloChar's rule: cosine at least 0.34, nearest pixel within 20 mm in space, plain mean.
    pub fn holochar() -> Self {
        Self { rule: Rule::PointDistance, min_cos: 0.34, mask: MaskUse::Ignore, ..Self::default() }
    }

    /// DVA's rule: bilinear depth within 20 mm, no gate on the angle, plain mean.
    pub fn dva() -> Self {
        Self { rule: Rule::Bilinear, min_cos: -1.0, mask: MaskUse::Ignore, ..Self::default() }
    }

    /// GHG's rule: all texels of the faces that own a pixel, plain mean.
    pub fn ghg() -> Self {
        Self { rule: Rule::FaceTag, min_cos: -1.0, mask: MaskUse::Ignore, ..Self::default() }
    }

    /// Verifies every number.
    ///
    /// # Errors
    /// Names the first out of its domain.
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

/// What the cameras say about the `K` valid texels of a table.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// `T_c`, 0 where unseen; `K` rows.
    pub colors: Vec<[f32; 3]>,
    /// `Σ v`; `K` rows.
    pub weight: Vec<f32>,
    /// Views that see each texel, 0 where it is unseen; `K` rows.
    pub seen: Vec<u16>,
    /// Weight of each view at each texel before fusing (`K · V`, views fastest), if it was to be kept.
    pub by_view: Vec<f32>,
    /// Views with enough of the mesh before them.
    pub used: Vec<bool>,
    /// The mesh that was looked at, and what was drawn of it.
    state: State,
}

/// What an update starts from.
#[derive(Clone, Debug, PartialEq)]
struct State {
    vertices: Vec<Vec3>,
    normals: Vec<Vec3>,
    depths: Vec<Option<DepthMap>>,
}

impl Texture {
    /// The colours as an `S × S × 3` map, `unseen` off the charts and where no camera looks.
    pub fn map(&self, table: &TexelTable, unseen: f32) -> Image {
        let rows: Vec<[f32; 3]> =
            self.colors.iter().zip(&self.seen).map(|(&c, &n)| if n > 0 { c } else { [unseen; 3] }).collect();
        table.to_map(&rows, unseen)
    }

    /// Share of the valid texels that some camera sees.
    pub fn coverage(&self) -> f64 {
        self.seen.iter().filter(|&&n| n > 0).count() as f64 / self.seen.len().max(1) as f64
    }

    /// The depth map of view `i`, if the rule drew one.
    pub fn depth(&self, i: usize) -> Option<&DepthMap> {
        self.state.depths.get(i).and_then(Option::as_ref)
    }
}

/// Colours the texels of `table` on a posed mesh from `views`. The mesh's faces are the table's.
///
/// # Errors
/// Meshes, cameras, images or settings that do not fit or are not finite. No view at all is no error: nothing is seen.
pub fn unproject(
    mesh: &Mesh<'_>,
    table: &TexelTable,
    views: &[View<'_>],
    config: &UnprojectConfig,
) -> Result<Texture, UnprojectError> {
    check(mesh, table, views, config)?;
    let mut eyes: Vec<Eye<'_>> = views.iter().map(Eye::new).collect();
    eyes.par_iter_mut().zip(views).for_each(|(eye, view)| eye.look(view, mesh, config));
    let tracer = tracer_of(mesh, config)?;
    let mut texture = Texture {
        colors: vec![[0.0; 3]; table.len()],
        weight: vec![0.0; table.len()],
        seen: vec![0; table.len()],
        by_view: vec![0.0; if config.keep_views { table.len() * views.len() } else { 0 }],
        used: eyes.iter().map(|e| e.used).collect(),
        state: State { vertices: mesh.vertices.to_vec(), normals: mesh.normals.to_vec(), depths: Vec::new() },
    };
    let rows: Vec<u32> = (0..table.len() as u32).collect();
    texture.fuse(&Gaze { mesh, table, eyes: &eyes, tracer: tracer.as_ref(), config }, &rows);
    texture.state.depths = eyes.into_iter().map(|e| e.depth).collect();
    Ok(texture)
}

fn tracer_of(mesh: &Mesh<'_>, config: &UnprojectConfig) -> Result<Option<Tracer>, MeshError> {
    config.rule.needs_rays().then(|| Tracer::new(mesh.vertices, mesh.faces)).transpose()
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

/// Everything a texel is looked at with.
struct Gaze<'a> {
    mesh: &'a Mesh<'a>,
    table: &'a TexelTable,
    eyes: &'a [Eye<'a>],
    tracer: Option<&'a Tracer>,
    config: &'a UnprojectConfig,
}

/// What is said about one texel.
#[derive(Clone, Copy, Default)]
struct Said {
    color: [f32; 3],
    weight: f32,
    seen: u16,
}

impl Texture {
    /// Looks at the given rows of the table.
    fn fuse(&mut self, gaze: &Gaze<'_>, rows: &[u32]) {
        let views = if gaze.config.keep_views { gaze.eyes.len() } else { 0 };
        let of_chunk = |rows: &[u32]| {
            let mut by_view = vec![0.0; rows.len() * views];
            let mut said = Vec::with_capacity(rows.len());
            for (i, &row) in rows.iter().enumerate() {
                said.push(gaze.texel(row as usize, &mut by_view[i * views..(i + 1) * views]));
            }
            (said, by_view)
        };
        let chunks: Vec<(Vec<Said>, Vec<f32>)> = rows.par_chunks(CHUNK).map(of_chunk).collect();
        for (rows, (said, by_view)) in rows.chunks(CHUNK).zip(chunks) {
            for (i, (&row, said)) in rows.iter().zip(said).enumerate() {
                let row = row as usize;
                (self.colors[row], self.weight[row], self.seen[row]) = (said.color, said.weight, said.seen);
                self.by_view[row * views..(row + 1) * views].copy_from_slice(&by_view[i * views..(i + 1) * views]);
            }
        }
    }
}

/// Weights and weighted colours are summed as multiples of 2⁻³⁶.
const UNIT: f64 = (1u64 << 36) as f64;

impl Gaze<'_> {
    /// Fuses what all views say about row `k`; `by_view` gets their weights, if it has room.
    fn texel(&self, k: usize, by_view: &mut [f32]) -> Said {
        let face = self.table.tri[k];
        let p = self.table.at(self.mesh.faces, self.mesh.vertices, k);
        let n = self.table.at(self.mesh.faces, self.mesh.normals, k);
        let mut sum = Sum::default();
        for (i, eye) in self.eyes.iter().enumerate() {
            let Some(sighting) = eye.sees(p, n, face, self.config, self.tracer) else { continue };
            let weight = sum.add(&sighting, self.config.fuse);
            if let Some(w) = by_view.get_mut(i) {
                *w = weight;
            }
        }
        sum.mean(self.config)
    }
}

/// What views have said so far.
#[derive(Default)]
struct Sum {
    colors: [i64; 3],
    weight: i64,
    seen: u16,
    best: Option<Sighting>,
}

impl Sum {
    /// Adds a view and returns its weight.
    fn add(&mut self, s: &Sighting, fuse: FuseWeight) -> f32 {
        self.seen += 1;
        let weight = match fuse {
            FuseWeight::CosPow(p) => s.mask * s.cos.max(0.0).powf(p),
            FuseWeight::Mask | FuseWeight::BestView => s.mask,
        };
        if fuse == FuseWeight::BestView {
            let key = |s: &Sighting| [s.cos, s.mask, s.color[0], s.color[1], s.color[2]];
            let better = |old: Sighting| key(s).partial_cmp(&key(&old)) == Some(std::cmp::Ordering::Greater);
            if self.best.is_none_or(better) {
                self.best = Some(*s);
            }
            return weight;
        }
        let weighted = |c: f32| (f64::from(weight) * f64::from(c) * UNIT) as i64;
        self.colors.iter_mut().zip(s.color).for_each(|(sum, c)| *sum = sum.saturating_add(weighted(c)));
        self.weight += weighted(1.0);
        weight
    }

    fn mean(&self, config: &UnprojectConfig) -> Said {
        if let Some(best) = self.best {
            return Said { color: best.color, weight: best.mask, seen: self.seen };
        }
        let weight = (self.weight as f64 / UNIT) as f32;
        if self.weight == 0 || weight < config.min_weight {
            return Said::default();
        }
        let color = self.colors.map(|c| (c as f64 / self.weight as f64) as f32);
        Said { color, weight, seen: self.seen }
    }
}
