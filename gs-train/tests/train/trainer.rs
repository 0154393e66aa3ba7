//! The trainer through its public interface, with a method whose gradients are chosen here: gradients that are not finite,
//! batches, and what is refused before the first step.

use gs_core::io::images::save_png;
use gs_core::{Camera, Image, Param, Params, Splats};
use gs_data::{Dataset, ImageSource};
use gs_synth::SynthOptions;
use gs_train::checkpoint::Checkpoint;
use gs_train::error::RanksError;
use gs_train::method::{Buffers, LossValue, Method, MethodError, RenderView, ViewCtx};
use gs_train::model::Model;
use gs_train::ranks::Ranks;
use gs_train::registry::section;
use gs_train::scene::SceneInfo;
use gs_train::step::StepCtx;
use gs_train::testkit::{on_a_thread, threads_as_ranks};
use gs_train::timestamp::Timestamp;
use gs_train::trainer::{TrainError, TrainOptions, Trainer};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Two blocks whose gradients are the same in every step.
struct Fake {
    blocks: [Param; 2],
    gradients: [Vec<f32>; 2],
}

impl Params for Fake {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.blocks.iter().for_each(f);
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.blocks.iter_mut().for_each(f);
    }
}

impl Buffers for Fake {}

impl Method for Fake {
    fn begin_step(&mut self, _at: &StepCtx) {}

    fn splats(&self, _at: &Timestamp, _camera: &Camera) -> Result<Splats, MethodError> {
        Ok(Splats::default())
    }

    fn step(&mut self, _view: &ViewCtx<'_>, _render: &mut dyn RenderView) -> Result<Vec<LossValue>, MethodError> {
        self.blocks.iter_mut().zip(&self.gradients).for_each(|(p, g)| p.grad.clone_from(g));
        Ok(Vec::new())
    }

    fn splat_count(&self) -> usize {
        1000
    }
}

/// Resting bodies.
fn data(size: u32, views: u32) -> Arc<Dataset> {
    let options = SynthOptions::of_views(size, views, 0);
    Arc::new(gs_synth::generate("static", &options).expect("scene").dataset)
}

fn tiny(method: &str) -> toml::Table {
    gs_methods::registry().find(method).and_then(|m| m.config("tiny")).expect("preset")
}

/// A run of the fake: so many of 1000 gradient rows are not finite, and perhaps one gradient of the shared weights.
fn fake(bad_rows: usize, bad_shared: bool) -> Trainer {
    let (dataset, config) = (data(16, 2), tiny("fourdgs"));
    let schedule = section("fourdgs", &config, "schedule").expect("schedule");
    let init = section("fourdgs", &config, "init").expect("init");
    let scene = SceneInfo::of(&dataset, &init, 0).expect("scene");
    let blocks = [Param::rows("cloud.means", 1, vec![1.0; 1000]), Param::shared("field.trunk", vec![1.0; 3])];
    let mut gradients = [vec![1.0; 1000], vec![1.0; 3]];
    gradients[0][7..7 + bad_rows].fill(f32::NAN);
    gradients[1][1] = if bad_shared { f32::INFINITY } else { 1.0 };
    let model = Model::new("fake", Fake { blocks, gradients }, schedule).expect("model");
    Trainer::with_method(model, dataset, scene, TrainOptions::default()).expect("trainer")
}

#[test]
fn few_bad_rows_are_counted_and_left_alone() {
    let mut trainer = fake(1, false);
    assert_eq!(trainer.step().expect("step").quarantined, 1);
    trainer.model().visit(&mut |p| {
        assert!(p.grad.iter().all(|g| *g == 0.0), "{}: gradients are cleared", p.name);
        if p.name == "cloud.means" {
            assert!(p.value[7] == 1.0 && p.value[6] < 1.0 && p.value[8] < 1.0);
            assert!(p.moment1[7] == 0.0 && p.moment1[8] > 0.0);
        }
    });
}

#[test]
fn many_bad_rows_or_one_bad_weight_end_the_run() {
    for (mut trainer, culprit) in [(fake(2, false), "row 7 of `cloud.means`"), (fake(0, true), "`field.trunk`")] {
        let error = trainer.step().expect_err("refused");
        assert_eq!(error.exit_code(), 4);
        assert!(error.to_string().contains(culprit), "{error}");
        assert_eq!(trainer.steps_done(), 0);
    }
}

/// Values of a method after a step: first moments of all blocks, then the sums of screen gradients.
fn moments(trainer: &Trainer) -> (Vec<f32>, Vec<f32>) {
    let (mut all, mut sums) = (Vec::new(), Vec::new());
    trainer.model().visit(&mut |p| all.extend_from_slice(&p.moment1));
    trainer.model().buffers(&mut |b| {
        if b.name == "density.grad_sum" {
            sums.clone_from(b.values);
        }
    });
    (all, sums)
}

