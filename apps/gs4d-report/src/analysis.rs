//! Statistics of a trained scene beyond its scores: distributions of scalar attributes, motion, rendering cost. They need the
//! [`Model`] and cameras only, no data set.
//!
//! * [`histogram`]: 64 bins of every attribute, over time where it changes with time; logged while training.
//! * [`paths`]: temporal spectra and second differences of the means.
//! * [`economy`]: splats, tiles per splat, entries per pixel at the run's PSNR.

pub mod economy;
pub mod histogram;
pub mod paths;

pub use economy::RenderCost;
pub use histogram::{Histogram, Snapshot};
pub use paths::Paths;

use crate::ReportRow;
use gs_metrics::trajectory::TrajectoryError;
use gs_train::method::MethodError;
use gs_train::model::Model;

/// A model whose motion cannot be analysed.
#[derive(Debug, thiserror::Error)]
pub enum AnalysisError {
    /// The model cannot produce its splats.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// The number of splats changes over time, or the sampling is too coarse.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
}

/// The analyses that need neither data set nor camera.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Analysis {
    /// Histograms of the attributes.
    pub snapshot: Snapshot,
    /// Motion; absent if the splats are not the same ones at every time.
    pub paths: Option<Paths>,
}

impl Analysis {
    /// Analyses a model: `moments` evenly spaced times for its motion (fewer than 4: no motion), and the first frequency of
    /// its spectrum that counts as high (`None`: `⌈moments/4⌉`).
    ///
    /// # Errors
    /// If the model cannot produce its splats.
    pub fn of(method: &Model, moments: usize, cutoff: Option<usize>) -> Result<Self, MethodError> {
        let paths = match Paths::of(method, moments, cutoff) {
            Ok(paths) => Some(paths),
            Err(AnalysisError::Trajectory(_)) => None,
            Err(AnalysisError::Method(e)) => return Err(e),
        };
        Ok(Self { snapshot: Snapshot::of(method)?, paths })
    }

    /// Rows for the report.
    pub fn rows(&self) -> Vec<ReportRow> {
        let mut rows = self.snapshot.rows();
        rows.extend(self.paths.iter().flat_map(Paths::rows));
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::paths::{painted, second_difference_overlay};
    use crate::needs::neutral_camera;
    use glam::{DVec3, Vec3};
    use gs_core::{Camera, Color, Param, Params, Splats};
    use gs_raster::RasterOptions;
    use gs_train::capabilities::{Capabilities, Inspect, Quantity};
    use gs_train::method::{Buffers, LossValue, Method, RenderView, ViewCtx};
    use gs_train::registry::section;
    use gs_train::step::StepCtx;
    use gs_train::timestamp::Timestamp;

    /// Splat `i` of `SPLATS` swings along x with amplitude `i`, [`TURNS`] times over the span; λ rests, a gate opens.
    struct Swing {
        lambda: Param,
    }

    const SPLATS: usize = 5;
    const TURNS: f64 = 10.0;

    impl Swing {
        fn model() -> Model {
            let config = gs_methods::registry().find("static3d").unwrap().config("tiny").unwrap();
            let schedule = section("static3d", &config, "schedule").unwrap();
            let swing = Self { lambda: Param::rows("cloud.lambda", 1, vec![0.0, 9.0, -9.0, 1.0, 2.0]) };
            Model::new("swing", swing, schedule).unwrap()
        }
    }

    impl Params for Swing {
        fn visit(&self, f: &mut dyn FnMut(&Param)) {
            f(&self.lambda);
        }

        fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
            f(&mut self.lambda);
        }
    }

    impl Buffers for Swing {}

    impl Method for Swing {
        fn begin_step(&mut self, _at: &StepCtx) {}

        fn splats(&self, at: &Timestamp, _camera: &Camera) -> Result<Splats, MethodError> {
            let swing = (std::f64::consts::TAU * TURNS * f64::from(at.t.normalised)).cos() as f32;
            Ok(Splats {
                means: (0..SPLATS).map(|i| Vec3::new(0.1 * i as f32 * swing, 0.3 * i as f32 - 0.6, 0.0)).collect(),
                quats: vec![[1.0, 0.0, 0.0, 0.0]; SPLATS],
                scales: vec![Vec3::splat(0.05); SPLATS],
                opacities: vec![0.9; SPLATS],
                color: Color::Rgb(vec![[0.5; 3]; SPLATS]),
                ..Splats::default()
            })
        }

        fn step(&mut self, _view: &ViewCtx<'_>, _render: &mut dyn RenderView) -> Result<Vec<LossValue>, MethodError> {
            Ok(Vec::new())
        }

