//! [`gs_train::conformance`] over every method of gs4d and one from outside.
//!
//! Some methods leave a path out of the gradient on purpose. Then the functional leaves it out as well
//! ([`stop_gradients`]), or the parameters are such that nothing goes that way:
//!
//! | methods | block | path without gradient | what is tested |
//! |---|---|---|---|
//! | defgs, trace, trace-4dgs, defgs-nvfi | `cloud.means` | field and dynamics read at the centres | the rendered splats, shifted by the displacement of the centres |
//! | grid4d, fags, acutance | `cloud.means` | hash grids read at the centres | everything, with the hash tables set to zero: the field is the same rigid motion everywhere |
//! | modec | `anchors.positions` | GAD read at the anchors | everything, with the heads of GAD set to zero |
//! | modec | `anchors.dynamics` | the step of the mask, whose gradient is that of the logistic function | everything, with `global = "mul"`, which has no step |
//! | trace, trace-4dgs, defgs-nvfi | `cloud.*`, `field.*` | dynamics read at the deformed splats | the splats of the field with the displacement and the turn of the dynamics frozen |

mod broken;
mod outside_method;
mod spacetime;
mod stop_gradients;

use gs_core::{Param, Rng};
use gs_data::Dataset;
use gs_synth::SynthOptions;
use gs_synth::testkit::{dataset, film};
use gs_train::conformance::gradients::{BlockGradient, BlockReport, Report, Rules, View, check, check_block};
use gs_train::conformance::{ConformanceError, Subject};
use gs_train::model::Model;
use gs_train::registry::Registry;
use gs_train::testkit;
use std::sync::{Arc, LazyLock};
use stop_gradients::{Frozen, StopGradient};

static REGISTRY: LazyLock<Registry> = LazyLock::new(|| {
    let known = gs_methods::registry().iter().copied();
    Registry::new(known.chain([spacetime::ENTRY]).collect())
});

static BALLS: LazyLock<Arc<Dataset>> =
    LazyLock::new(|| dataset("balls", &SynthOptions { supersample: 2, ..SynthOptions::of_views(32, 6, 0) }));

/// A method in a state, and what of it must have a gradient.
#[derive(Clone, Copy)]
struct Case {
    method: &'static str,
    /// TOML over the configuration.
    over: &'static str,
    /// Normalised time of the view.
    time: f32,
    /// What is changed about the trained parameters.
    modify: fn(&mut Param),
    stop: StopGradient,
    required: &'static [&'static str],
    exempt: &'static [(&'static str, &'static str)],
}

const PLAIN: Case = Case {
    method: "",
    over: "",
    time: 0.3,
    modify: |_| {},
    stop: StopGradient::None,
    required: &["cloud.", "field."],
    exempt: &[],
};

/// Dynamics carry splats from the last time of the field to 0.9. The clamp of accelerations is one of gradients.
const PHYSICS: Case = Case {
    over: "law.accel_clamp = 0.0",
    time: 0.9,
    stop: StopGradient::Dynamics,
    required: &["cloud.", "field.", "physics."],
    ..PLAIN
};

const ELSEWHERE: &str = "is checked in another case of this method";

/// A cloud whose hash grids say the same everywhere.
const UNIFORM: Case = Case {
    modify: |p| {
        if p.name.starts_with("field.grids.") {
            p.value.fill(0.0);
        }
    },
    required: &["cloud.means"],
    exempt: &[("", ELSEWHERE)],
    ..PLAIN
};

const GRIDS: Case = Case { exempt: &[("cloud.means", ELSEWHERE)], ..PLAIN };

const MODEC: Case = Case {
    method: "modec",
    required: &["anchors.", "heads.", "gad.", "lgd."],
    exempt: &[
        ("anchors.positions", ELSEWHERE),
        ("anchors.dynamics", ELSEWHERE),
        ("intervals.starts", "is moved by a rule, not learnt"),
    ],
    ..PLAIN
};

/// Where only what happens between GAD and LGD differs, anchors and heads are those of [`MODEC`].
const MODEC_FIELDS: Case = Case { required: &["gad.", "lgd."], exempt: &[("", ELSEWHERE)], ..MODEC };

