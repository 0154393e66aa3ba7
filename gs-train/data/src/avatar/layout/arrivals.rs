//! Frames of a filmed person that arrive in a folder one by one.
//!
//! ```text
//! images/CAMERA/FRAME.png   of every conditioning camera, with alpha or with masks/CAMERA/FRAME.png
//! poses/FRAME.json          {nodes: {NAME: {translation, rotation, scale}}, morphs: […]}; nodes it does not name are at rest,
//!                           and morphs where `morph` of the film's scene.json is not "apply"
//! cameras.json, crops.json  as in a film; without cameras.json those of the film are taken
//! ```
//! A frame is there once all of its files are; masks have to be written before their images. A file that cannot be read yet is
//! read again for a second.

use super::cameras::{self, Crops, FilmCamera};
use super::manifest::Manifest;
use super::{Role, Shots, poses};
use crate::Dataset;
use crate::avatar::AvatarScene;
use crate::cache::ImageCache;
use crate::error::{DataError, Place};
use crate::files::Root;
use crate::frames::EXTENSIONS;
use crate::options::DataOptions;
use gs_core::{Camera, Image};
use gs_texel::Pose;
use std::collections::BTreeSet;
use std::ops::Bound;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

/// A file that cannot be read is taken for one that is still being written so long after its last change.
const SETTLED: Duration = Duration::from_secs(1);
/// So long after a change of a folder was seen it may change again without another time of change, on the coarsest file systems.
const COARSE: Duration = Duration::from_secs(2);
/// Within that time it is listed again after this one.
const AGAIN: Duration = Duration::from_millis(50);
/// Bytes of decoded images kept: those of one frame are read once.
const IMAGE_BYTES: usize = 0;

/// A frame that has arrived.
#[derive(Clone, Debug)]
pub struct ArrivedFrame {
    /// Its number.
    pub number: u32,
    /// Joint transforms and known morph weights.
    pub pose: Pose,
    /// Images of the conditioning cameras, ascending in id: `[H, W, 4]` in 0..1, straight colours and coverage.
    pub images: Vec<(Camera, Image)>,
    /// When the last of its files was written.
    pub written: SystemTime,
    /// Frames that were there, too, and are older: they are passed over.
    pub passed_over: usize,
}

/// Where the poses of frames come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PosesFrom {
    /// `poses/FRAME.json` of the folder.
    Folder,
    /// The frame of the same number of the film.
    Film,
}

/// Finds the newest frame of a folder into which a film of a person is written.
pub struct Arrivals {
    root: Root,
    cameras: Vec<FilmCamera>,
    crops: Crops,
    scene: Arc<AvatarScene>,
    poses: PosesFrom,
    /// The film's own file, which says whether poses state morphs.
    manifest: Option<Manifest>,
    options: DataOptions,
    /// Number of the newest frame that was given out.
    last: Option<u32>,
    refused: BTreeSet<u32>,
    listing: Option<Listing>,
}

/// What was in a folder, and when.
struct Listing {
    /// The time of change that the folder had.
    changed: SystemTime,
    /// When it was seen to have it first, and when it was listed.
    seen: Instant,
    listed: Instant,
    numbers: BTreeSet<u32>,
}

impl Listing {
    /// Whether a folder whose time of change is the same holds the same.
    fn holds(&self, now: Instant) -> bool {
        self.listed >= self.seen + COARSE || now < self.listed + AGAIN
    }
}

impl Arrivals {
    /// Frames in `dir` of the person of `film`, whose cameras are taken where `dir` has none.
    ///
    /// # Errors
    /// `data.path` if `dir` is no folder, `data.layout` if `film` shows no person; those of `cameras.json`, `crops.json` and the film's
    /// `scene.json`.
    pub fn new(dir: &Path, film: &Dataset, poses: PosesFrom, options: DataOptions) -> Result<Self, DataError> {
        let Some(scene) = film.avatar.clone() else {
            let looked_for = "a film of a person, layout `avatar`".into();
            return Err(DataError::Layout { path: film.root.clone(), looked_for });
        };
        let root = Root::new(dir)?;
        let own = dir.join("cameras.json").is_file();
        let mut cameras = cameras::read(&if own { dir } else { &film.root }.join("cameras.json"))?;
        cameras.retain(|c| c.role == Role::Cond);
        let crops = Crops::read(&dir.join("crops.json"))?;
        let file = film.root.join("scene.json");
        let manifest = file.is_file().then(|| Manifest::read(&file)).transpose()?;
        let (last, refused, listing) = Default::default();
        Ok(Self { root, cameras, crops, scene, poses, manifest, options, last, refused, listing })
    }

