//! GeoNet finds how a surface moves that the template does not know of.

use super::{bare, config, mean, start};
use gs_core::Params;
use gs_synth::avatar::{self, AvatarOptions};
use gs_train::method::{Buffers, Method};
use std::sync::Arc;

/// Trains GeoNet on eight frames that one morph moves: its offsets must be within this share of the true ones, over all vertices
/// and frames, and the mean loss must fall from each sixth of the steps to the next.
fn geonet_finds(morph: &str, within: f64) {
    let steps = 1400;
    let options = AvatarOptions {
        only_morphs: vec![morph.into()],
        frames: 8,
        rings: 1,
        points: 5000,
        ..AvatarOptions::default()
    };
    let data = Arc::new(avatar::generate(&options).expect("film"));
    let over = format!(
        "
geonet.offset_unit = 0.1
surface = {{ points = \"faces\", color = 0.05, texture = 0.0, normal_target = \"rest\", laplacian = 1.0 }}
[schedule]
batch = 2
lr_batch = 2
stages.geometry.steps = {steps}
stages.main.steps = 1
lr.geo.all = {{ start = 3e-4, end = 1e-5, steps = {steps} }}
"
    );
    let config = config(&[&over]);
    let mut trainer = start(&data, &config);
    let mut loss = || trainer.step().expect("step").penalties.iter().map(|p| f64::from(p.1)).sum::<f64>();
    let losses: Vec<f64> = (0..steps).map(|_| loss()).collect();
    let means: Vec<f64> =
        losses.chunks_exact(steps as usize / 6).map(|c| c.iter().sum::<f64>() / c.len() as f64).collect();
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
#[ignore = "minutes long: cargo test -p gs-method-texel --test dut -- --ignored geonet_finds"]
fn geonet_finds_a_morph() {
    geonet_finds("swing", 0.06);
}

#[test]
#[ignore = "minutes long: cargo test -p gs-method-texel --test dut -- --ignored geonet_finds"]
fn geonet_finds_a_small_morph() {
    geonet_finds("breathe", 0.25);
}
