//! From frames, camera roles and images to a data set: shared by the reader and by generated films.
//!
//! | frame in | camera | goes to |
//! |---|---|---|
//! | any list | cond | the inputs of its frame |
//! | `train` | train, cond | training views |
//! | `train`, `test` | test | test views |
//! | `ood` | test | poses out of distribution: [`Dataset::extrapolate`] |

use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::PathBuf;
use std::sync::Arc;

use glam::Vec3;
use gs_texel::{Character, Pose, Skinning};

use crate::avatar::{AvatarFrame, AvatarScene, SurfacePoints, sample};
use crate::error::{DataError, Place};
use crate::options::{DataOptions, TimeFrom};
use crate::times::{Draft, Drafts, settle};
use crate::{Dataset, PointCloud, View};

/// Number of initial points on the template's surface.
const START_POINTS: usize = 20_000;
/// A box around the poses is widened by this share of its size on each side.
const MARGIN: f32 = 0.1;

/// The use of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Its views are trained on.
    Train,
    /// Training views that are also the inputs of their frames (conditioning).
    Cond,
    /// Its views are held out.
    Test,
}

impl Role {
    /// All roles with their names in `cameras.json`.
    pub const NAMES: [(&'static str, Self); 3] = [("train", Self::Train), ("cond", Self::Cond), ("test", Self::Test)];
}

/// The list of `splits` that a frame is in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameUse {
    /// Training cameras train, test cameras are held out.
    Train,
    /// Novel poses: test cameras are held out, others are not used.
    Test,
    /// Poses out of distribution: test cameras are extrapolation views.
    Ood,
}

/// A frame without its images; the fields are those of [`AvatarFrame`].
pub struct FilmFrame {
    /// Number of the frame, at `number / fps` seconds.
    pub number: u32,
    /// The list the frame is in.
    pub list: FrameUse,
    /// Joint transforms and known morph weights.
    pub pose: Pose,
    /// Morph weights that the images show, where they are known.
    pub true_morphs: Option<Vec<f32>>,
    /// Points of the true surface, where there are any.
    pub points: Option<SurfacePoints>,
}

/// An image of a frame.
pub struct Shot {
    /// Number of the frame it shows.
    pub number: u32,
    /// Role of the camera that took it.
    pub role: Role,
    /// The view; its time is not used.
    pub view: View,
}

/// A film before its frames have timestamps: [`Film::into_dataset`] makes the data set.
pub struct Film {
    /// The folder; empty for films made in memory.
    pub root: PathBuf,
    /// Becomes [`Dataset::layout`], the name of the reader.
    pub layout: &'static str,
    /// The place that errors of times name.
    pub place: Place,
    /// Template mesh, skeleton and motions of the person.
    pub character: Character,
    /// How joint transforms are blended.
    pub skinning: Skinning,
    /// Frames per second of the recording.
    pub fps: f64,
    /// The frames, ascending in number.
    pub frames: Vec<FilmFrame>,
    /// Camera after camera, ascending in id, each with its frames ascending in number; every number is in `frames`.
    pub shots: Vec<Shot>,
    /// Becomes [`Dataset::has_alpha`]: images carry transparency.
    pub has_alpha: bool,
    /// Assumptions of the reader so far; become [`Dataset::notes`].
    pub notes: Vec<String>,
}

/// The name of a view: `c003_f000012` for camera 3 and frame 12.
pub fn shot_name(camera: u32, frame: u32) -> String {
    format!("c{camera:03}_f{frame:06}")
}

impl Film {
    /// The data set: timestamps, splits, inputs, and initial points and box from the posed template.
    ///
    /// # Errors
    /// `data.option` if an option does not fit a film, `data.empty` if no training view is left.
    pub fn into_dataset(mut self, options: &DataOptions) -> Result<Dataset, DataError> {
        if options.time_from != TimeFrom::File {
            let (name, value) = ("data.time_from", format!("{:?}", options.time_from).to_lowercase());
            let rule = "file: frame n of a film is at n / fps; data.fps sets another rate".into();
            return Err(DataError::Option { name, value, rule });
        }
        let fps = options.fps.unwrap_or(self.fps);
        if let Some(shift) = &options.time_shift {
            let rule =
                "images of a film belong to frames by their numbers: renumber those of a camera that is late".into();
            return Err(DataError::Option { name: "data.time_shift", value: shift.to_string(), rule });
        }
        if !(fps > 0.0 && fps.is_finite()) {
            let rule = "above 0: frames per second".into();
            return Err(DataError::Option { name: "data.fps", value: fps.to_string(), rule });
        }
        let stated = |number: u32| Some(f64::from(number) / fps);
        let place = self.place.clone();
        let mut sorted = self.sort(|number, view| Draft { view, stated: stated(number), place: place.clone() });
        self.leave_out(&mut sorted);
        let Sorted { drafts, mut inputs, ood, numbers } = sorted;
        if drafts.train.is_empty() {
            return Err(DataError::Empty { file: place.file });
        }
        let mut settled = settle(drafts, options, None)?;
        let (beyond, test) = std::mem::take(&mut settled.test).into_iter().partition(|v| ood.contains(&v.name));
        settled.test = test;
        settled.extrapolate.extend::<Vec<View>>(beyond);
        if !settled.dynamic {
            let shown = settled.train.first().and_then(|v| numbers.get(&v.name));
            self.frames.retain(|s| Some(&s.number) == shown);
        }
        let mut frames = Vec::with_capacity(self.frames.len());
        let mut first = None;
        for s in self.frames {
            let time = settled.clock.time(stated(s.number), &place)?;
            let Some(mut views) = inputs.remove(&s.number) else { continue };
            views.iter_mut().for_each(|v| v.time = time);
            if s.list == FrameUse::Train {
                first.get_or_insert(frames.len());
            }
            let learnt = settled.train.iter().any(|v| v.time == time);
            let (number, pose, points, true_morphs) = (s.number, s.pose, s.points, s.true_morphs);
            frames.push(AvatarFrame { number, time, learnt, pose, inputs: views, points, true_morphs });
        }
        if frames.is_empty() {
            return Err(DataError::Empty { file: place.file });
        }
        let (character, skinning, max_image_mib) = (self.character, self.skinning, options.max_image_mib);
        let scene = AvatarScene { character, skinning, fps, frames, max_image_mib };
        self.notes.push(format!("frame n is at n / {fps} seconds; data.fps sets another rate"));
        let (points, bounds) = (start(&scene, first.unwrap_or(0)), bounds(&scene));
        Ok(Dataset {
            points,
            bounds,
            avatar: Some(Arc::new(scene)),
            ..settled.dataset(&self.root, self.layout, self.has_alpha, self.notes)
        })
    }

