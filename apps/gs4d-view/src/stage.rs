//! What can be seen: trained runs with their data, runs under training, and splat files.

use crate::checkpoints::Checkpoints;
use crate::pose;
use crate::scene::Scene;
use gs_core::{Camera, Splats};
use gs_data::{Dataset, ImageCache, View};
use gs_raster::RasterOptions;
use gs4d_run::orbit::middle;
use gs4d_run::{OpenRun, Training};
use serde_json::{Value, json};
use std::sync::{Arc, PoisonError, RwLock};

/// Views of the data that the page lists, at most, spread evenly.
const MOST_VIEWS: usize = 200;
/// Marks of training times on the slider, at most.
const MOST_MARKS: usize = 400;
/// Bytes of photographs kept beside a run under training.
const LIVE_PHOTOGRAPHS: usize = 64 << 20;

/// One thing to look at.
pub struct Show {
    /// What the page calls it.
    pub name: String,
    scene: RwLock<Arc<Scene>>,
    checkpoints: Option<Checkpoints>,
    options: RasterOptions,
    /// Views of the data, training and held out.
    pub views: Vec<View>,
    photographs: Option<ImageCache>,
    /// Training times, normalised, ascending.
    times: Vec<f32>,
    /// Seconds from normalised time 0 to 1.
    seconds: f64,
    background: [f32; 3],
}

impl Show {
    /// A run with its data, if they can be read.
    pub fn run(name: String, run: OpenRun, dataset: Option<&Dataset>) -> Self {
        let background = run.background();
        let options = run.loaded.model.raster_options(background);
        let photographs = dataset.map(|_| run.photographs());
        let checkpoints = run.folder().ok().map(|f| Checkpoints::of(run.resolved.registry.clone(), f.checkpoints()));
        let mut show = Self::new(name, Scene::method(run.loaded.model), options, background);
        (show.photographs, show.checkpoints) = (photographs, checkpoints);
        dataset.into_iter().for_each(|data| show.bring(data));
        show
    }

    /// A run under training, as it stands; what comes of it is brought by [`Self::replace`].
    ///
    /// # Errors
    /// In words, if its state cannot be read back.
    pub fn live(name: String, training: &Training) -> Result<Self, String> {
        let trainer = training.trainer();
        let data = trainer.dataset();
        let copy = gs_train::saved::load_with(
            &training.resolved().registry,
            &trainer.state_for_rendering(),
            None,
            data.avatar.clone(),
        )?;
        let background = copy.model.background();
        let options = copy.model.raster_options(background);
        let mut show = Self::new(name, Scene::method(copy.model), options, background);
        let limit = training.resolved().data.max_image_mib;
        show.photographs = Some(ImageCache::new(LIVE_PHOTOGRAPHS, 1.0).with_max_image_mib(limit));
        show.checkpoints = Some(Checkpoints::of(training.resolved().registry.clone(), training.folder().checkpoints()));
        show.bring(data);
        Ok(show)
    }

    /// A splat file.
    pub fn splats(name: String, splats: Splats) -> Self {
        Self::new(name, Scene::splats(splats), RasterOptions::default(), [0.0; 3])
    }

    fn new(name: String, scene: Scene, options: RasterOptions, background: [f32; 3]) -> Self {
        let (scene, times) = (RwLock::new(Arc::new(scene)), vec![0.0]);
        let (checkpoints, photographs) = (None, None);
        Self { name, scene, checkpoints, options, views: Vec::new(), photographs, times, seconds: 1.0, background }
    }

    fn bring(&mut self, data: &Dataset) {
        let spread = |all: &[View], most: usize| -> Vec<View> {
            let kept = all.len().min(most);
            (0..kept).map(|k| all[k * all.len() / kept].clone()).collect()
        };
        self.views = spread(&data.test, MOST_VIEWS / 2);
        self.views.extend(spread(&data.extrapolate, MOST_VIEWS / 4));
        self.views.extend(spread(&data.train, MOST_VIEWS - self.views.len().min(MOST_VIEWS)));
        let mut times: Vec<f32> = data.train.iter().map(|v| v.time.normalised).collect();
        times.sort_by(f32::total_cmp);
        times.dedup();
        let last = data.train.iter().max_by(|a, b| a.time.normalised.total_cmp(&b.time.normalised));
        self.seconds = last.map_or(1.0, |v| v.time.seconds / f64::from(v.time.normalised.max(1e-6)));
        let kept = times.len().min(MOST_MARKS);
        self.times = (0..kept).map(|k| times[k * times.len() / kept]).collect();
        self.times.extend(times.last().filter(|t| self.times.last() != Some(t)));
    }

