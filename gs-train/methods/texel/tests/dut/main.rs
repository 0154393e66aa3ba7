//! DUT on small films of simple bodies.
//!
//! | property | tolerance |
//! |---|---|
//! | slope of geometric losses along the gradient | 2 % |
//! | in-mask PSNR of values of the texels' own, seen frames | 32 dB |
//! | in-mask PSNR of GauNet over-fitting four views of a frame; after its warm-up alone | 30 dB; 20 dB |
//! | GeoNet's offsets of a known morph, RMS error over RMS length | 10 % |

mod draws;
mod morphs;
mod needs_avatar;

use gs_core::{Camera, Params, Rng, SplatsGrad, SplatsRef};
use gs_data::{Dataset, ImageCache, ImageSource, Split};
use gs_method_texel::{Config, Dut, METHODS};
use gs_raster::ScreenStats;
use gs_synth::SynthOptions;
use gs_synth::avatar::{self, AvatarOptions, Morphs};
use gs_synth::testkit::{dataset, film};
use gs_train::evaluate::evaluate;
use gs_train::method::{Buffers, Method, MethodError, RenderView, ViewCtx};
use gs_train::model::Model;
use gs_train::registry::{Registry, overlay, own_settings};
use gs_train::saved;
use gs_train::scene::{InitConfig, SceneInfo};
use gs_train::testkit::{self, SHORT_FILM as SHORT, run, timeless};
use gs_train::timestamp::Timestamp;
use gs_train::trainer::{TrainError, TrainOptions, Trainer};
use std::sync::Arc;

/// The methods of this crate.
fn registry() -> Registry {
    Registry::new(METHODS.to_vec())
}

fn config(over: &[&str]) -> toml::Table {
    testkit::config(&registry(), "dut", "tiny", over)
}

fn start(data: &Arc<Dataset>, config: &toml::Table) -> Trainer {
    testkit::start(&registry(), data, "dut", config, 3)
}

/// Mean in-mask PSNR of a split, dB.
fn in_mask(trainer: &Trainer, data: &Dataset, split: Split) -> f64 {
    let report = evaluate(trainer.model(), data, split, [0.0; 3], &ImageCache::new(64 << 20, 1.0)).expect("scores");
    report.mean.masked.and_then(|m| m.psnr).expect("masks")
}

const DIRECT: &str = "
mode = \"direct\"
[schedule]
stages.warm_up.steps = 0
";

/// GauNet's values are added to the reference Gaussians, at which it begins.
const RESIDUAL: &str = "
gaunet.residual = true
schedule.stages.warm_up.steps = 0
";

#[test]
fn presets_build_and_every_parameter_learns() {
    let data = film("cylinder", 32, 2);
    for (preset, _) in registry().find("dut").unwrap().presets {
        let config =
            testkit::config(&registry(), "dut", preset, &["textures = { unproject = 64, geo = 32, gau = 64 }"]);
        let trainer = start(&data, &config);
        let method = trainer.model();
        method.visit(&mut |p| assert!(method.schedule().rule(&p.name).is_some(), "{preset} {}", p.name));
        let at = Timestamp::new(data.train[0].time);
        let splats = method.splats(&at, &data.train[0].camera).expect("splats");
        assert_eq!((splats.check(), splats.len()), (Ok(()), method.splat_count()), "{preset}");
        assert_eq!(
            method.quantities(&at).expect("quantities").iter().map(|q| q.values.len()).collect::<Vec<_>>(),
            [method.splat_count(); 4]
        );
    }
}

/// A bare method of a film at a step.
fn bare(data: &Dataset, config: &toml::Table, step: u32) -> Dut {
    let init: InitConfig = config["init"].clone().try_into().expect("init");
    let scene = SceneInfo::of(data, &init, 3).expect("scene");
    let config: Config = own_settings(config.clone()).try_into().expect("settings");
    let at = config.schedule.trainer.at(step);
    let mut dut = Dut::new(config, &scene).expect("method");
    dut.begin_step(&at);
    dut
}

/// A step that must not come to rendering.
struct Unrendered;

