//! Gradients of DUT's rendering stages, as in `methods`.

use crate::methods::{check_blocks, smooth};
use crate::support::*;
use gs_core::Rng;
use gs_raster::{Workspace, render};
use gs_train::method::ViewCtx;
use gs_train::saved;
use gs_train::timestamp::Timestamp;
use gs_train::trainer::{TrainOptions, Trainer};

const DIRECT: &str = "
mode = \"direct\"
[schedule]
stages.warm_up.steps = 0
";

#[test]
fn gradients_match_directional_finite_differences() {
    let data = film("cylinder", 32, 2);
    let texture = [
        FILM_SHORT,
        DIRECT,
        "[gaussians]\nsh_degree = 1\ndecode.sh_active = 1",
        "input = \"single\"",
        "schedule.stages.geometry.steps = 0",
    ];
    for over in [&[FILM_SHORT][..], &[FILM_SHORT, "gaunet.residual = true"], &[FILM_SHORT, DIRECT], &texture] {
        let options = TrainOptions { seed: 3, ..TrainOptions::default() };
        let mut trainer =
            Trainer::new(gs_methods::registry(), data.clone(), "dut", &film_config(over), options).expect("trainer");
        while trainer.steps_done() < trainer.steps() {
            trainer.step().expect("step");
        }
        let mut method =
            saved::load_with(gs_methods::registry(), &trainer.state(), None, data.avatar.clone()).expect("state").model;
        let (at, camera) = (Timestamp::new(data.train[0].time), data.train[0].camera.clone());
        let options = smooth(&method);
        let weight =
            |i: usize| Rng::new(1, "weights", (i % 3) as u32, (i / 3 / 256 * 4 + i / 3 % 32 / 8) as u64).normal();
        let weights: Vec<f32> = (0..32 * 32 * 3).map(weight).collect();
        let mut view = GivenCotangent::new(&camera, &options, &weights);
        method.step(&ViewCtx { at, camera: &camera, last: false }, &mut view).expect("step");
        // The penalty of offsets is part of the gradient, but below its tolerance.
        check_blocks("dut", trainer.steps_done(), &mut method, &mut |m| {
            let frame = render(&m.splats(&at, &camera).expect("splats"), &camera, &options, &mut Workspace::new());
            frame.rgb.iter().zip(&weights).map(|(v, w)| f64::from(*v) * f64::from(*w)).sum()
        });
    }
}
