//! Initial points made on request and kept in the data folder: from a COLMAP model, depth maps, the visual hull or at
//! random.
//!
//! [`Dataset::start`] makes them, [`write_start`] writes `start.ply` and the section `[start]` of `scene.toml`, which
//! [`Dataset::open`] reads. The points are a function of data, count, box and seed.

use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use gs_core::Rng;
use gs_core::io::write_file;
use serde::Serialize;

use super::cache::ImageCache;
use super::error::DataError;
use super::files::read_text;
use super::{Dataset, PointCloud, View, colmap, ply, scene_file};

/// File of the points in the data folder.
const POINTS: &str = "start.ply";
/// Most depth maps read; of more, an even selection.
const MAX_DEPTHS: usize = 100;
/// Random pixels tried per point wanted, before depth maps count as empty.
const TRIES_PER_POINT: usize = 20;
/// A model of whose points a smaller share is visible is taken to be in another frame than the poses.
const MIN_VISIBLE: f64 = 0.5;

/// Source of initial points: `gs4d init --from`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum StartFrom {
    /// The points of the data set or of a COLMAP model in its folder.
    Colmap,
    /// Depth maps of training views ([`View::depth`]).
    Depth,
    /// The visual hull of alpha or masks ([`super::hull`]).
    Hull,
    /// Uniform in [`Dataset::scene_bounds`], all of them grey.
    Random,
}

impl StartFrom {
    /// All sources, the most accurate first.
    pub const ALL: [Self; 4] = [Self::Colmap, Self::Depth, Self::Hull, Self::Random];

    /// The name of the source in lower case, for example `colmap`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Colmap => "colmap",
            Self::Depth => "depth",
            Self::Hull => "hull",
            Self::Random => "random",
        }
    }

    /// Why a data set can have no points of this source.
    fn lacks(self) -> &'static str {
        match self {
            Self::Colmap => "the data have neither points nor a COLMAP model with points in the frame of its poses",
            Self::Depth => "the training views have no depth",
            Self::Hull => "the images have neither alpha nor masks that agree anywhere",
            Self::Random => "the scene box is empty",
        }
    }
}

/// Initial points and where they come from.
#[derive(Clone, Debug, PartialEq)]
pub struct Start {
    /// The source of the points.
    pub from: StartFrom,
    /// The points: positions and colours.
    pub cloud: PointCloud,
    /// Lower and upper corner of a scene box for [`write_start`] to keep; [`Dataset::start`] gives none.
    pub bounds: Option<[Vec3; 2]>,
}

/// Lower and upper corner of the cube around the origin with this half side.
///
/// ```
/// assert_eq!(gs_data::cube(1.5), [glam::Vec3::splat(-1.5), glam::Vec3::splat(1.5)]);
/// ```
pub fn cube(half: f32) -> [Vec3; 2] {
    [Vec3::splat(-half), Vec3::splat(half)]
}

impl Dataset {
    /// At most `n` initial points, from the source named or the first of [`StartFrom::ALL`] that has any.
    ///
    /// # Errors
    /// `data.option` if the source has no points; those of reading images, depth maps or models.
    pub fn start(&self, from: Option<StartFrom>, n: usize, seed: u64) -> Result<Start, DataError> {
        let sources = from.map_or(StartFrom::ALL.to_vec(), |f| vec![f]);
        for &source in &sources {
            if let Some(cloud) = self.start_from(source, n, seed)?.filter(|c| !c.positions.is_empty()) {
                return Ok(Start { from: source, cloud, bounds: None });
            }
        }
        let source = sources[0];
        Err(DataError::Option { name: "--from", value: source.name().into(), rule: source.lacks().into() })
    }

    fn start_from(&self, source: StartFrom, n: usize, seed: u64) -> Result<Option<PointCloud>, DataError> {
        match source {
            StartFrom::Colmap => {
                let points = if self.points.is_some() { self.points.clone() } else { colmap::points_beside(self)? };
                let seen = points.filter(|p| self.seen_share(&p.positions) >= MIN_VISIBLE);
                Ok(seen.map(|p| super::initial::subset(&p, n, seed)))
            }
            StartFrom::Depth => self.depth_points(n, seed),
            StartFrom::Hull => self.hull_points(n, seed),
            StartFrom::Random => Ok(Some(super::initial::uniform(self.scene_bounds(), n, seed))),
        }
    }

    /// Share in 0..1 of the points that project into the image of at least two training views (of one, if there is one only). Of
    /// more than 5000 points, an even selection of 5000 is tested.
    pub fn seen_share(&self, points: &[Vec3]) -> f64 {
        const MOST: usize = 5000;
        let enough = self.train.len().min(2);
        let seen = |p: Vec3| self.train.iter().filter(|v| sees(v, p.as_dvec3())).take(enough).count() == enough;
        let found = super::evenly(points.len(), MOST).filter(|k| seen(points[*k])).count();
        found as f64 / points.len().clamp(1, MOST) as f64
    }

