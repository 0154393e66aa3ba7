//! Image files of cameras: frames of videos by ffmpeg, or copies of images.

use crate::error::ImportError;
use crate::probe::input;
use crate::program::{Call, FFMPEG, Runner, Sink};
use crate::rates::Cut;
use gs_core::cast::{to_u32, to_usize};
use gs_core::io::disk;
use gs_data::decode::stored_size;
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// Folders of images and masks in the data set.
pub(crate) const IMAGES: &str = "images";
pub(crate) const MASKS: &str = "masks";
/// Image files that are read.
pub(crate) const EXTENSIONS: [&str; 3] = ["jpg", "jpeg", "png"];
/// Sizes that an error names.
const SHOWN_SIZES: usize = 3;

/// The name of a camera, from 0.
pub(crate) fn camera_name(camera: usize) -> String {
    format!("cam{camera:02}")
}

/// COLMAP's name of an image of a camera.
pub(crate) fn image_name(camera: usize, file: &Path) -> String {
    format!("{}/{}", camera_name(camera), file.file_name().unwrap_or_default().to_string_lossy())
}

/// The size of frames: that of the video by a factor, its longer side at most so long.
pub(crate) fn scaled(size: [u32; 2], scale: f64, longest: Option<u32>) -> [u32; 2] {
    let longer = f64::from(size[0].max(size[1])) * scale;
    let factor = longest.map_or(scale, |most| scale * (f64::from(most) / longer).min(1.0));
    size.map(|side| to_u32(to_usize((f64::from(side) * factor).round())).max(1))
}

/// What is taken of a video, and where it goes.
pub(crate) struct Extraction<'a> {
    pub(crate) video: &'a Path,
    pub(crate) size: [u32; 2],
    /// Which frames, and the number of the camera.
    pub(crate) cut: &'a Cut,
    pub(crate) camera: usize,
    pub(crate) is_mask: bool,
}

impl Extraction<'_> {
    /// Frames at their times, nearest first: at a multiple of the rate, of which every so many-th is kept.
    fn filter(&self, lead: f64) -> String {
        let Self { cut, size: [width, height], is_mask, .. } = self;
        // JPEG is decoded with the matrix of BT.601 and the full range, whatever those of the video are.
        let flags = if *is_mask { "neighbor" } else { "area:out_color_matrix=bt601:out_range=pc" };
        let (base, every) = (cut.fps * cut.every as f64, cut.every);
        format!(
            "setpts=PTS-{lead}/TB,fps=fps={base}:start_time=0,framestep={every},scale={width}:{height}:flags={flags},setsar=1"
        )
    }

    fn call(&self, folder: &Path) -> Call {
        let begin = self.cut.begins[self.camera];
        // The frame nearest to the beginning may lie before it.
        let lead = begin.min(0.5 / (self.cut.fps * self.cut.every as f64));
        let name = if self.is_mask { "%05d.png" } else { "%05d.jpg" };
        let form: &[&str] = if self.is_mask { &["-pix_fmt", "gray"] } else { &["-qmin", "1", "-q:v", "1"] };
        Call::new(FFMPEG, folder, format!("take frames of {}", self.video.display()))
            .args(["-nostdin", "-hide_banner", "-loglevel", "error", "-progress", "pipe:1", "-ss"])
            .args([format!("{:.6}", begin - lead), "-i".to_owned()])
            .args([input(self.video)])
            .args(["-map", "0:v:0", "-vf", &self.filter(lead), "-frames:v", &self.cut.frames.to_string()])
            .args(form)
            .args(["-start_number", "0", "-f", "image2", name])
    }

    /// Takes the frames into the folder of the camera; they appear there when all are whole. Their number.
    pub(crate) fn run(
        &self,
        runner: &Runner<'_>,
        data: &Path,
        work: &Path,
        tell: &mut dyn FnMut(usize),
    ) -> Result<usize, ImportError> {
        let (part, parent) = (work.join("frames"), data.join(if self.is_mask { MASKS } else { IMAGES }));
        clear(&part)?;
        create(&part)?;
        create(&parent)?;
        let mut progress = |line: &str| {
            line.strip_prefix("frame=").and_then(|n| n.trim().parse().ok()).into_iter().for_each(&mut *tell)
        };
        runner.run(self.call(&part), Sink::Lines(&mut progress))?;
        let count = list(&part)?.len();
        let place = parent.join(camera_name(self.camera));
        disk::rename(&part, &place).map_err(ImportError::os("name the folder of frames", &place))?;
        Ok(count)
    }
}

