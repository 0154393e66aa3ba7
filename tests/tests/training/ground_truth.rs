//! What images are held against beside their colours: masks and measured depth.

use crate::support::*;
use gs_core::Image;
use gs_core::io::{npy, write_file};
use gs_data::{Dataset, DepthMap, ImageSource, ImageU8};
use gs_synth::{SynthOptions, generate};
use gs_train::renderer::Renderer;
use gs_train::timestamp::Timestamp;
use gs_train::trainer::Trainer;
use std::sync::Arc;

/// Paints a block into every training image, at a place that changes, and masks it.
fn painted(data: &Dataset, mask_loss: bool) -> Arc<Dataset> {
    let mut data = data.clone();
    for (k, view) in data.train.iter_mut().enumerate() {
        let ImageSource::Memory(image) = &view.image else { panic!("an image in memory") };
        let mut image = image.as_ref().clone();
        let mut mask = ImageU8 { data: vec![255; image.data.len()], ..image.clone() };
        let (width, left, top) = (image.width, 5 * k % 28, 7 * k % 28);
        for at in (0..20 * 20).map(|i| 4 * ((top + i / 20) * width + left + i % 20)) {
            image.data[at..at + 4].copy_from_slice(&[255, 0, 255, 255]);
            mask.data[at..at + 4].fill(0);
        }
        view.image = ImageSource::Memory(image.into());
        view.mask = Some(ImageSource::Memory(mask.into()));
        view.mask_loss = mask_loss;
    }
    Arc::new(data)
}

#[test]
fn what_lies_outside_masks_teaches_nothing() {
    let clean = scene("static", 48, 24);
    let score = |data: &Arc<Dataset>| {
        let mut trainer = trainer(data, "static3d", "");
        run(&mut trainer, 300);
        psnr(&trainer, &clean)
    };
    let [none, masked, spoilt] =
        [clean.clone(), painted(&clean, true), painted(&clean, false)].map(|data| score(&data));
    println!("{none:.2} dB without the block, {masked:.2} dB with masks, {spoilt:.2} dB with the block");
    assert!(masked > spoilt + 4.0 && none - masked < (none - spoilt) / 4.0, "{none} {masked} {spoilt}");
}

/// Mean relative distance of rendered to true depth where something is seen, over the held-out views.
fn depth_error(trainer: &Trainer, data: &Dataset, truth: &dyn Fn(usize) -> Image) -> f64 {
    let mut renderer = Renderer::new(trainer.model().raster_options([1.0; 3]));
    let (mut sum, mut count) = (0.0, 0);
    for (k, view) in data.test.iter().enumerate() {
        let splats = trainer.model().splats(&Timestamp::new(view.time), &view.camera).expect("splats");
        let frame = renderer.render(&splats, &view.camera).expect("a frame");
        let (pixels, truth) = (frame.depth.iter().zip(&frame.alpha), truth(k));
        for ((depth, alpha), z) in pixels.zip(&truth.data).filter(|((_, alpha), z)| **alpha > 0.5 && **z > 0.0) {
            sum += f64::from((depth / alpha / z - 1.0).abs());
            count += 1;
        }
    }
    sum / f64::from(count)
}

#[test]
fn measured_depth_puts_splats_on_the_surface() {
    let folder = tempfile::tempdir().expect("a folder");
    let options = SynthOptions { supersample: 2, ..SynthOptions::of_views(48, 5, 4) };
    let made = generate("static", &options).expect("scene");
    let mut data = made.dataset.clone();
    for (k, view) in data.train.iter_mut().enumerate() {
        let file = folder.path().join(format!("{k}.npy"));
        let depth = made.truth.depth(&view.camera, 0.0);
        write_file(&file, false, |out| npy::write(&[depth.height, depth.width], &depth.data, out)).expect("written");
        view.depth = Some(DepthMap::new(file));
    }
    let data = Arc::new(data);
    let truth = |k: usize| made.truth.depth(&data.test[k].camera, 0.0);
    let score = |schedule: &str| {
        let mut trainer = trainer(&data, "static3d", schedule);
        run(&mut trainer, 300);
        (depth_error(&trainer, &data, &truth), psnr(&trainer, &data))
    };
    let (without, with) = (score(""), score("lambda_depth = 2.0"));
    println!(
        "five views: depth {:.4} off and {:.2} dB without, {:.4} and {:.2} dB with",
        without.0, without.1, with.0, with.1
    );
    assert!(with.0 < 0.8 * without.0 && with.1 > without.1 + 0.3, "{without:?} {with:?}");
    let none = scene("static", 48, 5);
    let config = tiny("static3d", "lambda_depth = 0.5");
    let refused = Trainer::new(gs_methods::registry(), none, "static3d", &config, Default::default());
    assert!(refused.err().expect("refused").to_string().contains("no training view has a depth map"));
}
