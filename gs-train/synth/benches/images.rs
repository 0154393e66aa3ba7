//! Time and error of ground truth: one image of a scene by the number of samples per pixel, against 16×16 samples. Rows go to
//! the terminal and to `target/speed-error/gs-synth.jsonl`; `work` counts samples.

use criterion::Criterion;
use gs_core::speed::{BenchRow, Stopwatch};
use gs_data::{Dataset, ImageCache, ImageU8};
use gs_synth::SynthOptions;
use gs_synth::testkit::dataset;
use std::sync::Arc;

/// Side of the images, pixels.
const SIDE: u32 = 200;

fn options(supersample: u32) -> SynthOptions {
    SynthOptions { supersample, ..SynthOptions::of_views(SIDE, 1, 0) }
}

fn image(data: &Dataset) -> Arc<ImageU8> {
    ImageCache::new(0, 1.0).get(&data.train[0]).expect("an image")
}

/// Root mean square over the channels, 8-bit levels.
fn difference(a: &ImageU8, b: &ImageU8) -> f64 {
    let squares = a.data.iter().zip(&b.data).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
    (squares.sum::<f64>() / a.data.len() as f64).sqrt()
}

fn main() {
    let mut criterion = Criterion::default().sample_size(10).without_plots().configure_from_args();
    for scene in ["balls", "sheet"] {
        let fine = image(&dataset(scene, &options(16)));
        for supersample in [1, 2, 3, 6] {
            let options = options(supersample);
            let error = Some(difference(&image(&dataset(scene, &options)), &fine));
            for threads in [1, 2] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
                let (mut laps, name) = (Stopwatch::default(), format!("{scene}/{supersample}/{threads}t"));
                criterion.bench_function(&name, |b| {
                    b.iter_custom(|calls| pool.install(|| laps.run(calls, || drop(dataset(scene, &options)))))
                });
                let Some(ms) = laps.median_ms() else { continue };
                BenchRow {
                    krate: "gs-synth",
                    case: format!("image of {scene}"),
                    variant: format!("{supersample}x{supersample} samples"),
                    n: (SIDE * SIDE) as usize,
                    threads,
                    ms,
                    work: f64::from((SIDE * supersample).pow(2)),
                    error,
                    error_kind: "rms against 16x16 samples, levels of 255",
                }
                .append(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
            }
        }
    }
    criterion.final_summary();
}
