//! Motion blur: the mean of images at times while the shutter is open.
//!
//! ```text
//! I(t) = mean over j < n of  image(t + e s_j, camera rotated by the shake at s_j)        s_j = (j + ½)/n − ½
//! ```
//! with the exposure `e` in normalised time. Light adds up linearly: with [`Exposure::linear`] colours are decoded from
//! sRGB before and encoded after the mean. Colour is averaged premultiplied by alpha: a surface that covers a pixel for a share
//! of the exposure has that share of alpha.

use crate::SynthData;
use crate::save::{save_json, save_png};
use glam::{DQuat, DVec3};
use gs_core::{Camera, Rng, cast};
use gs_data::{DataError, ImageSource, ImageU8, View, moments};
use serde::Serialize;
use std::borrow::Borrow;
use std::path::Path;

/// Length of the exposure and motion of the camera during it.
///
/// ```
/// use gs_data::ImageU8;
/// use gs_synth::blur::Exposure;
///
/// let exposure = Exposure { length: 0.1, samples: 9, linear: true, shake: 0.0, seed: 0 };
/// let grey = |v| ImageU8 { width: 1, height: 1, data: vec![v, v, v, 255] };
/// assert_eq!(exposure.mean([&grey(0), &grey(255)]).data, [188, 188, 188, 255]); // half the light is 0.735 in sRGB
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Exposure {
    /// Length of the exposure, normalised time, 0 to 1.
    pub length: f64,
    /// Number of images averaged, 1 to 256; 9 to 33 suffice for motions of as many pixels.
    pub samples: u32,
    /// Average linear light instead of display-encoded values.
    pub linear: bool,
    /// Rotation of the camera during the exposure, radians, 0 to 1, about a random axis of each view.
    pub shake: f64,
    /// Seed of the axes of rotation.
    pub seed: u64,
}

impl Exposure {
    /// Checks the domain of every field.
    ///
    /// # Errors
    /// `data.option`: the first field out of its domain.
    pub fn check(&self) -> Result<(), DataError> {
        let need = |good: bool, name: &'static str, value: String, rule: &str| match good {
            true => Ok(()),
            false => Err(DataError::Option { name, value, rule: rule.into() }),
        };
        need((0.0..=1.0).contains(&self.length), "exposure", self.length.to_string(), "0 to 1, in normalised time")?;
        need((1..=256).contains(&self.samples), "exposure_samples", self.samples.to_string(), "1 to 256")?;
        need((0.0..=1.0).contains(&self.shake), "shake", self.shake.to_string(), "0 to 1 radian")
    }

    /// Times and cameras of the images of an exposure centred at `time`. `view` is the index of the view, for its axis.
    pub fn pictures(&self, camera: &Camera, time: f64, view: u64) -> Vec<(f64, Camera)> {
        let mut rng = Rng::new(self.seed, "blur.shake", 0, view);
        let axis = DVec3::from_array([0; 3].map(|_| f64::from(rng.normal()))).try_normalize().unwrap_or(DVec3::X);
        let at = |j: u32| {
            let s = (f64::from(j) + 0.5) / f64::from(self.samples) - 0.5;
            let turn = glam::DMat3::from_quat(DQuat::from_axis_angle(axis, self.shake * s));
            let (rotation, translation) = (turn * camera.rotation, turn * camera.translation);
            (time + self.length * s, Camera { rotation, translation, ..camera.clone() })
        };
        (0..self.samples).map(at).collect()
    }

    /// The mean of images of one size; empty for none.
    pub fn mean(&self, images: impl IntoIterator<Item: Borrow<ImageU8>>) -> ImageU8 {
        let (mut sums, mut out, mut n) = (Vec::new(), ImageU8::default(), 0.0);
        for image in images {
            let image = image.borrow();
            (out.width, out.height) = (image.width, image.height);
            sums.resize(image.data.len() / 4, [0.0f64; 4]);
            n += 1.0;
            for (sum, p) in sums.iter_mut().zip(image.data.chunks_exact(4)) {
                let alpha = f64::from(p[3]) / 255.0;
                (0..3).for_each(|c| sum[c] += alpha * self.decoded(f64::from(p[c]) / 255.0));
                sum[3] += alpha;
            }
        }
        out.data = sums
            .iter()
            .flat_map(|sum| {
                let color = |c: usize| if sum[3] > 0.0 { self.encoded(sum[c] / sum[3]) } else { 0.0 };
                [color(0), color(1), color(2), sum[3] / n].map(|v| cast::to_u8((255.0 * v).round()))
            })
            .collect();
        out
    }

    fn decoded(&self, v: f64) -> f64 {
        match (self.linear, v <= 0.04045) {
            (false, _) => v,
            (true, true) => v / 12.92,
            (true, false) => ((v + 0.055) / 1.055).powf(2.4),
        }
    }

    fn encoded(&self, v: f64) -> f64 {
        match (self.linear, v <= 0.003_130_8) {
            (false, _) => v,
            (true, true) => 12.92 * v,
            (true, false) => 1.055 * v.powf(1.0 / 2.4) - 0.055,
        }
    }

    /// The image of a view of a generated scene with this exposure. `number` is the index of the view, for its axis.
    pub fn render(&self, data: &SynthData, view: &View, number: u64) -> ImageU8 {
        let time = if data.truth.dynamic() { f64::from(view.time.normalised) } else { 0.0 };
        // One after the other: many of them do not fit into memory at once, and each is made by all threads.
        self.mean(
            self.pictures(&view.camera, time, number).into_iter().map(|(t, camera)| data.truth.picture(&camera, t)),
        )
    }
}

