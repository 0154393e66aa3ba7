//! A trained scene as files of plain splats: baked at a timestamp, written, read back and scored.
//!
//! Files hold less than methods do. Non-Gaussian kernels become the nearest Gaussians; splats that a network decodes per camera
//! (anchors) become their mean over the training cameras, with spherical harmonics fitted to their colours; motion becomes one
//! file per timestamp. The loss of all this is measured by scoring renders of the bytes read back ([`AsExported`]). Files may be
//! turned so that they stand upright in viewers ([`Baker::turned`]). That a model is drawn anti-aliased is kept by `.ply` and `.spz` files
//! and by pages; `.splat`, `.glb` and `.4dgs` files have no place for it, and their small splats are drawn too opaque.

mod fit;
mod player;
mod rigid;

pub use player::{evaluate_played, frame_times};
pub use rigid::RigidScene;

use crate::segment::SegmentError;
use fit::Fit;
use glam::DVec3;
use gs_core::io::{IoError, Limits, RawSplats, SplatFormat, load_splats, parse_splats, write_splats};
use gs_core::rot::Mat3;
use gs_core::splats::SplatsError;
use gs_core::{Camera, Color, Splats, sh};
use gs_data::View;
use gs_data::{Dataset, Split};
use gs_train::evaluate::{EvalError, EvalReport, Scoring, evaluate_splats};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::timestamp::Timestamp;
use gs4d_player::PlayerError;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Most training cameras that view-dependent splats are averaged over.
pub(crate) const MAX_CAMERAS: usize = 24;
/// Opacity below which a splat is not written: it would change no pixel.
pub(crate) const MIN_OPACITY: f32 = 1.0 / 255.0;

