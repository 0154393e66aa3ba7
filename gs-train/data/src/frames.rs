//! Steps every JSON reader shares: frames with poses, images that exist, unique names.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::path::{Path, PathBuf};

use gs_core::cast;

use super::error::{DataError, Place};
use super::files::Root;
use super::header::{self, ImageHeader};
use super::options::DataOptions;
use super::times::{Draft, Drafts};

/// An image listed by a data set, with the other fields its reader needs.
pub(crate) struct Listed<T> {
    /// Path relative to the folder, as shown to people.
    pub(crate) shown: PathBuf,
    /// Path to open.
    pub(crate) path: PathBuf,
    /// Fields of the reader.
    pub(crate) rest: T,
}

/// Extensions tried for a name without one.
pub(crate) const EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];

/// The image a file names, relative to the folder. A name without a known extension gets the first of `.png`, `.jpg`,
/// `.jpeg` that exists, else `.png`.
///
/// # Errors
/// `data.escape`.
pub(crate) fn locate(root: &Root, written: &str, place: &Place) -> Result<(PathBuf, PathBuf), DataError> {
    let known = Path::new(written).extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    let candidates = match known {
        Some(e) if EXTENSIONS.contains(&e.as_str()) => vec![written.to_string()],
        _ => EXTENSIONS.iter().map(|e| format!("{written}.{e}")).collect(),
    };
    for name in &candidates {
        let path = root.resolve(name, place)?;
        if path.exists() {
            return Ok((relative(root, &path), path));
        }
    }
    let path = root.resolve(&candidates[0], place)?;
    Ok((relative(root, &path), path))
}

fn relative(root: &Root, path: &Path) -> PathBuf {
    path.strip_prefix(root.dir()).unwrap_or(path).to_path_buf()
}

/// Reads the header of every listed image. Missing files are one error that names them all, or, when allowed, a note.
///
/// # Errors
/// `data.missing`, `data.image`, `io.read`.
pub(crate) fn with_headers<T>(
    listed_in: &Path,
    frames: Vec<Listed<T>>,
    options: &DataOptions,
    notes: &mut Vec<String>,
) -> Result<Vec<(Listed<T>, ImageHeader)>, DataError> {
    let total = frames.len();
    let (present, missing): (Vec<_>, Vec<_>) = frames.into_iter().partition(|f| f.path.exists());
    if !missing.is_empty() {
        let missing: Vec<PathBuf> = missing.into_iter().map(|f| f.shown).collect();
        let error = DataError::Missing { listed_in: listed_in.to_path_buf(), missing, total };
        if !options.allow_missing {
            return Err(error);
        }
        notes.push(format!("{error} (left out, as data.allow_missing asks)"));
    }
    present.into_iter().map(|f| header::read(&f.path).map(|h| (f, h))).collect()
}

/// Names views by the stem of their file, or by their whole path where stems repeat.
pub(crate) fn name_views(drafts: &mut [Draft], shown: &[PathBuf]) {
    let stems: Vec<String> = shown.iter().map(|p| without_folder(p)).collect();
    let unique = stems.iter().collect::<HashSet<_>>().len() == stems.len();
    for ((draft, path), stem) in drafts.iter_mut().zip(shown).zip(stems) {
        draft.view.name =
            if unique { stem } else { path.with_extension("").to_string_lossy().replace(['/', '\\'], "_") };
    }
}

fn without_folder(path: &Path) -> String {
    path.file_stem().map_or_else(|| path.to_string_lossy().into_owned(), |s| s.to_string_lossy().into_owned())
}

/// Numbers the cameras of all splits in order of appearance: views of one pose are of one camera. Returns their count.
pub(crate) fn number_cameras(drafts: &mut Drafts) -> usize {
    let mut known: BTreeMap<[u64; 12], u32> = BTreeMap::new();
    for d in drafts.train.iter_mut().chain(&mut drafts.val).chain(&mut drafts.test) {
        let next = cast::to_u32(known.len());
        d.view.camera_id = *known.entry(pose_bits(d)).or_insert(next);
    }
    known.len()
}

/// The same where a pose repeats; else views keep their numbers, which stored digests have.
pub(crate) fn share_cameras(drafts: &mut Drafts) {
    let mut poses = BTreeSet::new();
    if !drafts.all().all(|d| poses.insert(pose_bits(d))) {
        number_cameras(drafts);
    }
}

fn pose_bits(draft: &Draft) -> [u64; 12] {
    let camera = &draft.view.camera;
    let (r, t) = (camera.rotation.to_cols_array(), camera.translation.to_array());
    std::array::from_fn(|i| if i < 9 { r[i] } else { t[i - 9] }.to_bits())
}

/// The image folder below `root`: the one asked for, or the first of the `usual` ones that exists; `missing` says what
/// was found instead.
///
/// # Errors
/// If the one asked for lies outside `root`, or there is none.
pub(crate) fn image_folder(
    root: &Root,
    options: &DataOptions,
    usual: &[&str],
    missing: &str,
) -> Result<String, DataError> {
    if let Some(name) = &options.images {
        root.resolve(name, &Place::new(root.dir(), "data.images"))?;
        return Ok(name.clone());
    }
    let found = usual.iter().find(|f| root.dir().join(f).is_dir());
    found.map(|f| (*f).to_owned()).ok_or_else(|| DataError::Layout {
        path: root.dir().to_path_buf(),
        looked_for: format!("{missing}: looked for {}", usual.join(", ")),
    })
}
