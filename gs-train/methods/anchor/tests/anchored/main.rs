//! What anchored methods promise beyond what every method does.
//!
//! | property | tolerance |
//! |---|---|
//! | the local stage starts from the global fit | same bits |
//! | pictures with the filter against pictures without | 1e-6 |
//! | an appearance vector folded into a bias | 1e-6 |
//! | local anchors kept per interval against fresh ones | same bits |
//! | without GAD and LGD against the plain scaffold | same bits |
//! | centres of baked rows at times between those looked at | 1.5 × the tolerance |

mod change;
mod hash;

use gs_core::{Camera, Splats, SplatsGrad, SplatsRef, Time};
use gs_method_anchor::METHODS;
use gs_raster::{ScreenStats, Workspace, render};
use gs_synth::testkit::scene;
use gs_train::capabilities::FreezeOptions;
use gs_train::jumps::jumps;
use gs_train::method::{MethodError, RenderView, ViewCtx};
use gs_train::model::Model;
use gs_train::registry::Registry;
use gs_train::saved;
use gs_train::testkit::{config, run, short, start};
use gs_train::timestamp::Timestamp;
use gs_train::trainer::{TrainOptions, Trainer};

/// The methods of this crate.
fn registry() -> Registry {
    Registry::new(METHODS.to_vec())
}

fn at(t: f32) -> Timestamp {
    Timestamp::new(Time::new(t).expect("time"))
}

fn picture(method: &Model, splats: &Splats, camera: &Camera) -> Vec<f32> {
    let options = method.raster_options([1.0; 3]);
    render(splats, camera, &options, &mut Workspace::new()).rgb.data
}

fn splats(model: &Model, t: f32, camera: &Camera) -> Splats {
    model.splats(&at(t), camera).expect("splats")
}

/// Keeps the splats of a step, which have no gradient.
#[derive(Default)]
struct Kept {
    splats: Splats,
    stats: ScreenStats,
}

impl RenderView for Kept {
    fn render(&mut self, splats: SplatsRef<'_>, grad: &mut SplatsGrad) -> Result<&ScreenStats, MethodError> {
        self.splats = splats.to_splats();
        grad.reset(splats);
        self.stats = ScreenStats { grad_means2d: vec![[0.0; 2]; splats.len()], radii: vec![0.0; splats.len()] };
        Ok(&self.stats)
    }
}

fn modec(over: &str) -> toml::Table {
    short(&registry(), "modec", &[over])
}

fn trained(config: &toml::Table, steps: u32) -> Trainer {
    let mut trainer = start(&registry(), &scene("sheet", 32, 6), "modec", config, 0);
    run(&mut trainer, steps);
    trainer
}

#[test]
fn the_local_stage_starts_from_the_global_fit() {
    // Stages of 30 steps each.
    let trainer = trained(&modec(""), 30);
    let mut method = saved::load(&registry(), &trainer.state(), None).expect("state").model;
    let camera = trainer.dataset().train[0].camera.clone();
    let global = splats(&method, 0.7, &camera);
    method.begin_step(31);
    assert!(method.schedule().dynamic(31) && !method.schedule().dynamic(30));
    let mut kept = Kept::default();
    method.step(&ViewCtx { at: at(0.7), camera: &camera, draw: 0, last: true }, &mut kept).expect("step");
    assert!(!global.is_empty());
    assert_eq!(kept.splats, global, "bit for bit");
}

#[test]
fn filtered_pictures_are_those_without_a_filter() {
    let trainer = trained(&modec("lgd_query = \"rest\""), 60);
    let config = modec("lgd_query = \"rest\"\n[anchors]\nfilter = \"off\"");
    let load = |config| saved::load(&registry(), &trainer.state(), config).expect("state").model;
    let (filtered, whole) = (load(None), load(Some(&config)));
    let mut left_out = 0;
    for view in &trainer.dataset().train {
        // Close-ups of every corner: most anchors are out of sight.
        for (dx, dy) in [(0.0, 0.0), (-40.0, 30.0), (50.0, -40.0), (300.0, 0.0)] {
            let c = &view.camera;
            let camera = Camera { fx: 6.0 * c.fx, fy: 6.0 * c.fy, cx: c.cx + dx, cy: c.cy + dy, ..c.clone() };
            let (few, all) = (splats(&filtered, 0.4, &camera), splats(&whole, 0.4, &camera));
            left_out += all.len() - few.len();
            let (few, all) = (picture(&filtered, &few, &camera), picture(&whole, &all, &camera));
            let worst = few.iter().zip(&all).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(worst <= 1e-6, "{worst}");
        }
    }
    assert!(left_out > 1000, "the filter left out {left_out} splats only");
}

