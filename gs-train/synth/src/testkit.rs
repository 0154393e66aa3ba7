//! Small scenes and films for tests and benches (feature `testkit`). Every function panics where it fails.

use crate::avatar::{self, AvatarOptions};
use crate::{SynthOptions, generate};
use gs_data::Dataset;
use std::sync::Arc;

/// The data set of a generated scene.
pub fn dataset(name: &str, options: &SynthOptions) -> Arc<Dataset> {
    Arc::new(generate(name, options).expect("generated scene").dataset)
}

/// A scene in images of `size` pixels with 2×2 samples each: so many training views and four test views.
pub fn scene(name: &str, size: u32, views: u32) -> Arc<Dataset> {
    dataset(name, &SynthOptions { supersample: 2, ..SynthOptions::of_views(size, views, 4) })
}

/// A film of a built-in body in images of `size` pixels, by one ring of cameras.
pub fn film(template: &str, size: u32, frames: u32) -> Arc<Dataset> {
    let template = format!("builtin:{template}");
    let options = AvatarOptions { template, size, frames, rings: 1, points: 4000, ..AvatarOptions::default() };
    Arc::new(avatar::generate(&options).expect("film"))
}