/// Cameras of a folder of images: its own images are those of one, else those of each folder in it. Names and files, in order.
pub(crate) fn cameras_of(folder: &Path) -> Result<Vec<(String, Vec<PathBuf>)>, ImportError> {
    let own = list(folder)?;
    if !own.is_empty() {
        return Ok(vec![(folder.display().to_string(), own)]);
    }
    let mut cameras = Vec::new();
    for inside in folders(folder)? {
        let files = list(&inside)?;
        if !files.is_empty() {
            cameras.push((inside.display().to_string(), files));
        }
    }
    if cameras.is_empty() {
        return Err(ImportError::Input {
            what: "there are no images".to_owned(),
            path: folder.to_path_buf(),
            why: "PNG and JPEG files are looked for, here and one folder below",
            fix: "give the folder that holds them".to_owned(),
        });
    }
    Ok(cameras)
}

/// Refuses images of one camera that have several sizes: COLMAP finds one lens of one size for them, and leaves out the others.
pub(crate) fn check_sizes(files: &[PathBuf]) -> Result<(), ImportError> {
    let mut sizes: BTreeMap<[u32; 2], Vec<&PathBuf>> = BTreeMap::new();
    for file in files {
        sizes.entry(stored_size(file)?).or_default().push(file);
    }
    let mut groups: Vec<([u32; 2], Vec<&PathBuf>)> = sizes.into_iter().collect();
    groups.sort_by_key(|(_, files)| Reverse(files.len()));
    let [_, (_, others), ..] = &groups[..] else { return Ok(()) };
    let words = |([width, height], files): &([u32; 2], Vec<&PathBuf>)| {
        let first = files.first().and_then(|f| f.file_name()).unwrap_or_default().to_string_lossy().into_owned();
        format!("{width}x{height} ({}, the first is {first})", files.len())
    };
    let shown: Vec<String> = groups.iter().take(SHOWN_SIZES).map(words).collect();
    let more = if groups.len() > SHOWN_SIZES { " ..." } else { "" };
    Err(ImportError::Input {
        what: format!("images of one camera have {} sizes: {}{more}", groups.len(), shown.join(", ")),
        path: others.first().map(|file| file.to_path_buf()).unwrap_or_default(),
        why: "one lens of one size is found for the images of a camera, and images of other sizes have no place",
        fix: "bring them to one size, or take the others away; with --unordered, images of each size in a folder of their own below that of \
            --images are those of a camera each"
            .to_owned(),
    })
}

/// Copies the images of a camera, numbered in order, and their masks.
pub(crate) fn copy(
    images: &[PathBuf],
    masks: Option<&[PathBuf]>,
    data: &Path,
    work: &Path,
    camera: usize,
    stop: &AtomicBool,
) -> Result<(), ImportError> {
    for (parent, files) in [(IMAGES, Some(images)), (MASKS, masks)] {
        let Some(files) = files else { continue };
        let (part, parent) = (work.join("frames"), data.join(parent));
        clear(&part)?;
        create(&part)?;
        create(&parent)?;
        for (k, from) in files.iter().enumerate() {
            if stop.load(Ordering::Relaxed) {
                return Err(ImportError::Stopped { task: "copying images".to_owned() });
            }
            let extension = from.extension().unwrap_or_default().to_string_lossy().to_lowercase();
            let to = part.join(format!("{k:05}.{extension}"));
            fs::copy(from, &to).map_err(ImportError::os("copy the image", from))?;
        }
        let place = parent.join(camera_name(camera));
        disk::rename(&part, &place).map_err(ImportError::os("name the folder of images", &place))?;
    }
    Ok(())
}

/// The number of a frame, where a file is named as one: `00012.jpg`.
pub(crate) fn number(file: &Path) -> Option<usize> {
    let stem = file.file_stem()?.to_str()?;
    stem.parse().ok().filter(|k: &usize| format!("{k:05}") == stem)
}