/// LGD is asked where Gaussians are at rest, and anchors move between key frames.
const REST: &str = "lgd_query = \"rest\"\nintervals.blend = \"linear\"";

const GAD_AT_ZERO: Case = Case {
    modify: |p| {
        if ["gad.positions.", "gad.features.", "gad.offsets.", "gad.scales."].iter().any(|h| p.name.starts_with(h)) {
            p.value.fill(0.0);
        }
    },
    required: &["anchors.positions"],
    exempt: &[("", ELSEWHERE)],
    ..MODEC
};

const CASES: &[Case] = &[
    Case { method: "spacetime", required: &["cloud.", "motion.", "time."], ..PLAIN },
    Case { method: "static3d", required: &["cloud."], ..PLAIN },
    Case { method: "scaffold", required: &["anchors.", "heads."], ..PLAIN },
    Case { method: "defgs", stop: StopGradient::Centres, ..PLAIN },
    Case { method: "fourdgs", ..PLAIN },
    Case { method: "grid4d", ..GRIDS },
    Case { method: "grid4d", ..UNIFORM },
    Case { method: "fags", ..GRIDS },
    Case { method: "fags", ..UNIFORM },
    Case { method: "acutance", ..GRIDS },
    Case { method: "acutance", ..UNIFORM },
    MODEC,
    Case { over: "intervals.blend = \"linear\"", time: 0.5, ..MODEC_FIELDS },
    Case { over: "intervals.blend = \"smooth\"", ..MODEC_FIELDS },
    Case { over: REST, ..MODEC_FIELDS },
    Case {
        over: "gad.dynamics.global = \"mul\"",
        required: &["anchors.dynamics", "gad."],
        exempt: &[("", ELSEWHERE)],
        ..MODEC
    },
    GAD_AT_ZERO,
    Case { over: REST, ..GAD_AT_ZERO },
    // At 0.9 a pixel crosses the border of a wide splat whose opacity is three times the least that is drawn.
    Case { method: "trace", time: 0.88, ..PHYSICS },
    // Lobes turn with their splats; no gradient of turning comes from colours.
    Case {
        method: "trace",
        over: "physics.turn_colours = true",
        stop: StopGradient::None,
        required: &["cloud.sh_"],
        exempt: &[("", ELSEWHERE)],
        ..PHYSICS
    },
    Case { method: "trace-4dgs", ..PHYSICS },
    Case {
        method: "defgs-nvfi",
        over: "",
        required: &["cloud.", "field.", "velocity."],
        exempt: &[("acceleration.", "learns from the penalty on the equation of motion alone")],
        ..PHYSICS
    },
];

/// The `tiny` preset of a case's method, in 60 steps, of so few splats that few pairs change their order in depth.
fn short(case: &Case) -> toml::Table {
    let mut config = testkit::short(&REGISTRY, case.method, &["init.points = 20", case.over]);
    match config.get_mut("adapt") {
        Some(adapt) => adapt["max_anchors"] = 24.into(),
        None => config["schedule"]["density"]["max_splats"] = 24.into(),
    }
    config
}

fn subject<'a>(case: &'a Case, config: &'a toml::Table) -> Subject<'a> {
    let rules = Rules { required: case.required, exempt: case.exempt, ..Rules::default() };
    Subject { rules, time: case.time, modify: &case.modify, ..Subject::new(&REGISTRY, case.method, &BALLS, config) }
}

/// A case in its state, with its gradients.
struct Fixture {
    case: Case,
    model: Model,
    view: View,
    frozen: Frozen,
    gradients: Vec<BlockGradient>,
}

impl Fixture {
    fn new(case: Case) -> Self {
        let config = short(&case);
        let (mut model, view) = subject(&case, &config).trained().unwrap_or_else(|e| panic!("{e}"));
        let gradients = view.gradients(&mut model).expect("step");
        let frozen = Frozen::new(case.stop, &view, &mut model);
        Self { case, model, view, frozen, gradients }
    }

