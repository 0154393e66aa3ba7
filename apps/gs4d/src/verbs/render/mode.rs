//! What `gs4d render` draws: colours, depth, alpha, counts, or a layer of the method.

use super::scene::{Scene, checked};
use crate::failure::{Class, Failure};
use gs_core::{Camera, Image, Splats};
use gs_raster::Frame;
use gs_train::evaluate::clamped;
use gs_train::model::Model;
use gs_train::palette::color_scale;
use gs_train::renderer::{Renderer, depth_colors, depth_span, mean_depth};
use gs_train::timestamp::Timestamp;
use gs4d_eval::layers::{self, LayerError};
use gs4d_eval::segment::Labels;
use gs4d_run::OpenRun;
use serde_json::{Value, json};

/// Names of the modes of every scene.
const OF_EVERY_SCENE: [&str; 4] = ["color", "depth", "alpha", "count"];

/// What is drawn.
pub(super) enum Mode<'a> {
    Color,
    Depth,
    Alpha,
    Count,
    Layer(Layer<'a>),
}

/// A layer of a method.
pub(super) struct Layer<'a> {
    model: &'a Model,
    name: String,
    /// The rigid parts, if they are the layer.
    parts: Option<Box<Labels>>,
}

/// Which image a file holds.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// The image to look at, RGB in 0..1.
    Shown,
    /// Float values: one channel of depth, alpha and counts, RGBA of the others.
    Values,
}

impl<'a> Mode<'a> {
    /// The mode of a name; `time` is that of the first image.
    ///
    /// # Errors
    /// If the scene has no such mode (the message names those it has), or its parts cannot be told.
    pub(super) fn of(name: &str, scene: &'a Scene, time: f32) -> Result<Self, Failure> {
        match (name, scene) {
            ("color", _) => Ok(Self::Color),
            ("depth", _) => Ok(Self::Depth),
            ("alpha", _) => Ok(Self::Alpha),
            ("count", _) => Ok(Self::Count),
            (_, Scene::Run(run)) => Ok(Self::Layer(Layer::of(name, run, time)?)),
            (_, Scene::File(..)) => Err(unknown(name, "a splat file", &[])),
        }
    }

    /// What the colours of a layer say, as text and as JSON; `None` for the other modes.
    ///
    /// # Errors
    /// As [`Self::image`].
    pub(super) fn legend(&self, time: f32) -> Result<Option<(String, Value)>, Failure> {
        let Self::Layer(layer) = self else { return Ok(None) };
        layer.legend(time).map(Some)
    }

    /// An image of the scene.
    ///
    /// # Errors
    /// If the splats or their layer cannot be computed, or the device fails.
    pub(super) fn image(
        &self,
        scene: &Scene,
        renderer: &mut Renderer,
        (camera, time): (&Camera, f32),
        kind: Kind,
    ) -> Result<Image, Failure> {
        if let Self::Layer(layer) = self {
            return Ok(colors(renderer.render(&layer.splats(camera, time)?, camera)?, kind));
        }
        let splats = scene.splats(camera, time)?;
        if let Self::Count = self {
            let counts = layers::counts(&splats, camera, &renderer.options);
            return Ok(scalars(camera, counts, kind, count_colors));
        }
        let frame = renderer.render(splats.view(), camera)?;
        Ok(match self {
            Self::Depth => scalars(camera, mean_depth(frame), kind, |d| depth_colors(d, depth_span(d))),
            Self::Alpha => scalars(camera, frame.alpha.clone(), kind, |all| all.iter().flat_map(|&a| [a; 3]).collect()),
            _ => colors(frame, kind),
        })
    }
}

impl<'a> Layer<'a> {
    fn of(name: &str, run: &'a OpenRun, time: f32) -> Result<Self, Failure> {
        let model = &run.loaded.model;
        let times = run.kept().map(|kept| kept.times).unwrap_or_default();
        let own = layers::names(model, times.len() > 1, &Timestamp::normalised(time));
        if !own.contains(&name) {
            return Err(unknown(name, "this run", &own));
        }
        let observed = times.last().copied().unwrap_or(1.0);
        let parts = (name == layers::PARTS).then(|| layers::parts(model, observed).map(Box::new)).transpose()?;
        Ok(Self { model, name: name.to_owned(), parts })
    }

