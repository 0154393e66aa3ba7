//! Which mask belongs to which image or video: the one of the same name without the ending, in a folder of masks.

use crate::error::ImportError;
use crate::probe::Video;
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

/// The videos of masks for videos, in their order: each the only other file of the same stem in a folder.
///
/// # Errors
/// [`ImportError::Input`] if two videos have one stem, or a video has no such file, or several.
pub(crate) fn of_videos(videos: &[PathBuf], masks: &Path) -> Result<Vec<PathBuf>, ImportError> {
    check_stems(videos)?;
    videos.iter().map(|video| of_video(video, masks)).collect()
}

fn of_video(video: &Path, masks: &Path) -> Result<PathBuf, ImportError> {
    let stem = video.file_stem().unwrap_or_default();
    let entries = fs::read_dir(masks).map_err(ImportError::os("list the folder of masks", masks))?;
    let same = |p: &PathBuf| p.file_stem() == Some(stem) && p.is_file() && is_another(p, video);
    let mut found: Vec<PathBuf> = entries.flatten().map(|e| e.path()).filter(same).collect();
    found.sort();
    let what = match &found[..] {
        [one] => return Ok(one.clone()),
        [] => format!("there is no video of masks for {}", video.display()),
        [first, second, ..] => {
            format!("{} and {} have the name of {}", first.display(), second.display(), video.display())
        }
    };
    Err(wrong(what, masks, format!("have one file {}.mp4 there: white counts, black does not", stem.to_string_lossy())))
}

/// The masks of the images of a camera, in their order: PNG files of the same stems. They lie in the folder `masks` where the images lie
/// in the folder `images`, and in a folder of the camera's name in it where the images lie in such a one.
///
/// # Errors
/// [`ImportError::Input`] if two images have one stem, or an image has no mask.
pub(crate) fn of_images(files: &[PathBuf], images: &Path, masks: &Path) -> Result<Vec<PathBuf>, ImportError> {
    check_stems(files)?;
    let parent = files.first().and_then(|file| file.parent()).filter(|parent| *parent != images);
    let folder = parent.and_then(Path::file_name).map_or_else(|| masks.to_path_buf(), |camera| masks.join(camera));
    let of_image = |image: &PathBuf| {
        // A stem may have dots.
        let mut name = image.file_stem().unwrap_or_default().to_os_string();
        name.push(".png");
        let mask = folder.join(&name);
        if mask.is_file() && is_another(&mask, image) {
            return Ok(mask);
        }
        let fix = format!("have the file {} there: white counts, black does not", name.to_string_lossy());
        Err(wrong(format!("there is no mask for {}", image.display()), &folder, fix))
    };
    files.iter().map(of_image).collect()
}

/// Checks that frames of a video and of its masks are those of the same times.
pub(crate) fn check_length(video: &Video, masks: &Video, path: &Path) -> Result<(), ImportError> {
    if (video.seconds - masks.seconds).abs() <= 2.0 / video.fps {
        return Ok(());
    }
    Err(ImportError::Input {
        what: format!("the masks last {:.2} s, their video {:.2} s", masks.seconds, video.seconds),
        path: path.to_path_buf(),
        why: "masks are taken at the times of the frames",
        fix: "give masks of the whole video, at its rate".to_owned(),
    })
}

/// Refuses files of which two would have one mask.
fn check_stems(files: &[PathBuf]) -> Result<(), ImportError> {
    let mut seen: BTreeMap<&OsStr, &PathBuf> = BTreeMap::new();
    for file in files {
        if let Some(other) = seen.insert(file.file_stem().unwrap_or_default(), file) {
            let what = format!(
                "{} and {} have one name without their endings, and so one mask",
                other.display(),
                file.display()
            );
            let fix = "rename one of them, give each a mask of its name, and put masks into a folder of their own";
            return Err(wrong(what, file, fix.to_owned()));
        }
    }
    Ok(())
}

/// Whether two paths are of different files.
fn is_another(a: &Path, b: &Path) -> bool {
    a.canonicalize().ok() != b.canonicalize().ok()
}

fn wrong(what: String, path: &Path, fix: String) -> ImportError {
    let why = "masks belong to images and videos by their names without the ending";
    ImportError::Input { what, path: path.to_path_buf(), why, fix }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Creates empty files, and the folders above them.
    fn touch(dir: &Path, names: &[&str]) -> Vec<PathBuf> {
        let create = |name: &&str| {
            let file = dir.join(name);
            fs::create_dir_all(file.parent().unwrap()).unwrap();
            fs::write(&file, "x").unwrap();
            file
        };
        names.iter().map(create).collect()
    }

    #[test]
    fn masks_of_a_video_are_one_other_file_of_the_name() {
        let dir = tempfile::tempdir().unwrap();
        let films = &touch(dir.path(), &["a.mp4", "b.mp4"])[..1];
        let fails = |films: &[PathBuf]| of_videos(films, dir.path()).unwrap_err().to_string();
        assert!(fails(films).contains("no video of masks"), "not the film");
        let masks = touch(dir.path(), &["a.mkv"]);
        assert_eq!(of_videos(films, dir.path()).unwrap(), masks);
        touch(dir.path(), &["a.json"]);
        let e = fails(films);
        assert!(e.contains("a.json") && e.contains("a.mkv"), "{e}");
        let e = fails(&touch(dir.path(), &["left/c.mp4", "right/c.mp4"]));
        assert!(e.contains("left/c.mp4 and ") && e.contains("right/c.mp4 have one name"), "{e}");
    }

    #[test]
    fn a_mask_has_the_whole_stem_of_its_image_and_of_no_other() {
        let dir = tempfile::tempdir().unwrap();
        let [images, masks] = ["pictures", "white"].map(|name| dir.path().join(name));
        let shots = touch(&images, &["shot.0001.png", "shot.0002.jpg"]);
        let fails = |files: &[PathBuf], masks: &Path| of_images(files, &images, masks).unwrap_err().to_string();
        assert!(fails(&shots, &masks).contains("no mask for"));
        assert!(fails(&shots[..1], &images).contains("no mask for"), "an image is not its own mask");
        let white = touch(&masks, &["shot.0001.png", "shot.0002.png"]);
        assert_eq!(of_images(&shots, &images, &masks).unwrap(), white);
        let both = [shots, touch(&images, &["shot.0002.png"])].concat();
        let e = fails(&both, &masks);
        assert!(e.contains("shot.0002.jpg and ") && e.contains("shot.0002.png have one name"), "{e}");
    }

    #[test]
    fn masks_lie_in_folders_of_cameras_where_images_do() {
        let dir = tempfile::tempdir().unwrap();
        let [images, masks] = ["pictures", "white"].map(|name| dir.path().join(name));
        let left = touch(&images, &["left/1.jpg"]);
        touch(&masks, &["1.png"]);
        let e = of_images(&left, &images, &masks).unwrap_err();
        assert!(matches!(&e, ImportError::Input { path, .. } if path.ends_with("white/left")), "{e:?}");
        let mask = touch(&masks, &["left/1.png"]);
        assert_eq!(of_images(&left, &images, &masks).unwrap(), mask);
    }
}
