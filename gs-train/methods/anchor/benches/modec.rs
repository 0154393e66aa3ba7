//! What MoDec-GS need not compute: each saving with it and without, and how far the pictures are apart; then the stages of
//! a frame. A small run on `synth reach`. Rows go to the terminal and to `target/speed-error/gs-train.jsonl`.

use gs_anchor::{
    AnchorShape, Anchors, DecodeTape, Decoder, Gad, GadTape, LocalAnchors, LocalAnchorsGrad, VisibilityOptions,
    Visible, visible,
};
use gs_core::speed::{BenchRow, median_seconds};
use gs_core::{Camera, Geometry, Param, Params, Splats, Time};
use gs_data::{Dataset, ImageCache, Split};
use gs_deform::{Aabb, Field, HexPlaneField};
use gs_method_anchor::modec::Config;
use gs_raster::{FrameGrad, RasterOptions, Workspace, render, render_backward};
use gs_synth::{self as synth, SynthOptions};
use gs_train::capabilities::FreezeOptions;
use gs_train::checkpoint::Checkpoint;
use gs_train::evaluate::evaluate;
use gs_train::model::Model;
use gs_train::registry::overlay;
use gs_train::saved;
use gs_train::timestamp::Timestamp;
use gs_train::trainer::{TrainOptions, Trainer};
use std::collections::BTreeMap;
use std::sync::Arc;

const RUNS: usize = 21;
const GLOBAL_STEPS: u32 = 100;
const LOCAL_STEPS: i64 = 300;
const SMALL: &str = "
[init]
points = 2500
[adapt]
max_anchors = 2500
observe_from = 20
from = 40
[schedule.stages.global]
image_scale = 1.0
";
const T: Time = Time { normalised: 0.37, seconds: 0.37 };
const WORST: &str = "worst of a picture";

fn record(case: &str, variant: &str, n: usize, ms: f64, error: Option<f64>) {
    let (krate, threads) = ("gs-train", rayon::current_num_threads());
    let (case, variant, work) = (format!("modec {case}"), variant.to_owned(), n as f64);
    let line = BenchRow { krate, case, variant, n, threads, ms, work, error, error_kind: WORST };
    line.append(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
}

/// One saving: measures both ways, alternating, and prints their ratio.
fn saving(name: &str, n: usize, error: f64, mut without: impl FnMut(), mut with: impl FnMut()) {
    let [mut off, mut on] = [f64::INFINITY; 2];
    for _ in 0..3 {
        off = off.min(1e3 * median_seconds(RUNS / 3, &mut without));
        on = on.min(1e3 * median_seconds(RUNS / 3, &mut with));
    }
    record(name, "without", n, off, None);
    record(name, "with", n, on, Some(error));
    println!("  {name}: {off:.3} ms without, {on:.3} ms with, ratio {:.2}, pictures differ by {error:.1e}", off / on);
}

fn worst(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max)
}

/// The pictures of one camera after the other, over the span of time.
fn pictures(method: &Model, cameras: &[Camera]) -> Vec<f32> {
    let at = |i: usize| Timestamp::new(Time { normalised: i as f32 / cameras.len() as f32, ..T });
    cameras.iter().enumerate().flat_map(|(i, c)| picture(&method.splats(&at(i), c).expect("splats"), c)).collect()
}

fn apart(a: &Model, b: &Model, cameras: &[Camera]) -> f64 {
    worst(&pictures(a, cameras), &pictures(b, cameras))
}

/// Mean squared difference of the pictures, as PSNR, dB.
fn apart_psnr(a: &Model, b: &Model, cameras: &[Camera]) -> f64 {
    let (a, b) = (pictures(a, cameras), pictures(b, cameras));
    let sum: f64 = a.iter().zip(&b).map(|(a, b)| f64::from(a - b).powi(2)).sum();
    -10.0 * (sum / a.len() as f64).log10()
}

fn options() -> RasterOptions {
    RasterOptions { background: [1.0; 3], ..RasterOptions::default() }
}

fn picture(splats: &Splats, camera: &Camera) -> Vec<f32> {
    render(splats, camera, &options(), &mut Workspace::new()).rgb.data
}

