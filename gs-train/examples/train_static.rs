//! Trains 3D Gaussian Splatting on a generated scene in memory and prints how it improves.
//!
//! ```text
//! cargo run --release -p gs-train --example train_static -- [SCENE] [PRESET] [METHOD]
//! ```

use gs_data::{ImageCache, Split};
use gs_synth::{self as synth, SynthOptions};
use gs_train::evaluate::evaluate;
use gs_train::trainer::{TrainOptions, Trainer};
use std::sync::Arc;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let scene = arguments.next().unwrap_or_else(|| synth::SCENES[0].name.to_owned());
    let preset = arguments.next().unwrap_or_else(|| "tiny".to_owned());
    let method = arguments.next().unwrap_or_else(|| "static3d".to_owned());

    let options = SynthOptions::of_views(96, 40, 8);
    let data = synth::generate(&scene, &options)?;
    let dataset = Arc::new(data.dataset);
    let config = gs_methods::registry().find(&method)?.config(&preset)?;
    let mut trainer = Trainer::new(gs_methods::registry(), dataset.clone(), &method, &config, TrainOptions::default())?;
    let background = trainer.model().background();
    let images = ImageCache::new(64 << 20, 1.0);

    println!("{method} ({preset}) on the generated scene `{scene}`, {} steps", trainer.steps());
    let every = (trainer.steps() / 10).max(1);
    while trainer.steps_done() < trainer.steps() {
        let report = trainer.step()?;
        if report.step % every == 0 {
            let test = evaluate(trainer.model(), &dataset, Split::Test, background, &images)?;
            println!(
                "step {:6}  {:8}  loss {:.4}  test {:.2} dB, SSIM {:.4}  {} splats  {:.1} ms",
                report.step,
                report.stage,
                report.loss.total,
                test.mean.psnr.unwrap_or(f64::INFINITY),
                test.mean.ssim.unwrap_or(1.0),
                report.splats,
                report.ms.total
            );
        }
    }
    println!("{:.1} s of training", trainer.train_seconds());
    Ok(())
}
