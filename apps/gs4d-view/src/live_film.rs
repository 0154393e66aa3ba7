//! A film of a person that arrives while it is shown: each new frame goes through a trained avatar.
//!
//! ```text
//! folder ── newest frame ──▶ textures, networks ──▶ splats ──▶ first show of the server ──▶ browsers
//! ```

use crate::server::Server;
use crate::stage::Show;
use gs_data::avatar::layout::{Arrivals, ArrivedFrame, PosesFrom};
use gs_data::{DataError, Dataset};
use gs_method_texel::{Dut, FrameError};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::timestamp::Timestamp;
use gs4d_run::{OpenRun, RunError};
use std::path::Path;
use std::time::{Duration, Instant};

/// Why a film cannot be shown, or a frame of it.
#[derive(Debug, thiserror::Error)]
pub enum LiveFilmError {
    /// The run is of a method that knows no people.
    #[error("the run is of the method {0}, which is not one of people")]
    NoPerson(String),
    /// The data of the run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The folder, or a frame in it.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The trained avatar.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// Splats of a frame.
    #[error("frame {0}: {1}")]
    Frame(u32, #[source] FrameError),
}

/// A trained avatar and the folder in which frames arrive.
pub struct LiveFilm {
    model: Model,
    arrivals: Arrivals,
    film: Dataset,
}

/// A frame that was shown, and how long it took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShownFrame {
    /// Its number.
    pub number: u32,
    /// Older frames that were passed over.
    pub passed_over: usize,
    /// From its last file to when it was looked for.
    pub waited: Duration,
    /// Listing the folder, reading and decoding.
    pub read: Duration,
    /// Textures, networks and splats.
    pub computed: Duration,
}

impl LiveFilm {
    /// Frames that arrive in `dir`, through the avatar of a run.
    ///
    /// # Errors
    /// If the run is not of a person, or its data or the folder cannot be read.
    pub fn open(run: OpenRun, dir: &Path, poses: PosesFrom) -> Result<Self, LiveFilmError> {
        if run.loaded.model.concrete::<Dut>().is_none() {
            return Err(LiveFilmError::NoPerson(run.loaded.model.name().to_owned()));
        }
        let film = run.open_data()?;
        let arrivals = Arrivals::new(dir, &film, poses, run.resolved.data.clone())?;
        Ok(Self { model: run.loaded.model, arrivals, film })
    }

    /// What a server shows first: the first frame of the run's own film, and one view of each of its cameras.
    ///
    /// # Errors
    /// If its images cannot be read.
    pub fn show(&self, name: String) -> Result<Show, LiveFilmError> {
        let start = Timestamp::normalised(0.0);
        let splats = self.model.splats(&start, &self.film.train[0].camera)?;
        let background = self.model.background();
        Ok(Show::live_film(name, splats, self.model.raster_options(background), background, &self.film))
    }

    /// Ids of the cameras whose images are waited for.
    pub fn cameras(&self) -> impl Iterator<Item = u32> {
        self.arrivals.cameras()
    }

    /// Shows the newest frame, if one has arrived since the last call.
    ///
    /// # Errors
    /// If a frame cannot be read or does not fit the person. Later calls go on with later frames.
    pub fn next(&mut self, server: &Server) -> Result<Option<ShownFrame>, LiveFilmError> {
        let looked = Instant::now();
        let Some(frame) = self.arrivals.newest()? else { return Ok(None) };
        let ArrivedFrame { number, pose, images, written, passed_over } = frame;
        let read = looked.elapsed();
        let waited = written.elapsed().unwrap_or_default().saturating_sub(read);
        let begun = Instant::now();
        let dut = self.model.concrete::<Dut>().ok_or_else(|| LiveFilmError::NoPerson(self.model.name().to_owned()))?;
        let splats = dut.splats_of(&pose, &images).map_err(|e| LiveFilmError::Frame(number, e))?;
        let computed = begun.elapsed();
        server.show_frame(splats, number, looked.checked_sub(waited).unwrap_or(looked));
        Ok(Some(ShownFrame { number, passed_over, waited, read, computed }))
    }
}
