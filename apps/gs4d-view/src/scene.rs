//! What is drawn: a trained method, or splats at rest.

use gs_core::{Camera, Splats};
use gs_train::method::{Figure, Method, Quantity};
use gs_train::renderer::moment;
use gs4d_eval::segment::{Labels, Options, segment};
use std::borrow::Cow;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

/// A scene that does not change while it is looked at.
pub struct Scene {
    /// Differs from that of every other scene of this process.
    pub id: u64,
    source: Source,
    /// Its rigid parts, once asked for.
    parts: OnceLock<Result<Labels, String>>,
}

enum Source {
    Method(Box<dyn Method>),
    Splats(Box<Splats>),
}

impl Scene {
    /// A method at some step of its training.
    pub fn method(method: Box<dyn Method>) -> Self {
        Self::of(Source::Method(method))
    }

    /// Splats at rest.
    pub fn splats(splats: Splats) -> Self {
        Self::of(Source::Splats(Box::new(splats)))
    }

    fn of(source: Source) -> Self {
        static SCENES: AtomicU64 = AtomicU64::new(0);
        Self { id: SCENES.fetch_add(1, Ordering::Relaxed), source, parts: OnceLock::new() }
    }

    /// The method, if it is one.
    pub fn as_method(&self) -> Option<&dyn Method> {
        match &self.source {
            Source::Method(method) => Some(method.as_ref()),
            Source::Splats(_) => None,
        }
    }

    /// The person, if it draws one who can be posed.
    pub fn figure(&self) -> Option<&dyn Figure> {
        self.as_method().and_then(Method::figure)
    }

    /// The splats at a normalised time.
    pub fn at(&self, time: f32, camera: &Camera) -> Cow<'_, Splats> {
        match &self.source {
            Source::Method(method) => Cow::Owned(method.splats(&moment(time), camera)),
            Source::Splats(splats) => Cow::Borrowed(splats),
        }
    }

    /// All splats in the same order at every moment.
    pub fn tracked(&self, time: f32, camera: &Camera) -> Cow<'_, Splats> {
        match &self.source {
            Source::Method(method) => Cow::Owned(method.tracked(&moment(time), camera)),
            Source::Splats(splats) => Cow::Borrowed(splats),
        }
    }

    /// Numbers about each of the [`Self::tracked`] splats.
    pub fn quantities(&self, time: f32) -> Vec<Quantity> {
        self.as_method().map(|m| m.quantities(&moment(time))).unwrap_or_default()
    }

    /// The rigid part of each of the [`Self::tracked`] splats, by their motion up to the last time that was learnt from;
    /// found when first asked for.
    ///
    /// # Errors
    /// In words, where nothing moves.
    pub fn parts(&self, observed: f32) -> Result<&Labels, String> {
        let find = || {
            let method = self.as_method().ok_or("a splat file does not move")?;
            segment(method, &Options { observed, ..Options::default() }).map_err(|e| e.to_string())
        };
        self.parts.get_or_init(find).as_ref().map_err(Clone::clone)
    }

    /// Names of quantities and of other colours a method offers.
    pub fn overlays(&self, time: f32) -> Vec<&'static str> {
        self.as_method().map(|m| m.overlays(&moment(time)).iter().map(|o| o.name).collect()).unwrap_or_default()
    }
}
