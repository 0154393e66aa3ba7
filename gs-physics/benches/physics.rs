//! Time and error of the roll-out: every integrator on exact motions at 30 steps (one thread), the adjoint, cached steps of
//! the extrapolator, and the savings of classes and groups.
//!
//! Each row is printed and appended to `target/speed-error/gs-physics.jsonl`. `work` counts particle-steps (for an
//! extrapolator, those a fresh roll-out would take), so the rate is in particle-steps.

use criterion::Criterion;
use glam::Vec3;
use gs_core::Rng;
use gs_core::speed::{BenchRow, Stopwatch};
use gs_physics::groups::UNGROUPED;
use gs_physics::refit::{Bodies, Tracks};
use gs_physics::truth::{self, Truth};
use gs_physics::{ClassRule, Extrapolator, Groups, Integrator, Motion, ParticleState, RollTape, Rollout, Twist};
use std::time::Duration;

const PARTICLES: usize = 50_000;
const STEPS: f64 = 30.0;
const UNIT: [f32; 4] = [1.0, 0.0, 0.0, 0.0];
const RULES: [(Integrator, &str); 6] = [
    (Integrator::Euler, "euler"),
    (Integrator::MidParams, "mid params"),
    (Integrator::Rk2, "rk2"),
    (Integrator::Rk4, "rk4"),
    (Integrator::Se3Mid, "se3 mid"),
    (Integrator::Se3Magnus4, "se3 magnus4"),
];
type Failure = Box<dyn std::error::Error>;

/// A measured row without its time.
struct Row {
    case: String,
    variant: &'static str,
    work: f64,
    threads: usize,
    error: f64,
    error_kind: &'static str,
}

/// Measures `f`, prints the row with the median, and records it.
fn measure(c: &mut Criterion, row: Row, mut f: impl FnMut()) {
    let mut laps = Stopwatch::default();
    c.bench_function(&format!("{}/{}/{PARTICLES}", row.case, row.variant), |b| {
        b.iter_custom(|calls| laps.run(calls, &mut f))
    });
    let Some(ms) = laps.median_ms() else { return };
    let line = BenchRow {
        krate: "gs-physics",
        case: row.case,
        variant: row.variant.to_owned(),
        n: PARTICLES,
        threads: row.threads,
        ms,
        work: row.work,
        error: Some(row.error),
        error_kind: row.error_kind,
    };
    line.append(env!("CARGO_MANIFEST_DIR"));
}

/// The particle of a truth, many times over.
struct Cloud {
    motions: Vec<Motion<f32>>,
    means: Vec<Vec3>,
    quats: Vec<[f32; 4]>,
}

impl Cloud {
    fn of(truth: &Truth) -> Self {
        let start = Vec3::from_array(truth.start.map(|v| v as f32));
        let motions = vec![truth.motion.to_f32(); PARTICLES];
        Self { motions, means: vec![start; PARTICLES], quats: vec![UNIT; PARTICLES] }
    }
}

/// Every integrator on a truth at 30 steps, from the same start each time.
fn integrators(c: &mut Criterion, truth: &Truth, threads: usize) -> Result<(), Failure> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let cloud = Cloud::of(truth);
    let span = [0.0, truth.span];
    for (rule, variant) in RULES {
        let rollout = Rollout { rule, dt: truth.span / STEPS, origin: Vec3::ZERO };
        let (mut means, mut quats) = (cloud.means.clone(), cloud.quats.clone());
        rollout.advance(&cloud.motions, span, &mut means, &mut quats);
        let error = truth.position_error(means[0].as_dvec3().to_array());
        let (case, work) = (truth.name.into(), PARTICLES as f64 * STEPS);
        measure(c, Row { case, variant, work, threads, error, error_kind: "from truth" }, || {
            means.copy_from_slice(&cloud.means);
            quats.copy_from_slice(&cloud.quats);
            pool.install(|| rollout.advance(&cloud.motions, span, &mut means, &mut quats));
        });
    }
    Ok(())
}