#[test]
fn lgd_at_rest_differs_once_anchors_have_moved() {
    let trainer = trained(&modec(""), 60);
    let camera = &trainer.dataset().train[0].camera;
    let asked = |over: &str| {
        let model = saved::load(&registry(), &trainer.state(), Some(&modec(over))).expect("state").model;
        splats(&model, 0.6, camera)
    };
    assert_eq!(asked("lgd_query = \"moved\""), splats(trainer.model(), 0.6, camera));
    assert_ne!(asked("lgd_query = \"rest\"").means, splats(trainer.model(), 0.6, camera).means);
}

#[test]
fn kept_intervals_draw_the_same_bits() {
    let trainer = trained(&modec("lgd_query = \"rest\""), 60);
    let camera = &trainer.dataset().train[0].camera;
    let load = || saved::load(&registry(), &trainer.state(), None).expect("state").model;
    let warm = load();
    let times = [0.1, 0.15, 0.9, 0.12, 0.5, 0.9];
    let first: Vec<Splats> = times.iter().map(|&t| splats(&warm, t, camera)).collect();
    for (t, before) in times.iter().zip(&first) {
        assert_eq!(*before, splats(&warm, *t, camera), "kept");
        assert_eq!(*before, splats(&load(), *t, camera), "anew");
    }
}

#[test]
fn stages_lead_to_what_is_drawn() {
    let trainer = trained(&modec(""), 60);
    let (method, camera) = (trainer.model(), &trainer.dataset().train[0].camera);
    let stages = method.stages(&at(0.6), camera).expect("stages");
    assert_eq!(stages.iter().map(|s| s.name).collect::<Vec<_>>(), ["global", "local", "full"]);
    let full = &stages[2];
    assert_eq!(full.before.as_ref(), Some(&stages[1].splats.means), "where LGD found them");
    assert_eq!(stages[1].before.as_ref().map(Vec::len), Some(stages[1].splats.len()));
    let (drawn, staged) = (splats(method, 0.6, camera), &full.splats);
    let (drawn, staged) = (picture(method, &drawn, camera), picture(method, staged, camera));
    let worst = drawn.iter().zip(&staged).map(|(a, b)| (a - b).abs());
    assert!(worst.fold(0.0, f32::max) <= 1e-6);
}

#[test]
fn parts_are_left_out_by_name() {
    let names = |ablate: &str| {
        let trainer = trained(&modec(&format!("ablate = \"{ablate}\"")), 1);
        let mut names = std::collections::BTreeSet::new();
        trainer.model().visit(&mut |p| {
            names.insert(p.name.split('.').next().unwrap_or_default().to_owned());
        });
        names.into_iter().collect::<Vec<_>>().join(" ")
    };
    assert_eq!(names(""), "anchors gad heads intervals lgd");
    assert_eq!(names("gad"), "anchors heads lgd");
    assert_eq!(names("lgd"), "anchors gad heads intervals");
    assert_eq!(names("gad,lgd"), "anchors heads");
    let error =
        Trainer::new(&registry(), scene("sheet", 32, 6), "modec", &modec("ablate = \"gda\""), TrainOptions::default());
    assert!(error.err().expect("refused").to_string().contains("choose of gad, lgd, tia"));
}