    /// Unprojected random pixels of depth maps.
    fn depth_points(&self, n: usize, seed: u64) -> Result<Option<PointCloud>, DataError> {
        let with: Vec<&View> = self.train.iter().filter(|v| v.depth.is_some()).collect();
        if with.is_empty() {
            return Ok(None);
        }
        let count = with.len().min(MAX_DEPTHS).min(n.max(1));
        let cache = ImageCache::new(0, 1.0).with_max_image_mib(self.max_image_mib);
        let mut cloud = PointCloud::default();
        for (k, i) in super::spread(with.len(), count).into_iter().enumerate() {
            let view = with[i];
            let (Some(depth), image) = (cache.depth(view)?, cache.get(view)?) else { continue };
            let wanted = (k + 1) * n / count - k * n / count;
            let mut random = Rng::new(seed, "data.depth", 0, k as u64);
            let mut left = TRIES_PER_POINT * wanted;
            let end = cloud.positions.len() + wanted;
            while cloud.positions.len() < end && left > 0 {
                left -= 1;
                let (x, y) = (random.below(view.camera.width) as usize, random.below(view.camera.height) as usize);
                let [r, g, b, a] = image.pixel(x, y);
                let z = f64::from(depth.pixel(x, y)[0]);
                if z > 0.0 && a > 127 {
                    cloud.positions.push(at_depth(view, x, y, z).as_vec3());
                    cloud.colors.push([r, g, b].map(|c| f32::from(c) / 255.0));
                }
            }
        }
        Ok(Some(cloud))
    }
}

/// Whether a point projects into the image of a view.
fn sees(v: &View, p: DVec3) -> bool {
    let c = v.camera.to_camera(p);
    let at = v.camera.to_pixel(c);
    let inside = |x: f64, side: u32| x >= 0.0 && x < f64::from(side);
    c.z > 0.0 && inside(at.x, v.camera.width) && inside(at.y, v.camera.height)
}

/// World position of the centre of a pixel at camera-space depth `z`.
fn at_depth(v: &View, x: usize, y: usize, z: f64) -> DVec3 {
    let c = &v.camera;
    let ray = DVec3::new((x as f64 + 0.5 - c.cx) / c.fx, (y as f64 + 0.5 - c.cy) / c.fy, 1.0);
    c.rotation.transpose() * (ray * z - c.translation)
}

/// Writes points as `start.ply` and states them, and the box if there is one, in the section `[start]` of `scene.toml`. Other
/// sections of that file stay as they are. Returns the paths of both files.
///
/// # Errors
/// `io.exists` if there are such points already and `overwrite` is not set; those of reading and writing.
pub fn write_start(dir: &Path, start: &Start, overwrite: bool) -> Result<[PathBuf; 2], DataError> {
    let (points, scene) = (dir.join(POINTS), dir.join(scene_file::NAME));
    let old = if scene.exists() { read_text(&scene, scene_file::MAX_BYTES)? } else { String::new() };
    let had = scene_file::read(dir)?.start;
    if !overwrite && (points.exists() || had.points.is_some() || had.bounds.is_some()) {
        return Err(DataError::Occupied { path: if points.exists() { points } else { scene } });
    }
    let text = with_section(&old, start);
    toml::from_str::<toml::Table>(&text).map_err(|e| DataError::syntax(&scene, String::new(), e.message()))?;
    let write_points = |out: &mut dyn std::io::Write| ply::write_points(&start.cloud, out);
    write_file(&points, overwrite, write_points).map_err(|e| DataError::unwritten(&points, e))?;
    write_file(&scene, true, |out| out.write_all(text.as_bytes())).map_err(|e| DataError::unwritten(&scene, e))?;
    Ok([points, scene])
}

/// Whether `scene.toml` of a folder names initial points, as after [`write_start`].
///
/// # Errors
/// Those of reading it.
pub fn has_start_points(dir: &Path) -> Result<bool, DataError> {
    Ok(scene_file::read(dir)?.start.points.is_some())
}

/// The text with its section `[start]` replaced, or with one at its end.
fn with_section(old: &str, start: &Start) -> String {
    let mut inside = false;
    let mut kept = String::new();
    for line in old.lines() {
        if let Some(name) = scene_file::header(line) {
            inside = name == "start";
        }
        if !inside {
            kept.push_str(line);
            kept.push('\n');
        }
    }
    if !kept.trim().is_empty() {
        kept.push('\n');
    }
    kept.push_str(&format!("[start]\npoints = \"{POINTS}\"   # from {}\n", start.from.name()));
    if let Some(corners) = start.bounds {
        kept.push_str(&format!("bounds = {:?}\n", corners.map(|c| c.to_array())));
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_section_is_replaced_whole_and_others_stay() {
        let start =
            Start { from: StartFrom::Random, cloud: PointCloud::default(), bounds: Some([Vec3::ZERO, Vec3::ONE]) };
        let old = "[start] # box\nbounds = [\n  [-1, -1, -1],\n  [1, 1, 1],\n]\n\n[time]\nboundary = 0.75\n";
        let text = with_section(old, &start);
        let table: toml::Table = toml::from_str(&text).unwrap();
        assert_eq!(table["time"]["boundary"].as_float(), Some(0.75));
        assert_eq!(table["start"]["bounds"][1][0].as_float(), Some(1.0));
        assert_eq!(text.matches("bounds").count(), 1, "{text}");
    }
}