/// A finished run.
struct Run {
    trainer: Trainer,
    config: toml::Table,
    /// The state at the end of the first stage.
    global: Checkpoint,
    cameras: Vec<Camera>,
}

impl Run {
    fn new() -> Self {
        let size = SynthOptions::of_views(128, 40, 10);
        let data = Arc::new(synth::generate("reach", &size).expect("a scene").dataset);
        let mut config = gs_methods::registry().find("modec").and_then(|m| m.config("fast")).expect("a preset");
        overlay(&mut config, SMALL.parse().expect("TOML"));
        config["schedule"]["stages"]["global"]["steps"] = i64::from(GLOBAL_STEPS).into();
        config["schedule"]["stages"]["local"]["steps"] = LOCAL_STEPS.into();
        let cameras = data.train.iter().map(|v| v.camera.clone()).collect();
        let mut trainer =
            Trainer::new(gs_methods::registry(), data, "modec", &config, TrainOptions::default()).expect("a run");
        let mut global = None;
        for step in 1..=trainer.steps() {
            trainer.step().expect("a step");
            if step == GLOBAL_STEPS {
                global = Some(trainer.state());
            }
        }
        Self { trainer, config, global: global.expect("the end of the first stage"), cameras }
    }

    fn method(&self, over: &str) -> Model {
        let mut config = self.config.clone();
        overlay(&mut config, over.parse().expect("TOML"));
        saved::load(gs_methods::registry(), &self.trainer.state(), Some(&config)).expect("a state").model
    }

    fn psnr(&self, method: &Model) -> f64 {
        let data: &Dataset = self.trainer.dataset();
        let report = evaluate(method, data, Split::Test, [1.0; 3], &ImageCache::new(64 << 20, 1.0)).expect("scores");
        report.mean.psnr.expect("finite scores")
    }
}

/// The parts of a trained scene.
struct Parts {
    anchors: Anchors,
    gad: Gad,
    lgd: HexPlaneField,
    decoder: Decoder,
}

impl Parts {
    fn of(run: &Run) -> Self {
        let config: Config = run.config.clone().try_into().expect("a configuration");
        let mut values = BTreeMap::new();
        run.trainer.model().visit(&mut |p| {
            values.insert(p.name.clone(), p.value.clone());
        });
        let shape = AnchorShape { offsets: config.anchors.offsets, features: config.anchors.features, dynamics: 2 };
        let positions: Vec<_> = values["anchors.positions"].as_chunks().0.iter().map(|p| (*p).into()).collect();
        let [min, max] = run.trainer.scene().bounds;
        let margin = config.margin * min.distance(max);
        let aabb = Aabb::new(min - margin, max + margin).expect("a box");
        let mut parts = Self {
            anchors: Anchors::new(shape, &positions, &vec![0.0; positions.len()]),
            gad: Gad::new(&config.gad, shape, aabb, 0).expect("a field"),
            lgd: HexPlaneField::new("lgd", &config.lgd.field, aabb, 0).expect("a field"),
            decoder: Decoder::new(&config.decoder, shape, 0).expect("a decoder"),
        };
        let mut fill = |p: &mut Param| p.value.clone_from(&values[&p.name]);
        parts.anchors.visit_mut(&mut fill);
        parts.gad.visit_mut(&mut fill);
        parts.lgd.visit_mut(&mut fill);
        parts.decoder.visit_mut(&mut fill);
        parts
    }

    fn local(&self) -> LocalAnchors {
        let mut local = LocalAnchors::default();
        self.gad.forward(&self.anchors, T, &mut GadTape::default(), &mut local);
        local
    }
}

