//! Output files and folders.

use crate::failure::{Class, Failure};
use gs_core::io::{disk, folder_of};
use gs_data::View;
use gs_train::renderer::file_stem;
use std::collections::BTreeSet;
use std::path::Path;

/// A file name per view; numbered if two views have the same name.
pub fn stems(views: &[View]) -> Vec<String> {
    let own: Vec<String> = views.iter().map(|v| file_stem(&v.name)).collect();
    if own.iter().collect::<BTreeSet<_>>().len() == own.len() {
        return own;
    }
    own.iter().enumerate().map(|(k, stem)| format!("{k:04}_{stem}")).collect()
}

/// Fails if one of the output files exists, unless `force` is set. `what` names the file and `choose` what `-o` gives
/// (`name` or `folder`) in the message.
pub fn check_free<P: AsRef<Path>>(
    force: bool,
    what: &str,
    choose: &str,
    files: impl IntoIterator<Item = P>,
) -> Result<(), Failure> {
    match files.into_iter().find(|f| !force && f.as_ref().exists()) {
        None => Ok(()),
        Some(file) => Err(Failure::new(Class::Io, "io.exists", format!("the {what} exists already"))
            .place(file.as_ref().display())
            .why("nothing is overwritten unless asked")
            .remedy(format!("choose another {choose} with -o, or pass -f"))),
    }
}

/// Fails if the file that `-o` names exists, unless `force` is set; creates the folder for it.
pub fn prepare_file(force: bool, file: &Path) -> Result<(), Failure> {
    check_free(force, "file", "name", [file])?;
    create_folder(folder_of(file))
}

/// Creates a folder and those above it.
pub fn create_folder(folder: &Path) -> Result<(), Failure> {
    disk::create_folder(folder).map_err(|e| Failure::io("create the folder", folder, &e))
}
