//! What is drawn: a trained method, or splats at rest.

use gs_core::{Camera, Splats};
use gs_method_texel::Dut;
use gs_train::capabilities::Quantity;
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::timestamp::Timestamp;
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
    Method(Model),
    Splats(Box<Splats>),
}

impl Scene {
    /// A method at some step of its training.
    pub fn method(method: Model) -> Self {
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
    pub fn as_method(&self) -> Option<&Model> {
        match &self.source {
            Source::Method(method) => Some(method),
            Source::Splats(_) => None,
        }
    }

    /// The person, if it draws one who can be posed.
    pub fn figure(&self) -> Option<&Dut> {
        self.as_method().and_then(Model::concrete)
    }

    /// The splats at a normalised time.
    ///
    /// # Errors
    /// If the method cannot be asked for them.
    pub fn at(&self, time: f32, camera: &Camera) -> Result<Cow<'_, Splats>, String> {
        match &self.source {
            Source::Method(method) => owned(method.splats(&Timestamp::normalised(time), camera)),
            Source::Splats(splats) => Ok(Cow::Borrowed(splats)),
        }
    }

    /// All splats in the same order at every time.
    ///
    /// # Errors
    /// If the method cannot be asked for them.
    pub fn all_splats(&self, time: f32, camera: &Camera) -> Result<Cow<'_, Splats>, String> {
        match &self.source {
            Source::Method(method) => owned(method.all_splats(&Timestamp::normalised(time), camera)),
            Source::Splats(splats) => Ok(Cow::Borrowed(splats)),
        }
    }

    /// Numbers about each of the [`Self::all_splats`] splats.
    ///
    /// # Errors
    /// If the method cannot be asked for them.
    pub fn quantities(&self, time: f32) -> Result<Vec<Quantity>, String> {
        let Some(method) = self.as_method() else { return Ok(Vec::new()) };
        method.quantities(&Timestamp::normalised(time)).map_err(|e| e.to_string())
    }

    /// The rigid part of each of the [`Self::all_splats`] splats, by their motion up to the last time that was learnt from;
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

    /// Names of quantities and of other colours a method offers; none where it cannot be asked.
    pub fn overlays(&self, time: f32) -> Vec<&'static str> {
        let overlays = self.as_method().and_then(|m| m.overlays(&Timestamp::normalised(time)).ok());
        overlays.into_iter().flatten().map(|o| o.name).collect()
    }
}

fn owned<'a>(splats: Result<Splats, MethodError>) -> Result<Cow<'a, Splats>, String> {
    splats.map(Cow::Owned).map_err(|e| e.to_string())
}
