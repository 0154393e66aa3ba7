//! Cameras: of a rig at rest from a few moments, of moving cameras from key frames and then the rest; and the end of an import.

use crate::colmap::{CameraModel, Colmap, Features, Lot, Model, Pairs};
use crate::error::ImportError;
use crate::frames::{IMAGES, MASKS, camera_name, image_name};
use crate::look::Rig;
use crate::poses::{Posed, RigPoses, central, rig, spread_over, upright};
use crate::write::{Frame, moved, write};
use crate::{Event, Imported, ImportedCamera, Job, named};
use gs_core::Camera;
use gs_data::{PointCloud, Registered, decode::stored_size};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Images of a rig that are matched with each other, about so many; most moments for that.
const RIG_IMAGES: usize = 60;
const RIG_MOMENTS: usize = 4;
/// Up to so many key frames every pair is matched; beyond, each with so many that follow.
const ALL_PAIRS: usize = 50;
const OVERLAP: usize = 10;
/// Most key frames of which every pair is matched where those that follow each other were not enough.
const MOST_ALL_PAIRS: usize = 150;
/// Share of the key frames, and of all frames, that must be placed.
const ENOUGH: f64 = 0.9;
const LEAST: f64 = 0.5;
/// Attempts at a rig or at key frames.
const ATTEMPTS: usize = 2;
/// A rig whose images of one camera lie apart by more than this share of its width is worth a warning.
const MAX_SPREAD: f64 = 0.02;

/// Cameras by frame, and what they were found from.
struct Placed {
    frames: Vec<([usize; 2], Posed)>,
    points: PointCloud,
    spread: Option<f64>,
    model: Model,
}

