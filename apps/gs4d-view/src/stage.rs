//! The shows of a viewer: trained runs with their data, runs under training, and splat files.

use crate::checkpoints::Checkpoints;
use crate::pose;
use crate::scene::Scene;
use gs_core::{Camera, Splats, Time};
use gs_data::{Dataset, ImageCache, ImageU8, View};
use gs_raster::RasterOptions;
use gs4d_run::orbit::middle;
use gs4d_run::{Kept, OpenRun, Training};
use serde_json::{Value, json};
use std::sync::{Arc, PoisonError, RwLock};

/// Most dataset views listed by the page; of more, a selection ([`gs_data::spread()`]).
const MAX_VIEWS: usize = 200;
/// Image cache of a run under training, bytes.
const LIVE_IMAGE_BYTES: usize = 64 << 20;

/// A run or splat file in the viewer.
pub struct Show {
    /// Name on the page.
    pub(crate) name: String,
    scene: RwLock<Arc<Scene>>,
    checkpoints: Option<Checkpoints>,
    options: RasterOptions,
    /// Dataset views listed by the page, the held-out ones first; corrected where cameras were refined.
    views: Vec<View>,
    /// The same as the data give them: their images are those of these.
    given: Vec<View>,
    /// Number of held-out views.
    held_out: usize,
    images: Option<ImageCache>,
    /// Training timestamps, normalised, ascending.
    times: Vec<f32>,
    /// The data's own time at normalised 0 and 1, where it is another.
    clock: Option<[f64; 2]>,
    background: [f32; 3],
}

impl Show {
    /// A trained run. Without `dataset` it has the views and timestamps that the run has kept, and no ground truth.
    pub fn run(name: String, run: OpenRun, dataset: Option<&Dataset>) -> Self {
        let kept = dataset.is_none().then(|| run.kept().ok()).flatten();
        let (background, placed) = (run.background(), run.placed());
        let options = run.loaded.model.raster_options(background);
        let images = dataset.map(|_| run.images());
        let checkpoints = run.folder().ok().map(|f| Checkpoints::of(run.resolved.registry.clone(), f.checkpoints()));
        let mut show = Self::new(name, Scene::method(run.loaded.model), options, background);
        (show.images, show.checkpoints) = (images, checkpoints);
        dataset.into_iter().for_each(|data| show.set_data(data));
        kept.into_iter().for_each(|kept| show.set_kept(kept));
        let (held_out, train) = show.given.split_at(show.held_out);
        let train = train.iter().map(|view| placed.view(view));
        show.views = held_out.iter().map(|view| placed.held_out(view)).chain(train).collect();
        show
    }

