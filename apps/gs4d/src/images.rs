//! Folders of images and single images, as the metrics want them.

use crate::failure::{Class, Failure};
use gs_core::Image;
use gs_core::io::{Limits, images, npy, read_file};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const EXTENSIONS: [&str; 5] = ["png", "jpg", "jpeg", "exr", "npy"];
/// Missing partners are named up to this many, then counted.
const NAMED: usize = 10;

/// The images of a folder by name without extension.
pub struct Pictures {
    folder: PathBuf,
    files: BTreeMap<String, PathBuf>,
}

impl Pictures {
    /// Lists a folder; files that are not images by their extension are passed over.
    pub fn of(folder: &Path) -> Result<Self, Failure> {
        let refused = |e: std::io::Error| Failure::io("list the folder", folder, &e);
        let mut files = BTreeMap::new();
        for entry in std::fs::read_dir(folder).map_err(refused)? {
            let path = entry.map_err(refused)?.path();
            let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
            if !path.is_file() || !extension.is_some_and(|e| EXTENSIONS.contains(&e.as_str())) {
                continue;
            }
            let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            if let Some(other) = files.insert(name, path.clone()) {
                return Err(Failure::new(Class::Data, "data.names", "two images have the same name")
                    .place(format!("{} and {}", other.display(), path.display()))
                    .why("images belong together by name, whatever their extension")
                    .remedy("remove one of them"));
            }
        }
        if files.is_empty() {
            return Err(Failure::new(Class::Data, "data.empty", "the folder holds no image")
                .place(folder.display())
                .remedy(format!("give a folder of {} files", EXTENSIONS.join(", "))));
        }
        Ok(Self { folder: folder.to_owned(), files })
    }

    /// Name and path of every image, by name.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Path)> {
        self.files.iter().map(|(name, path)| (name.as_str(), path.as_path()))
    }

    /// The path of a name.
    pub fn path(&self, name: &str) -> Result<&Path, Failure> {
        self.files.get(name).map(PathBuf::as_path).ok_or_else(|| self.lacks(&[name]))
    }

    /// Both folders must hold the same names.
    pub fn same_names(&self, other: &Self) -> Result<(), Failure> {
        self.have_partners(other)?;
        other.have_partners(self)
    }

    /// Every image must have a partner in the other folder.
    pub fn have_partners(&self, other: &Self) -> Result<(), Failure> {
        let alone: Vec<&str> =
            self.files.keys().filter(|k| !other.files.contains_key(*k)).map(String::as_str).collect();
        if alone.is_empty() { Ok(()) } else { Err(other.lacks(&alone)) }
    }

    fn lacks(&self, names: &[&str]) -> Failure {
        let more = names.len().saturating_sub(NAMED);
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        let named = names[..names.len().min(NAMED)].join(", ");
        Failure::new(Class::Data, "data.missing", format!("{} images have no partner: {named}{more}", names.len()))
            .place(self.folder.display())
            .why("a mean over fewer images than given is another number")
            .remedy("add the missing files, or remove their partners")
    }
}

/// An image over a background, three channels. PNG has straight alpha, EXR and NPY premultiplied.
pub fn over(path: &Path, background: [f32; 3]) -> Result<Image, Failure> {
    let (image, premultiplied) = load(path)?;
    let mut data = Vec::with_capacity(image.width * image.height * 3);
    for p in image.data.chunks_exact(image.channels) {
        let alpha = if image.channels == 4 { p[3] } else { 1.0 };
        let weight = if premultiplied { 1.0 } else { alpha };
        for c in 0..3 {
            let value = if image.channels < 3 { p[0] } else { p[c] };
            data.push(value * weight + background[c] * (1.0 - alpha));
        }
    }
    Ok(Image { width: image.width, height: image.height, channels: 3, data })
}

/// A mask: the first channel, one for pixels that count.
pub fn mask(path: &Path) -> Result<Image, Failure> {
    let (image, _) = load(path)?;
    let data = image.data.chunks_exact(image.channels).map(|p| p[0]).collect();
    Ok(Image { width: image.width, height: image.height, channels: 1, data })
}

/// An image of 1, 3 or 4 channels, and whether its colour is premultiplied.
fn load(path: &Path) -> Result<(Image, bool), Failure> {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let image = if extension == "npy" { load_npy(path)? } else { images::load_image(path, &Limits::default())? };
    if ![1, 3, 4].contains(&image.channels) || image.data.is_empty() {
        let what = format!("an image of {}x{} with {} channels", image.width, image.height, image.channels);
        return Err(Failure::new(Class::Data, "data.image", what)
            .place(path.display())
            .remedy("give 1, 3 or 4 channels"));
    }
    Ok((image, extension != "png" && extension != "jpg" && extension != "jpeg"))
}

fn load_npy(path: &Path) -> Result<Image, Failure> {
    let array = npy::read(&read_file(path, &Limits::default())?, &path.display().to_string(), &Limits::default())?;
    let (height, width, channels) = match array.shape[..] {
        [h, w] => (h, w, 1),
        [h, w, c] => (h, w, c),
        _ => {
            let what = format!("an array of {} dimensions", array.shape.len());
            return Err(Failure::new(Class::Data, "data.image", what)
                .place(path.display())
                .remedy("give [H, W] or [H, W, C]"));
        }
    };
    Ok(Image { width, height, channels, data: array.to_f32() })
}
