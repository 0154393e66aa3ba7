//! Where the cameras of a run stand whose cameras were refined.

use super::folder;
use crate::OpenRun;
use gs_data::View;
use gs_train::cameras::{Cameras, Correction};
use gs_train::evaluate::EvalReport;
use std::collections::BTreeMap;

/// The corrections of a run's cameras: those that were learnt, and those that placed held-out views when the run was scored
/// (`metrics.json`). Empty where cameras were not refined.
#[derive(Clone, Debug, Default)]
pub struct Placed {
    learnt: Cameras,
    /// By name and normalised time as the data give them: views of two splits may have one name.
    scored: BTreeMap<(String, u32), Correction>,
}

impl OpenRun {
    /// The corrections of its cameras.
    pub fn placed(&self) -> Placed {
        let learnt = self.loaded.model.cameras().clone();
        let report = || -> Option<EvalReport> {
            let folder = self.folder().ok().filter(|_| !learnt.is_empty())?;
            serde_json::from_str(&folder.read(folder::METRICS).ok()?).ok()
        };
        let report = report();
        let future = report.iter().filter_map(|report| report.extrapolate.as_deref());
        let views = report.iter().chain(future).flat_map(|report| &report.views);
        let scored = views.filter_map(|view| Some(((view.name.clone(), view.time.to_bits()), view.camera?))).collect();
        Placed { learnt, scored }
    }
}

impl Placed {
    /// A view with the camera and time that it is rendered with; as the data give it where nothing is known. Its image is that
    /// of the data's view ([`Correction::corrected`]).
    pub fn view(&self, view: &View) -> View {
        self.learnt.of(view).map_or_else(|| view.clone(), |correction| correction.corrected(view))
    }

    /// The same of a held-out view, whose camera may have been placed when it was scored.
    pub fn held_out(&self, view: &View) -> View {
        let key = (view.name.clone(), view.time.normalised.to_bits());
        let known = self.learnt.of(view).or_else(|| self.scored.get(&key).copied());
        known.map_or_else(|| view.clone(), |correction| correction.corrected(view))
    }
}