/// The frames of a camera that were taken, in order.
///
/// # Errors
/// [`ImportError::Input`] if one is missing, or something else lies between them.
pub(crate) fn taken(folder: &Path, count: usize) -> Result<Vec<PathBuf>, ImportError> {
    let mut files = if folder.is_dir() { list(folder)? } else { Vec::new() };
    let at = |k: usize| files.get(k).and_then(|f| number(f));
    let Some(k) = (0..count).find(|&k| at(k) != Some(k)) else {
        files.truncate(count);
        return Ok(files);
    };
    let why = "frame k is image k of its camera";
    let other = files.get(k).filter(|_| files.iter().any(|f| number(f) == Some(k)));
    Err(match other {
        Some(other) => ImportError::Input {
            what: "an image that is no frame lies between the frames".to_owned(),
            path: other.clone(),
            why,
            fix: "move it away".to_owned(),
        },
        None => ImportError::Input {
            what: format!("of {count} frames the image {k:05} is missing"),
            path: folder.to_path_buf(),
            why,
            fix: "put it back, or start over with -f".to_owned(),
        },
    })
}

/// Images of a folder, in order of names, numbers by their value.
pub(crate) fn list(folder: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let known = |p: &PathBuf| {
        let extension = p.extension().map(|e| e.to_string_lossy().to_lowercase());
        p.is_file() && extension.is_some_and(|e| EXTENSIONS.contains(&e.as_str()))
    };
    sorted(folder, &known)
}

fn folders(folder: &Path) -> Result<Vec<PathBuf>, ImportError> {
    sorted(folder, &|p: &PathBuf| p.is_dir())
}

fn sorted(folder: &Path, keep: &dyn Fn(&PathBuf) -> bool) -> Result<Vec<PathBuf>, ImportError> {
    let entries = fs::read_dir(folder).map_err(ImportError::os("list the folder", folder))?;
    let mut found: Vec<PathBuf> = entries.flatten().map(|e| e.path()).filter(keep).collect();
    found.sort_by_key(|p| natural(&p.file_name().unwrap_or_default().to_string_lossy()));
    Ok(found)
}

/// A key by which `img9` comes before `img10`.
fn natural(name: &str) -> Vec<(u64, String)> {
    let mut key = vec![(0, String::new())];
    let mut digits = String::new();
    for c in name.chars().chain(['\0']) {
        if c.is_ascii_digit() {
            digits.push(c);
            continue;
        }
        if !digits.is_empty() {
            key.push((digits.parse().unwrap_or(u64::MAX), std::mem::take(&mut digits)));
            key.push((0, String::new()));
        }
        key.last_mut().into_iter().for_each(|k| k.1.push(c));
    }
    key
}

/// Creates a folder and those above it.
pub(crate) fn create(folder: &Path) -> Result<(), ImportError> {
    disk::create_folder(folder).map_err(ImportError::os("create the folder", folder))
}

