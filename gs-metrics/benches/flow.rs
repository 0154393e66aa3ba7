//! Time of optical flow and tOF at 640 × 360, and their distance from OpenCV 4.10's flow of the same generated frames.
//! Each row goes to the terminal and to `target/speed-error/gs-metrics.jsonl`.

#[path = "../tests/metrics/frames.rs"]
mod frames;

use std::hint::black_box;

use gs_core::speed::{BenchRow, median_seconds};
use gs_metrics::flow::{Expansion, Farneback, Flow};
use gs_metrics::{Tof, TofOptions};

const SIZE: (usize, usize) = (640, 360);
/// OpenCV's displacements at every 24th pixel from the twelfth.
const STORED: &[u8] = include_bytes!("../tests/metrics/flow/wide.f32");

/// Largest distance from the stored displacements, pixels.
fn off(flow: &Flow) -> f64 {
    let stored = STORED.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b));
    let places = (12..SIZE.1).step_by(24).flat_map(|y| (12..SIZE.0).step_by(24).map(move |x| (x, y)));
    let ours = places.flat_map(|(x, y)| flow.at(x, y));
    ours.zip(stored).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max)
}

fn measure(case: &str, variant: &str, error: Option<f64>, mut f: impl FnMut() + Send) {
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let row = BenchRow {
            krate: "gs-metrics",
            case: case.to_owned(),
            variant: variant.to_owned(),
            n: SIZE.0 * SIZE.1,
            threads,
            ms: 1e3 * pool.install(|| median_seconds(9, &mut f)),
            work: (SIZE.0 * SIZE.1) as f64,
            error,
            error_kind: "largest, pixels, against OpenCV",
        };
        row.append(env!("CARGO_MANIFEST_DIR"));
    }
}

fn main() {
    let [a, b] = frames::moved(SIZE.0, SIZE.1, 40, 23);
    let (mut estimate, mut flow) = (Farneback::default(), Flow::default());
    estimate.flow(&a, &b, &mut flow).expect("a flow");
    let error = Some(off(&flow));
    measure("optical flow", "pair of frames", error, || estimate.flow(&a, &b, black_box(&mut flow)).expect("a flow"));
    let mut estimate = Farneback::default();
    let mut fits = [Expansion::default(), Expansion::default()];
    measure("optical flow", "expansion of one frame", None, || estimate.expand(&a, &mut fits[0]).expect("a frame"));
    estimate.expand(&b, &mut fits[1]).expect("a frame");
    let [first, second] = &fits;
    measure("optical flow", "between expanded frames", error, || {
        estimate.between(first, second, black_box(&mut flow)).expect("a flow");
    });
    let (pred, truth) =
        (frames::video_frame(SIZE.0, SIZE.1, 1, [24, -10]), frames::video_frame(SIZE.0, SIZE.1, 1, [20, -16]));
    let mut tof = Tof::new(TofOptions { trim: false, crop: true });
    measure("tof", "one more frame", None, || tof.add(black_box(&pred), &truth).expect("a frame"));
}