        fn splat_count(&self) -> usize {
            SPLATS
        }

        fn capabilities(&self) -> Capabilities<'_> {
            Capabilities { inspect: Some(self), ..Capabilities::default() }
        }
    }

    impl Inspect for Swing {
        fn quantities(&self, at: &Timestamp) -> Result<Vec<Quantity>, MethodError> {
            let lambda = Quantity::share("lambda", vec![0.1, 0.2, 0.5, 0.7, 0.3]);
            Ok(vec![lambda, Quantity::share("gate", vec![at.t.normalised; SPLATS])])
        }
    }

    #[test]
    fn quantities_are_pooled_and_shown_over_time_where_they_change() {
        let s = Snapshot::of(&Swing::model()).unwrap();
        let names: Vec<_> = s.histograms.iter().map(|h| (h.name.as_str(), h.time.is_some())).collect();
        assert_eq!(names[..2], [("lambda", false), ("gate", false)]);
        assert!(names.len() == 2 + 8 && names[2..].iter().all(|n| *n == ("gate", true)));
        let total = |h: &Histogram| h.counts.iter().sum::<u32>() as usize;
        assert_eq!((total(&s.histograms[0]), total(&s.histograms[1])), (SPLATS, 8 * SPLATS));
        assert_eq!((s.histograms[2].counts[0], s.histograms[9].counts[63]), (5, 5), "shut at 0, open at 1");
        let c = s.classes.unwrap();
        assert_eq!((c.low, c.middle, c.high), (3, 1, 1));
        assert_eq!((s.saturation[0].saturated, s.saturation[0].of), (2, SPLATS));
        let back: Snapshot = serde_json::from_str(&serde_json::to_string(&s).unwrap()).unwrap();
        assert_eq!(back, s);
    }

    #[test]
    fn swinging_splats_have_fast_motion_of_known_energy() {
        let analysis = Analysis::of(&Swing::model(), 41, None).unwrap();
        let paths = analysis.paths.clone().unwrap();
        assert_eq!((paths.moments, paths.cutoff), (41, 11));
        // 10 turns over 40 intervals: four moments a turn, A = (2 x)² at the turning points and 0 between them.
        assert!((paths.jerk.p99 / (2.0f64 * 0.4).powi(2) - 1.0).abs() < 1e-4, "{:?}", paths.jerk);
        assert!(paths.hann.mean_log10 < paths.raw.mean_log10 + 1.0 && paths.jerk.gini > 0.5);
        assert!(matches!(Paths::of(&Swing::model(), 41, Some(21)), Err(AnalysisError::Trajectory(_))));
        assert!(Analysis::of(&Swing::model(), 0, None).unwrap().paths.is_none());
        assert_eq!(analysis.rows().len(), 2 + 1 + 1 + 4);
    }

    #[test]
    fn jerk_is_seen_where_it_is_and_pictures_have_a_price() {
        let (swing, camera) = (Swing::model(), neutral_camera());
        let overlay = second_difference_overlay(&swing, 0.0, 0.025, &camera).unwrap();
        assert_eq!((overlay.colors[0], overlay.colors[4]), ([0.0; 3], [1.0; 3]));
        assert!(overlay.colors.windows(2).all(|w| w[0] <= w[1]), "the wider the swing, the brighter");
        let splats = painted(swing.splats(&Timestamp::normalised(0.0), &camera).unwrap(), overlay.clone());
        assert_eq!(splats.color, Color::Rgb(overlay.colors));
        let eye = Camera::look_at(64, 64, 0.7, DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::Y).unwrap();
        let views = [(eye, Timestamp::normalised(0.0).t)];
        let economy = RenderCost::of(&swing, &views, &RasterOptions::default(), Some(30.0)).unwrap().unwrap();
        assert!(economy.tiles_per_splat >= 1.0 && economy.used_per_tile <= economy.listed_per_tile);
        assert!(economy.walked_per_pixel > 0.0 && economy.walked_per_pixel <= economy.used_per_tile);
        assert!((economy.tiles_per_splat * SPLATS as f64 / 16.0 - economy.listed_per_tile).abs() < 1e-12, "16 tiles");
        let [drawn, trained] = economy.bytes_per_splat;
        assert!(drawn > 56.0 && trained > drawn + 56.0, "{drawn}, {trained}: at least 14 numbers each");
        assert!(RenderCost::of(&swing, &[], &RasterOptions::default(), None).unwrap().is_none());
    }
}