    /// A run under training, in its current state; a [`Feed`](crate::Feed) updates it.
    ///
    /// # Errors
    /// A message, if its state cannot be copied.
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
        show.images = Some(ImageCache::new(LIVE_IMAGE_BYTES, 1.0).with_max_image_mib(limit));
        show.checkpoints = Some(Checkpoints::of(training.resolved().registry.clone(), training.folder().checkpoints()));
        show.set_data(data);
        Ok(show)
    }

    /// A film that arrives while it is shown; until its first frame it shows `splats`.
    /// [`Server::show_frame`](crate::Server::show_frame) updates it. The cameras of `film` are listed.
    pub fn live_film(
        name: String,
        splats: Splats,
        options: RasterOptions,
        background: [f32; 3],
        film: &Dataset,
    ) -> Self {
        let mut show = Self::new(name, Scene::splats(splats), options, background);
        // One view of each camera: they stand still.
        let mut seen = std::collections::BTreeSet::new();
        let all = [&film.train, &film.test].into_iter().flatten();
        let mut views: Vec<View> = all.filter(|v| seen.insert(v.camera_id)).take(MAX_VIEWS).cloned().collect();
        views.sort_by_key(|v| v.camera_id);
        views.iter_mut().for_each(|v| v.time = Time::default());
        show.set_views(views);
        show
    }

    /// A show of splats that never move, over black.
    pub fn splats(name: String, splats: Splats) -> Self {
        Self::new(name, Scene::splats(splats), RasterOptions::default(), [0.0; 3])
    }

    /// The same, drawn anti-aliased or not.
    pub fn antialiased(mut self, antialias: bool) -> Self {
        self.options.antialias = antialias;
        self
    }

    fn new(name: String, scene: Scene, options: RasterOptions, background: [f32; 3]) -> Self {
        let (scene, times) = (RwLock::new(Arc::new(scene)), vec![0.0]);
        let (checkpoints, images) = (None, None);
        let (views, given, held_out, clock) = (Vec::new(), Vec::new(), 0, None);
        Self { name, scene, checkpoints, options, views, given, held_out, images, times, clock, background }
    }

    fn set_data(&mut self, data: &Dataset) {
        let spread = |all: &[View], most: usize| -> Vec<View> {
            gs_data::spread(all.len(), most).into_iter().map(|k| all[k].clone()).collect()
        };
        let kept = Kept::of(data);
        let held_out = [spread(&data.test, MAX_VIEWS / 2), spread(&data.extrapolate, MAX_VIEWS / 4)].concat();
        let train = spread(&data.train, MAX_VIEWS - held_out.len());
        self.set_kept(Kept { held_out, train, ..kept });
    }

    fn set_kept(&mut self, kept: Kept) {
        self.held_out = kept.held_out.len();
        self.set_views([kept.held_out, kept.train].concat());
        self.clock = kept.clock;
        if !kept.times.is_empty() {
            self.times = kept.times;
        }
    }

    fn set_views(&mut self, views: Vec<View>) {
        self.views.clone_from(&views);
        self.given = views;
    }

    /// The ground-truth image of a view, by its index.
    ///
    /// # Errors
    /// A message, if there is none.
    pub(crate) fn truth(&self, number: usize) -> Result<Arc<ImageU8>, String> {
        let (images, view) = self.images.as_ref().zip(self.given.get(number)).ok_or("there are no images")?;
        images.get(view).map_err(|e| e.to_string())
    }

    /// The newest scene, or the scene at the step of a checkpoint.
    ///
    /// # Errors
    /// A message, if there is no such checkpoint.
    pub(crate) fn scene(&self, checkpoint: Option<u32>) -> Result<Arc<Scene>, String> {
        match (checkpoint, &self.checkpoints) {
            (None, _) => Ok(self.newest()),
            (Some(step), Some(all)) => all.at(step),
            (Some(_), None) => Err(format!("{} has no checkpoints", self.name)),
        }
    }

    fn newest(&self) -> Arc<Scene> {
        self.scene.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Replaces the newest scene. Images being rendered keep the one they began with.
    pub(crate) fn replace(&self, scene: Scene) {
        *self.scene.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(scene);
    }

    /// Render options.
    pub(crate) fn options(&self) -> &RasterOptions {
        &self.options
    }

    /// Cache of the dataset images; `None` without a dataset.
    pub(crate) fn images(&self) -> Option<&ImageCache> {
        self.images.as_ref()
    }

    /// Background colour, RGB in 0..1.
    pub(crate) fn background(&self) -> [f32; 3] {
        self.background
    }

    /// Seconds from normalised time 0 to 1; 1, for the whole sequence, where the data have none.
    pub(crate) fn seconds(&self) -> f64 {
        self.clock.filter(|_| self.has_seconds()).map_or(1.0, |[start, end]| end - start)
    }

    /// Whether the data's own time is in seconds: it is where it lies outside 0..1.
    pub(crate) fn has_seconds(&self) -> bool {
        self.clock.is_some_and(|[start, end]| start < 0.0 || end > 1.0)
    }

    /// Mean interval of training timestamps, normalised.
    pub(crate) fn interval(&self) -> f32 {
        let [first, .., last] = self.times[..] else { return 1.0 };
        (last - first) / (self.times.len() - 1) as f32
    }

    /// Last training timestamp, normalised.
    pub(crate) fn observed(&self) -> f32 {
        self.times.last().copied().unwrap_or(0.0)
    }

    /// Whether it is a method trained on more than one timestamp.
    pub(crate) fn moving(&self) -> bool {
        self.newest().as_method().is_some() && self.times.len() > 1
    }

    /// What changes during training, as JSON: names of the layers, steps of the checkpoints.
    pub(crate) fn live_info(&self) -> Value {
        let mut layers: Vec<&str> = vec!["color", "depth", "alpha", "count"];
        if self.images.is_some() && !self.views.is_empty() {
            layers.push("truth");
        }
        let middle = self.times.get(self.times.len() / 2).copied().unwrap_or(0.0);
        layers.extend(self.newest().layers(self.moving(), middle));
        let steps = self.checkpoints.as_ref().map(Checkpoints::steps).unwrap_or_default();
        json!({"layers": layers, "checkpoints": steps})
    }

    /// Description for the page, as JSON.
    pub(crate) fn about(&self) -> Value {
        let view = |(k, v): (usize, &View)| {
            let c = &v.camera;
            let fov = 2.0 * (0.5 * f64::from(c.width) / c.fx).atan();
            let (eye, down) = (c.position(), c.rotation.row(1));
            json!({
                "name": v.name, "held_out": k < self.held_out, "time": v.time.normalised, "width": c.width, "height": c.height,
                "fov": fov, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy,
                "eye": eye.to_array(), "forward": c.forward().to_array(), "up": (-down).to_array(),
            })
        };
        let centre = self.centre();
        let mut about = json!({
            "name": self.name, "times": self.times, "seconds": self.seconds(), "clock": self.clock, "moving": self.moving(),
            "views": self.views.iter().enumerate().map(view).collect::<Vec<_>>(),
            "splats": self.splat_count(), "has_seconds": self.has_seconds(), "background": self.background, "borders": self.borders(),
            "centre": centre.0, "radius": centre.1, "joints": self.newest().avatar().map(pose::joints),
        });
        let live = self.live_info();
        for name in ["layers", "checkpoints"] {
            about[name] = live[name].clone();
        }
        about
    }

    /// Number of splats of the newest scene, at most.
    fn splat_count(&self) -> usize {
        self.newest().splat_count()
    }

    /// Normalised times at which the motion of the method changes: borders of its intervals.
    fn borders(&self) -> Vec<f32> {
        self.newest().as_method().and_then(|m| m.capabilities().inspect).map(|i| i.borders()).unwrap_or_default()
    }

    /// Median of the means at the first timestamp, and the radius around it that holds three quarters of them.
    fn centre(&self) -> ([f32; 3], f32) {
        let neutral = gs4d_report::needs::neutral_camera();
        let camera: &Camera = self.views.first().map_or(&neutral, |v| &v.camera);
        let scene = self.newest();
        let splats = scene.at(self.times.first().copied().unwrap_or(0.0), camera).unwrap_or_default();
        middle(&splats.means).map_or(([0.0; 3], 1.0), |(centre, away)| (centre.to_array(), away))
    }
}

