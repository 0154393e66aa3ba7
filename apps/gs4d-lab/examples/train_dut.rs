//! Films the built-in person, trains DUT on it and prints scores where the person is (ours, and those of papers on avatars,
//! [`gs_metrics::person`]), sharpness over that of the images, how well GeoNet knows the surface, and what each stage of a new
//! frame takes.
//!
//! ```text
//! cargo run --release -p gs4d-lab --example train_dut -- [PRESET] [TEMPLATE] [KEY=VALUE ...]
//! ```
//! `seed=N` is that of the training, `look=DIR` a folder for pictures of the test views (truth, drawn, three times their
//! difference); keys `film.*` are of the film, others of the method (`film.frames=12`, `input="single"`,
//! `schedule.stages.main.steps=500`). `oracle=STEPS` trains nothing: it looks for every frame's offsets by themselves, by
//! GeoNet's losses alone, in `rounds=N` rounds (3) with new mean colours after each.

use gs_core::io::images::save_png;
use gs_core::{Image, Params};
use gs_data::{Dataset, ImageCache, Split};
use gs_method_texel::{Config, Dut, OffsetErrors, OracleOptions};
use gs_metrics::Mean;
use gs_raster::{Workspace, render};
use gs_synth::avatar::{self, AvatarOptions};
use gs_train::evaluate::{ViewScores, clamped, evaluate};
use gs_train::method::{Buffers, Method};
use gs_train::model::Model;
use gs_train::registry::{overlay, own_settings};
use gs_train::scene::{InitConfig, SceneInfo};
use gs_train::timestamp::Timestamp;
use gs_train::trainer::{TrainOptions, Trainer};
use gs4d_lab::bench::{StageOptions, stage_times};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let preset = arguments.next().unwrap_or_else(|| "tiny".to_owned());
    let template = arguments.next().unwrap_or_else(|| "builtin:person".to_owned());
    let mut config = gs_methods::registry().find("dut")?.config(&preset)?;
    let film = AvatarOptions { template, size: 256, frames: 16, test_every: 5, ..AvatarOptions::default() };
    let mut film = toml::Table::try_from(film)?;
    let (mut look, mut training) = (None, TrainOptions::default());
    let mut oracle = OracleOptions { steps: 0, rounds: 3, rate: 2e-3 };
    for setting in arguments {
        match setting.split_once(['=', '.']) {
            Some(("look", folder)) => look = Some(PathBuf::from(folder)),
            Some(("oracle", steps)) => oracle.steps = steps.parse()?,
            Some(("rounds", rounds)) => oracle.rounds = rounds.parse()?,
            Some(("seed", seed)) => training.seed = seed.parse()?,
            Some(("film", of_film)) => overlay(&mut film, of_film.parse()?),
            _ => overlay(&mut config, setting.parse()?),
        }
    }
    let begun = Instant::now();
    let dataset = Arc::new(avatar::generate(&film.try_into()?)?);
    println!(
        "filmed in {:.1} s: {} training views, {} test views",
        begun.elapsed().as_secs_f64(),
        dataset.train.len(),
        dataset.test.len()
    );
    let scene = SceneInfo::of(&dataset, &config["init"].clone().try_into::<InitConfig>()?, training.seed)?;
    if oracle.steps > 0 {
        let mut dut = Dut::new(own_settings(config).try_into::<Config>()?, &scene)?;
        dut.oracle(&oracle)?.iter().for_each(print_offsets);
        return Ok(());
    }
    let mut trainer = Trainer::new(gs_methods::registry(), dataset.clone(), "dut", &config, training.clone())?;
    println!("dut ({preset}): {} texels, {} steps", trainer.model().splat_count(), trainer.steps());
    let every = (trainer.steps() / 10).max(1);
    while trainer.steps_done() < trainer.steps() {
        let report = trainer.step()?;
        if report.step % every == 0 || report.step == 1 {
            let seconds = trainer.train_seconds();
            let penalties = &report.penalties;
            println!(
                "{seconds:6.0} s  step {:5} {:8} loss {:.5} {penalties:?}",
                report.step, report.stage, report.loss.total
            );
        }
    }
    for split in [Split::Train, Split::Test] {
        print_scores(&trainer, &dataset, split)?;
    }
    if let Some(folder) = look {
        pictures(trainer.model(), &dataset, &folder)?;
    }
    let mut dut = Dut::new(own_settings(config).try_into::<Config>()?, &scene)?;
    copy(trainer.model(), &mut dut);
    dut.begin_step(&trainer.schedule().at(trainer.steps()));
    let errors = dut.offset_errors()?;
    // A template that is the truth has no offsets.
    if errors.length[0] > 0.0 {
        print_offsets(&errors);
    }
    let stages = StageOptions { warm_up: 2, frames: dut.actor().scene.frames.len(), repeats: 1, size: 512 };
    print!("{}", stage_times(&dut, &stages)?.text());
    Ok(())
}

