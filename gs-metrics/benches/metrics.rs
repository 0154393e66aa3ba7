//! Time and error of the metrics. Each row goes to the terminal and to `target/speed-error/gs-metrics.jsonl`; errors are
//! against plain loops in `f64`.

#[path = "../tests/metrics/fourier.rs"]
mod fourier;
#[path = "../tests/metrics/reference.rs"]
mod reference;

use std::hint::black_box;

use criterion::Criterion;
use fourier::amplitude_loss64;
use gs_core::speed::{BenchRow, median_seconds};
use gs_core::{Image, Rng};
use gs_metrics::{AmplitudeLoss, ColorMap, MsSsim, MsSsimOptions, Padding, Ssim, SsimOptions, mse, perceptual_proxy};
use reference::{Image64, mean_ssim64, relative_l2, ssim_grad64};

/// The columns of a row other than its time.
struct Row<'a> {
    case: &'a str,
    variant: &'a str,
    side: usize,
    error: Option<f64>,
    error_kind: &'static str,
}

/// A smooth image with grain, and a noisier version of it.
fn pair(side: usize) -> (Image, Image) {
    let mut rng = Rng::new(1, "bench", 0, 0);
    let shade = |i: usize| 0.5 + 0.3 * ((i / 3 % side) as f32 * 0.05).sin() * ((i / 3 / side) as f32 * 0.03).cos();
    let a: Vec<f32> = (0..side * side * 3).map(|i| shade(i) + 0.1 * rng.uniform()).collect();
    let b = a.iter().map(|v| v + 0.05 * rng.normal()).collect();
    let image = |data| Image { width: side, height: side, channels: 3, data };
    (image(a), image(b))
}

/// Times `f` with 1 and 2 threads and writes the rows.
fn measure(criterion: &mut Criterion, row: &Row, mut f: impl FnMut() + Send) {
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let seconds = pool.install(|| median_seconds(15, &mut f));
        let line = BenchRow {
            krate: "gs-metrics",
            case: row.case.to_owned(),
            variant: row.variant.to_owned(),
            n: row.side,
            threads,
            ms: 1e3 * seconds,
            work: (row.side * row.side * 3) as f64,
            error: row.error,
            error_kind: row.error_kind,
        };
        line.append(env!("CARGO_MANIFEST_DIR"));
        let name = format!("{}/{}/{}px/{}t", row.case, row.variant, row.side, threads);
        criterion.bench_function(&name, |b| b.iter(|| pool.install(&mut f)));
    }
}

fn ssim_rows(criterion: &mut Criterion, a: &Image, b: &Image, padding: Padding) {
    let (variant, margin) = if padding == Padding::Zero { ("zero padding", 0) } else { ("valid area", 5) };
    let (a64, b64) = (Image64::from(a), Image64::from(b));
    let mut ssim = Ssim::new(SsimOptions { padding, ..SsimOptions::default() });
    let mut grad = Image::default();
    let value = ssim.value_and_grad(a, b, &mut grad).expect("a score");
    let error = Some((value - mean_ssim64(&a64, &b64, margin)).abs());
    let side = a.width;
    measure(criterion, &Row { case: "ssim", variant, side, error, error_kind: "absolute" }, || {
        black_box(ssim.value(a, b).expect("a score"));
    });
    let error = Some(relative_l2(&grad.data, &ssim_grad64(&a64, &b64, margin)));
    let row = Row { case: "ssim and gradient", variant, side, error, error_kind: "gradient, relative L2" };
    measure(criterion, &row, || {
        black_box(ssim.value_and_grad(a, b, &mut grad).expect("a score"));
    });
}

fn other_rows(criterion: &mut Criterion, a: &Image, b: &Image) {
    let side = a.width;
    let plain: f64 = a.data.iter().zip(&b.data).map(|(x, y)| (f64::from(*x) - f64::from(*y)).powi(2)).sum();
    let want = plain / a.data.len() as f64;
    let error = Some((mse(a, b).expect("a score") / want - 1.0).abs());
    measure(criterion, &Row { case: "mse", variant: "f64 sums", side, error, error_kind: "relative" }, || {
        black_box(mse(a, b).expect("a score"));
    });
    let warm = ColorMap::linear([[1.2, 0.05, 0.0], [0.02, 1.0, -0.03], [0.0, 0.1, 0.8]]);
    let mut warmer = a.clone();
    warm.apply(&mut warmer);
    warmer.data.iter_mut().for_each(|v| *v = v.min(1.0));
    let found = ColorMap::fit(a, &warmer, None, 1e-9).expect("a map");
    let entries = found.matrix.as_flattened().iter().zip(warm.matrix.as_flattened());
    let error = Some(entries.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max));
    let row = Row { case: "colour map", variant: "fit", side, error, error_kind: "entry, absolute" };
    measure(criterion, &row, || {
        black_box(ColorMap::fit(a, b, None, 1e-3).expect("a map"));
    });
    let mut ms = MsSsim::new(MsSsimOptions::default());
    let mut grad = Image::default();
    let own = |case, variant| Row { case, variant, side, error: None, error_kind: "see the tests" };
    measure(criterion, &own("ms-ssim and gradient", "five levels"), || {
        black_box(ms.value_and_grad(a, b, &mut grad).expect("a score"));
    });
    measure(criterion, &own("perceptual proxy", "no weights"), || {
        black_box(perceptual_proxy(a, b).expect("a score"));
    });
}

fn amplitude_rows(criterion: &mut Criterion, a: &Image, b: &Image) {
    let mut loss = AmplitudeLoss::default();
    let mut grad = Image::default();
    let value = loss.value_and_grad(a, b, &mut grad).expect("a score");
    let (want, slope) = amplitude_loss64(&Image64::from(a), &Image64::from(b));
    let side = a.width;
    let error = Some((value - want).abs());
    let row = Row { case: "amplitude loss", variant: "both images", side, error, error_kind: "absolute" };
    measure(criterion, &row, || {
        black_box(loss.value(a, b).expect("a score"));
    });
    let error = Some(relative_l2(&grad.data, &slope));
    let kind = "gradient, relative L2";
    let row = Row { case: "amplitude loss, gradient", variant: "both images", side, error, error_kind: kind };
    measure(criterion, &row, || {
        black_box(loss.value_and_grad(a, b, &mut grad).expect("a score"));
    });
}

fn main() {
    let quick = std::time::Duration::from_millis(200);
    let mut criterion = Criterion::default()
        .sample_size(10)
        .warm_up_time(quick / 4)
        .measurement_time(quick)
        .without_plots()
        .configure_from_args();
    for side in [400, 800] {
        let (a, b) = pair(side);
        ssim_rows(&mut criterion, &a, &b, Padding::Zero);
        ssim_rows(&mut criterion, &a, &b, Padding::Valid);
        other_rows(&mut criterion, &a, &b);
    }
    // 397 is a prime number.
    for side in [397, 400, 800] {
        let (a, b) = pair(side);
        amplitude_rows(&mut criterion, &a, &b);
    }
    criterion.final_summary();
}