/// As in training: two steps forward with a tape, and backward.
fn training(c: &mut Criterion) {
    let truth = truth::tumble();
    let cloud = Cloud::of(&truth);
    let d = ParticleState {
        means: vec![Vec3::new(0.3, -0.5, 0.7); PARTICLES],
        rotations: vec![[0.1, 0.4, -0.2, 0.6]; PARTICLES],
    };
    let span = [0.0, 1.0 / 15.0];
    for (rule, variant) in [(Integrator::Rk2, "rk2, 2 steps"), (Integrator::Se3Mid, "se3 mid, 2 steps")] {
        let rollout = Rollout { rule, dt: 1.0 / 30.0, origin: Vec3::ZERO };
        let (mut means, mut quats) = (cloud.means.clone(), cloud.quats.clone());
        let (mut tape, mut grads) = (RollTape::default(), vec![Motion::default(); PARTICLES]);
        let mut go = |grads: &mut Vec<Motion<f32>>| {
            means.copy_from_slice(&cloud.means);
            quats.copy_from_slice(&cloud.quats);
            rollout.advance_taped(&cloud.motions, span, &mut means, &mut quats, &mut tape);
            rollout.adjoint(&cloud.motions, &tape, &d, grads)
        };
        go(&mut grads);
        let pose = (truth.start, UNIT.map(f64::from));
        let weight = (d.means[0].as_dvec3().to_array(), d.rotations[0].map(f64::from));
        let (want, _) = gs_physics::reference::adjoint(&rollout, &truth.motion, span, pose, weight);
        let largest = want.to_array().iter().fold(0.0f64, |a, v| a.max(v.abs()));
        let off = grads[0].to_array().into_iter().zip(want.to_array()).map(|(g, w)| (f64::from(g) - w).abs());
        let error = off.fold(0.0, f64::max) / largest;
        let kind = "gradient relative to f64";
        let (work, threads) = (2.0 * PARTICLES as f64, rayon::current_num_threads());
        let row = Row { case: "forward and backward".into(), variant, work, threads, error, error_kind: kind };
        measure(c, row, || drop(go(&mut grads)));
    }
}

/// A scene: half of the particles rest, a quarter belong to three bodies, an eighth translate, the rest rotate or tumble on
/// their own.
fn scene() -> (Vec<Motion<f32>>, Vec<Vec3>, Vec<u32>) {
    let mut rng = Rng::new(1, "scene", 0, 0);
    let bodies = [truth::wheel().motion, truth::tumble().motion, truth::spin_up().motion];
    let (mut motions, mut means, mut labels) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..PARTICLES {
        let mut vec = |s: f32| -> [f32; 3] { std::array::from_fn(|_| s * rng.normal()) };
        let body = (i / 8) % 3;
        let still = Twist::default();
        let (motion, label) = match i % 8 {
            0..4 => (Motion::default(), UNGROUPED),
            4 | 5 => (bodies[body].to_f32(), body as u32),
            6 => {
                let flies = |v| Twist { v, w: [0.0; 3] };
                (Motion { twist: flies(vec(1.0)), rate: flies([0.0, 0.0, -9.81]), jerk: still }, UNGROUPED)
            }
            _ if i % 16 == 7 => {
                (Motion { twist: Twist { v: vec(1.0), w: vec(3.0) }, rate: still, jerk: still }, UNGROUPED)
            }
            _ => {
                let twist = |vec: &mut dyn FnMut(f32) -> [f32; 3]| Twist { v: vec(1.0), w: vec(1.0) };
                (Motion { twist: twist(&mut vec), rate: twist(&mut vec), jerk: still }, UNGROUPED)
            }
        };
        motions.push(motion);
        means.push(Vec3::from_array(vec(0.5)));
        labels.push(label);
    }
    (motions, means, labels)
}

