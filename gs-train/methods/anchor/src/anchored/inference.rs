//! Splats without gradients: as a camera sees them, stage by stage, and all of them for analyses.

use super::Anchored;
use super::forward::{Filter, ROOM, center, centers, farthest};
use super::motion::Query;
use super::rest::Rest;
use glam::Vec3;
use gs_anchor::visible::{self, VisibilityOptions};
use gs_anchor::{DecodeTape, Lgd, LocalAnchors, Visible};
use gs_core::{Camera, Color, Geometry, GeometryRef, Splats, Time, cast};
use gs_train::capabilities::StageView;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Intervals kept at once: 64 of 27 000 anchors are 500 MB.
const INTERVALS_KEPT: usize = 64;
/// How often an image is tried with a wider margin before everything is decoded.
const TRIES: usize = 3;

/// Local anchors by canonical time: GAD takes few values, so a run of frames asks for it once per interval. What comes
/// out of it has the same bits as anew.
#[derive(Default)]
pub(super) struct Cache {
    locals: Mutex<BTreeMap<u32, Arc<LocalAnchors>>>,
    /// The anchors before GAD, where LGD is asked there.
    at_rest: OnceLock<LocalAnchors>,
    /// What is left where it rests, if anything is.
    rest: Option<Rest>,
}

impl Cache {
    /// To be called before anything it depends on changes.
    pub(super) fn forget(&mut self) {
        self.locals.get_mut().unwrap_or_else(PoisonError::into_inner).clear();
        self.at_rest.take();
        self.rest = None;
    }

    /// One that leaves what rests where it is.
    pub(super) fn resting(rest: Rest) -> Self {
        Self { rest: Some(rest), ..Self::default() }
    }

    fn get(&self, canonical: Time, make: impl FnOnce() -> LocalAnchors) -> Arc<LocalAnchors> {
        let key = canonical.normalised.to_bits();
        let lock = || self.locals.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(local) = lock().get(&key) {
            return local.clone();
        }
        let made = Arc::new(make());
        let mut locals = lock();
        if locals.len() >= INTERVALS_KEPT {
            locals.clear();
        }
        locals.insert(key, made.clone());
        made
    }
}

impl Anchored {
    /// The anchors at `t`, before LGD: those of its interval, or a blend of those around it.
    pub(super) fn local(&self, t: Time) -> Arc<LocalAnchors> {
        let Some(gad) = self.motion.gad.as_ref().filter(|_| self.dynamic()) else {
            return self.cache.get(Time::default(), || self.at_rest());
        };
        let at = |canonical: Time| {
            let mut local = LocalAnchors::default();
            match &self.cache.rest {
                Some(rest) => gad.forward_active(&self.anchors, canonical, rest.below(), &mut local),
                None => gad.forward(&self.anchors, canonical, &mut Default::default(), &mut local),
            }
            local
        };
        let keys = self.motion.keys(t);
        let locals: Vec<_> =
            keys.iter().map(|(canonical, w)| (self.cache.get(*canonical, || at(*canonical)), *w)).collect();
        if let [(local, _)] = &locals[..] {
            return local.clone();
        }
        let mut blended = LocalAnchors::default();
        blended.blend(&locals.iter().map(|(local, w)| (&**local, *w)).collect::<Vec<_>>());
        Arc::new(blended)
    }

    fn at_rest(&self) -> LocalAnchors {
        let mut local = LocalAnchors::default();
        self.anchors.activate(&mut local);
        local
    }

    /// Decodes the anchors a camera may see.
    pub(super) fn decoded(&self, local: &LocalAnchors, camera: &Camera, margin: Option<f64>) -> (Splats, DecodeTape) {
        let (mut splats, mut tape, mut listed) = <(Splats, DecodeTape, Vec<u32>)>::default();
        let visible = match margin {
            Some(margin) => {
                let reach = VisibilityOptions { margin, dilation: self.dilation };
                visible::conservative(local, camera, &reach, &mut listed);
                Visible::List(&listed)
            }
            None => Visible::All,
        };
        self.decoder.forward(local, visible, camera.position(), &mut tape, &mut splats);
        (splats, tape)
    }

