//! Time to make a clip of 5000 splats at 30 times, and the same as spans, the size of page and file, and the error of their images, by
//! tolerance; then the time to write a page, to read it back and to take the splats of a time.

use criterion::{Criterion, criterion_group, criterion_main};
use gs_core::Splats;
use gs_core::speed::{BenchRow, median_seconds};
use gs_raster::{RasterOptions, Workspace, measure, render};
use gs4d_player::{Clip, Frames, Page, Spans, Start, Tolerance, read};

const SPLATS: usize = 5000;
const FRAMES: usize = 30;
const SIDE: u32 = 256;

/// The bench scene with a fifth of its splats on circles.
fn scene() -> (Vec<f32>, Vec<Splats>) {
    let still = measure::scene(SPLATS, 1);
    let times: Vec<f32> = (0..FRAMES).map(|k| k as f32 / (FRAMES - 1) as f32).collect();
    let at = |&t: &f32| {
        let mut splats = still.clone();
        for (i, mean) in splats.means.iter_mut().enumerate().filter(|(i, _)| i % 5 == 0) {
            let angle = t * 3.0 + i as f32;
            *mean += 0.3 * glam::Vec3::new(angle.cos(), angle.sin(), 0.0);
        }
        splats
    };
    let splats = times.iter().map(at).collect();
    (times, splats)
}

/// Root mean square difference of the images of two scenes.
fn apart(a: &Splats, b: &Splats) -> f64 {
    let draw =
        |s: &Splats| render(s, &measure::camera(SIDE), &RasterOptions::default(), &mut Workspace::new()).rgb.data;
    let (x, y) = (draw(a), draw(b));
    let sum: f64 = x.iter().zip(&y).map(|(p, q)| f64::from(p - q).powi(2)).sum();
    (sum / x.len() as f64).sqrt()
}

fn clip(c: &mut Criterion) {
    let (times, splats) = scene();
    let frames = Frames::new(times.clone(), splats.clone()).expect("a valid scene");
    let cameras = [measure::camera(SIDE)];
    let page = Page { title: "bench".into(), start: Start::default(), background: [0.0; 3], clock: None };
    let row = |kind: &str, tolerance: f32, bytes: usize, fit: &dyn Fn(), at: &dyn Fn(f32) -> Splats| {
        let each = times.iter().zip(&splats).map(|(&t, s)| apart(s, &at(t)));
        let row = BenchRow {
            krate: "gs4d-player",
            case: format!("{FRAMES} times, {kind}, {} kB", bytes / 1000),
            variant: format!("tolerance {tolerance}"),
            n: SPLATS,
            threads: 1,
            ms: 1e3 * median_seconds(5, fit),
            work: (SPLATS * FRAMES) as f64,
            error: Some(each.sum::<f64>() / FRAMES as f64),
            error_kind: "image RMS",
        };
        row.append(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    };
    for tolerance in [0.025, 0.05, 0.1, 0.2, 0.4] {
        let clip = || Clip::fit(&frames, &cameras, Tolerance(tolerance));
        let made = clip();
        let bytes = page.html(&made).expect("a page").len();
        row("page", tolerance, bytes, &|| drop(clip()), &|t| made.splats(t));
        let spans = || Spans::fit(&frames, &cameras, Tolerance(tolerance), 3.0);
        let bytes = spans().bytes().expect("a file");
        let read = Spans::read(&bytes).expect("the same file");
        row(".4dgs", tolerance, bytes.len(), &|| drop(spans()), &|t| read.splats(t));
    }
    let made = Clip::fit(&frames, &cameras, Tolerance::default());
    let html = page.html(&made).expect("a page");
    c.bench_function("clip/write", |b| b.iter(|| page.html(&made)));
    c.bench_function("clip/read", |b| b.iter(|| read(&html)));
    c.bench_function("clip/splats", |b| b.iter(|| made.splats(0.37)));
}

criterion_group!(benches, clip);
criterion_main!(benches);
