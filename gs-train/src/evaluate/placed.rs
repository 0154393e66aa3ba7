//! Places held-out cameras in a scene whose training cameras were corrected, as is customary where poses are learnt (Lin et
//! al. 2021, BARF, section 4.2): the scene rests, and each camera descends on the squared error of its own images.
//!
//! Steps are measured in pixels: a turn of `1/f`, or a shift of `1/f` of the mean depth, moves the image by about one.

use super::EvalError;
use crate::adam::{Adam, Refused, Update};
use crate::cameras::{CameraConfig, Cameras, Correction, KnownCamera};
use crate::clocks;
use crate::method::MethodError;
use crate::model::Model;
use crate::ranks::Share;
use crate::timestamp::Timestamp;
use gs_core::{Camera, Image, Splats, SplatsGrad};
use gs_data::{ImageCache, View};
use gs_raster::{Frame, FrameGrad, RasterOptions, ScreenStats, Workspace, render_backward_with_camera, render_into};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// How held-out cameras are placed, in words.
const PLACED: &str = "training cameras were refined; held-out cameras that are not among them are placed anew (pose, clock or both, \
                      as was learnt; a camera whose other images trained keeps its clock) by 100 steps on the squared error \
                      of their own images, the scene at rest, before they are scored";

/// Steps of a camera.
const STEPS: i32 = 100;
/// Length of the first step, and of the last, pixels.
const PIXELS: [f64; 2] = [1.0, 0.01];
/// Length of the first step of a clock, and of the last, normalised time.
const TIMES: [f64; 2] = [5e-3, 5e-5];
/// At most so many of the views of a camera are looked at.
const VIEWS: usize = 8;

/// The corrections of the training cameras that frames were rendered with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RefinedCameras {
    /// Number of corrections.
    pub count: usize,
    /// Root mean square of the turns, degrees.
    pub turn: f64,
    /// Root mean square of the shifts, world units.
    pub shift: f64,
    /// Root mean square of the changes of focal lengths, as shares of them.
    pub focal: f64,
    /// Root mean square of the offsets of clocks, normalised time.
    #[serde(default)]
    pub time: f64,
    /// How held-out cameras were placed, in words.
    pub held_out: String,
}

fn length_squared(v: &[f32; 3]) -> f64 {
    v.iter().map(|v| f64::from(*v).powi(2)).sum()
}

impl RefinedCameras {
    /// Of a model; none where no camera has a correction.
    pub fn of(model: &Model) -> Option<Self> {
        let count = model.cameras().known().len();
        let mean = |square: fn(&Correction) -> f64| {
            let sum: f64 = (0..count).map(|row| square(&model.cameras().correction(row))).sum();
            (sum / count as f64).sqrt()
        };
        (count > 0).then(|| Self {
            count,
            turn: mean(|c| length_squared(&c.turn)).to_degrees(),
            shift: mean(|c| length_squared(&c.shift)),
            focal: mean(|c| f64::from(c.focal).exp_m1().powi(2)),
            time: mean(|c| f64::from(c.time).powi(2)),
            held_out: PLACED.to_owned(),
        })
    }
}

/// The correction of the camera of each view: what was learnt for it, or else what places it; none of a model whose cameras
/// were not refined. Ranks share the cameras; the result is the same on all.
///
/// # Errors
/// If an image cannot be read, the method gives no splats, or another rank fails.
pub fn place(
    model: &Model,
    views: &[View],
    background: [f32; 3],
    images: &ImageCache,
    share: &Share,
) -> Result<Vec<Option<Correction>>, EvalError> {
    let cameras = model.cameras();
    let mut found: Vec<Option<Correction>> = views.iter().map(|view| cameras.of(view)).collect();
    if cameras.is_empty() {
        return Ok(found);
    }
    let mut groups: Vec<(KnownCamera, Vec<usize>)> = Vec::new();
    for k in (0..views.len()).filter(|k| found[*k].is_none()) {
        let camera = KnownCamera::new(&views[k], 0.0);
        match groups.iter_mut().find(|(known, _)| known.is(&camera)) {
            Some((_, members)) => members.push(k),
            None => groups.push((camera, vec![k])),
        }
    }
    let learnt: Vec<Correction> = (0..cameras.known().len()).map(|row| cameras.correction(row)).collect();
    let seconds = cameras.known().iter().map(|known| known.clock).find(|clock| *clock != 0.0).unwrap_or(0.0);
    let splats = &|at: &Timestamp, camera: &Camera| model.splats(at, camera);
    let placed = share.each(groups.len(), |group| {
        let members = &groups[group].1;
        let first = members.first().map(|k| views[*k].time);
        let time = cameras.clock_offset(groups[group].0.camera_id);
        let several = members.iter().any(|k| Some(views[*k].time) != first);
        let clock = if several || time.is_some() { seconds } else { 0.0 };
        let seen: Vec<&View> = gs_data::evenly(members.len(), VIEWS).map(|k| &views[members[k]]).collect();
        let options = model.raster_options(background);
        Placing { splats, images, options, learnt: &learnt, clock, time }.of(&seen)
    })?;
    for ((_, members), correction) in groups.iter().zip(placed) {
        members.iter().for_each(|k| found[*k] = Some(correction));
    }
    Ok(found)
}