/// 18 frames ahead, with a cold and a warm cache; reductions on and off.
fn extrapolation(c: &mut Criterion) -> Result<(), Failure> {
    let (motions, means, labels) = scene();
    let quats = vec![UNIT; PARTICLES];
    let rollout = Rollout { rule: Integrator::Se3Mid, dt: 1.0 / 30.0, origin: Vec3::ZERO };
    let plain = Extrapolator::new(rollout, 0.7, motions.clone(), means.clone(), quats)?;
    let (rule, reach) = (ClassRule { tolerance: 1e-3, horizon: 0.3 }, vec![0.01; PARTICLES]);
    let groups = Groups::fit(&rule, &labels, &motions, &means, rollout.origin, &reach)?;
    let classes = plain.clone().reduce(&rule, &reach, None)?;
    let grouped = plain.clone().reduce(&rule, &reach, Some(groups))?;
    println!("    static, translation, constant twist, fixed axis, general: {:?}", classes.counts().classes);
    println!("    with groups: {:?}", grouped.counts());
    let frames: Vec<f64> = (1..=18).map(|k| 0.7 + f64::from(k) / 60.0).collect();
    let work = |frames: &[f64]| frames.iter().map(|t| rollout.steps([0.7, *t]).len()).sum::<usize>() * PARTICLES;
    let want: Vec<Vec3> = plain.clone().at(1.0).0.to_vec();
    let off = |e: &Extrapolator| {
        let mut e = e.clone();
        let got = e.at(1.0).0;
        got.iter().zip(&want).map(|(a, b)| f64::from((*a - *b).length())).fold(0.0, f64::max)
    };
    let row = |case: &str, variant, work: usize, error| Row {
        case: case.into(),
        variant,
        work: work as f64,
        threads: rayon::current_num_threads(),
        error,
        error_kind: "worst, to all steps",
    };
    for (variant, e) in [("all steps", &plain), ("classes", &classes), ("classes and groups", &grouped)] {
        let mut asked = e.clone();
        measure(c, row("18 frames, cold", variant, work(&frames), off(e)), || {
            asked = e.clone();
            frames.iter().for_each(|t| {
                asked.at(*t);
            });
        });
        measure(c, row("18 frames, again", variant, work(&frames), off(e)), || {
            frames.iter().for_each(|t| {
                asked.at(*t);
            });
        });
    }
    let (mut x, mut q) = (means.clone(), vec![UNIT; PARTICLES]);
    measure(c, row("18 frames, cold", "fresh roll-outs", work(&frames), 0.0), || {
        for t in &frames {
            x.copy_from_slice(&means);
            q.fill(UNIT);
            rollout.advance(&motions, [0.0, t - 0.7], &mut x, &mut q);
        }
    });
    Ok(())
}

/// Two bodies, one thrown and one at rest, refitted through 28 frames whose velocities are off by 5 %: the error is the largest
/// of a place of the thrown one as far ahead as was seen behind.
fn refitting(c: &mut Criterion) {
    const FRAMES: u32 = 28;
    let (v, a) = (Vec3::new(1.0, 0.4, 2.0), Vec3::Z * -4.0);
    let moves = |i: usize| if i.is_multiple_of(2) { 1.0 } else { 0.0 };
    let fall = |t: f32| v * t + a * (0.5 * t * t);
    let begin: Vec<Vec3> = (0..PARTICLES)
        .map(|i| {
            let mut rng = Rng::new(2, "refit", 0, i as u64);
            Vec3::new(rng.range(-0.3, 0.3), rng.range(-0.3, 0.3), rng.range(-0.3, 0.3))
        })
        .collect();
    let mut tracks = Tracks::default();
    for k in 0..FRAMES {
        let t = -0.02 * k as f32;
        let mut rng = Rng::new(3, "refit", k, 0);
        tracks.taus.push(f64::from(t));
        tracks.means.push(begin.iter().enumerate().map(|(i, x)| *x + fall(t) * moves(i)).collect());
        let motion = |i: usize| {
            let v = (v + a * t) * (moves(i) * (1.0 + 0.05 * rng.normal()));
            Motion { twist: Twist { v: v.to_array(), w: [0.0; 3] }, ..Motion::default() }
        };
        tracks.motions.push((0..PARTICLES).map(motion).collect());
    }
    let weights = vec![0.9; PARTICLES];
    let bodies = Bodies::fit(&tracks, &weights);
    let ahead = 0.02 * FRAMES as f32;
    let off = |i: usize| {
        let body = &bodies.list[bodies.of[i] as usize];
        f64::from(body.carry(ahead.into(), begin[i]).distance(begin[i] + fall(ahead)))
    };
    let error = (0..PARTICLES).step_by(2).filter(|i| bodies.of[*i] != UNGROUPED).map(off).fold(0.0, f64::max);
    let row = Row {
        case: "refit".to_owned(),
        variant: "28 frames",
        work: PARTICLES as f64 * f64::from(FRAMES),
        threads: rayon::current_num_threads(),
        error,
        error_kind: "place",
    };
    measure(c, row, || {
        std::hint::black_box(Bodies::fit(&tracks, &weights));
    });
}

fn main() -> Result<(), Failure> {
    let mut c = Criterion::default()
        .sample_size(15)
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_millis(900))
        .without_plots()
        .configure_from_args();
    for truth in [truth::circle(), truth::wheel(), truth::tumble()] {
        integrators(&mut c, &truth, 1)?;
    }
    training(&mut c);
    refitting(&mut c);
    extrapolation(&mut c)
}