/// Learning rates of 1e-12 move nothing, and Adam's first moment after steps with gradients `g₁`, `g₂` is `0.1 g₁`, then
/// `0.09 g₁ + 0.1 g₂`.
#[test]
fn a_batch_is_the_mean_of_its_views() {
    let dataset = data(24, 4);
    let start = |batch: i64| {
        let mut config = tiny("static3d");
        let schedule = config["schedule"].as_table_mut().expect("schedule");
        ["batch", "lr_batch"].into_iter().for_each(|key| drop(schedule.insert(key.into(), batch.into())));
        for (_, rate) in schedule["lr"]["cloud"].as_table_mut().expect("rates").iter_mut() {
            let rate = rate.as_table_mut().expect("rate");
            rate.insert("start".into(), 1e-12.into());
            rate.insert("end".into(), 1e-12.into());
        }
        let options = TrainOptions::default();
        Trainer::new(gs_methods::registry(), dataset.clone(), "static3d", &config, options).expect("trainer")
    };
    let (mut both, mut single) = (start(2), start(1));
    let of_both = both.step().expect("step");
    let first = single.step().expect("step");
    let after_first = moments(&single).0;
    let second = single.step().expect("step");
    let (after_second, single_sums) = moments(&single);
    let (mean, both_sums) = moments(&both);

    let mut names = [&first.view[..], &second.view];
    names.sort_unstable();
    assert_eq!(of_both.view, names.join(", "), "in the order of the data set");
    assert_ne!(first.view, second.view);
    assert!((of_both.loss.total - 0.5 * (first.loss.total + second.loss.total)).abs() < 1e-7);
    let largest = mean.iter().fold(0.0f32, |m, g| m.max(g.abs()));
    assert!(largest > 0.0);
    for (i, m) in mean.iter().enumerate() {
        let (one, two) = (after_first[i], after_second[i] - 0.9 * after_first[i]);
        assert!((m - 0.5 * (one + two)).abs() < 1e-6 * largest, "first moment {i}: {m}, {one} and {two} alone");
    }
    assert!(both_sums.iter().any(|s| *s > 0.0));
    for (i, (a, b)) in both_sums.iter().zip(&single_sums).enumerate() {
        assert!((a - b).abs() <= 1e-5 * b.abs(), "statistics of densification are of whole losses: {i}");
    }
}

/// At full size as at the reduced size of a stage.
#[test]
fn images_are_decoded_within_the_limit_of_the_data() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("large.png");
    save_png(&file, &Image::zeros(640, 640, 3), false).expect("a file");
    let mut large = Dataset::clone(&data(16, 2));
    for view in &mut large.train {
        (view.camera, view.image) = (view.camera.scaled(40.0), ImageSource::File(file.clone()));
    }
    for scale in [1.0, 0.5] {
        let mut config = tiny("static3d");
        config["init"].as_table_mut().expect("init").insert("from".into(), "random".into());
        for (_, stage) in config["schedule"]["stages"].as_table_mut().expect("stages").iter_mut() {
            stage.as_table_mut().expect("stage").insert("image_scale".into(), scale.into());
        }
        let step = |max_image_mib| {
            let dataset = Arc::new(Dataset { max_image_mib, ..large.clone() });
            let options = TrainOptions::default();
            let trainer = Trainer::new(gs_methods::registry(), dataset, "static3d", &config, options);
            trainer.expect("trainer").step().err()
        };
        assert!(matches!(step(Some(1)), Some(TrainError::Data(e)) if e.code() == "limits.file"), "{scale}");
        assert!(step(None).is_none() && step(Some(8)).is_none(), "{scale}");
    }
}

#[test]
fn unknown_methods_and_settings_are_refused() {
    let (dataset, config) = (data(16, 2), tiny("fourdgs"));
    let error = |method: &str, config: &toml::Table| {
        Trainer::new(gs_methods::registry(), dataset.clone(), method, config, TrainOptions::default())
            .err()
            .expect("refused")
    };
    assert_eq!(error("none", &config).exit_code(), 2);
    assert!(error("none", &config).to_string().contains("fourdgs"), "known names are listed");
    assert!(error("static3d", &config).to_string().contains("field"), "static3d has no field");
    let mut wrong = config.clone();
    wrong["schedule"].as_table_mut().expect("schedule").insert("lambda_dssim".into(), 2.0.into());
    assert!(error("fourdgs", &wrong).to_string().contains("lambda_dssim"));
    let mut still = tiny("static3d");
    for (_, stage) in still["schedule"]["stages"].as_table_mut().expect("stages").iter_mut() {
        stage.as_table_mut().expect("stage").insert("field_alone".into(), true.into());
    }
    assert!(error("static3d", &still).to_string().contains("field_alone"), "nothing would learn");
    let mut without = config.clone();
    without.remove("init");
    assert!(error("fourdgs", &without).to_string().contains("section `init` is missing"));
}

/// A rank that gets other messages than the ones sent: those of its call `at`, from 0, after `change`.
struct Astray<F> {
    ranks: Arc<dyn Ranks>,
    calls: AtomicUsize,
    at: usize,
    change: F,
}

impl<F: Fn(&mut [Vec<u8>]) + Send + Sync> Astray<F> {
    fn new(ranks: Arc<dyn Ranks>, at: usize, change: F) -> Arc<Self> {
        Arc::new(Self { ranks, calls: AtomicUsize::new(0), at, change })
    }
}