    /// Splits the views by list and role.
    fn sort(&mut self, draft: impl Fn(u32, View) -> Draft) -> Sorted {
        let lists: HashMap<u32, FrameUse> = self.frames.iter().map(|s| (s.number, s.list)).collect();
        let mut out = Sorted::default();
        for Shot { number, role, view } in std::mem::take(&mut self.shots) {
            if role == Role::Cond {
                out.inputs.entry(number).or_default().push(view.clone());
            }
            let list = match (lists.get(&number), role) {
                (Some(FrameUse::Train), Role::Train | Role::Cond) => &mut out.drafts.train,
                (Some(_), Role::Test) => &mut out.drafts.test,
                _ => continue,
            };
            if lists.get(&number) == Some(&FrameUse::Ood) {
                out.ood.insert(view.name.clone());
            }
            out.numbers.insert(view.name.clone(), number);
            list.push(draft(number, view));
        }
        out
    }

    /// Leaves out frames without inputs, and their views: the inputs of another frame would stand in for theirs.
    fn leave_out(&mut self, sorted: &mut Sorted) {
        let Sorted { drafts, inputs, numbers, .. } = sorted;
        let lacking = self.frames.iter().map(|f| f.number).filter(|number| !inputs.contains_key(number));
        let mut views_of: BTreeMap<u32, usize> = lacking.map(|number| (number, 0)).collect();
        let mut keep = |d: &Draft| match numbers.get(&d.view.name).and_then(|number| views_of.get_mut(number)) {
            None => true,
            Some(views) => {
                *views += 1;
                false
            }
        };
        drafts.train.retain(&mut keep);
        drafts.test.retain(&mut keep);
        self.frames.retain(|f| !views_of.contains_key(&f.number));
        for (number, views) in views_of {
            self.notes.push(format!("frame {number} has no input and is left out with its {views} views"));
        }
    }
}

/// Result of [`Film::sort`].
#[derive(Default)]
struct Sorted {
    drafts: Drafts,
    /// Inputs by frame, ascending in camera id.
    inputs: BTreeMap<u32, Vec<View>>,
    /// Names of the test views of frames of the list `ood`.
    ood: HashSet<String>,
    numbers: HashMap<String, u32>,
}

/// Points on the posed template at frame `first`, with its colours.
fn start(scene: &AvatarScene, first: usize) -> Option<PointCloud> {
    let frame = scene.frames.get(first)?;
    let (template, vertices) = (&scene.character.template, scene.posed(frame));
    let points = sample::on_faces(&vertices, &template.faces, START_POINTS, 0, frame.number);
    let color = |(face, bary): &sample::OnFace| {
        let c = template.colour(*face as usize, *bary);
        [c.x, c.y, c.z].map(|v| v.clamp(0.0, 1.0))
    };
    let positions = sample::places(&points, &vertices, &template.faces);
    (!points.is_empty()).then(|| PointCloud { positions, colors: points.iter().map(color).collect() })
}

/// A box around the posed template at every frame.
fn bounds(scene: &AvatarScene) -> Option<[Vec3; 2]> {
    let mut all: Option<[Vec3; 2]> = None;
    for frame in &scene.frames {
        for p in scene.posed(frame).into_iter().filter(|p| p.is_finite()) {
            let [low, high] = all.unwrap_or([p; 2]);
            all = Some([low.min(p), high.max(p)]);
        }
    }
    all.map(|[low, high]| {
        let margin = MARGIN * (high - low).max_element() * Vec3::ONE;
        [low - margin, high + margin]
    })
}