/// A scene that cannot be exported.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The model cannot produce its splats.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// A splat at this time is not valid.
    #[error("the scene at time {time}: {source}")]
    Splats {
        /// Normalised time of the scene.
        time: f32,
        /// The row and column that is not valid, and its value.
        source: SplatsError,
    },
    /// A file cannot be written or read back.
    #[error(transparent)]
    Io(#[from] IoError),
    /// The scene cannot become a clip.
    #[error(transparent)]
    Player(#[from] PlayerError),
    /// Rigid parts cannot be found.
    #[error("no rigid parts: {0}")]
    Parts(#[source] Box<SegmentError>),
    /// No splat is visible at this time.
    #[error("the scene has no visible splat at time {time}")]
    Empty {
        /// Normalised time of the scene.
        time: f32,
    },
}

/// Bakes a model to plain splats.
pub struct Baker<'a> {
    method: &'a Model,
    cameras: Vec<Camera>,
    /// Every pose of a training camera, once: a splat is as large as the nearest sees it.
    poses: Vec<Camera>,
    degree: Option<u8>,
    turn: Option<Mat3<f64>>,
}

/// Degree of the SH that are fitted to colours of a network, unless another is asked for.
const FITTED_DEGREE: u8 = 2;

impl<'a> Baker<'a> {
    /// Bakes over up to 24 of the cameras of `views`, evenly spaced, with SH up to `degree` (at most 3); none: all that there are, and of
    /// colours that depend on the camera in another way degree 2.
    pub fn new(method: &'a Model, views: &[View], degree: Option<u8>) -> Self {
        let cameras = gs_data::evenly(views.len(), MAX_CAMERAS).map(|k| views[k].camera.clone()).collect();
        let mut poses: Vec<Camera> = Vec::new();
        for view in views {
            // Cameras at rest come again with every moment.
            if !poses.contains(&view.camera) {
                poses.push(view.camera.clone());
            }
        }
        Self { method, cameras, poses, degree: degree.map(|d| d.min(sh::MAX_DEGREE)), turn: None }
    }

    /// The same with scenes turned by a rotation, by rows ([`gs_core::io::upright`]).
    pub fn turned(self, turn: Option<Mat3<f64>>) -> Self {
        Self { turn, ..self }
    }

    /// Whether the model is drawn anti-aliased, as its files say where their format can ([`SplatFormat::keeps_antialiased`]).
    pub fn antialiased(&self) -> bool {
        self.method.schedule().antialias
    }

    /// The visible splats (opacity of at least 1/255) at a timestamp, with the raw parameters of files.
    ///
    /// # Errors
    /// If a splat is not valid, or none is visible.
    pub fn bake(&self, at: &Timestamp) -> Result<RawSplats, ExportError> {
        let time = at.t.normalised;
        let splats = self.averaged(at)?.with_plain_kernel();
        let visible: Vec<usize> = (0..splats.len()).filter(|&i| splats.opacities[i] >= MIN_OPACITY).collect();
        if visible.is_empty() {
            return Err(ExportError::Empty { time });
        }
        let raw = RawSplats::from_splats(&splats.rows(&visible));
        let mut raw =
            cut(raw.map_err(|source| ExportError::Splats { time, source })?, self.degree.unwrap_or(sh::MAX_DEGREE));
        raw.antialiased = self.antialiased();
        Ok(match &self.turn {
            Some(turn) => raw.mapped(turn),
            None => raw,
        })
    }

    /// A scene of a file as the data have it: turned back.
    fn turned_back(&self, raw: RawSplats) -> RawSplats {
        match self.turn {
            Some(turn) => raw.mapped(&std::array::from_fn(|r| turn.map(|row| row[r]))),
            None => raw,
        }
    }

    /// The splats with no more SH than asked for.
    fn truncated(&self, mut splats: Splats) -> Splats {
        let (width, most) = (splats.color.width(), self.degree.unwrap_or(sh::MAX_DEGREE));
        if let Color::Sh { degree, coeffs } = &mut splats.color
            && most < *degree
        {
            *coeffs = coeffs.chunks_exact(width).flat_map(|row| row[..3 * sh::coeffs(most)].iter().copied()).collect();
            *degree = most;
        }
        splats
    }

    /// The splats, averaged over the cameras if they depend on the camera.
    fn averaged(&self, at: &Timestamp) -> Result<Splats, MethodError> {
        let Some((first, others)) = self.cameras.split_first() else { return Ok(Splats::default()) };
        let splats = self.method.all_splats(at, first)?;
        // Compared for one other camera only.
        let depends = match others.last() {
            Some(camera) => self.method.all_splats(at, camera)? != splats,
            None => false,
        };
        if !depends {
            return Ok(splats);
        }
        let mut fit = Fit::new(&splats, self.degree.unwrap_or(FITTED_DEGREE));
        for camera in &self.cameras {
            fit.add(&self.method.all_splats(at, camera)?, camera);
        }
        Ok(fit.finish())
    }
}

/// The direction that is up in most of the views, a unit vector: the mean of what is up in each image. None without views, or if they
/// have none in common.
pub fn mean_up(views: &[View]) -> Option<DVec3> {
    let sum: DVec3 = views.iter().map(|v| -v.camera.rotation.row(1)).sum();
    (sum.length() > 0.1 * views.len() as f64).then(|| sum.normalize())
}

/// The splats with SH truncated to `degree`; unchanged if they have no more.
pub fn cut(mut raw: RawSplats, degree: u8) -> RawSplats {
    if degree < raw.degree {
        let kept = 3 * sh::coeffs(degree);
        raw.sh = raw.sh.chunks_exact(raw.sh_width()).flat_map(|row| row[..kept].iter().copied()).collect();
        raw.degree = degree;
    }
    raw
}

/// A method as its files render it: a timestamp that a written file stands for is read from that file, any other is baked, written and
/// read back before it is rendered.
pub struct AsExported<'a> {
    baker: Baker<'a>,
    format: SplatFormat,
    files: Vec<(f32, PathBuf)>,
    /// Splats of the times that were asked for, as bits; at most [`MAX_CACHED`] splats.
    cache: Mutex<HashMap<u32, Splats>>,
}

