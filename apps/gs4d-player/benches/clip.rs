//! Time to make, write and read a clip of 5000 splats at 30 times, and its size and error.

use criterion::{Criterion, criterion_group, criterion_main};
use gs_core::Splats;
use gs_raster::measure;
use gs4d_player::{Clip, Frames, Page, Start, Tolerance, read};

/// The bench scene with a fifth of its splats on circles.
fn frames() -> Frames {
    let (scene, times): (Splats, Vec<f32>) = (measure::scene(5000, 1), (0..30).map(|k| k as f32 / 29.0).collect());
    let at = |&t: &f32| {
        let mut splats = scene.clone();
        for (i, mean) in splats.means.iter_mut().enumerate().filter(|(i, _)| i % 5 == 0) {
            let angle = t * 3.0 + i as f32;
            *mean += 0.3 * glam::Vec3::new(angle.cos(), angle.sin(), 0.0);
        }
        splats
    };
    Frames::new(times.clone(), times.iter().map(at).collect()).expect("a valid scene")
}

fn clip(c: &mut Criterion) {
    let (frames, cameras) = (frames(), [measure::camera(256)]);
    let page = Page { title: "bench".into(), start: Start::default(), background: [0.0; 3], clock: None };
    for tolerance in [0.05, 0.1, 0.2] {
        let made = Clip::fit(&frames, &cameras, Tolerance(tolerance));
        let html = page.html(&made).expect("a page");
        println!("tolerance {tolerance}: {} keys, {} kB", made.keys(), html.len() / 1000);
    }
    let made = Clip::fit(&frames, &cameras, Tolerance::default());
    let html = page.html(&made).expect("a page");
    c.bench_function("clip/fit", |b| b.iter(|| Clip::fit(&frames, &cameras, Tolerance::default())));
    c.bench_function("clip/write", |b| b.iter(|| page.html(&made)));
    c.bench_function("clip/read", |b| b.iter(|| read(&html)));
    c.bench_function("clip/splats", |b| b.iter(|| made.splats(0.37)));
}

criterion_group!(benches, clip);
criterion_main!(benches);
