//! A scene from a camera at a moment: everything a picture of it is made from.

use crate::question::{Choice, Question, Target};
use crate::scene::Scene;
use crate::stage::{Show, Stage};
use gs_core::{Camera, Splats};
use gs_texel::Pose;
use gs_train::timestamp::Timestamp;
use std::borrow::Cow;
use std::sync::Arc;

/// Splats fainter than this are in no picture.
pub const FAINTEST: f32 = 1.0 / 255.0;
/// Answers to choices that are remembered.
const KEPT: usize = 16;

/// A target from a camera at a moment.
pub struct Shot<'a> {
    /// What is shown.
    pub show: &'a Show,
    /// Its state.
    pub scene: Arc<Scene>,
    /// From where.
    pub camera: Camera,
    /// Normalised.
    pub time: f32,
    /// Another pose than that of the moment.
    pub pose: Option<Pose>,
    /// Which of the tracked splats are left out, as far as any are.
    hidden: Option<Vec<bool>>,
}

impl<'a> Shot<'a> {
    /// What a question asks of a target.
    ///
    /// # Errors
    /// In words: no such show, checkpoint, view or joint.
    pub fn of(
        stage: &'a Stage,
        q: &Question,
        target: &Target,
        camera: &Camera,
        chosen: &mut Chosen,
    ) -> Result<Self, String> {
        let show = stage.show(target.show)?;
        let scene = show.scene(target.checkpoint)?;
        let pose = match (&q.pose, scene.figure()) {
            (Some(posing), Some(figure)) => Some(posing.of(figure, q.time)?),
            _ => None,
        };
        let mut hidden: Option<Vec<bool>> = None;
        for choice in q.hidden.iter().filter(|c| c.show == target.show) {
            let members = chosen.members(stage, &scene, choice)?;
            match &mut hidden {
                None => hidden = Some(members.to_vec()),
                Some(all) => all.iter_mut().zip(members.iter()).for_each(|(h, m)| *h |= m),
            }
        }
        Ok(Self { show, scene, camera: camera.clone(), time: q.time, pose, hidden })
    }

    /// The same from another camera.
    pub fn from(&self, camera: Camera) -> Shot<'_> {
        let (scene, pose, hidden) = (self.scene.clone(), self.pose.clone(), self.hidden.clone());
        Shot { show: self.show, scene, camera, time: self.time, pose, hidden }
    }

    /// The splats that are drawn.
    ///
    /// # Errors
    /// In words, if a pose cannot be taken.
    pub fn splats(&self) -> Result<Cow<'_, Splats>, String> {
        if self.pose.is_some() || self.hidden.is_some() {
            return self.all_splats();
        }
        self.scene.at(self.time, &self.camera)
    }

    /// All splats in the same order at every time, those left out with opacity 0.
    ///
    /// # Errors
    /// As [`Self::splats`].
    pub fn all_splats(&self) -> Result<Cow<'_, Splats>, String> {
        let mut splats = match (&self.pose, self.scene.figure()) {
            (Some(pose), Some(figure)) => {
                let posed = figure.posed(&Timestamp::normalised(self.time), pose);
                Cow::Owned(posed.map_err(|e| e.to_string())?)
            }
            _ => self.scene.all_splats(self.time, &self.camera)?,
        };
        if let Some(hidden) = &self.hidden {
            let opacities = &mut splats.to_mut().opacities;
            opacities.iter_mut().zip(hidden).filter(|(_, h)| **h).for_each(|(o, _)| *o = 0.0);
        }
        Ok(splats)
    }
}

/// Which splats choices mean, remembered for the states of scenes they were asked of.
#[derive(Default)]
pub struct Chosen {
    /// The newest at the end.
    known: Vec<(u64, Choice, Arc<Vec<bool>>)>,
}

impl Chosen {
    /// Whether each tracked splat is among those whose centres were seen in a box.
    ///
    /// # Errors
    /// In words, if the choice's camera is none.
    pub fn members(&mut self, stage: &Stage, scene: &Scene, choice: &Choice) -> Result<Arc<Vec<bool>>, String> {
        if let Some(known) = self.known.iter().find(|k| k.0 == scene.id && k.1 == *choice) {
            return Ok(known.2.clone());
        }
        let camera = choice.look.camera(stage, choice.width, choice.height)?;
        let splats = scene.all_splats(choice.time, &camera)?;
        let members = Arc::new((0..splats.len()).map(|i| is_in(&splats, i, &camera, choice.at)).collect::<Vec<_>>());
        if self.known.len() == KEPT {
            self.known.remove(0);
        }
        self.known.push((scene.id, choice.clone(), members.clone()));
        Ok(members)
    }
}

/// Whether a splat can be seen and its centre lies in a box, however far away and behind whatever.
fn is_in(splats: &Splats, i: usize, camera: &Camera, [left, top, right, bottom]: [f32; 4]) -> bool {
    let at = camera.to_camera(splats.means[i].as_dvec3());
    if splats.opacities[i] < FAINTEST || at.z <= 0.0 {
        return false;
    }
    let pixel = camera.to_pixel(at);
    let share = [pixel.x / f64::from(camera.width), pixel.y / f64::from(camera.height)];
    let within = |v: f64, low: f32, high: f32| (f64::from(low)..=f64::from(high)).contains(&v);
    within(share[0], left, right) && within(share[1], top, bottom)
}
