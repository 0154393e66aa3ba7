//! A scene with camera, time, pose and hidden splats: everything needed to render one image.

use crate::pose::Posing;
use crate::question::{Choice, MAX_BOXES, Question, Target};
use crate::scene::Scene;
use crate::stage::{Show, Stage};
use crate::style::Style;
use gs_core::{Camera, Splats};
use gs_raster::RasterOptions;
use std::borrow::Cow;
use std::sync::Arc;

/// Splats with a lower opacity are not rendered: 1/255.
pub(crate) const MIN_OPACITY: f32 = 1.0 / 255.0;
/// Cached selections: those of one image of two sides.
const CACHE_SIZE: usize = 2 * (MAX_BOXES + 1);

/// A target with its camera and time.
#[derive(Clone)]
pub(crate) struct Shot {
    /// The show it belongs to.
    pub(crate) show: Arc<Show>,
    /// The state of the show.
    pub(crate) scene: Arc<Scene>,
    /// The camera.
    pub(crate) camera: Camera,
    /// Normalised time.
    pub(crate) time: f32,
    /// Pose of an avatar; `None`: the pose at each time.
    pub(crate) pose: Option<Posing>,
    /// For each splat of [`Scene::all_splats`], whether it is hidden; `None` if none is.
    hidden: Option<Vec<bool>>,
    /// How the splats are drawn.
    pub(crate) style: Style,
    /// Colour behind the scene; `None`: that of the show.
    background: Option<[f32; 3]>,
}

impl Shot {
    /// A target under the camera, time, pose and hidden boxes of a question.
    ///
    /// # Errors
    /// A message, if there is no such show, checkpoint, view or joint.
    pub(crate) fn of(
        stage: &Stage,
        q: &Question,
        target: &Target,
        camera: &Camera,
        selections: &mut SelectionCache,
    ) -> Result<Self, String> {
        let show = stage.show(target.show)?;
        let scene = show.scene(target.checkpoint)?;
        let pose = match (&q.pose, scene.avatar()) {
            (Some(posing), Some(avatar)) => {
                posing.of(avatar, q.time)?;
                Some(posing.clone())
            }
            _ => None,
        };
        let mut hidden: Option<Vec<bool>> = None;
        for choice in q.hidden.iter().filter(|c| c.show == target.show) {
            let members = selections.members(stage, &scene, choice)?;
            match &mut hidden {
                None => hidden = Some(members.to_vec()),
                Some(all) => all.iter_mut().zip(members.iter()).for_each(|(h, m)| *h |= m),
            }
        }
        let (style, background) = (q.style, q.background);
        Ok(Self { show, scene, camera: camera.clone(), time: q.time, pose, hidden, style, background })
    }

    /// The same with another camera.
    pub(crate) fn with_camera(&self, camera: Camera) -> Self {
        Self { camera, ..self.clone() }
    }

    /// The same at twice the resolution, with points of the same size in the image.
    pub(crate) fn doubled(&self) -> Self {
        let style = match self.style {
            Style::Points(d) => Style::Points(2.0 * d),
            style => style,
        };
        Self { style, ..self.with_camera(self.camera.scaled(2.0)) }
    }

    /// Whether it is what training is scored on: splats as they are, none hidden, in the pose of its time, over the show's own
    /// background.
    pub(crate) fn is_plain(&self) -> bool {
        let own = self.background.is_none_or(|b| b == self.show.background());
        own && self.style == Style::Splats && self.pose.is_none() && self.hidden.is_none()
    }

    /// Colour behind the scene, RGB in 0..1.
    pub(crate) fn background(&self) -> [f32; 3] {
        self.background.unwrap_or_else(|| self.show.background())
    }

    /// Render options, over [`Self::background`].
    pub(crate) fn options(&self) -> RasterOptions {
        RasterOptions { background: self.background(), ..self.show.options().clone() }
    }

    /// The splats to render.
    ///
    /// # Errors
    /// A message, if they cannot be computed.
    pub(crate) fn splats(&self) -> Result<Cow<'_, Splats>, String> {
        if self.pose.is_some() || self.hidden.is_some() {
            return self.all_splats();
        }
        self.scene.at(self.time, &self.camera)
    }

    /// All splats of the scene at a time, none hidden, in the pose that was asked for.
    ///
    /// # Errors
    /// As [`Self::splats`].
    pub(crate) fn all_splats_at(&self, time: f32) -> Result<Cow<'_, Splats>, String> {
        self.scene.all_splats(time, &self.camera, self.pose.as_ref())
    }

    /// All splats, in the same order at every time; hidden ones have opacity 0.
    ///
    /// # Errors
    /// As [`Self::splats`].
    pub(crate) fn all_splats(&self) -> Result<Cow<'_, Splats>, String> {
        let mut splats = self.all_splats_at(self.time)?;
        if let Some(hidden) = &self.hidden {
            let opacities = &mut splats.to_mut().opacities;
            opacities.iter_mut().zip(hidden).filter(|(_, h)| **h).for_each(|(o, _)| *o = 0.0);
        }
        Ok(splats)
    }
}

/// Cache of the splats in selected boxes, by scene.
#[derive(Default)]
pub(crate) struct SelectionCache {
    /// Scene id, box, members; the newest at the end.
    entries: Vec<(u64, Choice, Arc<Vec<bool>>)>,
}

impl SelectionCache {
    /// For each splat of [`Scene::all_splats`], whether its centre lies in the box.
    ///
    /// # Errors
    /// A message, if the camera of the box is invalid.
    pub(crate) fn members(&mut self, stage: &Stage, scene: &Scene, choice: &Choice) -> Result<Arc<Vec<bool>>, String> {
        if let Some(entry) = self.entries.iter().find(|k| k.0 == scene.id && k.1 == *choice) {
            return Ok(entry.2.clone());
        }
        let camera = choice.look.camera(stage, choice.width, choice.height, false)?;
        let splats = scene.all_splats(choice.time, &camera, choice.pose.as_ref())?;
        let members = Arc::new((0..splats.len()).map(|i| is_in(&splats, i, &camera, choice.at)).collect::<Vec<_>>());
        if self.entries.len() == CACHE_SIZE {
            self.entries.remove(0);
        }
        self.entries.push((scene.id, choice.clone(), members.clone()));
        Ok(members)
    }
}

/// Whether a splat is not transparent and its centre projects into a box, at any depth.
fn is_in(splats: &Splats, i: usize, camera: &Camera, [left, top, right, bottom]: [f32; 4]) -> bool {
    let at = camera.to_camera(splats.means[i].as_dvec3());
    if splats.opacities[i] < MIN_OPACITY || at.z <= 0.0 {
        return false;
    }
    let pixel = camera.to_pixel(at);
    let share = [pixel.x / f64::from(camera.width), pixel.y / f64::from(camera.height)];
    let within = |v: f64, low: f32, high: f32| (f64::from(low)..=f64::from(high)).contains(&v);
    within(share[0], left, right) && within(share[1], top, bottom)
}