/// Savings that leave the picture as it is.
fn exact_savings(run: &Run, parts: &Parts) {
    let (camera, at) = (run.cameras[7].clone(), Timestamp::new(T));
    let (method, splats) = (run.method(""), run.trainer.model().splat_count());
    let (_, folded) = method.fold(&run.config).expect("an appearance");
    let error = apart(&method, &folded, &run.cameras);
    saving(
        "appearance folded, frame",
        splats,
        error,
        || drop(method.splats(&at, &camera)),
        || drop(folded.splats(&at, &camera)),
    );
    let (local, folded) = (parts.local(), parts.decoder.folded());
    let decode = |decoder: &Decoder, tape: &mut DecodeTape, out: &mut Splats| {
        decoder.forward(&local, Visible::All, camera.position(), tape, out);
    };
    let (mut a, mut b) = <[(DecodeTape, Splats); 2]>::default().into();
    saving(
        "appearance folded, decode",
        splats,
        error,
        || decode(&parts.decoder, &mut a.0, &mut a.1),
        || decode(&folded, &mut b.0, &mut b.1),
    );

    let (mut cold, step) = (run.method(""), run.trainer.steps_done());
    let error = apart(&method, &cold, &run.cameras);
    let without = || {
        cold.begin_step(step);
        drop(cold.splats(&at, &camera));
    };
    saving("GAD once per interval", parts.anchors.len(), error, without, || drop(method.splats(&at, &camera)));

    let rest: Vec<_> = (0..parts.anchors.len()).map(|v| parts.anchors.position(v)).collect();
    let (net, places) = (parts.gad.net(), parts.gad.net().place(&rest));
    let mut tapes = <[gs_deform::PlaneNetTape; 2]>::default();
    net.forward(&rest, T, &mut tapes[0]);
    net.forward_located(&places, T, &mut tapes[1]);
    let said =
        |h: usize| (tapes[0].blocks().iter().zip(tapes[1].blocks())).map(move |(a, b)| worst(a.head(h), b.head(h)));
    let error = (0..4).flat_map(said).fold(0.0, f64::max);
    let [a, b] = &mut tapes;
    saving(
        "cells of resting anchors, GAD",
        rest.len(),
        error,
        || net.forward(&rest, T, a),
        || net.forward_located(&places, T, b),
    );

    let whole = run.method("[anchors]\nfilter = \"off\"");
    let near = Camera { fx: 4.0 * camera.fx, fy: 4.0 * camera.fy, ..camera.clone() };
    for (name, camera) in [("filter, whole scene in view", &camera), ("filter, close-up", &near)] {
        let error = apart(&method, &whole, std::slice::from_ref(camera));
        let count = |model: &Model| model.splats(&at, camera).expect("splats").len();
        let splats = count(&method);
        println!("  {name}: {splats} splats of {}", count(&whole));
        saving(name, splats, error, || drop(whole.splats(&at, camera)), || drop(method.splats(&at, camera)));
    }

    // The end of the first stage: what the second adds says nothing yet.
    let load = || saved::load(gs_methods::registry(), &run.global, None).expect("a state").model;
    let (still, mut moving) = (load(), load());
    moving.begin_step(GLOBAL_STEPS + 1);
    let error = apart(&still, &moving, &run.cameras);
    saving(
        "no GAD, no LGD where all is still",
        splats,
        error,
        || drop(moving.splats(&at, &camera)),
        || drop(still.splats(&at, &camera)),
    );
}

/// Savings with an error.
fn bounded_savings(run: &Run) {
    let (camera, at, method) = (&run.cameras[7], Timestamp::new(T), run.method(""));
    let psnr = run.psnr(&method);
    for (pixels, shape) in [(0.05, 1e-3), (0.25, 1e-2), (1.0, 5e-2)] {
        let usual = FreezeOptions::usual(&run.cameras);
        let options = FreezeOptions { shape, pixels, ..usual };
        let (resting, report) = method.freeze_static(&options).expect("a field");
        let error = apart(&method, &resting, &run.cameras);
        let name = format!("at rest, {pixels} px, {shape}");
        saving(&name, report.splats, error, || drop(method.splats(&at, camera)), || drop(resting.splats(&at, camera)));
        let share = 100.0 * report.still as f64 / report.splats as f64;
        let (change, apart) = (run.psnr(&resting) - psnr, apart_psnr(&method, &resting, &run.cameras));
        println!("    {share:.1} % of the rows baked, PSNR {change:+.4} dB of {psnr:.2}, pictures {apart:.1} dB apart");
        println!("    {report:?}");
    }
}