/// Adds motion blur to the training views of a generated scene, in memory and in its folder `dir`, as [`write`](super::write()) made it. Other
/// views stay sharp. `exposure.json` records the exposure.
///
/// # Errors
/// `data.option` for a field out of its domain, `io.write` if a file cannot be written.
pub fn blur_training_views(dir: &Path, data: &mut SynthData, exposure: &Exposure) -> Result<(), DataError> {
    exposure.check()?;
    for k in 0..data.dataset.train.len() {
        let image = exposure.render(data, &data.dataset.train[k], k as u64);
        let view = &mut data.dataset.train[k];
        let file = dir.join("train").join(format!("{}.png", view.name));
        save_png(&file, &image)?;
        view.image = ImageSource::Memory(std::sync::Arc::new(image));
    }
    let step = f64::from(moments::median_step(&moments::distinct(&data.dataset.train)));
    let frames = if step > 0.0 { exposure.length * (1.0 / step).round() } else { 0.0 };
    let about = "training views are means over the exposure; validation and test views are sharp";
    let json = serde_json::json!({"about": about, "exposure": exposure, "frames": frames});
    save_json(&dir.join("exposure.json"), &json)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{self as synth, SynthOptions};
    use gs_metrics::Sharpness;

    const STILL: Exposure = Exposure { length: 0.0, samples: 4, linear: false, shake: 0.0, seed: 0 };

    fn pixel(p: [u8; 4]) -> ImageU8 {
        ImageU8 { width: 1, height: 1, data: p.to_vec() }
    }

    #[test]
    fn light_adds_up_linearly_and_by_coverage() {
        let (black, white) = (pixel([0, 0, 0, 255]), pixel([255; 4]));
        assert_eq!(STILL.mean([&black, &white]).data, [128, 128, 128, 255]);
        let linear = Exposure { linear: true, ..STILL };
        assert_eq!(linear.mean([&black, &white]).data, [188, 188, 188, 255], "half the light is 0.735 in sRGB");
        let nothing = pixel([9, 9, 9, 0]);
        assert_eq!(STILL.mean([&pixel([200, 100, 0, 255]), &nothing]).data, [200, 100, 0, 128]);
        let none: [ImageU8; 0] = [];
        assert_eq!(STILL.mean(none), ImageU8::default());
        for v in 0..=255u8 {
            let one = pixel([v, 255 - v, 7, 255]);
            assert_eq!(linear.mean([&one, &one, &one]), one, "decoding and encoding are inverse");
        }
    }

    #[test]
    fn exposures_are_centred_and_the_shake_turns_about_the_camera() {
        let camera = Camera::look_at(32, 32, 0.7, DVec3::new(0.0, -4.0, 1.0), DVec3::ZERO, DVec3::Z).unwrap();
        let e = Exposure { length: 0.2, samples: 5, shake: 0.1, ..STILL };
        let pictures = e.pictures(&camera, 0.5, 3);
        let times: Vec<f64> = pictures.iter().map(|p| (p.0 * 100.0).round()).collect();
        assert_eq!(times, [42.0, 46.0, 50.0, 54.0, 58.0]);
        assert!(pictures.iter().all(|p| p.1.position().distance(camera.position()) < 1e-12));
        assert!(
            (pictures[2].1.rotation - camera.rotation).abs_diff_eq(glam::DMat3::ZERO, 1e-15),
            "steady in the middle"
        );
        assert_ne!(e.pictures(&camera, 0.5, 4)[0].1, pictures[0].1, "another axis for another view");
    }

    #[test]
    fn moving_things_blur_and_held_out_views_stay_sharp() {
        let dir = tempfile::tempdir().unwrap();
        let options = SynthOptions { val_views: 1, supersample: 1, ..SynthOptions::of_views(48, 4, 1) };
        let sharp = synth::write(dir.path(), "balls", &options, false).unwrap();
        let test_file = dir.path().join("test/r_000.png");
        let before = std::fs::read(&test_file).unwrap();
        let mut data = sharp.clone();
        let exposure = Exposure { length: 0.1, samples: 9, ..STILL };
        blur_training_views(dir.path(), &mut data, &exposure).unwrap();
        assert_eq!(std::fs::read(&test_file).unwrap(), before);
        let over = |v: &View| match &v.image {
            ImageSource::Memory(image) => image.over([0.0; 3]),
            ImageSource::File(_) => unreachable!("generated views are in memory"),
        };
        let ratio = |k: usize| Sharpness::of(&over(&data.dataset.train[k]), &over(&sharp.dataset.train[k])).unwrap();
        let ratios: Vec<f64> = (0..4).map(|k| ratio(k).laplacian.unwrap()).collect();
        assert!(ratios.iter().all(|r| *r < 1.0) && ratios.iter().any(|r| *r < 0.8), "{ratios:?}");
        let exposure_json = std::fs::read_to_string(dir.path().join("exposure.json")).unwrap();
        assert!(exposure_json.contains("\"frames\": 0.3"), "{exposure_json}");
        let still = exposure.render(&sharp, &sharp.dataset.train[1], 1);
        assert_ne!(still, STILL.render(&sharp, &sharp.dataset.train[1], 1));
        let wrong = Exposure { samples: 0, ..STILL };
        assert!(
            blur_training_views(dir.path(), &mut data, &wrong).unwrap_err().to_string().contains("exposure_samples")
        );
    }
}
