//! What a picture of the viewer takes, drawn and packed, and what the packing loses.
//!
//! Rows are printed and appended to `target/speed-error/gs4d-view.jsonl`. `work` counts pixels; the error is the largest
//! difference to the frame as it was drawn, in 0..1.

use criterion::{Criterion, criterion_group, criterion_main};
use gs_core::io::{Limits, images::decode_image};
use gs_core::speed::{BenchRow, Stopwatch};
use gs_raster::measure;
use gs_train::device::Device;
use gs4d_view::picture::Renderer;
use gs4d_view::question::Question;
use gs4d_view::{Packing, Show, Stage};

/// Splats of the scene.
const SPLATS: usize = 100_000;
/// Width and height of a picture at rest.
const SIZE: [u32; 2] = [960, 540];

fn question(shrink: u32) -> Question {
    let camera = measure::camera(SIZE[0]);
    let (eye, target) = (camera.position(), camera.position() + camera.forward());
    let [width, height] = SIZE.map(|v| v / shrink);
    let text = serde_json::json!({
        "id": 1, "what": {"show": 0, "layer": "color"}, "time": 0.0, "width": width, "height": height,
        "look": {"free": [eye.to_array(), target.to_array(), (-camera.rotation.row(1)).to_array(), 0.8]},
    });
    Question::parse(&text.to_string()).expect("a sound question")
}

fn pictures(c: &mut Criterion) {
    let stage = Stage::new(vec![Show::splats("scene".into(), measure::scene(SPLATS, 3))]);
    let mut renderer = Renderer::on(&Device::default()).expect("the CPU");
    let exact =
        |renderer: &mut Renderer, q: &Question| renderer.answer(&stage, q, Packing::Png).expect("a picture").bytes;
    for (case, shrink) in [("at rest", 1), ("moving", 4)] {
        let question = question(shrink);
        let truth = exact(&mut renderer, &question);
        let truth = decode_image(&truth, "truth.png", &Limits::default()).expect("a PNG");
        for (variant, packing) in [("png", Packing::Png), ("jpeg", Packing::Jpeg)] {
            let mut laps = Stopwatch::default();
            let mut image = Vec::new();
            c.bench_function(&format!("{case}/{variant}"), |b| {
                b.iter_custom(|calls| {
                    laps.run(calls, || image = renderer.answer(&stage, &question, packing).expect("a picture").bytes)
                });
            });
            let Some(ms) = laps.median_ms() else { continue };
            let got = decode_image(&image, "answer", &Limits::default()).expect("an image");
            let apart = got.data.iter().zip(&truth.data).fold(0f32, |m, (a, b)| m.max((a - b).abs()));
            let row = BenchRow {
                krate: "gs4d-view",
                case: case.to_owned(),
                variant: variant.to_owned(),
                n: SPLATS,
                threads: std::thread::available_parallelism().map_or(1, usize::from),
                ms,
                work: f64::from(question.width * question.height),
                error: Some(f64::from(apart)),
                error_kind: "largest difference to PNG",
            };
            row.append(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
        }
    }
}

criterion_group!(name = benches; config = Criterion::default().sample_size(10); targets = pictures);
criterion_main!(benches);