impl Job<'_> {
    /// Finds the cameras and writes the data set.
    pub(crate) fn finish(&mut self) -> Result<Imported, ImportError> {
        let rig = self.state.rig.unwrap_or(Rig::Moving);
        if rig == Rig::Moving && self.settings().held_out.is_some() {
            self.say("note: these cameras move: no camera is held out as a whole, and --held-out has no effect");
        }
        let placed = match rig {
            Rig::Fixed => self.rig()?,
            Rig::Moving => self.moving()?,
        };
        let reprojection = self.colmap().error_of(&placed.model)?;
        let imported = self.write(rig, placed, reprojection)?;
        self.state.finished = serde_json::to_value(&imported).ok();
        self.save()?;
        Ok(imported)
    }

    fn colmap(&self) -> Colmap<'_> {
        Colmap { runner: self.runner, data: self.data, gpu: self.settings().gpu, threads: self.threads }
    }

    /// Calls COLMAP, and tells how far it is.
    fn call<T>(
        &mut self,
        what: &str,
        run: impl FnOnce(&Colmap<'_>, &mut dyn FnMut(usize, Option<usize>)) -> Result<T, ImportError>,
    ) -> Result<T, ImportError> {
        let (gpu, data, threads) = (self.settings().gpu, self.data, self.threads);
        let colmap = Colmap { runner: self.runner, data, gpu, threads };
        let tell = &mut *self.tell;
        run(&colmap, &mut |done, of| tell(Event::Progress { what, done, of }))
    }

    fn features(&self, wide: bool, usual: CameraModel) -> Features {
        Features { model: self.settings().model.unwrap_or(usual), fov: self.settings().fov, wide }
    }

    /// Images of frames as the lots of the extractor: one of each camera, or of all where they have one lens.
    fn lots(&self, frames: &[[usize; 2]], known: &BTreeMap<usize, u32>) -> Result<Vec<Lot>, ImportError> {
        let mut lots: Vec<Lot> = Vec::new();
        let mut by_camera: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        frames.iter().for_each(|[camera, frame]| by_camera.entry(*camera).or_default().push(*frame));
        for (camera, list) in by_camera {
            let files = self.files(camera)?;
            let size = stored_size(&files[list[0]])?;
            let names = list.iter().map(|&k| image_name(camera, &files[k]));
            match lots.first_mut().filter(|_| self.settings().same_lens) {
                Some(lot) if lot.size == size => lot.names.extend(names),
                Some(lot) => {
                    let ([[w0, h0], [w, h]], name) = ([lot.size, size], camera_name(camera));
                    return Err(ImportError::Cameras {
                        what: format!("images of one lens have sizes {w0}x{h0} and {w}x{h} ({name})"),
                        fix: "leave out --same-lens".to_owned(),
                    });
                }
                None => lots.push(Lot { names: names.collect(), size, existing: known.get(&camera).copied() }),
            }
        }
        Ok(lots)
    }

    /// One model of some frames: features, matches, reconstruction, each once.
    fn model(
        &mut self,
        frames: &[[usize; 2]],
        features: Features,
        pairs: &Pairs,
    ) -> Result<Option<Model>, ImportError> {
        if !self.state.solving.extracted {
            self.colmap().forget()?;
            let lots = self.lots(frames, &BTreeMap::new())?;
            self.call("features", |colmap, tell| colmap.extract(&lots, features, tell))?;
            self.state.solving.extracted = true;
            self.save()?;
        }
        if !self.state.solving.matched {
            self.call("matches", |colmap, tell| colmap.match_images(pairs, features.wide, tell))?;
            self.state.solving.matched = true;
            self.save()?;
        }
        if let Some(folder) = &self.state.solving.model {
            return Ok(Some(Model::open(self.data, folder)?));
        }
        let known = features.fov.is_some();
        let of = Some(frames.len());
        self.call("images placed", |colmap, tell| colmap.map(known, &mut |done, _| tell(done, of)))
    }

    fn keep(&mut self, model: &Model) -> Result<(), ImportError> {
        self.state.solving.model = Some(model.folder().to_owned());
        self.save()
    }

    /// The next attempt begins from nothing.
    fn next_attempt(&mut self) -> Result<(), ImportError> {
        let attempt = self.state.solving.attempt + 1;
        self.state.solving = crate::state::Solving { attempt, ..Default::default() };
        self.save()
    }

    /// Moments of a rig that are not left out.
    fn moments(&self) -> Vec<usize> {
        let count = self.state.frames.iter().copied().min().unwrap_or(0);
        let left = self.state.left_out.clone().unwrap_or_default();
        (0..count).filter(|&k| !left.has([0, k])).collect()
    }

    /// One pose for each camera of a rig.
    fn rig(&mut self) -> Result<Placed, ImportError> {
        let (moments, n) = (self.moments(), self.sources.len());
        let few = self.settings().moments.map_or((RIG_IMAGES / n).clamp(1, RIG_MOMENTS), |m| m as usize);
        let chosen = spread_over(moments.len(), few);
        let frames: Vec<[usize; 2]> =
            (0..n).flat_map(|c| chosen.iter().map(move |&k| (c, k))).map(|(c, k)| [c, moments[k]]).collect();
        let mut most: Option<(Model, RigPoses)> = None;
        while self.state.solving.attempt < ATTEMPTS {
            let wide = self.state.solving.attempt > 0;
            if wide && !self.state.solving.extracted {
                self.say("not all cameras could be placed: trying again with features for wider angles");
            }
            if let Some(model) = self.model(&frames, self.features(wide, CameraModel::SimpleRadial), &Pairs::All)? {
                let poses = rig(&model.read, n);
                if poses.cameras.iter().all(Option::is_some) {
                    self.keep(&model)?;
                    return self.placed_rig(model, poses, &moments);
                }
                let placed = |p: &RigPoses| p.images.iter().filter(|i| **i > 0).count();
                if most.as_ref().is_none_or(|(_, best)| placed(best) < placed(&poses)) {
                    most = Some((model, poses));
                }
            }
            self.next_attempt()?;
        }
        // A later call tries again.
        self.state.solving = crate::state::Solving::default();
        self.save()?;
        Err(self.unplaced(most.map(|m| m.1)))
    }

    fn unplaced(&self, poses: Option<RigPoses>) -> ImportError {
        let lacking: Vec<String> = match &poses {
            None => Vec::new(),
            Some(poses) => {
                let lacks = poses.images.iter().enumerate().filter(|i| *i.1 == 0);
                lacks.map(|(k, _)| format!("{} ({})", camera_name(k), self.sources[k].0.display())).collect()
            }
        };
        let what = match lacking.is_empty() {
            true => "COLMAP found no two images that fit together".to_owned(),
            false => format!("COLMAP could not place {}", lacking.join(", ")),
        };
        let fix = "cameras beside each other should differ by at most some 30 degrees and see a background with texture; for two or three cameras give \
            their horizontal field of view with --fov DEGREES; --moments 8 takes more images of each; \
            or leave those videos out; import/log.txt has what COLMAP said";
        ImportError::Cameras { what, fix: fix.to_owned() }
    }

    fn placed_rig(&mut self, model: Model, poses: RigPoses, moments: &[usize]) -> Result<Placed, ImportError> {
        if poses.spread > MAX_SPREAD {
            self.say(format!(
                "warning: the places of one camera at different moments differ by up to {:.1} % of the rig's width: does it stand still?",
                100.0 * poses.spread
            ));
        }
        let cameras: Vec<Posed> = poses.cameras.into_iter().flatten().collect();
        let each = |(c, posed): (usize, &Posed)| moments.iter().map(|&k| ([c, k], posed.clone())).collect::<Vec<_>>();
        let frames = cameras.iter().enumerate().flat_map(each).collect();
        let points = model.read.points.clone().unwrap_or_default();
        Ok(Placed { frames, points, spread: Some(poses.spread), model })
    }

    /// A pose for every frame of moving cameras.
    fn moving(&mut self) -> Result<Placed, ImportError> {
        let left = self.state.left_out.clone().unwrap_or_default();
        let of =
            |(camera, n): (usize, &usize)| (0..*n).map(|k| [camera, k]).filter(|f| !left.has(*f)).collect::<Vec<_>>();
        let kept: Vec<Vec<[usize; 2]>> = self.state.frames.iter().enumerate().map(of).collect();
        let all: usize = kept.iter().map(Vec::len).sum();
        let share = |list: &Vec<[usize; 2]>| (self.settings().keyframes as usize * list.len()).div_ceil(all.max(1));
        let keys: Vec<[usize; 2]> =
            kept.iter().flat_map(|list| spread_over(list.len(), share(list)).into_iter().map(|k| list[k])).collect();
        let model = self.key_model(&keys)?;
        let model = if keys.len() < all { self.others(model, &keys, kept.concat())? } else { model };
        self.placed_moving(model, &kept.concat())
    }

    /// The model of the key frames.
    fn key_model(&mut self, keys: &[[usize; 2]]) -> Result<Model, ImportError> {
        let mut most: Option<usize> = None;
        while self.state.solving.attempt < ATTEMPTS {
            let again = self.state.solving.attempt > 0;
            let every = keys.len() <= ALL_PAIRS || again || self.settings().unordered;
            let pairs = if every { Pairs::All } else { Pairs::Following(OVERLAP) };
            if let Some(model) = self.model(keys, self.features(again, CameraModel::Opencv), &pairs)? {
                let placed = model.read.images.len();
                let enough = if again || keys.len() > MOST_ALL_PAIRS { LEAST } else { ENOUGH };
                // Films that follow each other in order of names only may make models of their own.
                let whole = again
                    || keys.len() > 2 * MOST_ALL_PAIRS
                    || (0..self.sources.len()).all(|camera| lens_of(&model, camera).is_some());
                if whole && placed as f64 >= enough * keys.len() as f64 {
                    self.keep(&model)?;
                    return Ok(model);
                }
                most = most.max(Some(placed));
            }
            self.say("not enough frames could be placed: trying again with every pair and features for wider angles");
            self.next_attempt()?;
        }
        self.state.solving = crate::state::Solving::default();
        self.save()?;
        Err(ImportError::Cameras {
            what: format!("COLMAP could place {} of {} key frames", most.unwrap_or(0), keys.len()),
            fix: "the camera should move sideways, not only turn, before a background with texture that mostly stands still; more key frames: \
                --keyframes 200; a part of the video: --start, --duration; import/log.txt has what COLMAP said"
                .to_owned(),
        })
    }

    /// Places the frames that are no key frames.
    fn others(&mut self, model: Model, keys: &[[usize; 2]], all: Vec<[usize; 2]>) -> Result<Model, ImportError> {
        let step = all.len().div_ceil(keys.len().max(1));
        let rest = all.len() - keys.len();
        if !self.state.solving.rest_matched {
            let others: Vec<[usize; 2]> = all.into_iter().filter(|f| !keys.contains(f)).collect();
            let known = (0..self.sources.len()).filter_map(|c| Some((c, lens_of(&model, c)?))).collect();
            let lots = self.lots(&others, &known)?;
            let features = self.features(self.state.solving.attempt > 0, CameraModel::Opencv);
            self.call("features of the other frames", |colmap, tell| colmap.extract(&lots, features, tell))?;
            let pairs = match self.settings().unordered {
                true => Pairs::Listed(self.with_keys(&others, keys)?),
                false => Pairs::Following((2 * step).max(5)),
            };
            let matches = "matches of the other frames";
            self.call(matches, |colmap, tell| colmap.match_images(&pairs, features.wide, tell))?;
            self.state.solving.rest_matched = true;
            self.save()?;
        }
        let of = Some(rest);
        self.call("other frames placed", |colmap, tell| colmap.register(&model, &mut |done, _| tell(done, of)))
    }

    /// Pairs of each of the other frames with every key frame.
    fn with_keys(&self, others: &[[usize; 2]], keys: &[[usize; 2]]) -> Result<Vec<String>, ImportError> {
        let files = self.all_files()?;
        let name = |[camera, k]: &[usize; 2]| image_name(*camera, &files[*camera][*k]);
        let keys: Vec<String> = keys.iter().map(name).collect();
        let with = |other: String| keys.iter().map(move |key| format!("{key} {other}"));
        Ok(others.iter().map(name).flat_map(with).collect())
    }

    fn all_files(&self) -> Result<Vec<Vec<PathBuf>>, ImportError> {
        (0..self.sources.len()).map(|camera| self.files(camera)).collect()
    }

    fn placed_moving(&mut self, model: Model, all: &[[usize; 2]]) -> Result<Placed, ImportError> {
        let by_name: BTreeMap<&str, &Registered> = model.read.images.iter().map(|i| (i.name.as_str(), i)).collect();
        let (mut frames, mut unplaced) = (Vec::new(), Vec::new());
        let files = self.all_files()?;
        for &[camera, k] in all {
            match by_name.get(image_name(camera, &files[camera][k]).as_str()) {
                Some(image) => frames.push(([camera, k], Posed::from(*image))),
                None => unplaced.push([camera, k]),
            }
        }
        if !unplaced.is_empty() {
            let text = format!("{} frames could not be placed and are left out: {}", unplaced.len(), named(&unplaced));
            (self.tell)(Event::Say(&text));
        }
        let mut left = self.state.left_out.clone().unwrap_or_default();
        left.unplaced = unplaced;
        self.state.left_out = Some(left);
        let points = model.read.points.clone().unwrap_or_default();
        Ok(Placed { frames, points, spread: None, model })
    }

    /// Writes the data set, in an upright world.
    fn write(&mut self, rig: Rig, placed: Placed, reprojection: Option<f64>) -> Result<Imported, ImportError> {
        let cameras: Vec<&Camera> = placed.frames.iter().map(|f| &f.1.camera).collect();
        let change = upright(&cameras, &placed.points);
        let held_out = self.held_out(rig, &placed);
        let fps = self.state.cut.as_ref().map(|c| c.fps).filter(|_| !self.settings().unordered);
        let files = self.all_files()?;
        let numbered = rig == Rig::Fixed || self.sources.len() > 1;
        let with_masks = self.settings().masks.is_some();
        let frame = |([camera, k], posed): &([usize; 2], Posed)| {
            let name = |file: &Path| image_name(*camera, file);
            let file = &files[*camera][*k];
            Frame {
                file: format!("{IMAGES}/{}", name(file)),
                mask: with_masks.then(|| format!("{MASKS}/{}", name(&file.with_extension("png")))),
                time: fps.map(|fps| *k as f64 / fps),
                camera: numbered.then_some(*camera),
                posed: Posed { camera: change.camera(&posed.camera), ..posed.clone() },
            }
        };
        let frames: Vec<Frame> = placed.frames.iter().map(frame).collect();
        write(self.data, &frames, &moved(&placed.points, &change), held_out)?;
        let of = |c: usize| ImportedCamera {
            name: camera_name(c),
            source: self.sources[c].0.display().to_string(),
            frames: placed.frames.iter().filter(|f| f.0[0] == c).count(),
            offset: self.offset_of(c),
        };
        Ok(Imported {
            rig,
            why: self.state.why.clone(),
            cameras: (0..self.sources.len()).map(of).collect(),
            frames: frames.len(),
            fps,
            points: placed.points.positions.len(),
            reprojection,
            spread: placed.spread,
            held_out: held_out.map(camera_name),
            left_out: self.state.left_out.clone().unwrap_or_default(),
        })
    }

    fn offset_of(&self, camera: usize) -> Option<f64> {
        let given = self.settings().offsets.as_ref().and_then(|o| o.get(camera).copied());
        given.or_else(|| self.state.clocks.as_ref().filter(|c| c.known[camera]).map(|c| c.offsets[camera]))
    }

    /// Fails if the camera to hold out is none of several.
    pub(crate) fn check_held_out(&self) -> Result<(), ImportError> {
        let n = self.sources.len();
        match self.settings().held_out {
            Some(asked) if asked as usize >= n || n < 2 => Err(ImportError::Cameras {
                what: format!("there is no camera {asked} to hold out"),
                fix: match n {
                    0 | 1 => "leave --held-out out: there is one camera".to_owned(),
                    n => format!("cameras are numbered from 0 to {}", n - 1),
                },
            }),
            _ => Ok(()),
        }
    }

    /// The camera of a rig whose frames are for tests.
    fn held_out(&self, kind: Rig, placed: &Placed) -> Option<usize> {
        const LEAST_CAMERAS: usize = 5;
        let n = self.sources.len();
        if kind != Rig::Fixed {
            return None;
        }
        let asked = self.settings().held_out.map(|camera| camera as usize);
        if asked.is_some() || n < LEAST_CAMERAS {
            return asked;
        }
        let first = |c: usize| placed.frames.iter().find(|f| f.0[0] == c).map(|f| &f.1.camera);
        central(&(0..n).filter_map(first).collect::<Vec<_>>())
    }
}

/// The number of a camera's lens in a model.
fn lens_of(model: &Model, camera: usize) -> Option<u32> {
    let folder = format!("{}/", camera_name(camera));
    model.read.images.iter().find(|i| i.name.starts_with(&folder)).map(|i| i.camera_id)
}