/// Splats that are kept to be shown again: a gigabyte with harmonics of degree 3.
const MAX_CACHED: usize = 4_000_000;
/// Times that differ by no more are the same, normalised.
const SAME_TIME: f32 = 1e-5;

impl<'a> AsExported<'a> {
    /// The files of a baker in a format.
    pub fn new(baker: Baker<'a>, format: SplatFormat) -> Self {
        Self { baker, format, files: Vec::new(), cache: Mutex::default() }
    }

    /// The same with files that are written: of several, the nearest in time stands for every timestamp from the first to
    /// the last, as a player would show it; a single one for its own time.
    pub fn with_files(self, mut files: Vec<(f32, PathBuf)>) -> Self {
        files.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self { files, ..self }
    }

    /// The file that stands for a time, normalised.
    pub fn file_at(&self, time: f32) -> Option<&Path> {
        let (first, last) = (self.files.first()?.0, self.files.last()?.0);
        let within = (first - SAME_TIME..=last + SAME_TIME).contains(&time);
        let nearest = self.files.iter().min_by(|a, b| (a.0 - time).abs().total_cmp(&(b.0 - time).abs()));
        nearest.filter(|_| within).map(|f| f.1.as_path())
    }

    /// The splats of a timestamp, through the bytes of a file.
    ///
    /// # Errors
    /// If they cannot be baked, written or read back.
    pub fn splats(&self, at: &Timestamp) -> Result<Splats, ExportError> {
        let mut cache = self.cache.lock().unwrap_or_else(PoisonError::into_inner);
        let key = at.t.normalised.to_bits();
        if let Some(splats) = cache.get(&key) {
            return Ok(splats.clone());
        }
        let splats = match self.file_at(at.t.normalised) {
            Some(file) => load_splats(file, &Limits::default())?,
            None => self.round_trip(at)?,
        };
        let splats = self.baker.turned_back(splats).to_splats();
        let splats = splats.map_err(|source| ExportError::Splats { time: at.t.normalised, source })?;
        if cache.values().map(Splats::len).sum::<usize>() + splats.len() > MAX_CACHED {
            cache.clear();
        }
        cache.insert(key, splats.clone());
        Ok(splats)
    }

    /// Scores of the files on a split, as [`evaluate_with`](gs_train::evaluate::evaluate_with) scores the method, drawn as programs draw
    /// that know splats alone: anti-aliased where the files say so.
    ///
    /// # Errors
    /// Those of the evaluation, and of [`Self::splats`].
    pub fn evaluate(&self, dataset: &Dataset, split: Split, scoring: &Scoring<'_>) -> Result<EvalReport, EvalError> {
        let splats = |at: &Timestamp, _: &Camera| self.splats(at).map_err(|e| MethodError::Render(e.to_string()));
        let plain = Some(self.baker.antialiased() && self.format.keeps_antialiased());
        evaluate_splats(self.baker.method, &splats, dataset, split, &Scoring { plain, ..*scoring })
    }

    fn round_trip(&self, at: &Timestamp) -> Result<RawSplats, ExportError> {
        let mut bytes = Vec::new();
        write_splats(self.format, &self.baker.bake(at)?, &mut bytes)?;
        let name = format!("timestamp.{}", self.format.extension());
        Ok(parse_splats(&bytes, &name, &Limits::default())?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::io::RawSplats;

    #[test]
    fn a_lower_degree_keeps_the_first_coefficients() {
        let sh: Vec<f32> = (0..2 * 27).map(|k| k as f32).collect();
        let raw = RawSplats { degree: 2, sh, ..RawSplats::default() };
        let less = cut(raw.clone(), 1);
        assert_eq!((less.degree, less.sh.len()), (1, 24));
        assert_eq!((less.sh[0], less.sh[12]), (0.0, 27.0));
        assert_eq!(cut(raw.clone(), 3), raw);
    }
}