/// Removes a folder of the import's own and all that is in it.
pub(crate) fn clear(folder: &Path) -> Result<(), ImportError> {
    match fs::remove_dir_all(folder) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(ImportError::os("remove the folder", folder)(e)),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_keep_their_shape() {
        assert_eq!(scaled([1920, 1080], 1.0, None), [1920, 1080]);
        assert_eq!(scaled([1920, 1080], 0.5, Some(480)), [480, 270]);
        assert_eq!(scaled([1080, 1920], 1.0, Some(4000)), [1080, 1920]);
    }

    #[test]
    fn numbers_in_names_are_numbers() {
        let mut names = ["b1.png", "img10.png", "img9.png", "img9a.png", "img009.png"];
        names.sort_by_key(|n| natural(n));
        assert_eq!(names, ["b1.png", "img009.png", "img9.png", "img9a.png", "img10.png"]);
    }

    #[test]
    fn cameras_are_folders_or_the_folder_itself() {
        let dir = tempfile::tempdir().unwrap();
        let touch = |name: &str| {
            fs::create_dir_all(dir.path().join(name).parent().unwrap()).unwrap();
            fs::write(dir.path().join(name), "x").unwrap();
        };
        assert!(cameras_of(dir.path()).unwrap_err().to_string().contains("no images"));
        ["right/2.JPG", "right/10.jpg", "left/1.png", "notes/a.txt"].iter().for_each(|name| touch(name));
        let cameras = cameras_of(dir.path()).unwrap();
        assert_eq!((cameras.len(), cameras[0].1.len(), cameras[1].1.len()), (2, 1, 2));
        assert!(cameras[1].1[0].ends_with("right/2.JPG"));
        let (white, stop) = (vec![cameras[0].1[0].clone(); 2], AtomicBool::new(false));
        copy(&cameras[1].1, Some(&white), dir.path(), &dir.path().join("work"), 1, &stop).unwrap();
        assert!(["images/cam01/00001.jpg", "masks/cam01/00001.png"].iter().all(|file| dir.path().join(file).is_file()));
        touch("own.png");
        assert_eq!(cameras_of(dir.path()).unwrap().len(), 1);
    }

    #[test]
    fn images_of_another_size_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let save = |(name, width, height): (&str, u32, u32)| {
            let file = dir.path().join(name);
            image::GrayImage::new(width, height).save(&file).unwrap();
            file
        };
        let files = [("1.png", 6, 8), ("2.png", 8, 6), ("3.png", 8, 6), ("4.png", 6, 8), ("5.png", 8, 6)].map(save);
        check_sizes(&files[1..3]).unwrap();
        let e = check_sizes(&files).unwrap_err();
        let text = e.to_string();
        assert!(text.contains("2 sizes: 8x6 (3, the first is 2.png), 6x8 (2, the first is 1.png)"), "{text}");
        assert!(matches!(&e, ImportError::Input { path, fix, .. } if *path == files[0] && fix.contains("--unordered")));
    }

    #[test]
    fn a_frame_that_is_missing_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("cam00");
        let wrong = |word: &str| {
            let e = taken(&folder, 3).unwrap_err();
            assert!(matches!(&e, ImportError::Input { .. }) && e.to_string().contains(word), "{e}");
        };
        wrong("00000 is missing");
        fs::create_dir(&folder).unwrap();
        for name in ["00000.jpg", "00001.jpg", "00002.jpg", "00003.jpg", "mine.jpg"] {
            fs::write(folder.join(name), "x").unwrap();
        }
        let files = taken(&folder, 3).unwrap();
        assert!(files.len() == 3 && files[2].ends_with("00002.jpg"), "{files:?}");
        // Where another image follows, and where none does.
        fs::rename(folder.join("00001.jpg"), folder.join("1.jpg")).unwrap();
        wrong("00001 is missing");
        fs::rename(folder.join("1.jpg"), folder.join("00001.jpg")).unwrap();
        fs::write(folder.join("00001.png"), "x").unwrap();
        wrong("no frame");
        [2, 3].iter().for_each(|k| fs::remove_file(folder.join(format!("0000{k}.jpg"))).unwrap());
        fs::remove_file(folder.join("00001.png")).unwrap();
        wrong("00002 is missing");
    }

    /// Frame `k` of the video has the grey level `8 k`.
    #[cfg(feature = "testkit")]
    #[test]
    fn the_nearest_frames_are_taken() {
        use crate::testkit::{FPS, has, write_video};
        if !has("ffmpeg", "-version") {
            println!("SKIPPED the_nearest_frames_are_taken: ffmpeg is not installed");
            return;
        }
        let dir = tempfile::tempdir().unwrap();
        let video = dir.path().join("-v%d.mp4");
        let frame =
            |k: usize| gs_core::Image { width: 32, height: 32, channels: 3, data: vec![(8 * k) as f32 / 255.0; 3072] };
        write_video(&video, &(0..30).map(frame).collect::<Vec<_>>()).unwrap();
        let stop = std::sync::atomic::AtomicBool::new(false);
        let runner = Runner { stop: &stop, log: dir.path().join("log") };
        let fps = f64::from(FPS);
        let cases = [
            (0.0, fps, 1, [0, 1, 2]),
            (6.6 / fps, fps, 1, [7, 8, 9]),
            (2.0 / fps, fps / 4.0, 4, [2, 6, 10]),
            (0.3 / fps, fps / 2.0, 2, [0, 2, 4]),
        ];
        for (camera, (begin, fps, every, expected)) in cases.into_iter().enumerate() {
            let cut = Cut { fps, frames: 3, begins: vec![begin; 4], every };
            let extraction = Extraction { video: &video, size: [16, 16], cut: &cut, camera, is_mask: camera == 3 };
            let count = extraction.run(&runner, dir.path(), &dir.path().join("work"), &mut |_| {}).unwrap();
            let parent = if camera == 3 { MASKS } else { IMAGES };
            let files = list(&dir.path().join(parent).join(camera_name(camera))).unwrap();
            let level =
                |f: &PathBuf| (f64::from(gs_data::decode::decode(f, None).unwrap().pixel(8, 8)[0]) / 8.0).round();
            let found: Vec<usize> = files.iter().map(|f| to_usize(level(f))).collect();
            assert_eq!((count, found.as_slice()), (3, expected.as_slice()), "from {begin} s at {fps}");
        }
    }
}