    /// Ids of the conditioning cameras, which name the folders of their images.
    pub fn cameras(&self) -> impl Iterator<Item = u32> {
        self.cameras.iter().map(|c| c.id)
    }

    /// The newest whole frame whose number is above those given out before; none if there is none yet.
    ///
    /// # Errors
    /// If a frame cannot be read a second after its last file was written. It is not tried again; later calls go on.
    pub fn newest(&mut self) -> Result<Option<ArrivedFrame>, DataError> {
        let whole: Vec<(u32, SystemTime)> =
            self.numbers().into_iter().rev().filter_map(|n| Some((n, self.written(n)?))).collect();
        for (k, &(number, written)) in whole.iter().enumerate() {
            match self.read(number) {
                Ok((pose, images)) => {
                    self.last = Some(number);
                    self.refused.retain(|n| *n > number);
                    let passed_over = whole.len() - k - 1;
                    return Ok(Some(ArrivedFrame { number, pose, images, written, passed_over }));
                }
                Err(_) if written.elapsed().unwrap_or_default() < SETTLED => {}
                Err(e) => {
                    self.refused.insert(number);
                    return Err(e);
                }
            }
        }
        Ok(None)
    }

    /// Numbers of images of the first camera that were not given out, ascending.
    fn numbers(&mut self) -> BTreeSet<u32> {
        let Some(camera) = self.cameras.first() else { return BTreeSet::new() };
        let folder = self.root.dir().join(format!("images/{:03}", camera.id));
        let listing = listing(&folder, self.listing.take());
        let after = (self.last.map_or(Bound::Unbounded, Bound::Excluded), Bound::Unbounded);
        let numbers = listing.iter().flat_map(|l| l.numbers.range(after)).copied();
        let numbers = numbers.filter(|n| !self.refused.contains(n)).collect();
        self.listing = listing;
        numbers
    }

    /// When the last file of a frame was written; none while one is missing.
    fn written(&self, number: u32) -> Option<SystemTime> {
        let time = |file: &Path| std::fs::metadata(file).and_then(|m| m.modified()).ok();
        let image = |id: u32| {
            let name = |e: &str| time(&self.root.dir().join(format!("images/{id:03}/{number:06}.{e}")));
            EXTENSIONS.iter().find_map(|e| name(e))
        };
        let mut last = match self.poses {
            PosesFrom::Folder => time(&self.pose_file(number))?,
            PosesFrom::Film => SystemTime::UNIX_EPOCH,
        };
        for id in self.cameras() {
            last = last.max(image(id)?);
            let mask = self.root.dir().join(format!("masks/{id:03}/{number:06}.png"));
            last = time(&mask).map_or(last, |t| last.max(t));
        }
        Some(last)
    }

    fn pose_file(&self, number: u32) -> PathBuf {
        self.root.dir().join(format!("poses/{number:06}.json"))
    }

    fn pose(&self, number: u32) -> Result<Pose, DataError> {
        let character = &self.scene.character;
        if self.poses == PosesFrom::Folder {
            let shown = poses::read_one(&self.pose_file(number), character.skeleton.rest_pose(), character)?;
            return Ok(match &self.manifest {
                Some(manifest) => manifest.known(character, shown).0,
                None => shown,
            });
        }
        let filmed = self.scene.frames.iter().find(|f| f.number == number);
        filmed.map(|f| f.pose.clone()).ok_or_else(|| DataError::Field {
            place: Place::new(self.root.dir(), "images"),
            value: number.to_string(),
            why: "the film has no frame of this number, and poses were to be those of the film",
            fix: "write poses/FRAME.json",
        })
    }

