//! Images that were renumbered after the model was made.
//!
//! In some captures the model names images by the numbers of their cameras and the folder counts the same
//! images from one. Pairing by equal stems would then be wrong where numbers happen
//! to coincide. Images are paired by the order of their numbers, only under conditions that leave no other interpretation.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use super::super::error::DataError;
use super::{EXTENSIONS, ImageRow};

/// Number of pairs listed in the note.
const NAMED: usize = 8;

/// File names by model name, paired in order of number, where
/// 1. no image of the model is in the folder under its full name,
/// 2. at least one is not there under another extension either,
/// 3. the folder holds as many images as the model,
/// 4. all names on both sides are plain numbers, none twice.
///
/// # Errors
/// `io.read` if the folder cannot be listed.
pub(super) fn pairing(folder: &Path, rows: &[ImageRow]) -> Result<Option<HashMap<String, String>>, DataError> {
    let stated = |row: &ImageRow| folder.join(&row.name).exists();
    let found = |row: &ImageRow| EXTENSIONS.iter().any(|e| folder.join(&row.name).with_extension(e).exists());
    if !folder.is_dir() || rows.iter().any(stated) || rows.iter().all(found) {
        return Ok(None);
    }
    let failed = |e| DataError::read(folder, e);
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let Ok(name) = entry.map_err(failed)?.file_name().into_string() else { return Ok(None) };
        let extension = Path::new(&name).extension().and_then(|e| e.to_str());
        if extension.is_some_and(|e| EXTENSIONS.contains(&e)) {
            files.push(name);
        }
    }
    let model = by_number(rows.iter().map(|r| r.name.as_str()));
    let here = by_number(files.iter().map(String::as_str));
    let (Some(model), Some(here)) = (model, here) else { return Ok(None) };
    let pairs = || model.values().zip(here.values()).map(|(a, b)| ((*a).to_string(), (*b).to_string())).collect();
    Ok((model.len() == here.len()).then(pairs))
}

/// Names by their number; none if a stem is no number or a number appears twice.
fn by_number<'a>(names: impl Iterator<Item = &'a str>) -> Option<BTreeMap<u64, &'a str>> {
    let mut numbered = BTreeMap::new();
    for name in names {
        let stem = Path::new(name).with_extension("");
        let number = stem.to_str().filter(|s| s.bytes().all(|b| b.is_ascii_digit()))?.parse().ok()?;
        if numbered.insert(number, name).is_some() {
            return None;
        }
    }
    Some(numbered)
}

/// The note that says what was assumed.
pub(super) fn note(folder: &str, pairs: &HashMap<String, String>) -> String {
    let order = by_number(pairs.keys().map(String::as_str)).unwrap_or_default();
    let named: Vec<String> = order.values().take(NAMED).map(|m| format!("{m} is {}", pairs[*m])).collect();
    let more = if order.len() > NAMED { ", …" } else { "" };
    format!(
        "no image of the model is in \"{folder}\" under its name; both have {} numbered images, paired in order of number: \
         {}{more} (if that is wrong, rename the files)",
        pairs.len(),
        named.join(", ")
    )
}
