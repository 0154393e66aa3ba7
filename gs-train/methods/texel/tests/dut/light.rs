//! Frames under another light: scaled at random while training, or followed.

use super::*;
use gs_method_texel::Second;

/// Colours of the Gaussians of a second unprojection, of degree 0.
fn colors(method: &Dut, second: &Second) -> Vec<f32> {
    let mut rows = Vec::new();
    method.rows(second, &mut rows).expect("rows");
    let splats = method.decode(&rows, second).expect("splats");
    let gs_core::Color::Sh { coeffs, .. } = splats.color else { panic!("texel Gaussians are spherical harmonics") };
    coeffs
}

#[test]
fn a_step_under_another_light_learns_something_else() {
    let data = film("cylinder", 32, 2);
    let [plain, jittered] = ["jitter = 0.0", "jitter = 0.3"].map(|jitter| {
        let mut trainer = start(&data, &config(&[SHORT, jitter]));
        run(&mut trainer, 15);
        trainer.state().tensors
    });
    // GeoNet learns before that.
    let same = |name: &str| plain.iter().zip(&jittered).filter(|(a, _)| a.0.starts_with(name)).all(|(a, b)| a.1 == b.1);
    assert!(same("geo.") && same("mean.") && !same("gau.") && !same("texels."));
    let method = bare(&data, &config(&[SHORT]), 15);
    let second = method.second(&method.actor().scene.frames[0]).expect("frame");
    assert!(method.actor().relit(&second, [1.0; 3], true) == *second);
    let bright = method.actor().relit(&second, [0.5, 1.0, 9.0], true).seen.colors;
    for ((c, d), seen) in second.seen.colors.iter().zip(&bright).zip(&second.seen.views) {
        let want = if *seen > 0.0 { [0.5 * c[0], c[1], (9.0 * c[2]).min(1.0)] } else { *c };
        assert_eq!(*d, want);
    }
}

#[test]
fn a_method_that_shows_its_texture_has_nothing_to_learn_from_a_jittered_image() {
    let data = film("cylinder", 32, 2);
    // An untrained network adds nothing to the reference Gaussians, which have the colours of the texture.
    let residual = config(&[SHORT, RESIDUAL]);
    let learnt = config(&[SHORT, DIRECT, "direct.color = \"learnt\""]);
    for (config, follows) in [(residual, true), (config(&[SHORT, DIRECT]), true), (learnt, false)] {
        let mut method = bare(&data, &config, 15);
        // Values of the texels' own are no part of the texture.
        method.visit_mut(&mut |p| {
            let mut rng = Rng::new(5, &p.name, 0, 0);
            let own = p.name.starts_with("texels.");
            p.value.iter_mut().filter(|_| own).for_each(|v| *v += 0.1 * rng.normal());
        });
        let actor = method.actor();
        let second = method.second(&actor.scene.frames[0]).expect("frame");
        let plain = colors(&method, &second);
        // No channel of the film is above 1 / 1.2.
        let gain = [0.7, 1.0, 1.2];
        let [with, without] = [true, false].map(|image| colors(&method, &actor.relit(&second, gain, image)));
        let off = |other: &[f32], i: usize| {
            let channel = plain.iter().zip(other).skip(i).step_by(3);
            channel.fold(0.0f32, |worst, (a, b)| worst.max((a - b).abs()))
        };
        for (i, gain) in gain.into_iter().enumerate() {
            assert!(off(&with, i) < 1e-5, "{i}: {}", off(&with, i));
            assert_eq!(off(&without, i) > 0.1, follows && gain != 1.0, "{i}: {}", off(&without, i));
        }
    }
}

/// Sums the colours of what it is given to draw, and says that each counts once.
#[derive(Default)]
struct Summed {
    sum: f64,
    stats: ScreenStats,
}

impl RenderView for Summed {
    fn render(&mut self, splats: SplatsRef<'_>, grad: &mut SplatsGrad) -> Result<&ScreenStats, MethodError> {
        grad.reset(splats);
        grad.color.fill(1.0);
        let gs_core::Color::Sh { coeffs, .. } = splats.color else { panic!("texel Gaussians are spherical harmonics") };
        self.sum = coeffs.iter().map(|c| f64::from(*c)).sum();
        Ok(&self.stats)
    }
}