impl<F: Fn(&mut [Vec<u8>]) + Send + Sync> Ranks for Astray<F> {
    fn rank(&self) -> usize {
        self.ranks.rank()
    }

    fn size(&self) -> usize {
        self.ranks.size()
    }

    fn all_to_all(&self, to: Vec<Vec<u8>>) -> Result<Vec<Vec<u8>>, RanksError> {
        let mut received = self.ranks.all_to_all(to)?;
        if self.calls.fetch_add(1, Ordering::SeqCst) == self.at {
            (self.change)(&mut received[..]);
        }
        Ok(received)
    }
}

/// Moves one mean of the state that the first rank sent.
fn one_mean_moved(received: &mut [Vec<u8>]) {
    let dir = tempfile::tempdir().expect("folder");
    let file = dir.path().join("state.gsck");
    std::fs::write(&file, &received[0]).expect("state");
    let mut state = Checkpoint::load(&file).expect("state");
    let means = state.tensors.iter_mut().find(|(name, _)| name.ends_with("means")).expect("means");
    means.1[0] += 0.5;
    state.save(&file).expect("state");
    received[0] = std::fs::read(&file).expect("state");
}

#[test]
fn ranks_that_differ_are_reported_before_anything_is_saved() {
    let (data, registry) = (data(16, 4), gs_methods::registry());
    let lead = Trainer::new(registry, data.clone(), "static3d", &tiny("static3d"), TrainOptions::default());
    let mut ranks = threads_as_ranks(2);
    let (second, first) = (ranks.pop().expect("second"), ranks.pop().expect("first"));
    let astray = Astray::new(second, 0, one_mean_moved);
    std::thread::scope(|scope| {
        let follow = || Trainer::join(registry, Ok(data.clone()), 64 << 20, astray).and_then(|mut t| t.follow());
        let followed = scope.spawn(follow);
        let mut lead = lead.expect("trainer").lead(first).expect("first rank");
        let error = lead.gather().expect_err("another mean");
        assert!(matches!(&error, TrainError::Diverged { step: 0, ranks } if ranks[..] == [1]), "{error}");
        drop(lead);
        followed.join().expect("thread").expect("the first rank reports it");
    });
}

/// The first of two ranks gets no result of the second's views: its fourth call, after two to begin and one to ask for the step. The
/// second goes on with the step, and must not take what the first sends at its end for a part of it.
#[test]
fn a_first_rank_that_is_out_of_step_says_nothing_more() {
    let (data, registry) = (data(16, 4), gs_methods::registry());
    let lead = Trainer::new(registry, data.clone(), "static3d", &tiny("static3d"), TrainOptions::default());
    let mut ranks = threads_as_ranks(2);
    let (second, first) = (ranks.pop().expect("second"), ranks.pop().expect("first"));
    let first = Astray::new(first, 3, |received: &mut [Vec<u8>]| received[1].clear());
    std::thread::scope(|scope| {
        let follow = || Trainer::join(registry, Ok(data.clone()), 64 << 20, second).and_then(|mut t| t.follow());
        let followed = scope.spawn(|| on_a_thread(follow));
        let mut lead = lead.expect("trainer").lead(first).expect("first rank");
        let error = on_a_thread(|| lead.step()).expect_err("a message is empty");
        assert!(matches!(&error, TrainError::Ranks(e) if e.what.contains("message of rank 1")), "{error}");
        let error = lead.gather().expect_err("out of step");
        assert!(matches!(&error, TrainError::Ranks(e) if e.what.contains("earlier error")), "{error}");
        drop(lead);
        let error = followed.join().expect("thread").expect_err("the first rank has gone");
        assert!(matches!(&error, TrainError::Ranks(e) if e.what == "rank 0 is gone"), "{error}");
    });
}

/// The second of two ranks has the later two of the four views of a step, and cannot read the last.
#[test]
fn a_rank_that_fails_in_a_step_is_named_and_all_ranks_end() {
    let (data, registry) = (data(16, 4), gs_methods::registry());
    let mut config = tiny("static3d");
    config["schedule"].as_table_mut().expect("schedule").insert("batch".into(), 4i64.into());
    let mut broken = (*data).clone();
    broken.train[3].image = ImageSource::File("missing.png".into());
    let lead = Trainer::new(registry, data, "static3d", &config, TrainOptions::default()).expect("trainer");
    let mut ranks = threads_as_ranks(2);
    let (second, first) = (ranks.pop().expect("second"), ranks.pop().expect("first"));
    std::thread::scope(|scope| {
        let follow = move || Trainer::join(registry, Ok(Arc::new(broken)), 64 << 20, second)?.follow();
        let followed = scope.spawn(|| on_a_thread(follow));
        let mut lead = lead.lead(first).expect("first rank");
        let error = on_a_thread(|| lead.step()).expect_err("an image is missing");
        let named = matches!(&error, TrainError::Rank { rank: 1, what, code: 3 } if what.contains("missing.png"));
        assert!(named, "{error}");
        drop(lead);
        followed.join().expect("thread").expect("the first rank reports it");
    });
}