    /// The scene as it is, or as a checkpoint has it.
    ///
    /// # Errors
    /// In words, if there is no such checkpoint.
    pub fn scene(&self, checkpoint: Option<u32>) -> Result<Arc<Scene>, String> {
        match (checkpoint, &self.checkpoints) {
            (None, _) => Ok(self.now()),
            (Some(step), Some(all)) => all.at(step),
            (Some(_), None) => Err(format!("{} has no checkpoints", self.name)),
        }
    }

    fn now(&self) -> Arc<Scene> {
        self.scene.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Shows another state from now on. Pictures that are being drawn keep the older one.
    pub fn replace(&self, scene: Scene) {
        *self.scene.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(scene);
    }

    /// How it is drawn.
    pub fn options(&self) -> &RasterOptions {
        &self.options
    }

    /// Its photographs.
    pub fn photographs(&self) -> Option<&ImageCache> {
        self.photographs.as_ref()
    }

    /// The colour behind it.
    pub fn background(&self) -> [f32; 3] {
        self.background
    }

    /// Seconds from normalised time 0 to 1.
    pub fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Mean distance of training times, normalised.
    pub fn interval(&self) -> f32 {
        let [first, .., last] = self.times[..] else { return 1.0 };
        (last - first) / (self.times.len() - 1) as f32
    }

    /// The last time that was learnt from, normalised.
    pub fn observed(&self) -> f32 {
        self.times.last().copied().unwrap_or(0.0)
    }

    /// Whether it can move.
    pub fn moving(&self) -> bool {
        self.now().as_method().is_some() && self.times.len() > 1
    }

    /// What of it changes while it is trained: names of what can be drawn, steps of its checkpoints.
    pub fn changing(&self) -> Value {
        let mut layers: Vec<&str> = vec!["color", "depth", "alpha", "count"];
        if self.photographs.is_some() && !self.views.is_empty() {
            layers.push("truth");
        }
        if self.moving() {
            layers.push("segment");
        }
        layers.extend(self.now().overlays(self.times.get(self.times.len() / 2).copied().unwrap_or(0.0)));
        let steps = self.checkpoints.as_ref().map(Checkpoints::steps).unwrap_or_default();
        json!({"layers": layers, "checkpoints": steps})
    }

    /// What the page must know of it.
    fn about(&self) -> Value {
        let view = |v: &View| {
            let c = &v.camera;
            let fov = 2.0 * (0.5 * f64::from(c.width) / c.fx).atan();
            let (eye, down) = (c.position(), c.rotation.row(1));
            json!({
                "name": v.name, "time": v.time.normalised, "width": c.width, "height": c.height, "fov": fov,
                "eye": eye.to_array(), "forward": c.forward().to_array(), "up": (-down).to_array(),
            })
        };
        let centre = self.centre();
        let mut about = json!({
            "name": self.name, "times": self.times, "seconds": self.seconds, "moving": self.moving(),
            "views": self.views.iter().map(view).collect::<Vec<_>>(),
            "centre": centre.0, "radius": centre.1, "joints": self.now().figure().map(pose::joints),
        });
        let changing = self.changing();
        for name in ["layers", "checkpoints"] {
            about[name] = changing[name].clone();
        }
        about
    }

    /// Median of the centres at the first time and the distance that three quarters of them lie within.
    fn centre(&self) -> ([f32; 3], f32) {
        let neutral = gs4d_report::needs::neutral_camera();
        let camera: &Camera = self.views.first().map_or(&neutral, |v| &v.camera);
        let scene = self.now();
        let splats = scene.at(self.times.first().copied().unwrap_or(0.0), camera).unwrap_or_default();
        middle(&splats.means).map_or(([0.0; 3], 1.0), |(centre, away)| (centre.to_array(), away))
    }
}

/// Everything one viewer shows.
pub struct Stage {
    /// Never empty once served.
    pub shows: Vec<Show>,
}

impl Stage {
    /// What the page is told first.
    pub fn about(&self) -> Value {
        json!({"shows": self.shows.iter().map(Show::about).collect::<Vec<_>>()})
    }

    /// A show by its number.
    ///
    /// # Errors
    /// In words, if there is none.
    pub fn show(&self, number: usize) -> Result<&Show, String> {
        self.shows.get(number).ok_or_else(|| "there is no such show".to_owned())
    }

    /// A view of a show's data.
    ///
    /// # Errors
    /// In words, if there is none.
    pub fn view(&self, show: usize, number: usize) -> Result<&View, String> {
        self.show(show)?.views.get(number).ok_or_else(|| "there is no such view".to_owned())
    }
}