#[test]
fn values_of_the_texels_own_have_the_gradients_of_a_step_under_another_light() {
    let data = film("cylinder", 32, 2);
    let (at, camera) = (Timestamp::new(data.train[0].time), data.train[0].camera.clone());
    for over in [RESIDUAL, DIRECT] {
        let settings = config(&[SHORT, over, "jitter = 0.5\ngaussians = { sh_degree = 1, decode.sh_active = 1 }"]);
        let schedule = own_settings(settings.clone()).try_into::<Config>().expect("settings").schedule.trainer;
        let mut method = bare(&data, &settings, 8);
        let mut names = Vec::new();
        method.visit(&mut |p| names.push(p.name.clone()));
        names.retain(|n| ["texels.sh_dc", "texels.sh_rest", "texels.gain"].contains(&n.as_str()));
        assert!(names.len() >= 2, "{names:?}");
        for name in names {
            // The sum of the colours after all values of a block have moved by as much, and their gradients.
            let mut moved = |by: f32| {
                let mut slope = 0.0;
                method.visit_mut(&mut |p| {
                    p.clear_grad();
                    p.value.iter_mut().filter(|_| p.name == name).for_each(|v| *v += by);
                });
                method.begin_step(&schedule.at(8));
                let mut drawn = Summed::default();
                method.step(&ViewCtx { at, camera: &camera, draw: 0, last: true }, &mut drawn).expect("step");
                method.visit(&mut |p| {
                    slope += p.grad.iter().filter(|_| p.name == name).map(|g| f64::from(*g)).sum::<f64>();
                });
                (drawn.sum, slope)
            };
            let (before, slope) = moved(0.0);
            let (after, _) = moved(0.25);
            let found = (after - before) / 0.25;
            // As linear as the colours themselves.
            assert!((found / slope - 1.0).abs() < 1e-3, "{over} {name}: {found} {slope}");
        }
    }
}

#[test]
fn a_light_that_is_followed_changes_colours_alone() {
    let data = film("cylinder", 32, 2);
    let method = bare(&data, &config(&[SHORT, "follow_light = true"]), 15);
    let actor = method.actor();
    let frame = &actor.scene.frames[0];
    let images = actor.images(frame).expect("images");
    let gain = [0.5, 0.8, 1.0];
    let lit: Vec<_> = images
        .iter()
        .map(|(camera, image)| {
            let mut image = image.clone();
            image.data.chunks_exact_mut(4).for_each(|p| p[..3].iter_mut().zip(gain).for_each(|(c, g)| *c *= g));
            (camera.clone(), image)
        })
        .collect();
    let of = |images: &[_]| actor.first_of(actor.pose(&frame.pose), images).expect("first");
    let [own, other] = [of(&images), of(&lit)];
    for (gain, (own, other)) in gain.into_iter().zip(own.light.into_iter().zip(other.light)) {
        assert!((own - 1.0).abs() < 0.05, "the light of the recording: {own}");
        assert!((other / own - gain).abs() < 1e-4, "{other}");
    }
    let input = own.input.iter().zip(&other.input).fold(0.0f32, |worst, (a, b)| worst.max((a - b).abs()));
    assert!(input < 1e-4, "GeoNet sees the same: {input}");
    let second = |first, images: &[_]| {
        let offsets = Some(vec![glam::Vec3::ZERO; actor.scene.character.template.vertices.len()]);
        actor.second_of(first, offsets, images).expect("second")
    };
    let [own, other] = [colors(&method, &second(&own, &images)), colors(&method, &second(&other, &lit))];
    let c0 = gs_core::sh::C0 as f32;
    for (k, (a, b)) in own.iter().zip(&other).enumerate() {
        let [a, b] = [a, b].map(|s| 0.5 + c0 * s);
        assert!((gain[k % 3] * a - b).abs() < 1e-4, "Gaussians are lit: {k} {a} {b}");
    }
}
