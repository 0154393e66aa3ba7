//! The scene that `gs4d render` renders: a splat file or a run.

use crate::failure::{Class, Failure};
use crate::global::Global;
use crate::opening::last_trained;
use gs_core::io::load_splats;
use gs_core::{Camera, Splats};
use gs_data::{Dataset, View};
use gs_raster::RasterOptions;
use gs_train::method::MethodError;
use gs_train::timestamp::Timestamp;
use gs4d_run::orbit::Orbit;
use gs4d_run::{OpenRun, Placed};
use std::borrow::Cow;
use std::path::Path;

/// The rendered scene.
pub(super) enum Scene {
    /// Splats, and whether they are drawn anti-aliased.
    File(Box<Splats>, bool),
    Run(Box<OpenRun>),
}

impl Scene {
    pub(super) fn splat_count(&self) -> usize {
        match self {
            Scene::File(splats, _) => splats.len(),
            Scene::Run(run) => run.loaded.model.splat_count(),
        }
    }

    pub(super) fn options(&self) -> RasterOptions {
        match self {
            Scene::File(_, antialias) => RasterOptions { antialias: *antialias, ..RasterOptions::default() },
            Scene::Run(run) => run.loaded.model.raster_options(run.background()),
        }
    }

    /// The dataset of the run; `what` names the option that needs it.
    pub(super) fn data(&self, what: &str) -> Result<Dataset, Failure> {
        match self {
            Scene::File(..) => Err(Failure::usage(format!("{what} needs a run"))),
            Scene::Run(run) => Ok(run.open_data()?),
        }
    }

    /// Where the cameras of the run stand that were refined.
    pub(super) fn placed(&self) -> Placed {
        match self {
            Scene::File(..) => Placed::default(),
            Scene::Run(run) => run.placed(),
        }
    }

    /// The training views of the run, or those it has kept, as they were learnt; `what` names the option that needs them.
    pub(super) fn training_views(&self, what: &str) -> Result<Vec<View>, Failure> {
        match self {
            Scene::File(..) => Err(Failure::usage(format!("{what} needs a run"))),
            Scene::Run(run) => Ok(run.training_views()?.iter().map(|view| run.placed().view(view)).collect()),
        }
    }

    /// The orbit of the dataset's cameras, or around the splats of a file.
    pub(super) fn orbit(&self) -> Result<Option<Orbit>, Failure> {
        match self {
            Scene::File(splats, _) => Ok(Orbit::of_splats(&splats.means)),
            Scene::Run(_) => Ok(Orbit::of_views(&self.training_views("--camera orbit")?)),
        }
    }

    /// Normalised time of the last training image.
    pub(super) fn last_time(&self) -> f32 {
        match self {
            Scene::File(..) => 1.0,
            Scene::Run(run) => last_trained(run),
        }
    }

    /// The splats at a time, as a camera sees them.
    pub(super) fn splats(&self, camera: &Camera, time: f32) -> Result<Cow<'_, Splats>, MethodError> {
        Ok(match self {
            Scene::File(splats, _) => Cow::Borrowed(splats),
            Scene::Run(run) => {
                let splats = run.loaded.model.splats(&Timestamp::normalised(time), camera)?;
                checked(&splats, time)?;
                Cow::Owned(splats)
            }
        })
    }
}

/// Fails unless all values of the splats at a time are in their domains.
pub(super) fn checked(splats: &Splats, time: f32) -> Result<(), MethodError> {
    splats.check().map_err(|e| MethodError::Render(format!("the scene at time {time}: {e}")))
}

/// The splats of a file, and whether they are drawn anti-aliased.
pub fn load_splat_file(path: &Path, global: &Global) -> Result<(Splats, bool), Failure> {
    let raw = load_splats(path, &global.limits())?;
    let splats = raw.to_splats();
    let splats = splats.map_err(|e| Failure::new(Class::Data, "data.splats", e.to_string()).place(path.display()))?;
    Ok((splats, raw.antialiased))
}