/// Half of the anchors are told by hand that they neither move nor change: runs this short never get there.
fn idle_anchors(run: &Run, parts: &mut Parts) {
    let hush = |p: &mut Param| {
        if p.name == "anchors.dynamics" {
            p.value.chunks_exact_mut(2).step_by(2).for_each(|d| d.fill(-10.0));
        }
    };
    let mut method = run.method("");
    method.visit_mut(&mut |p| hush(p));
    method.begin_step(run.trainer.steps_done());
    parts.anchors.visit_mut(&mut |p| hush(p));
    let usual = FreezeOptions::usual(&run.cameras);
    let options = FreezeOptions { pixels: -1.0, probes: 2, ..usual };
    let (resting, report) = method.freeze_static(&options).expect("a field");
    let error = apart(&method, &resting, &run.cameras);
    let (mut a, mut b) = <(LocalAnchors, LocalAnchors)>::default();
    let (without, with) = (
        || parts.gad.forward(&parts.anchors, T, &mut GadTape::default(), &mut a),
        || parts.gad.forward_active(&parts.anchors, T, 1e-4, &mut b),
    );
    saving(&format!("GAD without {} idle anchors", report.anchors), parts.anchors.len(), error, without, with);
    println!("    pictures {:.1} dB apart", apart_psnr(&method, &resting, &run.cameras));
}

/// Milliseconds of each stage of a frame.
fn stages(run: &Run, parts: &mut Parts) {
    let camera = &run.cameras[7];
    let (mut local, mut listed, mut neural, mut moved) = <(LocalAnchors, Vec<u32>, Splats, Geometry)>::default();
    let (mut gad, mut decoded, mut lgd) = (GadTape::default(), DecodeTape::default(), Default::default());
    let mut all = Vec::new();
    let mut time = |name: &'static str, n: usize, forward: &mut dyn FnMut()| {
        let ms = 1e3 * median_seconds(RUNS, forward);
        record(&format!("stage {name}"), "forward", n, ms, None);
        all.push((name, ms));
    };
    let anchors = parts.anchors.len();
    time("GAD", anchors, &mut || parts.gad.forward(&parts.anchors, T, &mut gad, &mut local));
    time("filter", anchors, &mut || visible::conservative(&local, camera, &VisibilityOptions::default(), &mut listed));
    let eye = camera.position();
    time("decode", anchors, &mut || {
        parts.decoder.forward(&local, Visible::List(&listed), eye, &mut decoded, &mut neural)
    });
    time("LGD", neural.len(), &mut || parts.lgd.forward(neural.geometry(), T, &mut lgd, &mut moved));
    let fresh = |tape: &mut _| {
        parts.lgd.forward(neural.geometry(), T, tape, &mut Geometry::default());
    };
    time("LGD, new scratch", neural.len(), &mut || fresh(&mut Default::default()));
    let (options, mut workspace) = (options(), Workspace::new());
    let moved = neural.with_geometry(moved.view());
    time("raster", moved.len(), &mut || drop(render(moved, camera, &options, &mut workspace)));

    let d = FrameGrad { rgb: vec![1e-3; (3 * camera.width * camera.height) as usize], ..FrameGrad::default() };
    let (mut d_decoded, mut d_local) = <(Geometry, LocalAnchorsGrad)>::default();
    let (mut d_neural, _) = render_backward(moved, camera, &options, &mut workspace, &d);
    time("raster back", moved.len(), &mut || drop(render_backward(moved, camera, &options, &mut workspace, &d)));
    time("LGD back", neural.len(), &mut || {
        d_decoded.reset(neural.len());
        parts.lgd.backward(neural.geometry(), &mut lgd, d_neural.geometry(), &mut d_decoded);
    });
    d_neural.swap_geometry(&mut d_decoded);
    time("decode back", anchors, &mut || {
        d_local.reset(&local);
        parts.decoder.backward(&local, &mut decoded, &d_neural, &mut d_local);
    });
    time("GAD back", anchors, &mut || {
        parts.gad.backward(&mut parts.anchors, &mut gad, &d_local, 1.0);
    });
    let line: Vec<String> = all.iter().map(|(name, ms)| format!("{name} {ms:.2}")).collect();
    println!("  stages, {anchors} anchors, {} splats, ms: {}", neural.len(), line.join("  "));
}

fn main() {
    let run = Run::new();
    let mut parts = Parts::of(&run);
    exact_savings(&run, &parts);
    bounded_savings(&run);
    stages(&run, &mut parts);
    idle_anchors(&run, &mut parts);
}
