//! What tests of several crates need: where the shared captures lie, if they are there at all.

use std::path::PathBuf;

/// The path of a shared capture or golden file, or `None`, with a line that says what was skipped.
///
/// The folder is `$GS4D_SHARED`, else `shared` beside the workspace. The project is whole without it.
pub fn shared(relative: &str) -> Option<PathBuf> {
    let beside = || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared");
    let path = std::env::var_os("GS4D_SHARED").map_or_else(beside, PathBuf::from).join(relative);
    if path.exists() {
        return Some(path);
    }
    println!("SKIPPED: `{relative}` is not here (set GS4D_SHARED to the folder that holds it)");
    None
}