    /// The layer of the method at a time.
    fn at(&self, time: f32) -> Result<layers::Layer, Failure> {
        let found = layers::find(self.model, &self.name, &Timestamp::normalised(time))?;
        found.ok_or_else(|| {
            let what = format!("there is no layer `{}` at time {time}", self.name);
            Failure::new(Class::Usage, "usage", what).remedy("choose other times with --time or --times")
        })
    }

    /// All splats in its colours.
    fn splats(&self, camera: &Camera, time: f32) -> Result<Splats, Failure> {
        let colors = match &self.parts {
            Some(parts) => layers::part_colors(parts),
            None => self.at(time)?.overlay.colors,
        };
        let splats = self.model.all_splats(&Timestamp::normalised(time), camera)?;
        checked(&splats, time)?;
        Ok(layers::painted(splats, &self.name, colors)?)
    }

    fn legend(&self, time: f32) -> Result<(String, Value), Failure> {
        if let Some(parts) = &self.parts {
            let json = json!({"name": self.name, "parts": parts.k});
            return Ok((format!("{}: {} rigid parts, a colour each", self.name, parts.k), json));
        }
        let layers::Layer { overlay, quantity } = self.at(time)?;
        let Some(q) = quantity else {
            let json = json!({"name": self.name, "meaning": overlay.meaning});
            return Ok((format!("{}: {}", self.name, overlay.meaning), json));
        };
        let [low, high] = q.span();
        let each = if q.range.is_none() { " in the first image; each has its own span" } else { "" };
        let unit = if q.unit.is_empty() { String::new() } else { format!(" {}", q.unit) };
        let text = format!("{}: dark blue {low:.4}, pale yellow {high:.4}{unit}{each}", self.name);
        Ok((text, json!({"name": self.name, "unit": q.unit, "low": low, "high": high, "fixed": q.range.is_some()})))
    }
}

/// The failure for a name that is no mode of `what`, whose method has the layers `own`.
fn unknown(name: &str, what: &str, own: &[&str]) -> Failure {
    let all = [&OF_EVERY_SCENE[..], own].concat().join(", ");
    Failure::usage(format!("--mode {name}: {what} has no such layer")).remedy(format!("choose one of {all}"))
}

impl From<LayerError> for Failure {
    fn from(e: LayerError) -> Self {
        match e {
            LayerError::Method(e) => e.into(),
            LayerError::Rows { .. } => Self::new(Class::Data, "method.moment", e.to_string())
                .remedy("render other layers; gs4d inspect RUN says what the scene contains"),
        }
    }
}

/// The colours of a frame.
fn colors(frame: &Frame, kind: Kind) -> Image {
    if kind == Kind::Shown {
        return clamped(frame);
    }
    let pixels = frame.rgb.data.chunks_exact(3).zip(&frame.alpha);
    let data = pixels.flat_map(|(rgb, &a)| [rgb[0], rgb[1], rgb[2], a]).collect();
    Image { width: frame.rgb.width, height: frame.rgb.height, channels: 4, data }
}

/// One number per pixel of a camera, as it is or as a colour.
fn scalars(camera: &Camera, values: Vec<f32>, kind: Kind, shown: impl FnOnce(&[f32]) -> Vec<f32>) -> Image {
    let (width, height) = (camera.width as usize, camera.height as usize);
    match kind {
        Kind::Shown => Image { width, height, channels: 3, data: shown(&values) },
        Kind::Values => Image { width, height, channels: 1, data: values },
    }
}

/// Counts as colours, over 0 to the largest.
fn count_colors(counts: &[f32]) -> Vec<f32> {
    let most = counts.iter().copied().fold(1.0, f32::max);
    counts.iter().flat_map(|c| color_scale(c / most)).collect()
}
