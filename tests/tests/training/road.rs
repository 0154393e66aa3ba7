//! The whole road, from files to files: a data set on disk, a trained scene, a checkpoint, a splat file, a picture.
//!
//! | step | must hold |
//! |---|---|
//! | data set written and read | the same pixels and cameras |
//! | training | held-out PSNR rises by at least 5 dB |
//! | checkpoint written and read | the same splats, bit for bit |
//! | splat file written and read | pictures within 1e-4 of a channel (scales and opacities pass through log and logit) |

use gs_core::Splats;
use gs_core::io::{Limits, RawSplats, load_splats, save_splats};
use gs_data::{DataOptions, Dataset, ImageCache, View};
use gs_raster::{Frame, Workspace, render};
use gs_synth::{self as synth, SynthOptions};
use gs_train::checkpoint::{self, Checkpoint};
use gs_train::model::Model;
use gs_train::registry::overlay;
use gs_train::saved;
use gs_train::timestamp::Timestamp;
use gs_train::trainer::{TrainOptions, Trainer};
use std::path::Path;
use std::sync::Arc;

fn written(dir: &Path, name: &str) -> Arc<Dataset> {
    let options = SynthOptions { supersample: 2, ..SynthOptions::of_views(48, 24, 4) };
    synth::write(dir, name, &options, false).expect("a folder to write to");
    Arc::new(Dataset::open(dir, &DataOptions::default()).expect("what was written can be read"))
}

fn trainer(data: &Arc<Dataset>, method: &str, steps: i64) -> Trainer {
    let mut config = gs_methods::registry().find(method).and_then(|m| m.config("tiny")).expect("the tiny preset");
    let names: Vec<String> = config["schedule"]["stages"].as_table().expect("stages").keys().cloned().collect();
    let share = steps / names.len() as i64;
    for name in names {
        let over = format!("[schedule.stages.{name}]\nsteps = {share}").parse().expect("TOML");
        overlay(&mut config, over);
    }
    Trainer::new(gs_methods::registry(), data.clone(), method, &config, TrainOptions { seed: 5, ..Default::default() })
        .expect("a trainer")
}

fn splats(model: &Model, view: &View) -> Splats {
    model.splats(&Timestamp::new(view.time), &view.camera).expect("splats")
}

fn picture(method: &Model, view: &View) -> Frame {
    let background = method.background();
    let splats = splats(method, view);
    render(&splats, &view.camera, &method.raster_options(background), &mut Workspace::new())
}

fn held_out_psnr(method: &Model, data: &Dataset) -> f64 {
    let background = method.background();
    let images = ImageCache::new(64 << 20, 1.0);
    let scores = data.test.iter().map(|view| {
        let frame = picture(method, view);
        gs_metrics::psnr(&frame.rgb, &images.get(view).expect("an image").over(background)).expect("a score")
    });
    scores.sum::<f64>() / data.test.len() as f64
}

#[test]
fn from_a_folder_of_images_to_a_splat_file() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let data = written(&folder.path().join("data"), "static");
    let mut trainer = trainer(&data, "static3d", 400);
    let before = held_out_psnr(trainer.model(), &data);
    while trainer.steps_done() < trainer.steps() {
        trainer.step().expect("a step");
    }
    let after = held_out_psnr(trainer.model(), &data);
    println!("static scene, 48x48, {} steps: {before:.2} -> {after:.2} dB", trainer.steps());
    assert!(after > before + 5.0, "{before:.2} -> {after:.2} dB");

    let kept = folder.path().join("checkpoints");
    std::fs::create_dir(&kept).expect("a folder");
    trainer.state().save_step(&kept, trainer.steps_done()).expect("a checkpoint");
    let newest: Checkpoint = checkpoint::load_newest(&kept).expect("the newest checkpoint").checkpoint;
    let again = saved::load(gs_methods::registry(), &newest, None).expect("a method").model;
    let view = &data.test[0];
    let splats = splats(trainer.model(), view);
    assert_eq!(self::splats(&again, view), splats);

    let ply = folder.path().join("scene.ply");
    save_splats(&ply, &RawSplats::from_splats(&splats).expect("legal splats"), false).expect("a splat file");
    let read = load_splats(&ply, &Limits::default()).expect("a splat file").to_splats();
    let options = trainer.model().raster_options([1.0; 3]);
    let draw = |s| render(s, &view.camera, &options, &mut Workspace::new());
    let (want, got) = (draw(&splats), draw(&read.expect("legal splats")));
    let worst = want.rgb.data.iter().zip(&got.rgb.data).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
    assert!(worst < 1e-4, "export changed the picture by {worst:.1e}");
}
