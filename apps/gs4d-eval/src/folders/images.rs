//! Image folders sorted by the numbers in file names, and images in the form the metrics take.

use super::FolderError;
use gs_core::Image;
use gs_core::io::{Limits, images, npy, read_file};
use std::path::{Path, PathBuf};

const EXTENSIONS: [&str; 5] = ["png", "jpg", "jpeg", "exr", "npy"];
/// Most names in a message; the others are counted.
const MAX_LISTED: usize = 10;

/// An image file of a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ImageFile {
    /// File name without extension.
    pub(crate) name: String,
    /// Path of the file.
    pub(crate) path: PathBuf,
}

/// The image files of a folder, sorted by the numbers in their names, then by name.
#[derive(Clone, Debug)]
pub(crate) struct ImageFolder {
    folder: PathBuf,
    files: Vec<ImageFile>,
}

impl ImageFolder {
    /// Lists a folder; files that are not images by their extension are ignored.
    ///
    /// # Errors
    /// If the folder cannot be read, holds no image, or two images have the same name.
    pub(crate) fn of(folder: &Path) -> Result<Self, FolderError> {
        let refused = |source| FolderError::List { folder: folder.to_owned(), source };
        let mut files = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(refused)? {
            let path = entry.map_err(refused)?.path();
            let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
            if path.is_file() && extension.is_some_and(|e| EXTENSIONS.contains(&e.as_str())) {
                let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
                files.push(ImageFile { name, path });
            }
        }
        files.sort_by(|a, b| (numbers(&a.name), &a.name, &a.path).cmp(&(numbers(&b.name), &b.name, &b.path)));
        if let Some(twins) = files.windows(2).find(|w| w[0].name == w[1].name) {
            return Err(FolderError::SameName { first: twins[0].path.clone(), second: twins[1].path.clone() });
        }
        if files.is_empty() {
            return Err(FolderError::Empty { folder: folder.to_owned(), extensions: EXTENSIONS.join(", ") });
        }
        Ok(Self { folder: folder.to_owned(), files })
    }

    /// The images in order.
    pub(crate) fn files(&self) -> &[ImageFile] {
        &self.files
    }

    /// Whether no name is in both folders.
    pub(crate) fn is_apart_from(&self, there: &Self) -> bool {
        self.without(there).len() == self.files.len()
    }

    /// For every image its counterpart in `there`: the one of the same name or, where no name is in both, all names contain digits
    /// and there are as many, the one at the same position.
    ///
    /// # Errors
    /// If an image has no counterpart, or (unless `more` is set) `there` holds other images as well.
    pub(crate) fn partners<'a>(&self, there: &'a Self, more: bool) -> Result<Vec<&'a ImageFile>, FolderError> {
        let found: Vec<Option<&ImageFile>> =
            self.files.iter().map(|p| there.files.iter().find(|q| q.name == p.name)).collect();
        let alone = self.without(there);
        if alone.is_empty() && (more || self.files.len() == there.files.len()) {
            return Ok(found.into_iter().flatten().collect());
        }
        let counted = |p: &Self| p.files.iter().all(|f| f.name.contains(|c: char| c.is_ascii_digit()));
        if self.is_apart_from(there) && self.files.len() == there.files.len() && counted(self) && counted(there) {
            return Ok(there.files.iter().collect());
        }
        let (names, folder) =
            if alone.is_empty() { (there.without(self), &self.folder) } else { (alone, &there.folder) };
        let rest = names.len().saturating_sub(MAX_LISTED);
        let rest = if rest > 0 { format!(" and {rest} more") } else { String::new() };
        let named = names[..names.len().min(MAX_LISTED)].join(", ") + &rest;
        let counts = [self.files.len(), there.files.len()];
        Err(FolderError::Unpaired { count: names.len(), named, folder: folder.clone(), counts })
    }

    /// Names that `there` does not have.
    fn without(&self, there: &Self) -> Vec<&str> {
        let lacks = |p: &&ImageFile| !there.files.iter().any(|q| q.name == p.name);
        self.files.iter().filter(lacks).map(|p| p.name.as_str()).collect()
    }
}

/// The numbers in a name as length and digits without leading zeros: this order is numeric for numbers of any size.
fn numbers(name: &str) -> Vec<(usize, String)> {
    let parts = name.split(|c: char| !c.is_ascii_digit()).filter(|p| !p.is_empty());
    parts.map(|p| p.trim_start_matches('0')).map(|p| (p.len(), p.to_owned())).collect()
}

/// An image over a background.
pub(crate) struct Loaded {
    /// `[H, W, 3]`.
    pub(crate) image: Image,
    /// Pixels that show the background alone, row-major; empty where every pixel shows something else.
    pub(crate) clear: Vec<bool>,
}

/// Loads an image composited over a background. PNG and JPEG have straight alpha, EXR and NPY premultiplied.
///
/// # Errors
/// If the file cannot be read or is no image of 1, 3 or 4 channels.
pub(crate) fn load_over(path: &Path, background: [f32; 3]) -> Result<Loaded, FolderError> {
    let (image, premultiplied) = load(path)?;
    let mut data = Vec::with_capacity(image.width * image.height * 3);
    let mut clear = Vec::new();
    for p in image.data.chunks_exact(image.channels) {
        let alpha = if image.channels == 4 { p[3] } else { 1.0 };
        let weight = if premultiplied { 1.0 } else { alpha };
        clear.push(alpha < 0.5 / 255.0);
        for c in 0..3 {
            let value = if image.channels < 3 { p[0] } else { p[c] };
            data.push(value * weight + background[c] * (1.0 - alpha));
        }
    }
    if !clear.contains(&true) {
        clear.clear();
    }
    Ok(Loaded { image: Image { width: image.width, height: image.height, channels: 3, data }, clear })
}