    fn read(&self, number: u32) -> Result<(Pose, Vec<(Camera, Image)>), DataError> {
        let pose = self.pose(number)?;
        let mut shots = Shots::new(&self.root, &self.options, &self.crops);
        let mut views = Vec::with_capacity(self.cameras.len());
        for camera in &self.cameras {
            let mut view = shots.shot(camera, number, shots.locate(camera.id, number)?)?.view;
            if self.options.scale < 1.0 {
                view.shrink(self.options.scale);
            }
            views.push(view);
        }
        let cache = ImageCache::new(IMAGE_BYTES, 1.0).with_max_image_mib(self.options.max_image_mib);
        Ok((pose, AvatarScene::input_images(&views, &cache)?))
    }
}

/// The images of a folder by number: those of a listing where it still holds; none where the folder does not say when it changed, or
/// is not there.
fn listing(folder: &Path, known: Option<Listing>) -> Option<Listing> {
    let changed = std::fs::metadata(folder).and_then(|m| m.modified()).ok()?;
    let (known, now) = (known.filter(|l| l.changed == changed), Instant::now());
    let seen = known.as_ref().map_or(now, |l| l.seen);
    known.filter(|l| l.holds(now)).or_else(|| Some(Listing { changed, seen, listed: now, numbers: numbers_in(folder) }))
}

/// Numbers that are names of images in a folder.
fn numbers_in(folder: &Path) -> BTreeSet<u32> {
    let number = |entry: std::io::Result<std::fs::DirEntry>| {
        let name = PathBuf::from(entry.ok()?.file_name());
        let image = name.extension().and_then(|e| e.to_str()).is_some_and(|e| EXTENSIONS.contains(&e));
        name.file_stem().filter(|_| image)?.to_str()?.parse::<u32>().ok()
    };
    std::fs::read_dir(folder).into_iter().flatten().filter_map(number).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_listing_holds_until_its_folder_may_have_changed() {
        let begun = Instant::now();
        let at = |ms: u64| begun + Duration::from_millis(ms);
        let holds = |listed: u64, now: u64| {
            let (changed, numbers) = (SystemTime::UNIX_EPOCH, BTreeSet::new());
            Listing { changed, seen: at(0), listed: at(listed), numbers }.holds(at(now))
        };
        assert!(holds(10, 59) && !holds(10, 60), "it may have changed within one time of change");
        assert!(holds(1990, 2039) && !holds(1990, 2040));
        assert!(holds(2000, 9_000_000), "any further change has another time");
    }

    #[cfg(unix)]
    #[test]
    fn a_folder_is_listed_when_its_time_has_changed() {
        let dir = tempfile::tempdir().unwrap();
        let put = |name: &str| std::fs::write(dir.path().join(name), "x").unwrap();
        let hour = |n: u64| {
            let time = SystemTime::UNIX_EPOCH + Duration::from_secs(3600 * n);
            std::fs::File::open(dir.path()).unwrap().set_modified(time).unwrap();
        };
        // Seen four seconds ago, listed two seconds ago.
        let earlier = |l: Listing| {
            let ago = |by: Duration| Instant::now().checked_sub(by).unwrap();
            Some(Listing { seen: ago(2 * COARSE), listed: ago(COARSE), ..l })
        };
        let numbers = |known: Option<Listing>| listing(dir.path(), known).unwrap();
        put("000001.png");
        put("notes.txt");
        hour(9);
        let first = numbers(None);
        assert_eq!(first.numbers, BTreeSet::from([1]));
        put("000002.png");
        hour(9);
        let kept = numbers(earlier(first));
        assert_eq!(kept.numbers.len(), 1, "it is not listed while its time stays");
        hour(10);
        assert_eq!(numbers(earlier(kept)).numbers, BTreeSet::from([1, 2]));
        assert!(listing(&dir.path().join("none"), None).is_none());
    }
}
