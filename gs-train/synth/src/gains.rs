//! Images that were not exposed alike: gains of their own, as a camera sets them by itself.
//!
//! ```text
//! c' = min(1, g_c c)        ln g_c = s z + s z_c / 3        z, z_c ~ N(0, 1)
//! ```
//! for the channels `c` of an image: `z` is its exposure, `z_c` its white balance.

use crate::SynthData;
use crate::save::{save_json, save_png};
use gs_core::{Rng, cast};
use gs_data::{DataError, ImageCache, ImageSource, ImageU8};
use std::path::Path;
use std::sync::Arc;

/// The gains of image `number`, `spread` being `s`.
///
/// ```
/// use gs_synth::gains::gains_of;
///
/// assert_eq!(gains_of(0.0, 7, 3), [1.0; 3]);
/// assert_ne!(gains_of(0.2, 7, 3), gains_of(0.2, 7, 4));
/// ```
pub fn gains_of(spread: f64, seed: u64, number: u64) -> [f64; 3] {
    let mut rng = Rng::new(seed, "gains", 0, number);
    let common = f64::from(rng.normal());
    [0; 3].map(|_| (spread * (common + f64::from(rng.normal()) / 3.0)).exp())
}

/// An image with these gains; alpha stays.
pub fn exposed(image: &ImageU8, gains: [f64; 3]) -> ImageU8 {
    let value = |(k, v): (usize, &u8)| match k % 4 {
        3 => *v,
        c => cast::to_u8((f64::from(*v) * gains[c]).round().min(255.0)),
    };
    ImageU8 { data: image.data.iter().enumerate().map(value).collect(), ..*image }
}

/// Checks the domain of a spread.
///
/// # Errors
/// `data.option` if it is not 0 to 1.
pub fn check(spread: f64) -> Result<(), DataError> {
    match (0.0..=1.0).contains(&spread) {
        true => Ok(()),
        false => Err(DataError::Option { name: "gains", value: spread.to_string(), rule: "0 to 1".into() }),
    }
}

/// Gives the training views of a generated scene gains of their own, in memory and in its folder `dir`, as [`write`](super::write()) made it. Other views
/// stay as they are. `gains.json` records the gains.
///
/// # Errors
/// `data.option` if the spread is not 0 to 1, `io` if an image cannot be read or a file cannot be written.
pub fn spread_exposures(dir: &Path, data: &mut SynthData, spread: f64, seed: u64) -> Result<(), DataError> {
    check(spread)?;
    let (images, mut all) = (ImageCache::new(0, 1.0), Vec::new());
    for (k, view) in (0..).zip(&mut data.dataset.train) {
        let gains = gains_of(spread, seed, k);
        let image = exposed(&*images.get(view)?, gains);
        save_png(&dir.join("train").join(format!("{}.png", view.name)), &image)?;
        view.image = ImageSource::Memory(Arc::new(image));
        all.push(serde_json::json!({ "view": view.name, "gains": gains }));
    }
    let about = "training views have gains of their own; validation and test views have none";
    save_json(&dir.join("gains.json"), &serde_json::json!({"about": about, "spread": spread, "views": all}))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SynthOptions, write};

    #[test]
    fn training_views_alone_are_exposed_and_files_are_as_memory() {
        let dir = tempfile::tempdir().unwrap();
        let options = SynthOptions::of_views(16, 4, 2);
        let mut data = write(dir.path(), "balls", &options, false).unwrap();
        let (before, images) = (data.clone(), ImageCache::new(0, 1.0));
        spread_exposures(dir.path(), &mut data, 0.3, 5).unwrap();
        for (k, (view, old)) in data.dataset.train.iter().zip(&before.dataset.train).enumerate() {
            let (image, was) = (images.get(view).unwrap(), images.get(old).unwrap());
            assert_eq!(image.data, exposed(&was, gains_of(0.3, 5, k as u64)).data);
            assert_ne!(image.data, was.data, "view {k}");
        }
        let read = gs_data::Dataset::open(dir.path(), &gs_data::DataOptions::default()).unwrap();
        for (view, memory) in read.train.iter().zip(&data.dataset.train) {
            assert_eq!(images.get(view).unwrap().data, images.get(memory).unwrap().data);
        }
        for (view, old) in read.test.iter().zip(&before.dataset.test) {
            assert_eq!(images.get(view).unwrap().data, images.get(old).unwrap().data);
        }
        assert!(dir.path().join("gains.json").is_file());
        assert!(spread_exposures(dir.path(), &mut data, 1.5, 5).is_err());
    }

    #[test]
    fn gains_saturate_and_leave_alpha() {
        let image = ImageU8 { width: 1, height: 1, data: vec![100, 200, 10, 77] };
        assert_eq!(exposed(&image, [2.0, 2.0, 0.5]).data, [200, 255, 5, 77]);
    }
}