/// Loads the first channel of an image as a mask, `[H, W, 1]`; 1 for pixels that count.
///
/// # Errors
/// Those of [`load_over`].
pub(crate) fn load_mask(path: &Path) -> Result<Image, FolderError> {
    let (image, _) = load(path)?;
    let data = image.data.chunks_exact(image.channels).map(|p| p[0]).collect();
    Ok(Image { width: image.width, height: image.height, channels: 1, data })
}

/// An image of 1, 3 or 4 channels, and whether its colour is premultiplied.
fn load(path: &Path) -> Result<(Image, bool), FolderError> {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let image = if extension == "npy" { load_npy(path)? } else { images::load_image(path, &Limits::default())? };
    if ![1, 3, 4].contains(&image.channels) || image.data.is_empty() {
        let what = format!("an image of {}x{} with {} channels", image.width, image.height, image.channels);
        return Err(FolderError::Image { path: path.to_owned(), what, remedy: "give 1, 3 or 4 channels" });
    }
    Ok((image, extension != "png" && extension != "jpg" && extension != "jpeg"))
}

fn load_npy(path: &Path) -> Result<Image, FolderError> {
    let array = npy::read(&read_file(path, &Limits::default())?, &path.display().to_string(), &Limits::default())?;
    let (height, width, channels) = match array.shape[..] {
        [h, w] => (h, w, 1),
        [h, w, c] => (h, w, c),
        _ => {
            let what = format!("an array of {} dimensions", array.shape.len());
            return Err(FolderError::Image { path: path.to_owned(), what, remedy: "give [H, W] or [H, W, C]" });
        }
    };
    let data = array.to_f32();
    if data.iter().any(|v| *v > 1.0) && data.iter().all(|v| v.fract() == 0.0) {
        let greatest = data.iter().fold(0.0f32, |m, v| m.max(*v));
        let what = format!("an array of whole numbers up to {greatest}");
        return Err(FolderError::Image { path: path.to_owned(), what, remedy: "divide it: colours are 0 to 1" });
    }
    Ok(Image { width, height, channels, data })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(names: &[&str]) -> ImageFolder {
        let mut files: Vec<ImageFile> =
            names.iter().map(|n| ImageFile { name: (*n).to_owned(), path: PathBuf::from(n) }).collect();
        files.sort_by(|a, b| (numbers(&a.name), &a.name).cmp(&(numbers(&b.name), &b.name)));
        ImageFolder { folder: PathBuf::from(names[0]), files }
    }

    fn names(found: Vec<&ImageFile>) -> Vec<&str> {
        found.into_iter().map(|p| p.name.as_str()).collect()
    }

    #[test]
    fn arrays_of_whole_numbers_are_no_colours() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.npy");
        let read = |values: &[f32]| {
            let mut bytes = Vec::new();
            npy::write(&[1, 2, 3], values, &mut bytes).unwrap();
            std::fs::write(&path, bytes).unwrap();
            load_npy(&path)
        };
        assert_eq!(
            read(&[0.0, 1.0, 1.0, 0.0, 0.0, 1.0]).unwrap().shape(),
            (2, 1, 3),
            "black, white and masks are colours"
        );
        assert_eq!(read(&[0.0, 1.5, 2.0, 0.0, 0.0, 1.0]).unwrap().data[1], 1.5, "so is what is brighter than white");
        let e = read(&[0.0, 255.0, 128.0, 7.0, 0.0, 1.0]).unwrap_err().to_string();
        assert!(e.contains("whole numbers up to 255"), "{e}");
    }

    #[test]
    fn digits_set_the_order() {
        let p = folder(&["f10", "f9", "f007", "f1_2", "f1", "plain"]);
        let order: Vec<&str> = p.files().iter().map(|f| f.name.as_str()).collect();
        assert_eq!(order, ["plain", "f1", "f1_2", "f007", "f9", "f10"]);
    }

    #[test]
    fn partners_by_name_else_by_order_else_named() {
        let (a, b) = (folder(&["r_2", "r_10"]), folder(&["r_10", "r_2"]));
        assert_eq!(names(a.partners(&b, false).unwrap()), ["r_2", "r_10"]);
        let renamed = folder(&["000040", "000041"]);
        assert_eq!(names(a.partners(&renamed, false).unwrap()), ["000040", "000041"]);
        let e = a.partners(&folder(&["x", "y"]), false).unwrap_err().to_string();
        assert!(e.contains("2 images have no partner: r_2, r_10"), "{e}");
        let e = a.partners(&folder(&["r_2", "r_10", "r_11"]), false).unwrap_err().to_string();
        assert!(e.contains("r_11") && e.contains("2 and 3"), "{e}");
        let many = folder(&["r_2", "r_10", "r_11"]);
        assert_eq!(names(a.partners(&many, true).unwrap()), ["r_2", "r_10"]);
    }
}
