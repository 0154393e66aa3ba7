//! One state of a show: a trained method, or static splats.

use crate::pose::Posing;
use gs_core::{Camera, Splats};
use gs_method_texel::Dut;
use gs_train::capabilities::Quantity;
use gs_train::model::Model;
use gs_train::timestamp::Timestamp;
use gs4d_eval::layers;
use gs4d_eval::segment::Labels;
use std::borrow::Cow;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// An immutable scene.
pub(crate) struct Scene {
    /// Unique in this process.
    pub(crate) id: u64,
    source: Source,
    /// The frame that it shows, if it is one of a live film.
    pub(crate) frame: Option<LiveFrame>,
    /// Rigid parts, computed on first use.
    parts: OnceLock<Result<Labels, String>>,
}

/// A frame of a live film.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LiveFrame {
    /// Its number.
    pub(crate) number: u32,
    /// When its last file was written.
    pub(crate) written: Instant,
}

enum Source {
    Method(Box<Model>),
    Splats(Box<Splats>),
}

impl Scene {
    /// A method at one step of its training.
    pub(crate) fn method(method: Model) -> Self {
        Self::of(Source::Method(Box::new(method)))
    }

    /// Static splats.
    pub(crate) fn splats(splats: Splats) -> Self {
        Self::of(Source::Splats(Box::new(splats)))
    }

    /// The splats of a frame of a live film.
    pub(crate) fn live(splats: Splats, frame: LiveFrame) -> Self {
        Self { frame: Some(frame), ..Self::splats(splats) }
    }

    fn of(source: Source) -> Self {
        static SCENES: AtomicU64 = AtomicU64::new(0);
        Self { id: SCENES.fetch_add(1, Ordering::Relaxed), source, frame: None, parts: OnceLock::new() }
    }

    /// The method; `None` for static splats.
    pub(crate) fn as_method(&self) -> Option<&Model> {
        match &self.source {
            Source::Method(method) => Some(method),
            Source::Splats(_) => None,
        }
    }

    /// Number of splats, at most.
    pub(crate) fn splat_count(&self) -> usize {
        match &self.source {
            Source::Method(method) => method.splat_count(),
            Source::Splats(splats) => splats.len(),
        }
    }

    /// The avatar method; `None` for other methods.
    pub(crate) fn avatar(&self) -> Option<&Dut> {
        self.as_method().and_then(Model::concrete)
    }

    /// The splats to render at a normalised time.
    ///
    /// # Errors
    /// A message, if the method cannot compute them.
    pub(crate) fn at(&self, time: f32, camera: &Camera) -> Result<Cow<'_, Splats>, String> {
        match &self.source {
            Source::Method(method) => owned(method.splats(&Timestamp::normalised(time), camera)),
            Source::Splats(splats) => Ok(Cow::Borrowed(splats)),
        }
    }

    /// All splats, in the same order at every time; an avatar in another pose than that of the time, if one is given.
    ///
    /// # Errors
    /// A message, if the method cannot compute them.
    pub(crate) fn all_splats(
        &self,
        time: f32,
        camera: &Camera,
        pose: Option<&Posing>,
    ) -> Result<Cow<'_, Splats>, String> {
        if let (Some(posing), Some(avatar)) = (pose, self.avatar()) {
            return owned(avatar.posed(&Timestamp::normalised(time), &posing.of(avatar, time)?));
        }
        match &self.source {
            Source::Method(method) => owned(method.all_splats(&Timestamp::normalised(time), camera)),
            Source::Splats(splats) => Ok(Cow::Borrowed(splats)),
        }
    }

    /// Scalar attributes of the splats of [`Self::all_splats`], in their order; empty for static splats.
    ///
    /// # Errors
    /// A message, if the method cannot compute them.
    pub(crate) fn quantities(&self, time: f32) -> Result<Vec<Quantity>, String> {
        let Some(method) = self.as_method() else { return Ok(Vec::new()) };
        method.quantities(&Timestamp::normalised(time)).map_err(|e| e.to_string())
    }

    /// Rigid part of each splat of [`Self::all_splats`], from the motion up to the last training time `observed`. Computed on
    /// first use.
    ///
    /// # Errors
    /// A message, if nothing moves.
    pub(crate) fn parts(&self, observed: f32) -> Result<&Labels, String> {
        let compute = || {
            let method = self.as_method().ok_or("a splat file does not move")?;
            layers::parts(method, observed).map_err(|e| e.to_string())
        };
        self.parts.get_or_init(compute).as_ref().map_err(Clone::clone)
    }

    /// Names of the layers of the method, parts among them if it is `moving`; empty for static splats.
    pub(crate) fn layers(&self, moving: bool, time: f32) -> Vec<&'static str> {
        self.as_method().map_or(Vec::new(), |m| layers::names(m, moving, &Timestamp::normalised(time)))
    }
}

fn owned<'a>(splats: Result<Splats, impl std::fmt::Display>) -> Result<Cow<'a, Splats>, String> {
    splats.map(Cow::Owned).map_err(|e| e.to_string())
}