impl RenderView for Unrendered {
    fn render(&mut self, _: SplatsRef<'_>, _: &mut SplatsGrad) -> Result<&ScreenStats, MethodError> {
        panic!("nothing is rendered")
    }
}

/// Loss of a step without rendering, gradients left in the blocks.
fn unrendered(m: &mut Dut, at: Timestamp, camera: &Camera) -> f64 {
    let terms = m.step(&ViewCtx { at, camera, draw: 0, last: true }, &mut Unrendered).expect("step");
    terms.iter().map(|p| f64::from(p.1)).sum()
}

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

#[test]
fn interruptions_and_threads_do_not_change_a_bit() {
    let data = film("cylinder", 32, 3);
    for over in [&[SHORT][..], &[SHORT, DIRECT], &[SHORT, "jitter = 0.3\nsurface.refresh = 2"]] {
        let config = config(over);
        let steps = start(&data, &config).steps();
        let mut whole = start(&data, &config);
        let mut states = vec![whole.state()];
        for _ in 0..steps {
            whole.step().expect("step");
            states.push(whole.state());
        }
        let last = timeless(whole.state());
        for from in [0, 3, 5, 7, steps - 1] {
            let mut resumed =
                Trainer::resume(&registry(), data.clone(), &states[from as usize], None, 1 << 20).expect("resume");
            run(&mut resumed, steps - from);
            assert!(timeless(resumed.state()) == last, "resumed at {from}");
        }
        for threads in [1, 4] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
            let state = pool.install(|| {
                let mut trainer = start(&data, &config);
                run(&mut trainer, steps);
                timeless(trainer.state())
            });
            assert!(state == last, "{threads} threads");
        }
    }
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

