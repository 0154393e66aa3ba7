//! What can be seen: trained runs with their data, and splat files.

use gs_core::{Camera, Splats};
use gs_raster::RasterOptions;
use gs_train::data::{Dataset, ImageCache, View};
use gs_train::methods::Method;
use gs_train::run::OpenRun;
use gs_train::run::orbit::middle;
use gs_train::run::picture::moment;
use serde_json::{Value, json};

/// Views of the data that the page lists, at most, spread evenly.
const MOST_VIEWS: usize = 200;
/// Marks of training times on the slider, at most.
const MOST_MARKS: usize = 400;

/// Where splats come from.
enum Source {
    Method(Box<dyn Method>),
    Splats(Box<Splats>),
}

/// One thing to look at.
pub struct Show {
    /// What the page calls it.
    pub name: String,
    source: Source,
    options: RasterOptions,
    /// Views of the data, training and held out.
    pub views: Vec<View>,
    photographs: Option<ImageCache>,
    /// Training times, normalised, ascending.
    times: Vec<f32>,
    /// Seconds of the last training time, if times stand for seconds.
    seconds: f64,
    background: [f32; 3],
}

impl Show {
    /// A run with its data, if they can be read.
    pub fn run(name: String, run: OpenRun, dataset: Option<&Dataset>) -> Self {
        let background = run.background();
        let options = run.loaded.method.schedule().raster_options(background);
        let photographs = dataset.map(|_| run.photographs());
        let mut show = Self::new(name, Source::Method(run.loaded.method), options, background);
        show.photographs = photographs;
        if let Some(data) = dataset {
            show.bring(data);
        }
        show
    }

    /// A splat file.
    pub fn splats(name: String, splats: Splats) -> Self {
        Self::new(name, Source::Splats(Box::new(splats)), RasterOptions::default(), [0.0; 3])
    }

    fn new(name: String, source: Source, options: RasterOptions, background: [f32; 3]) -> Self {
        Self { name, source, options, views: Vec::new(), photographs: None, times: vec![0.0], seconds: 1.0, background }
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

    /// The splats at a normalised time.
    pub fn at(&self, time: f32, camera: &Camera) -> Splats {
        match &self.source {
            Source::Method(method) => method.splats(&moment(time), camera),
            Source::Splats(splats) => (**splats).clone(),
        }
    }

    /// All splats in the same order at every moment.
    pub fn tracked(&self, time: f32, camera: &Camera) -> Splats {
        match &self.source {
            Source::Method(method) => method.tracked(&moment(time), camera),
            Source::Splats(splats) => (**splats).clone(),
        }
    }

    /// The method, if it is one.
    pub fn method(&self) -> Option<&dyn Method> {
        match &self.source {
            Source::Method(method) => Some(method.as_ref()),
            Source::Splats(_) => None,
        }
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

    /// Names of what can be drawn.
    fn layers(&self) -> Vec<String> {
        let mut layers: Vec<String> = ["color", "depth", "alpha"].map(String::from).into();
        if self.photographs.is_some() && !self.views.is_empty() {
            layers.push("truth".into());
        }
        if let Some(method) = self.method() {
            let mid = moment(self.times.get(self.times.len() / 2).copied().unwrap_or(0.0));
            layers.extend(method.quantities(&mid).iter().map(|q| q.name.to_owned()));
        }
        layers
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
        let moving = self.method().is_some() && self.times.len() > 1;
        let centre = self.centre();
        json!({
            "name": self.name, "layers": self.layers(), "times": self.times, "seconds": self.seconds, "moving": moving,
            "views": self.views.iter().map(view).collect::<Vec<_>>(),
            "centre": centre.0, "radius": centre.1,
        })
    }

    /// Median of the centres at the first time and the distance that three quarters of them lie within.
    fn centre(&self) -> ([f32; 3], f32) {
        let neutral = gs_train::run::needs::neutral_camera();
        let camera = self.views.first().map_or(neutral, |v| v.camera.clone());
        let means = self.at(self.times.first().copied().unwrap_or(0.0), &camera).means;
        middle(&means).map_or(([0.0; 3], 1.0), |(centre, away)| (centre.to_array(), away))
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
}
