//! What to do about a folder that no reader knows, and about paths of another machine.

use std::path::{Path, PathBuf};

use super::detect;
use super::frames::EXTENSIONS as IMAGES;

/// Endings of videos.
const VIDEOS: [&str; 6] = ["mp4", "mov", "avi", "mkv", "webm", "m4v"];

/// What to give instead of a path that is no data folder.
pub(crate) fn instead_of(path: &Path) -> String {
    if ends_in(path, &VIDEOS) && path.is_file() {
        return from_videos(path.parent().unwrap_or(Path::new(".")), path);
    }
    if path.is_file() {
        return match path.parent() {
            Some(folder) if detect(folder).is_some() => format!("give the folder of that file: {}", shown(folder)),
            _ => "give the folder of the data, not a file".into(),
        };
    }
    if !path.is_dir() {
        return "check the path".into();
    }
    let inside = entries(path);
    let known: Vec<&PathBuf> = inside.iter().filter(|p| p.is_dir() && detect(p).is_some()).collect();
    match known[..] {
        [one] => return format!("the data are one folder below: give {}", one.display()),
        [one, ..] => {
            return format!("{} folders below hold data: give one of them, such as {}", known.len(), one.display());
        }
        [] => {}
    }
    if let Some(above) = path.canonicalize().ok().as_deref().and_then(Path::parent).filter(|p| detect(p).is_some()) {
        return format!("the cameras are in the folder above: give {}", above.display());
    }
    if let Some(video) = inside.iter().find(|p| ends_in(p, &VIDEOS)) {
        return from_videos(path, video);
    }
    let folders = inside.iter().filter(|p| p.is_dir()).chain([&path.to_path_buf()]).cloned().collect::<Vec<_>>();
    match folders.iter().find(|folder| entries(folder).iter().filter(|p| ends_in(p, &IMAGES)).count() > 1) {
        Some(images) => format!("these are images without cameras; COLMAP finds them: {}", from_images(path, images)),
        None => "give the folder that holds the cameras, or name its layout with --set data.layout=NAME".into(),
    }
}

/// The command that makes a data set of a video.
fn from_videos(folder: &Path, video: &Path) -> String {
    let data = folder.join("data");
    format!(
        "make a data set of it, all videos of one scene together: gs4d import -o {} {}",
        quoted(&data),
        quoted(video)
    )
}

/// The command that makes a data set of images.
fn from_images(folder: &Path, images: &Path) -> String {
    format!("gs4d import -o {} --images {}", quoted(&folder.join("data")), quoted(images))
}

fn shown(folder: &Path) -> String {
    if folder.as_os_str().is_empty() { ".".into() } else { folder.display().to_string() }
}

fn ends_in(path: &Path, endings: &[&str]) -> bool {
    path.extension().and_then(|e| e.to_str()).is_some_and(|e| endings.contains(&e.to_ascii_lowercase().as_str()))
}

/// The first thousand entries of a folder, sorted.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut all: Vec<PathBuf> =
        std::fs::read_dir(folder).into_iter().flatten().flatten().take(1000).map(|e| e.path()).collect();
    all.sort();
    all
}

/// A word as a POSIX shell reads it back.
///
/// ```
/// assert_eq!(gs_data::shell_quoted("data/sheet".to_owned()), "data/sheet");
/// assert_eq!(gs_data::shell_quoted("it's $5".to_owned()), r"'it'\''s $5'");
/// ```
pub fn shell_quoted(word: String) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,:=+@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) { word } else { format!("'{}'", word.replace('\'', r"'\''")) }
}

fn quoted(path: &Path) -> String {
    shell_quoted(path.to_string_lossy().into_owned())
}

/// The end of a path of another machine that exists below `root`, with `/` between names.
pub(crate) fn inside(root: &Path, written: &str) -> Option<String> {
    let names: Vec<&str> = written.split(['/', '\\']).filter(|n| !n.is_empty() && *n != "." && *n != "..").collect();
    let tail = |from: usize| names[from..].join("/");
    let whole = root.canonicalize().ok()?;
    let is_inside = |name: String| root.join(name).canonicalize().is_ok_and(|real| real.starts_with(&whole));
    let exists = |name: &String| is_inside(name.clone()) || IMAGES.iter().any(|e| is_inside(format!("{name}.{e}")));
    (0..names.len()).map(tail).find(exists)
}

