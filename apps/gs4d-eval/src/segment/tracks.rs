//! Scene motion velocity and acceleration of a trained scene ([`gs_physics::complexity`]).
//!
//! Instead of a learned tracker, pixels on a lattice are tracked by the splats they show at the first time: the mean of their
//! displacements by blending weight ([`model_motion`]), also where these splats are occluded later.

use glam::DVec2;
use gs_core::{Camera, cast};
use gs_physics::complexity::{Complexity, ImageTracks, STATIC_PATH, complexity};

use crate::stage_motion::{Anchor, Motion, model_motion};
use gs_data::{Dataset, moments::distinct};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::renderer::Renderer;
use gs_train::timestamp::Timestamp;

/// Most pixels tracked per view (the paper tracks 40 000).
pub(crate) const MAX_POINTS: usize = 10_000;
/// Most cameras and times.
const MAX_CAMERAS: usize = 4;
const MAX_TIMES: usize = 61;

/// The complexity of a model's motion as seen by the training cameras (at most 4, and at most 61 of the training moments). Of more moments
/// every second, third and so on is seen, and the change of velocity is that from one moment of the data to the next: a share of what is
/// measured.
///
/// # Errors
/// If the model cannot produce its splats.
pub fn scene_complexity(method: &Model, data: &Dataset) -> Result<Complexity, MethodError> {
    let times = distinct(&data.train);
    let stride = times.len().div_ceil(MAX_TIMES).max(1);
    let times: Vec<f32> = times.into_iter().step_by(stride).collect();
    let mut ids: Vec<u32> = data.train.iter().map(|v| v.camera_id).collect();
    ids.sort_unstable();
    ids.dedup();
    let chosen = gs_data::evenly(ids.len(), MAX_CAMERAS).map(|k| ids[k]);
    let cameras = chosen.filter_map(|id| data.train.iter().find(|v| v.camera_id == id)).map(|v| v.camera.clone());
    let found = complexity(&tracks(method, &cameras.collect::<Vec<_>>(), &times, MAX_POINTS)?, STATIC_PATH);
    Ok(Complexity { acceleration: found.acceleration / stride as f64, ..found })
}

/// Tracks at most `points` pixels of each camera, on a lattice, from the first time on.
pub fn tracks(
    method: &Model,
    cameras: &[Camera],
    times: &[f32],
    points: usize,
) -> Result<Vec<ImageTracks>, MethodError> {
    let (Some(start), Some(camera)) = (times.first(), cameras.first()) else { return Ok(Vec::new()) };
    let mut renderer = Renderer::new(method.raster_options([0.0; 3]));
    let mut lattices: Vec<Lattice> = cameras.iter().map(|c| Lattice::new(c, points)).collect();
    let first = method.all_splats(&Timestamp::normalised(*start), camera)?;
    for time in times {
        let mut later = first.clone();
        later.means = method.all_splats(&Timestamp::normalised(*time), camera)?.means;
        for (lattice, camera) in lattices.iter_mut().zip(cameras) {
            let motion = model_motion(&mut renderer, camera, &later, &first.means, Anchor::Earlier)?;
            lattice.add(&motion);
        }
    }
    Ok(lattices.into_iter().map(|lattice| lattice.finish(times)).collect())
}

/// The tracked pixels of one camera.
struct Lattice {
    size: [usize; 2],
    pixels: Vec<usize>,
    tracks: Vec<Vec<Option<DVec2>>>,
}

impl Lattice {
    fn new(camera: &Camera, points: usize) -> Self {
        let [width, height] = [camera.width as usize, camera.height as usize];
        let stride = cast::to_usize(((width * height) as f64 / points.max(1) as f64).sqrt().ceil()).max(1);
        let lattice = |side: usize| (stride / 2..side).step_by(stride);
        let pixels: Vec<usize> = lattice(height).flat_map(|y| lattice(width).map(move |x| y * width + x)).collect();
        Self { size: [width, height], tracks: vec![Vec::new(); pixels.len()], pixels }
    }

    /// Adds the position of each tracked point at the next time.
    fn add(&mut self, motion: &Motion) {
        let (seen, width) = (motion.seen(), self.size[0]);
        for (track, &k) in self.tracks.iter_mut().zip(&self.pixels) {
            let moved = DVec2::new(motion.flow.u[k].into(), motion.flow.v[k].into());
            let start = DVec2::new((k % width) as f64 + 0.5, (k / width) as f64 + 0.5);
            track.push(seen[k].then_some(start + moved));
        }
    }

    fn finish(mut self, times: &[f32]) -> ImageTracks {
        self.tracks.retain(|track| track.iter().any(Option::is_some));
        let times = times.iter().map(|t| f64::from(*t)).collect();
        ImageTracks { size: self.size.map(|s| s as f64), times, tracks: self.tracks }
    }
}