/// All shows of a viewer; the first is selected at the start.
pub struct Stage {
    shows: RwLock<Vec<Arc<Show>>>,
}

impl Stage {
    /// A stage of shows.
    pub fn new(shows: Vec<Show>) -> Self {
        Self { shows: RwLock::new(shows.into_iter().map(Arc::new).collect()) }
    }

    /// All shows.
    pub(crate) fn shows(&self) -> Vec<Arc<Show>> {
        self.shows.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Adds a show, unless there are `most` already; its index.
    pub(crate) fn add(&self, show: Show, most: usize) -> Option<usize> {
        let mut shows = self.shows.write().unwrap_or_else(PoisonError::into_inner);
        (shows.len() < most).then(|| {
            shows.push(Arc::new(show));
            shows.len() - 1
        })
    }

    /// First message to the page, as JSON.
    pub(crate) fn about(&self) -> Value {
        json!({"shows": self.shows().iter().map(|s| s.about()).collect::<Vec<_>>()})
    }

    /// A show by its index.
    ///
    /// # Errors
    /// A message, if there is none.
    pub(crate) fn show(&self, number: usize) -> Result<Arc<Show>, String> {
        self.shows().get(number).cloned().ok_or_else(|| "there is no such show".to_owned())
    }

    /// A view of [`Show::views`] by the indices of show and view.
    ///
    /// # Errors
    /// A message, if there is none.
    pub(crate) fn view(&self, show: usize, number: usize) -> Result<View, String> {
        self.show(show)?.views.get(number).cloned().ok_or_else(|| "there is no such view".to_owned())
    }
}