/// A command that takes the folder of another machine out of the paths of a file.
pub(crate) fn relative(file: &Path, written: &str, inside: &str) -> String {
    let end = written.replace('\\', "/");
    let folder = end.strip_suffix(inside).filter(|f| f.ends_with('/'));
    let at = folder.and_then(|f| written.get(..f.len())).filter(|f| !f.contains('\''));
    let Some(folder) = at else { return format!("the file is there as {inside}: use that path") };
    // Backslashes are doubled in JSON and again in the pattern; other signs of patterns are escaped.
    let escaped: String = folder
        .chars()
        .map(|c| match c {
            '\\' => r"\\\\".to_owned(),
            '.' | '*' | '[' | ']' | '^' | '$' | '#' => format!("\\{c}"),
            c => c.to_string(),
        })
        .collect();
    format!("the file is there as {inside}; run in that folder: sed -i 's#{escaped}##g' {}", quoted(file))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::{create_dir_all, write};

    #[test]
    fn folders_above_and_below_are_found() {
        let dir = tempfile::tempdir().unwrap();
        let data = dir.path().join("lego");
        create_dir_all(data.join("train")).unwrap();
        write(data.join("transforms_train.json"), "{}").unwrap();
        let below = instead_of(dir.path());
        assert!(below.starts_with("the data are one folder below: give ") && below.ends_with("lego"), "{below}");
        assert!(instead_of(&data.join("train")).starts_with("the cameras are in the folder above: give "));
        let file = instead_of(&data.join("transforms_train.json"));
        assert!(file.starts_with("give the folder of that file: ") && file.ends_with("lego"), "{file}");
        create_dir_all(dir.path().join("ship")).unwrap();
        write(dir.path().join("ship/transforms_train.json"), "{}").unwrap();
        assert!(instead_of(dir.path()).starts_with("2 folders below hold data"));
        assert_eq!(instead_of(&dir.path().join("none")), "check the path");
    }

    #[test]
    fn images_and_videos_get_the_commands_that_come_first() {
        let dir = tempfile::tempdir().unwrap();
        assert!(instead_of(dir.path()).contains("data.layout=NAME"));
        for name in ["a.jpg", "b.JPG"] {
            write(dir.path().join(name), "x").unwrap();
        }
        let images = instead_of(dir.path());
        assert!(images.contains("gs4d import -o ") && images.contains("--images "), "{images}");
        let video = dir.path().join("clip.MP4");
        write(&video, "x").unwrap();
        for given in [dir.path(), &video] {
            let said = instead_of(given);
            assert!(said.contains("gs4d import -o ") && said.ends_with("clip.MP4"), "{said}");
        }
    }

    #[test]
    fn files_of_another_machine_are_found_by_the_end_of_their_path() {
        let dir = tempfile::tempdir().unwrap();
        create_dir_all(dir.path().join("train")).unwrap();
        write(dir.path().join("train/r_8.png"), "x").unwrap();
        for written in [r"C:\Users\me\lego\train\r_8.png", "/home/me/lego/train/r_8", "/train/r_8.png"] {
            let found = inside(dir.path(), written).unwrap();
            assert!(found.starts_with("train/r_8"), "{found}");
        }
        assert_eq!(inside(dir.path(), "/etc/passwd"), None);
        for odd in ["/x';rm -rf ~;'/train/r_8.png", "/home/me/train//r_8.png"] {
            let said = relative("t.json".as_ref(), odd, "train/r_8.png");
            assert_eq!(said, "the file is there as train/r_8.png: use that path", "{odd}");
        }
        let said = relative("t.json".as_ref(), r"C:\me\train\r_8.png", "train/r_8.png");
        assert_eq!(said, r"the file is there as train/r_8.png; run in that folder: sed -i 's#C:\\\\me\\\\##g' t.json");
    }
}