/// What all cameras are placed with.
struct Placing<'a> {
    splats: &'a dyn Fn(&Timestamp, &Camera) -> Result<Splats, MethodError>,
    images: &'a ImageCache,
    options: RasterOptions,
    /// Of the training cameras.
    learnt: &'a [Correction],
    /// [`KnownCamera::clock`].
    clock: f64,
    /// The offset of the camera's clock that training views of the same camera have given; it stays as it is.
    time: Option<f32>,
}

/// A view of a camera: its camera in the data, the splats at its time, its image and where that counts.
struct Seen {
    camera: Camera,
    at: Timestamp,
    splats: Splats,
    truth: Image,
    mask: Option<Arc<Image>>,
}

impl Placing<'_> {
    /// The correction of a camera with these views.
    fn of(&self, views: &[&View]) -> Result<Correction, EvalError> {
        let seen: Vec<Seen> = views.iter().map(|view| self.see(view)).collect::<Result<_, _>>()?;
        let Some((view, first)) = views.first().zip(seen.first()) else { return Ok(Correction::default()) };
        let (mut workspace, mut frame) = (Workspace::new(), Frame::default());
        let (mut grad, mut stats) = (SplatsGrad::default(), ScreenStats::default());
        render_into(&first.splats, &first.camera, &self.options, &mut workspace, &mut frame);
        let depth = mean_depth(&frame);
        let known = KnownCamera { clock: self.clock, ..KnownCamera::new(view, depth as f32) };
        let mut own = Cameras::new(CameraConfig::default(), vec![known]);
        let learnt = |what: fn(&Correction) -> bool| self.learnt.iter().any(what);
        let poses = learnt(|c| (c.turn, c.shift) != Default::default());
        let focal = learnt(|c| c.focal != 0.0);
        let learns_time = self.clock != 0.0 && self.time.is_none() && learnt(|c| c.time != 0.0);
        let falling =
            |[first, last]: [f64; 2], step| first * (last / first).powf(f64::from(step) / f64::from(STEPS - 1));
        let mut adam = Adam::default();
        for (step, seen) in (0..STEPS).zip(seen.iter().cycle()) {
            let correction = own.correction(0);
            let camera = correction.apply(&seen.camera);
            let at = Timestamp::new(correction.at(seen.at.t));
            let splats = |at: &Timestamp| (self.splats)(at, &seen.camera);
            let failed = |e| EvalError::Method { view: view.name.clone(), source: Box::new(e) };
            let moved = learns_time.then(|| splats(&at)).transpose().map_err(failed)?;
            let shown = moved.as_ref().unwrap_or(&seen.splats);
            render_into(shown, &camera, &self.options, &mut workspace, &mut frame);
            let d = FrameGrad { rgb: seen.cotangents(&frame), ..FrameGrad::default() };
            let options = &self.options;
            let camera_grad =
                render_backward_with_camera(shown, &camera, options, &mut workspace, &d, &mut grad, &mut stats);
            own.add_gradient(0, &seen.camera, &camera_grad);
            if learns_time {
                own.add_time_gradient(0, clocks::slope(&splats, at.t, self.clock, &grad).map_err(failed)?);
            }
            let pixels = falling(PIXELS, step);
            let turn = if poses { pixels / first.camera.fx } else { 0.0 };
            let zoom = if focal { 2.0 * pixels / f64::from(first.camera.width) } else { 0.0 };
            let rates = [turn, turn * depth, zoom, falling(TIMES, step)];
            for (block, rate) in own.blocks_mut().iter_mut().zip(rates) {
                let update = Update { rate: rate as f32, eps: 1e-15, sparse: false, weight_decay: 0.0, ramp: 0 };
                adam.update(block, update, &mut Refused::default());
            }
        }
        let found = own.correction(0);
        Ok(Correction { time: self.time.unwrap_or(found.time), ..found })
    }

    fn see(&self, view: &View) -> Result<Seen, EvalError> {
        let camera = self.images.camera(view);
        let at = Timestamp::new(clocks::moved(view.time, self.time.unwrap_or(0.0), self.clock));
        let splats = (self.splats)(&at, &camera);
        let splats = splats.map_err(|e| EvalError::Method { view: view.name.clone(), source: Box::new(e) })?;
        let truth = self.images.get(view)?.over(self.options.background);
        let mask = if view.mask_loss { self.images.mask(view)? } else { None };
        Ok(Seen { camera, at, splats, truth, mask })
    }
}

impl Seen {
    /// Gradient of half the mean squared error with respect to the colours of a frame.
    fn cotangents(&self, frame: &Frame) -> Vec<f32> {
        let pixels = self.truth.data.len() as f32;
        let mut d: Vec<f32> = frame.rgb.data.iter().zip(&self.truth.data).map(|(x, y)| (x - y) / pixels).collect();
        if let Some(mask) = &self.mask {
            d.as_chunks_mut::<3>().0.iter_mut().zip(&mask.data).for_each(|(d, w)| *d = d.map(|v| v * w));
        }
        d
    }
}

/// Mean depth of what is seen, world units; 1 where nothing is.
fn mean_depth(frame: &Frame) -> f64 {
    let sum = |values: &[f32]| values.iter().map(|v| f64::from(*v)).sum::<f64>();
    let (depth, alpha) = (sum(&frame.depth), sum(&frame.alpha));
    if alpha > 0.0 { depth / alpha } else { 1.0 }
}
