//! Scores the images of one folder against those of the same name in another, and prints a table.
//!
//! ```text
//! cargo run --release -p gs-metrics --example score_folders -- renders/ truth/
//! ```
//! Names are compared without their extension, images in sorted order. SSIM is the published form (valid area). Images
//! with alpha are composited on black.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use gs_core::Image;
use gs_metrics::{Scorer, Scores, SsimOptions, Summary};

fn main() -> ExitCode {
    let folders: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [renders, truth] = &folders[..] else {
        eprintln!("usage: score_folders RENDERS TRUTH");
        return ExitCode::from(2);
    };
    match score(renders, truth) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("error: {e}");
            ExitCode::FAILURE
        }
    }
}

fn score(renders: &Path, truth: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let (renders, mut truth) = (images_of(renders)?, images_of(truth)?);
    let mut scorer = Scorer::new(SsimOptions::published());
    let mut all = Vec::new();
    println!("{:<24} {:>9} {:>8} {:>8} {:>16}", "image", "psnr", "ssim", "ms-ssim", "perceptual-proxy");
    for (name, path) in &renders {
        let Some(other) = truth.remove(name) else {
            println!("{name:<24} has no counterpart");
            continue;
        };
        let scores = scorer.score(&read(path)?, &read(&other)?).map_err(|e| format!("{name}: {e}"))?;
        print_row(name, &scores);
        all.push(scores);
    }
    truth.keys().for_each(|name| println!("{name:<24} has no render"));
    let s = Summary::of(&all);
    println!("\n{} images", s.views);
    println!("mean of PSNR      {} dB", s.mean_psnr);
    if let Some(db) = s.psnr_of_mean_mse {
        println!("PSNR of mean MSE  {db:.4} dB");
    }
    println!("SSIM              {}\nMS-SSIM           {}", s.ssim, s.ms_ssim);
    println!("perceptual proxy  {} (no learned weights; not LPIPS)", s.perceptual_proxy);
    Ok(())
}

fn print_row(name: &str, s: &Scores) {
    let ms = s.ms_ssim.map_or("-".into(), |v| format!("{v:.4}"));
    println!("{name:<24} {:>9.4} {:>8.4} {ms:>8} {:>16.4}", s.psnr, s.ssim, s.perceptual_proxy);
}

/// Image files of a folder by name without extension.
fn images_of(folder: &Path) -> Result<BTreeMap<String, PathBuf>, String> {
    let entries = std::fs::read_dir(folder).map_err(|e| format!("cannot list {}: {e}", folder.display()))?;
    let paths = entries.filter_map(|e| Some(e.ok()?.path())).filter(|p| image::ImageFormat::from_path(p).is_ok());
    let named = paths.filter_map(|p| Some((p.file_stem()?.to_string_lossy().into_owned(), p)));
    Ok(named.collect())
}

fn read(path: &Path) -> Result<Image, String> {
    let decoded = image::open(path).map_err(|e| format!("cannot read {}: {e}", path.display()))?.to_rgba32f();
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let over_black = decoded.pixels().flat_map(|p| [p[0] * p[3], p[1] * p[3], p[2] * p[3]]);
    Ok(Image { width, height, channels: 3, data: over_black.collect() })
}
