//! GeoNet finds how a surface moves that the template does not know of.

use super::*;
use gs_synth::avatar::{self, AvatarOptions};

/// What GeoNet learns one morph of the person from, and for how long.
struct Lesson {
    /// Timestamps that are filmed, all of them used for training.
    frames: u32,
    /// Side of the images, pixels.
    size: u32,
    /// Measured points of each frame.
    points: u32,
    /// Sides of textures and maps, TOML; empty: those of `tiny`.
    textures: &'static str,
    steps: u32,
    /// Learning rate of the first step and of the last one.
    rates: [f32; 2],
    /// Parts of the steps, from each of which to the next the mean loss must fall.
    parts: u32,
}

/// Minutes: what `docs/dut.md` has figures of.
const LONG: Lesson =
    Lesson { frames: 8, size: 256, points: 5000, textures: "", steps: 1400, rates: [3e-4, 1e-5], parts: 6 };

/// Seconds: fewer and smaller images, a quarter of the texels, and a higher rate for fewer steps.
const QUICK: Lesson = Lesson {
    frames: 3,
    size: 96,
    points: 1500,
    textures: "textures = { unproject = 64, geo = 32, gau = 32 }",
    steps: 150,
    rates: [6e-4, 6e-5],
    parts: 3,
};

/// Trains GeoNet on frames that one morph moves: the RMS error of its offsets must be within this share of the RMS length of the true
/// ones, over all vertices and frames. 1 is the template without offsets.
fn learns(lesson: &Lesson, morph: &str, within: f64) {
    let Lesson { frames, size, points, textures, steps, rates: [start_rate, end_rate], parts } = *lesson;
    let only_morphs = vec![morph.into()];
    let options = AvatarOptions { only_morphs, frames, size, rings: 1, points, ..AvatarOptions::default() };
    let data = Arc::new(avatar::generate(&options).expect("film"));
    let over = format!(
        "
geonet.offset_unit = 0.1
surface = {{ points = \"faces\", color = 0.05, texture = 0.0, normal_target = \"rest\", laplacian = 1.0 }}
{textures}
[schedule]
batch = 2
lr_batch = 2
stages.geometry.steps = {steps}
stages.main.steps = 1
lr.geo.all = {{ start = {start_rate:e}, end = {end_rate:e}, steps = {steps} }}
"
    );
    let config = config(&[&over]);
    let mut trainer = start(&data, &config);
    let mut loss = || trainer.step().expect("step").penalties.iter().map(|p| f64::from(p.1)).sum::<f64>();
    let losses: Vec<f64> = (0..steps).map(|_| loss()).collect();
    let means: Vec<f64> =
        losses.chunks_exact((steps / parts) as usize).map(|c| c.iter().sum::<f64>() / c.len() as f64).collect();
    let mut method = bare(&data, &config, steps + 1);
    let mut values = Vec::new();
    trainer.model().visit(&mut |p| values.push(p.value.clone()));
    let mut values = values.into_iter();
    method.visit_mut(&mut |p| p.value = values.next().expect("block"));
    let mut textures = mean(&**trainer.model()).into_iter();
    method.buffers_mut(&mut |b| *b.values = textures.next().expect("buffer"));
    method.begin_step(&trainer.schedule().at(steps + 1));
    let [all, along] = method.offset_errors().expect("frames").ratio;
    println!("{morph}: RMS error / RMS length {all:.3}, along normals {along:.3}; losses {means:?}");
    assert!(means.windows(2).all(|w| w[1] < w[0]), "{means:?}");
    assert!(all < within, "{all:.3}");
}

#[test]
fn geonet_learns_a_morph() {
    learns(&QUICK, "swing", 0.45);
}

#[test]
fn geonet_learns_a_small_morph() {
    learns(&QUICK, "breathe", 0.7);
}

#[test]
#[ignore = "minutes long: cargo test -p gs-method-texel --test dut -- --ignored geonet_finds"]
fn geonet_finds_a_morph() {
    learns(&LONG, "swing", 0.06);
}

#[test]
#[ignore = "minutes long: cargo test -p gs-method-texel --test dut -- --ignored geonet_finds"]
fn geonet_finds_a_small_morph() {
    learns(&LONG, "breathe", 0.25);
}

#[test]
fn the_report_says_how_far_offsets_are_off_where_the_truth_is_known() {
    let data = film("person", 32, 3);
    let section = |over: &[&str]| {
        let method = bare(&data, &config(over), 15);
        let inspect = method.capabilities().inspect.expect("inspect");
        (inspect.report_section(&[]).expect("section"), method.offset_errors())
    };
    let (found, errors) = section(&[SHORT]);
    let (found, errors) = (found.expect("a film made here"), errors.expect("errors"));
    // Before any step the network gives no offsets.
    assert!(found.rows[0].value.starts_with("100.0 % of ") && errors.ratio == [1.0; 2], "{:?}", found.rows);
    assert_eq!(found.json["offsets"]["length_m"][0].as_f64(), Some(errors.length[0]));
    assert!(section(&[SHORT, "input = \"single\"\nschedule.stages.geometry.steps = 0"]).0.is_none());
}