fn print_offsets(OffsetErrors { ratio, length }: &OffsetErrors) {
    println!(
        "offsets: RMS error / RMS length = {:.3} of {:.1} mm; along normals {:.3} of {:.1} mm",
        ratio[0],
        1e3 * length[0],
        ratio[1],
        1e3 * length[1]
    );
}

/// Gives a method the state of another of the same configuration.
fn copy(from: &Model, to: &mut Dut) {
    let mut values = Vec::new();
    from.visit(&mut |p| values.push(p.value.clone()));
    let mut values = values.into_iter();
    to.visit_mut(&mut |p| p.value = values.next().unwrap_or_default());
    let mut buffers = Vec::new();
    from.buffers(&mut |b| buffers.push(b.values.clone()));
    let mut buffers = buffers.into_iter();
    to.buffers_mut(&mut |b| *b.values = buffers.next().unwrap_or_default());
}

/// Mean scores of a split, of the frames that training views show and of the others.
fn print_scores(trainer: &Trainer, dataset: &Dataset, split: Split) -> Result<(), Box<dyn Error>> {
    let report = evaluate(trainer.model(), dataset, split, [0.0; 3], &ImageCache::new(256 << 20, 1.0))?;
    let trained: Vec<f32> = dataset.train.iter().map(|v| v.time.normalised).collect();
    for (frames, seen) in [("trained frames", true), ("other frames", false)] {
        let views: Vec<&ViewScores> = report.views.iter().filter(|v| trained.contains(&v.time) == seen).collect();
        if views.is_empty() {
            continue;
        }
        // NaN where no view has the score.
        let mean = |score: fn(&ViewScores) -> Option<f64>| {
            Mean::of(views.iter().filter_map(|v| score(v))).value.unwrap_or(f64::NAN)
        };
        println!(
            "{split:?}, {} views of {frames}: in-mask PSNR {:.2} dB, whole picture {:.2} dB, f-psnr {:.2} dB, box-ssim {:.4}, \
             sharpness {:.3} (Laplacian) {:.3} (high band)",
            views.len(),
            mean(|v| v.masked?.psnr),
            mean(|v| v.psnr),
            mean(|v| v.masked?.frame_psnr),
            mean(|v| v.masked?.box_ssim),
            mean(|v| v.laplacian_ratio),
            mean(|v| v.high_band_ratio),
        );
    }
    Ok(())
}

/// Test views beside what is drawn, one in five.
fn pictures(method: &Model, dataset: &Dataset, folder: &Path) -> Result<(), Box<dyn Error>> {
    std::fs::create_dir_all(folder)?;
    let (images, options) = (ImageCache::new(256 << 20, 1.0), method.raster_options([0.0; 3]));
    for view in dataset.test.iter().step_by(5) {
        let splats = method.splats(&Timestamp::new(view.time), &view.camera)?;
        let drawn = clamped(&render(&splats, &view.camera, &options, &mut Workspace::new()));
        let truth = images.get(view)?.over([0.0; 3]);
        let mut panel = Image::zeros(3 * truth.width, truth.height, 3);
        for (y, x) in (0..truth.height).flat_map(|y| (0..truth.width).map(move |x| (y, x))) {
            let (a, b) = (truth.pixel(x, y), drawn.pixel(x, y));
            let difference: Vec<f32> = a.iter().zip(b).map(|(a, b)| 3.0 * (a - b).abs()).collect();
            for (k, value) in [a, b, &difference].into_iter().enumerate() {
                panel.pixel_mut(k * truth.width + x, y).copy_from_slice(value);
            }
        }
        save_png(&folder.join(format!("{}.png", view.name.replace(['/', '\\'], "_"))), &panel, true)?;
    }
    Ok(())
}
