//! Gradients of GeoNet's losses and of the warm-up against differences.

use super::*;
use gs_train::registry::overlay;

#[test]
fn geometry_and_warm_up_have_the_gradients_of_their_losses() {
    let data = film("cylinder", 32, 2);
    let at = Timestamp::new(data.train[0].time);
    let camera = data.train[0].camera.clone();
    // What cameras see of texels jumps; its gradient is tested where it stands.
    let vertices = config(&[SHORT, "gaunet.clip = 0.0\nsurface.texture = 0.0"]);
    let mut faces = vertices.clone();
    let colored = "geonet.offset_unit = 0.1\nsurface = { points = \"faces\", color = 0.05 }";
    overlay(&mut faces, colored.parse().expect("TOML"));
    for (step, config) in [(1, &vertices), (6, &vertices), (1, &faces)] {
        let mut method = bare(&data, config, step);
        // The last layers begin at zero: moved, or nothing before them has a gradient.
        method.visit_mut(&mut |p| {
            let mut rng = Rng::new(5, &p.name, 0, 0);
            p.value.iter_mut().for_each(|v| *v += 0.02 * rng.normal());
        });
        let ctx = own_settings(config.clone()).try_into::<Config>().expect("settings").schedule.trainer.at(step);
        method.begin_step(&ctx);
        unrendered(&mut method, at, &camera);
        let mut blocks = Vec::new();
        method.visit(&mut |p| blocks.push((p.name.clone(), p.grad.clone())));
        let whole: f64 = blocks.iter().flat_map(|b| &b.1).map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
        assert!(whole > 0.0);
        // Along the whole gradient.
        let mut moved = |h: f64| {
            let mut grads = blocks.iter();
            method.visit_mut(&mut |p| {
                let grad = &grads.next().expect("block").1;
                p.value.iter_mut().zip(grad).for_each(|(v, g)| *v += (h / whole * f64::from(*g)) as f32);
                p.clear_grad();
            });
            method.begin_step(&ctx);
            unrendered(&mut method, at, &camera)
        };
        let found: Vec<f64> = [3e-4, 1e-3, 3e-3]
            .map(|h| {
                let (hi, lo) = (moved(h), moved(-2.0 * h));
                moved(h);
                (hi - lo) / (2.0 * h)
            })
            .into();
        assert!(found.iter().any(|f| (f / whole - 1.0).abs() < 0.02), "step {step}: {found:?}, {whole} expected");
    }
}