    fn rules(&self) -> Rules<'static> {
        Rules { required: self.case.required, exempt: self.case.exempt, ..Rules::default() }
    }

    fn check(&mut self) -> Report {
        let (rules, Self { model, view, frozen, gradients, .. }) = (self.rules(), self);
        check(model, gradients, &mut |m, block| frozen.value(view, m, block), &rules)
    }

    /// Checks one block with another gradient.
    fn check_block(&mut self, gradient: &BlockGradient) -> BlockReport {
        let (rules, Self { model, view, frozen, .. }) = (self.rules(), self);
        check_block(model, gradient, &mut |m, block| frozen.value(view, m, block), &rules)
    }
}

#[test]
fn states_threads_ranks_rows_times_and_rates() {
    for entry in REGISTRY.iter().filter(|m| !m.needs_avatar && m.name != "spacetime") {
        let case = CASES.iter().find(|c| c.method == entry.name).expect("every method has a case");
        let config = short(case);
        let subject = subject(case, &config);
        let all = || {
            subject.rates()?;
            subject.updates()?;
            subject.rows()?;
            subject.times()?;
            subject.state()?;
            subject.threads()?;
            subject.ranks()
        };
        all().unwrap_or_else(|e| panic!("{e}"));
    }
}

#[test]
fn gradients_match_finite_differences() {
    let mut wrong = String::new();
    for case in CASES.iter().filter(|c| c.method != "spacetime") {
        let report = Fixture::new(*case).check();
        println!("{} {:?}\n{report}", case.method, case.over);
        if !report.all_faults().is_empty() {
            wrong += &format!("{} {:?}\n{report}\n", case.method, case.over);
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
}

/// Blocks that no gradient of an image may reach.
const NEVER: &[&str] = &["intervals.starts", "acceleration."];

#[test]
fn every_block_is_checked_in_some_case() {
    for entry in REGISTRY.iter().filter(|m| !m.needs_avatar) {
        let cases: Vec<&Case> = CASES.iter().filter(|c| c.method == entry.name).collect();
        let config = short(cases[0]);
        let (model, _) = subject(cases[0], &config).trained().unwrap_or_else(|e| panic!("{e}"));
        model.visit(&mut |p| {
            let exempt =
                |c: &&Case| Rules { required: c.required, exempt: c.exempt, ..Rules::default() }.is_exempt(&p.name);
            let never = NEVER.iter().any(|n| p.name.starts_with(n));
            assert!(cases.iter().all(exempt) == never, "{} {}", entry.name, p.name);
        });
    }
}

/// Networks of 16 texels a side. The penalty of offsets would be a part of the gradient that the image does not show.
const FILM: &str = "
gaussians.reg = 0.0
textures = { unproject = 16, geo = 16, gau = 16 }
";

#[test]
fn a_filmed_person() {
    let film = film("cylinder", 32, 2);
    let config = testkit::config(&REGISTRY, "dut", "tiny", &[testkit::SHORT_FILM, FILM]);
    let rules = Rules {
        exempt: &[("geo.", "learns in its own stage")],
        // A weight is shared by all texels: on some of them a rectifier bends within a step.
        relative: 0.05,
        rows: 8,
        ..Rules::default()
    };
    // Texels that no camera sees are black, which is where colours are clamped, and texels side by side are equally far
    // away: moved off both.
    let modify = |p: &mut Param| {
        if p.name.starts_with("gau.out.") {
            let mut rng = Rng::new(5, &p.name, 0, 0);
            p.value.iter_mut().for_each(|v| *v += 0.05 * rng.normal());
        }
    };
    let subject = Subject { rules, time: 0.0, modify: &modify, ..Subject::new(&REGISTRY, "dut", &film, &config) };
    subject.check().unwrap_or_else(|e| panic!("{e}"));
}

/// The checks must be able to fail: each fault is found by the check that looks for it.
#[test]
fn broken_methods_are_found() {
    let config = short(&CASES[0]);
    let found = |entry, check: fn(&Subject<'_>) -> Result<(), ConformanceError>| {
        let registry = Registry::new(vec![entry]);
        let error = check(&Subject::new(&registry, "spacetime", &BALLS, &config)).expect_err("found");
        println!("{error}");
        format!("{} {}", error.check, error.place)
    };
    assert!(found(broken::entry::<{ broken::ROWS }>(), |s| s.check()).starts_with("rates time.extra"));
    assert!(found(broken::entry::<{ broken::ROWS }>(), |s| s.rows()).starts_with("rows `time.extra` after step"));
    assert!(found(broken::entry::<{ broken::UPDATES }>(), |s| s.check()).starts_with("updates `idle` in `"));
    assert!(found(broken::entry::<{ broken::STATE }>(), |s| s.check()).starts_with("state resumed at step"));
    assert_eq!(found(broken::entry::<{ broken::THREADS }>(), |s| s.check()), "threads 1 and 2 threads");
    assert_eq!(found(broken::entry::<{ broken::VIEWS }>(), |s| s.check()), "ranks 1 and 2 ranks");
    assert!(found(broken::entry::<{ broken::COUNT }>(), |s| s.check()).starts_with("times time -10"));
    assert_eq!(found(broken::entry::<{ broken::GRADIENTS }>(), |s| s.check()), "gradients block `motion.poly`");
}

/// The checks must be able to fail: every wrong gradient below is reported.
#[test]
fn wrong_gradients_are_reported() {
    let tried = [
        ("spacetime", &["motion.", "time."][..]),
        ("fourdgs", &["cloud.means", "field.planes.xt.0", "field.trunk."]),
        ("modec", &["gad.planes.xt", "gad.positions."]),
    ];
    for (method, blocks) in tried {
        let case = CASES.iter().find(|c| c.method == method).expect("case");
        let mut fixture = Fixture::new(*case);
        for right in fixture.gradients.clone() {
            if !blocks.iter().any(|b| right.name.starts_with(b)) {
                continue;
            }
            for (what, wrong) in corruptions(&right) {
                let report = fixture.check_block(&wrong);
                assert!(!report.faults.is_empty(), "{method} {}, {what}\n{report}", right.name);
            }
        }
        // A block without an entry, and one that does not exist.
        let first = fixture.gradients.iter().position(|g| g.name.starts_with(blocks[0])).expect("block");
        let forgotten = fixture.gradients.remove(first).name;
        fixture.case.required = &["", "nothing."];
        let report = fixture.check();
        assert!(report.has_fault(&forgotten) && report.has_fault("nothing."), "{method} {forgotten}\n{report}");
    }
}

/// Wrong gradients of a block, each with what is wrong about it.
fn corruptions(right: &BlockGradient) -> Vec<(String, BlockGradient)> {
    let with = |what: String, change: &dyn Fn(usize, f32) -> f32| {
        let grad = right.grad.iter().enumerate().map(|(i, g)| change(i, *g)).collect();
        (what, BlockGradient { grad, ..right.clone() })
    };
    let mut all = vec![
        with("sign".into(), &|_, g| -g),
        with("factor 1.1".into(), &|_, g| 1.1 * g),
        with("forgotten".into(), &|_, _| 0.0),
    ];
    let Some(width) = right.row_width else { return all };
    let square = |values: &mut dyn Iterator<Item = f32>| values.map(|v| v * v).sum::<f32>();
    let total = square(&mut right.grad.iter().copied());
    let rows = right.grad.chunks_exact(width).enumerate();
    let mut by_size: Vec<(f32, usize)> = rows.map(|(row, g)| (square(&mut g.iter().copied()), row)).collect();
    by_size.retain(|row| row.0 > 0.0);
    by_size.sort_by(|a, b| a.0.total_cmp(&b.0));
    for place in [by_size.len() / 2, by_size.len() - 1] {
        let row = by_size[place].1;
        all.push(with(format!("row {row} dropped"), &|i, g| if i / width == row { 0.0 } else { g }));
    }
    for column in 0..width {
        let share = square(&mut right.grad.iter().skip(column).step_by(width).copied()) / total;
        if share > 1e-3 {
            all.push(with(format!("column {column} dropped"), &|i, g| if i % width == column { 0.0 } else { g }));
        }
    }
    all
}
