//! Whether the files that a call left are whole.

use gs_core::io::{Limits, load_splats};
use gs_train::checkpoint::Checkpoint;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// All files below a folder.
fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        match entry.file_type() {
            Ok(kind) if kind.is_dir() => files(&entry.path(), found),
            Ok(kind) if kind.is_file() => found.push(entry.path()),
            _ => {}
        }
    }
}

fn is_temporary(path: &Path) -> bool {
    path.components().any(|part| part.as_os_str().to_string_lossy().ends_with(".tmp"))
}

/// What is wrong with a file of this name, if anything.
fn fault(path: &Path) -> Option<String> {
    let parsed = |text: &str| serde_json::from_str::<Value>(text).err().map(|e| e.to_string());
    let utf8 = || fs::read_to_string(path).unwrap_or_default();
    match path.extension().and_then(|e| e.to_str()).unwrap_or_default() {
        "json" => parsed(&utf8()),
        // The last line may be cut; readers leave it out.
        "jsonl" => {
            let text = utf8();
            let whole = text.rfind('\n').map_or("", |end| &text[..end]);
            whole.lines().find_map(parsed)
        }
        "toml" => utf8().parse::<toml::Table>().err().map(|e| e.to_string()),
        "html" => (!utf8().trim_end().ends_with("</html>")).then(|| "cut".to_owned()),
        "png" => gs_core::io::images::load_image(path, &Limits::default()).err().map(|e| e.to_string()),
        "gs4d" => Checkpoint::load(path).err().map(|e| e.to_string()),
        "ply" | "glb" | "spz" | "splat" => load_splats(path, &Limits::default()).err().map(|e| e.to_string()),
        _ => None,
    }
}

/// All files below a folder with their final names are whole; `what` is said where one is not.
pub fn assert_whole(folder: &Path, what: &str) {
    let mut found = Vec::new();
    files(folder, &mut found);
    for path in found.iter().filter(|path| !is_temporary(path)) {
        assert_eq!(fault(path), None, "{what}: {}", path.display());
    }
}

/// No temporary file is left below a folder.
pub fn assert_swept(folder: &Path, what: &str) {
    let mut left = Vec::new();
    files(folder, &mut left);
    left.retain(|path| is_temporary(path));
    assert!(left.is_empty(), "{what} leaves {left:?}");
}
