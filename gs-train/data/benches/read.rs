//! Time and error of reading: a folder of a generated scene, opened, and its images decoded and kept by the cache. Rows go to
//! the terminal and to `target/speed-error/gs-data.jsonl`; `work` counts pixels.

use criterion::Criterion;
use gs_core::speed::{BenchRow, Stopwatch};
use gs_data::{DataOptions, Dataset, ImageCache};
use gs_synth::{SynthOptions, write};
use rayon::prelude::*;
use std::path::Path;

/// Side of the images, pixels, and their number.
const SIDE: u32 = 400;
const VIEWS: u32 = 20;

fn open(folder: &Path) -> Dataset {
    Dataset::open(folder, &DataOptions::default()).expect("what was written")
}

/// Gets every training image.
fn load(data: &Dataset, images: &ImageCache) {
    data.train.par_iter().for_each(|view| drop(images.get(view).expect("an image")));
}

/// Largest distance of a camera from where it was put, world units.
fn camera_error(made: &Dataset, read: &Dataset) -> f64 {
    let pairs = made.train.iter().zip(&read.train);
    pairs.map(|(a, b)| a.camera.position().distance(b.camera.position())).fold(0.0, f64::max)
}

/// Largest difference of a channel from the image that was written, 8-bit levels.
fn image_error(made: &Dataset, read: &Dataset) -> f64 {
    let images = ImageCache::new(0, 1.0);
    let worst = made.train.iter().zip(&read.train).map(|(a, b)| {
        let [a, b] = [a, b].map(|view| images.get(view).expect("an image"));
        assert_eq!((a.width, a.height), (b.width, b.height), "the size that was written");
        a.data.iter().zip(&b.data).map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0)
    });
    f64::from(worst.max().unwrap_or(0))
}

fn main() {
    let mut criterion = Criterion::default().sample_size(10).without_plots().configure_from_args();
    let folder = tempfile::tempdir().expect("a folder");
    let made = write(folder.path(), "balls", &SynthOptions::of_views(SIDE, VIEWS, 0), true).expect("a scene").dataset;
    let read = open(folder.path());
    assert_eq!(read.train.len(), made.train.len());
    let cameras = (camera_error(&made, &read), "largest distance of a camera, world units");
    let levels = (image_error(&made, &read), "largest difference, levels of 255");
    let kept = ImageCache::new(256 << 20, 1.0);
    load(&read, &kept);
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let mut row = |case: &str, (error, error_kind): (f64, &'static str), work: &(dyn Fn() + Sync)| {
            let mut laps = Stopwatch::default();
            criterion.bench_function(&format!("{case}/{threads}t"), |b| {
                b.iter_custom(|calls| pool.install(|| laps.run(calls, work)))
            });
            let Some(ms) = laps.median_ms() else { return };
            BenchRow {
                krate: "gs-data",
                case: case.into(),
                variant: format!("blender, {SIDE}x{SIDE} PNG"),
                n: VIEWS as usize,
                threads,
                ms,
                work: f64::from(VIEWS * SIDE * SIDE),
                error: Some(error),
                error_kind,
            }
            .append(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
        };
        row("open", cameras, &|| drop(open(folder.path())));
        row("decode", levels, &|| load(&read, &ImageCache::new(256 << 20, 1.0)));
        row("kept images", levels, &|| load(&read, &kept));
    }
    criterion.final_summary();
}