#[test]
fn boundaries_move_and_are_reported() {
    let over = "[intervals]\nfrom = 1\nuntil = 30\nperiod = 10\ntau = 0.5\nstep = 0.2\nsegments = 3";
    let mut config = modec(over);
    config["schedule"]["stages"]["local"]["steps"] = 60.into();
    let mut trainer = start(&registry(), &scene("sheet", 32, 24), "modec", &config, 0);
    let mut events = Vec::new();
    for _ in 0..90 {
        events.extend(trainer.step().expect("step").events);
    }
    let passes: Vec<_> = events.iter().filter(|line| line.get("intervals").is_some()).collect();
    assert_eq!(passes.len(), 3, "at 10, 20 and 30 of the local stage");
    assert!(passes.iter().all(|line| line["step"].as_u64() == line["intervals"]["step"].as_u64()));
    let moved = passes.iter().any(|line| !line["intervals"]["moves"].as_array().expect("moves").is_empty());
    assert!(moved, "{passes:?}");
    let mut starts = Vec::new();
    trainer.model().visit(&mut |p| {
        if p.name == "intervals.starts" {
            starts.clone_from(&p.value);
        }
    });
    let last: Vec<f32> = serde_json::from_value(passes[2]["starts"].clone()).expect("starts");
    assert_eq!(starts, last);
    assert!(starts[0] == 0.0 && starts.is_sorted_by(|a, b| a < b), "{starts:?}");
}

#[test]
fn folding_leaves_out_what_pictures_do_not_need() {
    folds(&modec(""));
    folds(&modec("gad.heads = [\"positions\"]\nlgd.move_scales = false"));
}

fn folds(config: &toml::Table) {
    let trainer = trained(config, 60);
    let (method, camera) = (trainer.model(), &trainer.dataset().train[0].camera);
    let (slim_config, folded) = method.fold(config).expect("an appearance to fold");
    let (before, after) = (splats(method, 0.3, camera), splats(&folded, 0.3, camera));
    let pictures = (picture(method, &before, camera), picture(&folded, &after, camera));
    let worst = pictures.0.iter().zip(&pictures.1).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst <= 1e-6, "{worst}");
    assert_eq!(slim_config["decoder"]["appearance"].as_integer(), Some(0));
    assert!(folded.param_count() < method.param_count());
    let table = method.capabilities().inspect.and_then(|i| i.paper_storage()).expect("a table");
    assert_eq!(table.needed_bytes(), 4 * folded.param_count(), "what is counted is what there is");
    assert!(table.paper_bytes() > table.needed_bytes());
}

#[test]
fn a_static_scene_is_the_plain_scaffold() {
    let scaffold = short(&registry(), "scaffold", &[]);
    let mut config = modec("ablate = \"gad,lgd\"");
    for part in ["init", "anchors", "decoder", "adapt", "schedule"] {
        config.insert(part.into(), scaffold[part].clone());
    }
    let data = scene("sheet", 32, 6);
    let drawn = |method: &str, config: &toml::Table| {
        let mut trainer = start(&registry(), &data, method, config, 0);
        run(&mut trainer, 60);
        let all = data.train.iter().map(|view| splats(trainer.model(), view.time.normalised, &view.camera));
        all.collect::<Vec<_>>()
    };
    let (plain, emptied) = (drawn("scaffold", &scaffold), drawn("modec", &config));
    assert!(plain.iter().all(|s| s.len() > 50));
    assert!(plain == emptied, "bit for bit");
}

#[test]
fn what_is_baked_stays_within_its_tolerance() {
    for over in ["", "lgd_query = \"rest\""] {
        baked_within_tolerance(&trained(&modec(over), 60));
    }
}