/// Colours of the Gaussians of a second unprojection, of degree 0.
fn colors(method: &Dut, second: &gs_method_texel::Second) -> Vec<f32> {
    let mut rows = Vec::new();
    method.rows(second, &mut rows).expect("rows");
    let splats = method.decode(&rows, second).expect("splats");
    let gs_core::Color::Sh { coeffs, .. } = splats.color else { panic!("texel Gaussians are spherical harmonics") };
    coeffs
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

#[test]
fn a_frame_of_its_own_images_is_that_of_the_film() {
    let data = film("person", 32, 3);
    for over in [
        &[SHORT][..],
        &[SHORT, "follow_light = true"],
        &[SHORT, "input = \"first\""],
        &[SHORT, "input = \"single\"", "schedule.stages.geometry.steps = 0"],
    ] {
        let method = bare(&data, &config(over), 15);
        let actor = method.actor();
        for frame in &actor.scene.frames {
            let images = actor.images(frame).expect("images");
            let made = method.splats_of(&frame.pose, &images).expect("splats");
            let camera = &frame.inputs[0].camera;
            assert_eq!(made, method.splats(&Timestamp { t: frame.time }, camera).expect("splats"));
        }
        let frames = &actor.scene.frames;
        let images = actor.images(&frames[0]).expect("images");
        let other = method.splats_of(&frames[2].pose, &images).expect("splats");
        assert_ne!(other, method.splats_of(&frames[0].pose, &images).expect("splats"), "the pose counts");
    }
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

#[test]
fn a_small_cache_changes_nothing() {
    let data = film("cylinder", 32, 3);
    let states = ["cache_mib = 0", "cache_mib = 64"].map(|cache| {
        let mut trainer = start(&data, &config(&[SHORT, cache]));
        run(&mut trainer, 15);
        trainer.state().tensors
    });
    assert!(states[0] == states[1]);
}

#[test]
fn data_without_a_person_are_refused() {
    let data = dataset("balls", &SynthOptions::of_views(32, 4, 0));
    let error = Trainer::new(&registry(), data, "dut", &config(&[]), TrainOptions::default())
        .err()
        .expect("refused")
        .to_string();
    assert!(error.contains("method `dut` needs a filmed person"), "{error}");
    let state = start(&film("cylinder", 32, 2), &config(&[SHORT])).state();
    let error = saved::load(&registry(), &state, None).err().expect("refused");
    assert!(error.contains("needs a filmed person"), "{error}");
}

#[test]
fn settings_that_do_not_fit_are_refused() {
    let data = film("cylinder", 32, 2);
    let refuse = |over: &[&str]| {
        let trainer = Trainer::new(&registry(), data.clone(), "dut", &config(over), TrainOptions::default());
        trainer.err().unwrap_or_else(|| panic!("{over:?} was taken")).to_string()
    };
    for (over, why) in [
        (&["input = \"single\""][..], "has no GeoNet"),
        (&["mode = \"direct\"", "schedule.stages.warm_up.steps = 3"], "has no GauNet"),
        (&["schedule.stages.warm_up.steps = 3"], "begins where a warm-up ends"),
        (&["schedule.stages.main.own_clock = false"], "own_clock"),
        (&["schedule.stages.main.order = 0", "schedule.stages.geometry.order = 3"], "the order must be"),
        (&["textures.geo = 60"], "multiple of 8"),
        (&["gaussians.sh_degree = 4"], "`gaussians.sh_degree` = 4"),
        (&["surface.isometry = -1.0"], "`surface.isometry` = -1"),
        (&["surface.color = 0.05"], "surface.points = \"faces\""),
        (&["unproject.min_cos = 2.0"], "min_cos"),
        (&["reference.opacity = 1.0"], "reference.opacity"),
        (&["schedule.lambda_mrf = -0.1"], "`schedule.lambda_mrf` = -0.1"),
        (&["schedule.lambda_mrf = nan"], "schedule.lambda_mrf"),
        (&["schedule.mrf_side = 4"], "`schedule.mrf_side` = 4"),
        (&["schedule.mrf_sid = 4"], "unknown field `mrf_sid`"),
    ] {
        let error = refuse(over);
        assert!(error.contains(why), "{over:?}: {error}");
    }
}

/// Weights of the user stand in for the fixed filters; a run whose weights are gone can be rendered, and not trained.
#[test]
fn textures_are_compared_by_the_weights_that_are_named() {
    let (dir, data) = (tempfile::tempdir().expect("folder"), film("cylinder", 32, 2));
    let file = dir.path().join("vgg19.safetensors");
    std::fs::write(&file, gs_metrics::testkit::file(&gs_metrics::testkit::vgg19())).expect("file");
    let named = |file: &std::path::Path| {
        let weights = format!("mrf_weights = \"{}\"", file.display());
        format!(
            "schedule.lambda_mrf = 0.01\nschedule.mrf_side = 32\nschedule.{weights}\nschedule.stages.geometry.steps = 0\nschedule.stages.warm_up.steps = 0\ninput = \"single\""
        )
    };
    let term = |over: &str| -> Result<Option<f64>, TrainError> {
        let mut trainer = start(&data, &config(&[SHORT, over]));
        trainer.step().map(|report| report.loss.term("mrf"))
    };
    let own = term(&named(&file)).expect("step").expect("term");
    let bank = term(&named(&file).replace(file.to_str().expect("path"), "")).expect("step").expect("term");
    assert!(own.is_finite() && (own - bank).abs() > 1e-6, "{own} {bank}");
    let error = term(&named(&dir.path().join("gone"))).expect_err("no file").to_string();
    assert!(error.contains("schedule.mrf_weights") && error.contains("gone"), "{error}");
}

#[test]
fn a_frame_that_cannot_be_made_stops_training_with_its_number() {
    let mut data = film("cylinder", 32, 2);
    let person = Arc::make_mut(Arc::make_mut(&mut data).avatar.as_mut().expect("person"));
    person.frames[1].inputs[0].image = ImageSource::File("/nowhere/0.png".into());
    person.frames[0].points = None;
    let mut trainer =
        start(&data, &config(&[SHORT, "centred = false\nsurface.texture = 0.0\ngaunet.unseen = \"black\""]));
    let error = (0..5).find_map(|_| trainer.step().err()).expect("stopped");
    assert!(matches!(error, TrainError::Method(_)), "{error}");
    let text = error.to_string();
    assert!(text.contains("frame 0") && text.contains("no points") || text.contains("frame 1"), "{text}");
}

#[test]
fn values_of_the_texels_own_show_what_was_filmed() {
    let data = film("cylinder", 64, 3);
    let over = "
[textures]
unproject = 64
geo = 32
gau = 64
[schedule]
stages.geometry.steps = 0
stages.main.steps = 1500
lr.texels.log_scales.steps = 1500
lr.texels.sh_dc.steps = 1500
lr.texels.offsets.steps = 1500
lr.texels.gain.steps = 1500
";
    let mut trainer = start(&data, &config(&[DIRECT, "input = \"single\"", over]));
    let before = in_mask(&trainer, &data, Split::Train);
    run(&mut trainer, 1500);
    let after = in_mask(&trainer, &data, Split::Train);
    assert!(after > 32.0 && after > before + 2.0, "{before:.2} dB before, {after:.2} dB after");
}

#[test]
fn networks_show_a_person_to_unseen_cameras() {
    let options = AvatarOptions { size: 96, frames: 4, points: 0, morph: Morphs::Apply, ..AvatarOptions::default() };
    let data = Arc::new(avatar::generate(&options).expect("film"));
    let over = "
textures = { unproject = 64, geo = 32, gau = 64 }
[schedule]
stages.geometry.steps = 0
stages.main.steps = 150
lr.gau.all.steps = 150
lr.texels = { log_scales.steps = 150, sh_dc.steps = 150, offsets.steps = 150 }
";
    let config = config(&["input = \"single\"", over]);
    let mut trainer = start(&data, &config);
    let before = in_mask(&trainer, &data, Split::Test);
    run(&mut trainer, 150);
    let after = in_mask(&trainer, &data, Split::Test);
    assert!(after > 23.0 && after > before + 5.0, "{before:.2} dB before, {after:.2} dB after");
}

#[test]
fn gaunet_fits_four_views_of_a_frame() {
    let data = film("cylinder", 64, 1);
    assert_eq!(data.train.len(), 4);
    let over = "
input = \"single\"
gaunet.residual = false
gaunet.own = false
textures = { unproject = 64, geo = 32, gau = 64 }
[schedule]
stages.geometry.steps = 0
stages.warm_up.steps = 200
stages.main.steps = 450
lr.gau.all = { start = 3e-3, end = 1e-4, steps = 450 }
";
    let mut trainer = start(&data, &config(&[over]));
    run(&mut trainer, 200);
    let warm = in_mask(&trainer, &data, Split::Train);
    run(&mut trainer, 450);
    let fitted = in_mask(&trainer, &data, Split::Train);
    assert!(warm > 20.0 && fitted > 30.0, "{warm:.2} dB after the warm-up, {fitted:.2} dB in the end");
}

/// The mean textures.
fn mean(method: &(impl Buffers + ?Sized)) -> Vec<Vec<f32>> {
    let mut all = Vec::new();
    method.buffers(&mut |b| all.push(b.values.clone()));
    all
}

/// The mean textures a run learnt with are its own: another film's would be others.
#[test]
fn a_run_over_another_film_draws_the_same() {
    let data = film("person", 48, 4);
    let mut other = Dataset::clone(&data);
    let person = Arc::make_mut(other.avatar.as_mut().expect("person"));
    person.frames.truncate(1);
    let at = Timestamp::new(person.frames[0].time);
    let camera = &data.train[0].camera;
    for over in [&[SHORT, RESIDUAL][..], &[SHORT, DIRECT]] {
        let config = config(over);
        let mut trainer = start(&data, &config);
        let steps = trainer.steps();
        run(&mut trainer, steps);
        let state = trainer.state();
        let of =
            |film: &Dataset| saved::load_with(&registry(), &state, None, film.avatar.clone()).expect("state").model;
        let (here, there) = (of(&data), of(&other));
        let splats = |model: &Model| model.splats(&at, camera).expect("splats");
        assert!(splats(&here) == splats(&there), "{over:?}");
        assert_eq!(mean(&*here).len(), 3);
        assert!(mean(&*here) == mean(&*there));
        // Made of the other film they differ, and so does what is drawn: a checkpoint without them says nothing of them.
        assert!(mean(&*here) != mean(&bare(&other, &config, 15)));
        let mut old = state.clone();
        old.tensors.retain(|(name, _)| !name.starts_with("mean."));
        let old = saved::load_with(&registry(), &old, None, other.avatar.clone()).expect("state").model;
        assert!(splats(&old) != splats(&here), "{over:?}");
    }
}

#[test]
fn mean_colours_are_made_anew_of_second_textures() {
    let data = film("person", 48, 3);
    let config = config(&[SHORT, "surface.refresh = 2"]);
    let mut trainer = start(&data, &config);
    let mut means = vec![mean(&**trainer.model())];
    for _ in 0..7 {
        run(&mut trainer, 1);
        means.push(mean(&**trainer.model()));
    }
    // Steps 2 and 4 of the five of GeoNet, and GauNet's texels alone.
    let renewed: Vec<bool> = means.windows(2).map(|pair| pair[0] != pair[1]).collect();
    assert_eq!(renewed, [false, true, false, true, false, false, false]);
    assert!(means.iter().all(|m| m[0] == means[0][0]));
    let state = trainer.state();
    let mut resumed = Trainer::resume(&registry(), data.clone(), &state, None, 1 << 20).expect("resume");
    assert!(mean(&**resumed.model()) == means[7]);
    run(&mut resumed, 3);
    run(&mut trainer, 3);
    assert!(timeless(resumed.state()) == timeless(trainer.state()));
}

/// Everything as in the authors' code, where that is not the default.
const PUBLISHED: &str = r#"
resize = "plain"
centred = false
refine.rule = "first_edge"
gaussians.decode.covariance = "raw"
geonet.norm_over = "all"
[unproject]
rule = "bilinear"
mask = "binary"
min_weight = 0.0
compat = { align_corners = true, clip_depth = true, zero_background = true }
[surface]
slide = 1.0
laplacian_rule = "positions"
isometry = 0.1
isometry_rule = "first_edge"
texture = 0.0
seams = "first"
[gaunet]
residual = false
unseen = "black"
own = false
net.norm_over = "all"
[schedule]
lambda_mrf = 0.01
mrf_side = 32
"#;

#[test]
fn published_behaviour_can_be_asked_for() {
    let data = film("person", 48, 2);
    let mut trainer = start(&data, &config(&[SHORT, PUBLISHED]));
    for step in 1..=trainer.steps() {
        let report = trainer.step().expect("step");
        let drawn = step > 9;
        assert!(
            report.loss.total.is_finite() && report.loss.term("mrf").is_some() == drawn,
            "{step}: {:?}",
            report.loss
        );
    }
    assert!(in_mask(&trainer, &data, Split::Test).is_finite());
    let at = Timestamp::new(data.train[0].time);
    let shown = |over: &[&str]| {
        let method = bare(&data, &config(over), 15);
        let second = method.second(&method.actor().scene.frames[1]).expect("frame");
        (second.seen.clone(), method.splats(&at, &data.train[0].camera).expect("splats"))
    };
    let same_size = &format!("textures = {{ unproject = 64, geo = 32, gau = 32 }}{RESIDUAL}");
    let (masked, _) = shown(&[SHORT, same_size]);
    let (plain, turned) = shown(&[SHORT, same_size, "resize = \"plain\""]);
    // Black bleeds in: no texel is brighter, those at borders are darker.
    let darker = plain.colors.iter().zip(&masked.colors).filter(|(p, m)| p[0] + 1e-6 < m[0]).count();
    assert!(darker > plain.colors.len() / 50, "{darker} of {}", plain.colors.len());
    let brighter = plain.colors.iter().zip(&masked.colors).filter(|(p, m)| p[0] > m[0] + 1e-6).count();
    assert_eq!(brighter, 0);
    let raw = shown(&[SHORT, same_size, "resize = \"plain\"\ngaussians.decode.covariance = \"raw\""]).1;
    assert!(raw.means == turned.means && raw.quats != turned.quats && raw.scales != turned.scales);
}