    /// Moves decoded Gaussians of these rows (`anchor · k + j`).
    fn moved(&self, neural: GeometryRef<'_>, rows: &[u32], t: Time) -> Option<Geometry> {
        let lgd = self.motion.lgd.as_ref().filter(|_| self.dynamic())?;
        let mut moved = Geometry::default();
        let places = self.places(neural.means, rows);
        match (&self.cache.rest, lgd) {
            (Some(rest), Lgd::Planes(lgd)) => rest.forward(lgd, &places, neural, rows, t, &mut moved),
            _ => lgd.forward_at(&places, neural, t, &mut Default::default(), &mut moved),
        }
        Some(moved)
    }

    /// Where LGD is asked about the Gaussians of these rows, which GAD has moved to `means`.
    pub(super) fn places<'a>(&self, means: &'a [Vec3], rows: &[u32]) -> Cow<'a, [Vec3]> {
        match self.motion.query {
            Query::Moved => Cow::Borrowed(means),
            Query::Rest => {
                let mut places = Vec::new();
                centers(self.cache.at_rest.get_or_init(|| self.at_rest()), rows, self.config.offsets, &mut places);
                Cow::Owned(places)
            }
        }
    }

    /// What `camera` sees at a time.
    pub(super) fn seen_by(&self, t: Time, camera: &Camera) -> Splats {
        let local = self.local(t);
        let mut reach = self.reach[0];
        for _ in 0..TRIES {
            let margin = (self.config.filter == Filter::Clean).then_some(ROOM * f64::from(reach));
            let (mut splats, tape) = self.decoded(&local, camera, margin);
            let Some(moved) = self.moved(splats.geometry(), &tape.rows, t) else { return splats };
            let farthest = farthest(splats.geometry(), moved.view());
            if margin.is_none_or(|margin| f64::from(farthest) <= margin) {
                splats.set_geometry(moved);
                return splats;
            }
            reach = reach.max(farthest);
        }
        let (splats, tape) = self.decoded(&local, camera, None);
        self.at_time(splats, &tape.rows, t)
    }

    /// Decoded Gaussians of these rows, moved if anything moves them.
    fn at_time(&self, mut splats: Splats, rows: &[u32], t: Time) -> Splats {
        if let Some(moved) = self.moved(splats.geometry(), rows, t) {
            splats.set_geometry(moved);
        }
        splats
    }

    /// Global, local and full: the anchors at rest, those of the interval, and their Gaussians at the timestamp.
    pub(super) fn staged(&self, t: Time, camera: &Camera) -> Vec<StageView> {
        let rest = self.at_rest();
        let (global, _) = self.decoded(&rest, camera, None);
        let mut stages = vec![StageView { name: "global", splats: global, before: None }];
        let local = self.local(t);
        let (neural, tape) = self.decoded(&local, camera, None);
        let moved = self.moved(neural.geometry(), &tape.rows, t);
        let full = moved.map(|moved| {
            let before = Some(neural.means.clone());
            let mut splats = neural.clone();
            splats.set_geometry(moved);
            StageView { name: "full", splats, before }
        });
        if self.motion.gad.is_some() && self.dynamic() {
            let before = tape.rows.iter().map(|&row| self.center(&rest, row)).collect();
            stages.push(StageView { name: "local", splats: neural, before: Some(before) });
        }
        stages.extend(full);
        stages
    }

    /// Centre of the Gaussian of a row before LGD.
    pub(super) fn center(&self, local: &LocalAnchors, row: u32) -> Vec3 {
        center(local, row, self.config.offsets)
    }

    /// Every Gaussian of every anchor, in the same order at all times; those that are not there have opacity 0.
    pub(super) fn every_splat(&self, t: Time, camera: &Camera) -> Splats {
        let local = self.local(t);
        let (seen, tape) = self.decoded(&local, camera, None);
        let n = local.len() * self.config.offsets;
        let mut all = Splats {
            means: (0..cast::to_u32(n)).map(|row| self.center(&local, row)).collect(),
            quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
            scales: vec![Vec3::ZERO; n],
            opacities: vec![0.0; n],
            ..Splats::default()
        };
        let mut colors = vec![[0.0; 3]; n];
        let Color::Rgb(seen_colors) = &seen.color else { unreachable!("a decoder gives plain colours") };
        for (i, &row) in tape.rows.iter().enumerate() {
            let row = row as usize;
            (all.quats[row], all.scales[row], all.opacities[row]) = (seen.quats[i], seen.scales[i], seen.opacities[i]);
            colors[row] = seen_colors[i];
        }
        all.color = Color::Rgb(colors);
        let rows: Vec<u32> = (0..cast::to_u32(n)).collect();
        self.at_time(all, &rows, t)
    }
}