fn baked_within_tolerance(trainer: &Trainer) {
    let method = trainer.model();
    let cameras: Vec<Camera> = trainer.dataset().train.iter().map(|v| v.camera.clone()).collect();
    let mut still = Vec::new();
    for (pixels, shape) in [(0.0, 0.0), (0.05, 1e-3), (0.5, 0.02), (4.0, 0.2)] {
        let options = FreezeOptions { shape, pixels, ..FreezeOptions::usual(&cameras) };
        let (resting, report) = method.freeze_static(&options).expect("a field");
        assert!(report.bound_pixels <= pixels && report.shape <= shape, "{report:?}");
        still.push(report.still);
        for step in 0..=20 {
            let t = at(step as f32 / 20.0 * 0.97);
            let [a, b] = [method, &resting].map(|m| m.all_splats(&t, &cameras[0]).expect("splats"));
            for (a, b) in a.means.iter().zip(&b.means) {
                let off = gs_train::still::screen_bound(a.distance(*b), *b, &cameras);
                assert!(off <= 1.5 * pixels + 1e-3, "off by {off} pixels at {step}");
            }
        }
        if pixels == 0.0 {
            let pictures = [method, &resting].map(|m| picture(m, &splats(m, 0.4, &cameras[2]), &cameras[2]));
            let worst = pictures[0].iter().zip(&pictures[1]).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(worst <= 1e-6, "{worst}");
        }
    }
    assert!(still.is_sorted() && still[0] < still[3], "{still:?}");
}

#[test]
fn a_change_of_a_parameter_ends_the_rest() {
    let trainer = trained(&modec(""), 60);
    let camera = &trainer.dataset().train[0].camera;
    let usual = FreezeOptions::usual(std::slice::from_ref(camera));
    let options = FreezeOptions { shape: 1.0, pixels: 1e3, ..usual };
    let (mut resting, report) = trainer.model().freeze_static(&options).expect("a field");
    assert!(report.still > 0, "{report:?}");
    let exact = splats(trainer.model(), 0.4, camera);
    assert_ne!(splats(&resting, 0.4, camera), exact);
    resting.visit_mut(&mut |_| {});
    resting.begin_step(60);
    assert_eq!(splats(&resting, 0.4, camera), exact);
}

/// GAD held over each interval leaves LGD a jump to undo at every border; the same parameters blended leave none.
#[test]
fn key_frames_that_blend_leave_no_jump() {
    let data = scene("reach", 48, 24);
    let camera = &data.test[0].camera;
    let tiny = |blend: &str| {
        let over = format!("intervals.blend = \"{blend}\"");
        config(&registry(), "modec", "tiny", &[&over])
    };
    let mut trainer = start(&registry(), &data, "modec", &tiny("hold"), 1);
    let steps = trainer.steps();
    run(&mut trainer, steps);
    let state = trainer.state();
    let most = |blend: &str| {
        let model = saved::load(&registry(), &state, Some(&tiny(blend))).expect("state").model;
        let all = jumps(&model, camera).expect("splats");
        assert_eq!(all.len(), 4, "borders");
        all.iter().map(|j| j.mean).fold(0.0, f64::max)
    };
    let [hold, linear, smooth] = ["hold", "linear", "smooth"].map(most);
    println!("mean jump, pixels: hold {hold:.3}, linear {linear:.4}, smooth {smooth:.4}");
    assert!(hold > 0.05 && linear < 0.005 && smooth < 0.005, "{hold} {linear} {smooth}");
}

#[test]
fn far_between_cameras_only_colours_see_the_direction() {
    let data = scene("sheet", 32, 6);
    let spacing = data.view_spacing();
    let trained = |within: f32| {
        let config = modec(&format!("anchors.direction_within = {within}\nanchors.filter = \"off\""));
        let mut trainer = start(&registry(), &data, "modec", &config, 0);
        run(&mut trainer, 40);
        trainer
    };
    let same = |trainer: &Trainer| {
        let [a, b] = [0, 1].map(|v| splats(trainer.model(), 0.4, &data.train[v].camera));
        let colors = a.color == b.color;
        (a.opacities == b.opacities && a.scales == b.scales && a.quats == b.quats, colors)
    };
    let (near, far) = (trained(spacing + 1.0), trained(spacing - 1.0));
    assert_eq!(same(&near), (false, false), "{spacing} degrees");
    assert_eq!(same(&far), (true, false), "{spacing} degrees");
    // A run that is taken up again has the same heads.
    let again = Trainer::resume(&registry(), data.clone(), &far.state(), None, 1 << 20).expect("resume");
    assert_eq!(same(&again), (true, false));
}
