use super::*;
use glam::Vec3;
use gs_core::{Camera, Rng, SplatsRef};
use gs_data::PointCloud;
use gs_deform::{DefGsConfig, DefMlp};
use gs_physics::{Integrator, Law, LawConfig, Motion, Twist, VelocityConfig, VelocityField};
use gs_train::capabilities::{Inspect, ParticleSource};
use gs_train::registry::section;
use gs_train::scene::CloudConfig;
use gs_train::schedule::Schedule;
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use std::time::Duration;

mod spans;

/// One twist for all particles, one Euler step; turns are not normalised. Simple enough to differentiate by hand.
struct OneTwist(Param);

impl Params for OneTwist {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        f(&self.0);
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        f(&mut self.0);
    }
}

impl OneTwist {
    fn parts(&self) -> [Vec3; 2] {
        [Vec3::from_slice(&self.0.value[..3]), Vec3::from_slice(&self.0.value[3..])]
    }
}

impl Dynamics for OneTwist {
    /// The step.
    type Tape = f32;

    fn integrate(&self, Start { x, t: from, .. }: Start<'_>, to: f64, h: &mut f32, out: &mut ParticleState) {
        // A thread of a pool that waits for others takes up what the pool has left to do.
        rayon::yield_now();
        let [v, w] = self.parts();
        *h = (to - from) as f32;
        out.means = x.iter().map(|&x| x + *h * (v + w.cross(x))).collect();
        let half = 0.5 * *h * w;
        out.rotations = vec![[1.0, half.x, half.y, half.z]; x.len()];
    }

    fn integrate_backward(&mut self, start: Start<'_>, h: &mut f32, d: &ParticleState) {
        for ((x, d_mean), d_turn) in start.x.iter().zip(&d.means).zip(&d.rotations) {
            let d_w = *h * (x.cross(*d_mean) + 0.5 * Vec3::from_slice(&d_turn[1..]));
            let all = (*h * *d_mean).to_array().into_iter().chain(d_w.to_array());
            self.0.grad.iter_mut().zip(all).for_each(|(g, d)| *g += d);
        }
    }

    fn motions(&self, start: Start<'_>) -> Vec<Motion<f32>> {
        let [v, w] = self.parts().map(|p| p.to_array());
        vec![Motion { twist: Twist { v, w }, ..Motion::default() }; start.x.len()]
    }

    fn motions_extrapolate(&self) -> bool {
        true
    }

    fn origin(&self) -> Vec3 {
        Vec3::ZERO
    }
}

const CONFIG: PhysicsConfig = PhysicsConfig {
    step_frames: 2.0,
    reach: 1,
    reach_until: 1.0,
    direct: 0.0,
    back_frames: 3.0,
    start: 0.0,
    inside: Inside::Field,
    field: true,
    turn_colours: false,
    slack: 0.0,
    bodies: 0,
    refit: false,
    settle: 0.0,
    settle_frames: 0.0,
    turn_gradients: false,
};

/// The schedule of the tests: stages `warm_up` to step 120 and `dynamic` to step 1000.
fn schedule() -> Schedule {
    let defgs = gs_methods::registry().find("defgs").and_then(|m| m.config("tiny")).unwrap();
    section("defgs", &defgs, "schedule").unwrap()
}

fn begin(method: &mut impl Method, step: u32) {
    method.begin_step(&schedule().at(step));
}

/// Hands the splats of a step to a function that writes their cotangents, with empty statistics.
struct Given<F> {
    cotangents: F,
    stats: ScreenStats,
}

impl<F: FnMut(SplatsRef<'_>, &mut SplatsGrad)> RenderView for Given<F> {
    fn render(&mut self, splats: SplatsRef<'_>, grad: &mut SplatsGrad) -> Result<&ScreenStats, MethodError> {
        grad.reset(splats);
        (self.cotangents)(splats, grad);
        let n = splats.len();
        self.stats = ScreenStats { grad_means2d: vec![[0.0; 2]; n], radii: vec![0.0; n] };
        Ok(&self.stats)
    }
}

/// One view of a step, `cotangents` given.
fn step_with(m: &mut impl Method, t: f32, cotangents: impl FnMut(SplatsRef<'_>, &mut SplatsGrad)) {
    let camera = Camera::look_at(8, 8, 0.7, glam::DVec3::Z * 5.0, glam::DVec3::ZERO, glam::DVec3::Y).unwrap();
    let view = ViewCtx { at: Timestamp::new(at(f64::from(t))), camera: &camera, draw: 0, last: false };
    m.step(&view, &mut Given { cotangents, stats: ScreenStats::default() }).unwrap();
}

fn method(config: PhysicsConfig, zero_init: bool) -> Advected<DefMlp, OneTwist> {
    let twist = OneTwist(Param::shared("physics.twist", vec![0.4, -0.3, 0.2, 0.5, 0.1, -0.6]));
    method_of(twist, config, zero_init)
}

/// Twelve points, frames a twentieth apart, the last at 0.75: Δt = 0.1, T_def = 0.6.
fn method_of<D: Dynamics>(dynamics: D, config: PhysicsConfig, zero_init: bool) -> Advected<DefMlp, D> {
    let mut rng = Rng::new(3, "points", 0, 0);
    let positions: Vec<Vec3> = (0..12).map(|_| Vec3::new(rng.normal(), rng.normal(), rng.normal())).collect();
    let points = PointCloud { colors: vec![[0.5; 3]; 12], positions };
    let bounds = [Vec3::splat(-2.0), Vec3::splat(2.0)];
    let scene = SceneInfo {
        points,
        extent: 1.0,
        bounds,
        views: 16,
        timestamps: 16,
        last_time: 0.75,
        frame_interval: 0.05,
        first_interval: 0.05,
        view_spacing: 6.0,
        seed: 5,
        avatar: None,
        max_parameters: gs_train::scene::MAX_PARAMETERS,
    };
    let defgs = gs_methods::registry().find("defgs").and_then(|m| m.config("tiny")).unwrap();
    let cloud: CloudConfig = section("defgs", &defgs, "cloud").unwrap();
    let canonical = Canonical::new(&cloud, &mut schedule(), &scene).unwrap();
    let width =
        DefGsConfig { width: 16, depth: 2, time_hidden: 8, time_features: 4, zero_init, ..DefGsConfig::default() };
    let field = DefMlp::new(&width, 1).unwrap();
    let mut method = Advected::new(canonical, field, dynamics, config, &scene).unwrap();
    begin(&mut method, 500);
    method
}

fn splats(method: &impl Method, t: f32) -> Splats {
    let camera = Camera::look_at(8, 8, 0.7, glam::DVec3::Z * 5.0, glam::DVec3::ZERO, glam::DVec3::Y).unwrap();
    method.splats(&Timestamp::new(at(f64::from(t))), &camera).unwrap()
}

#[test]
fn the_first_moving_step_draws_what_the_warm_up_drew() {
    let mut m = method(CONFIG, true);
    begin(&mut m, 120);
    assert!(!m.canonical.at.dynamic);
    let before = splats(&m, 0.0);
    begin(&mut m, 121);
    assert!(m.canonical.at.dynamic);
    assert_eq!(splats(&m, 0.0), before);
}

/// `Σ a·mean + Σ b·quat` of what a step renders, and the gradients it leaves.
fn learn(m: &mut Advected<DefMlp, OneTwist>, t: f32) -> f64 {
    let mut loss = 0.0;
    m.visit_mut(&mut Param::clear_grad);
    step_with(m, t, |s, d| {
        let mut rng = Rng::new(9, "weights", 0, 0);
        for i in 0..s.len() {
            d.means[i] = Vec3::new(rng.normal(), rng.normal(), rng.normal());
            d.quats[i] = std::array::from_fn(|_| rng.normal());
            loss += f64::from(d.means[i].dot(s.means[i]));
            loss += s.quats[i].iter().zip(d.quats[i]).map(|(q, d)| f64::from(q * d)).sum::<f64>();
        }
    });
    loss
}

#[test]
fn dynamics_learn_from_the_end_and_centres_as_if_the_displacement_were_constant() {
    for t in [0.3, 0.7] {
        let mut m = method(CONFIG, false);
        learn(&mut m, t);
        let got = m.dynamics.0.grad.clone();
        for (k, got) in got.iter().enumerate() {
            let mut at = |h: f32| {
                m.dynamics.0.value[k] += h;
                let loss = learn(&mut m, t);
                m.dynamics.0.value[k] -= h;
                loss
            };
            let want = (at(1e-2) - at(-1e-2)) / 2e-2;
            assert!((f64::from(*got) - want).abs() < 2e-4 * (1.0 + want.abs()), "{t} {k}: {got} {want}");
        }
        let mut rng = Rng::new(9, "weights", 0, 0);
        let mut means = Vec::new();
        m.canonical.cloud.visit(&mut |p| {
            if p.name == "cloud.means" {
                means.clone_from(&p.grad)
            }
        });
        for d in means.as_chunks::<3>().0 {
            assert_eq!(*d, [rng.normal(), rng.normal(), rng.normal()], "the cotangent passes unchanged");
            let _skipped: [f32; 4] = std::array::from_fn(|_| rng.normal());
        }
    }
}

/// A rigid motion takes `x` to `R x + b`: `⟨d, R x⟩ = ⟨Rᵀ d, x⟩`.
#[test]
fn gradients_of_centres_turn_back_with_their_particles() {
    let mut m = method(PhysicsConfig { turn_gradients: true, ..CONFIG }, false);
    let turn = {
        let (mut h, mut out) = Default::default();
        let x = [Vec3::ZERO];
        m.dynamics.integrate(Start { x: &x, t: 0.6, middle: Vec3::ZERO }, f64::from(0.7f32), &mut h, &mut out);
        rot::to_glam(out.rotations[0]).normalize()
    };
    learn(&mut m, 0.7);
    let (mut rng, mut means) = (Rng::new(9, "weights", 0, 0), Vec::new());
    m.canonical.cloud.visit(&mut |p| {
        if p.name == "cloud.means" {
            means.clone_from(&p.grad);
        }
    });
    let x = Vec3::new(0.3, -0.8, 0.5);
    for got in means.as_chunks::<3>().0 {
        let d = Vec3::new(rng.normal(), rng.normal(), rng.normal());
        assert!((Vec3::from_array(*got).dot(x) - d.dot(turn * x)).abs() < 1e-5, "{got:?} {d}");
        let _skipped: [f32; 4] = std::array::from_fn(|_| rng.normal());
    }
}

#[test]
fn turns_hand_their_cotangent_on_by_the_product_rule() {
    let (p, r, d) = ([0.9f32, 0.1, -0.3, 0.2], [0.5f32, -0.4, 0.6, 0.3], [0.2f32, 0.7, -0.1, 0.4]);
    let dot = |a: [f32; 4]| -> f64 { a.iter().zip(d).map(|(a, d)| f64::from(*a) * f64::from(d)).sum() };
    let (d_p, d_r) = (rot::hamilton(d, rot::conjugate(r)), rot::hamilton(rot::conjugate(p), d));
    for k in 0..4 {
        let unit: [f32; 4] = std::array::from_fn(|i| f32::from(u8::from(i == k)));
        assert!((f64::from(d_p[k]) - dot(rot::hamilton(unit, r))).abs() < 1e-6, "linear in the turn");
        assert!((f64::from(d_r[k]) - dot(rot::hamilton(p, unit))).abs() < 1e-6, "linear in what was turned");
    }
}

/// Coefficients learn through their turn: the loss is linear in them. At every time rendered, a turn keeps lengths and leaves
/// the first coefficient alone.
#[test]
fn colours_turn_with_their_splats() {
    let mut m = method(PhysicsConfig { turn_colours: true, ..CONFIG }, false);
    let plain = method(CONFIG, false);
    let mut rng = Rng::new(8, "lobes", 0, 0);
    let mut fill = |p: &mut Param| {
        if p.name == "cloud.sh_rest" {
            p.value.iter_mut().for_each(|v| *v = rng.normal());
        }
    };
    m.visit_mut(&mut fill);
    let lobes = |m: &Advected<DefMlp, OneTwist>| {
        let mut all = Vec::new();
        m.visit(&mut |p| all.extend(if p.name == "cloud.sh_rest" { p.grad.clone() } else { Vec::new() }));
        all
    };
    let step = |m: &mut Advected<DefMlp, OneTwist>| {
        let mut loss = 0.0;
        m.visit_mut(&mut Param::clear_grad);
        step_with(m, 0.3, |s, d| {
            let (mut rng, gs_core::Color::Sh { coeffs, .. }) = (Rng::new(9, "weights", 0, 0), s.color) else {
                panic!("a cloud has spherical harmonics")
            };
            d.color.iter_mut().for_each(|d| *d = rng.normal());
            loss = coeffs.iter().zip(&d.color).map(|(c, d)| f64::from(c * d)).sum();
        });
        loss
    };
    step(&mut m);
    let got = lobes(&m);
    for k in [0, 7, got.len() - 1] {
        let mut at = |h: f32| {
            m.visit_mut(&mut |p| {
                if p.name == "cloud.sh_rest" {
                    p.value[k] += h
                }
            });
            let at = m.canonical.at.clone();
            m.begin_step(&at);
            step(&mut m)
        };
        let (hi, lo) = (at(0.5), at(-1.0));
        at(0.5);
        assert!((f64::from(got[k]) - (hi - lo)).abs() < 1e-4 * (1.0 + (hi - lo).abs()), "{k}: {} {}", got[k], hi - lo);
    }
    for t in [0.3, 0.7, 1.5] {
        let (turned, still) = (splats(&m, t), m.canonical.activated());
        assert_eq!(turned.means, splats(&plain, t).means, "only colours differ");
        let (gs_core::Color::Sh { degree, coeffs: a }, gs_core::Color::Sh { coeffs: b, .. }) =
            (turned.color, still.color)
        else {
            panic!("a cloud has spherical harmonics")
        };
        assert!(degree >= 1 && a != b, "the test has lobes, and they turn");
        for (a, b) in a.chunks(3 * gs_core::sh::coeffs(degree)).zip(b.chunks(3 * gs_core::sh::coeffs(degree))) {
            let length = |v: &[f32]| v[3..].iter().map(|v| v * v).sum::<f32>();
            assert!(a[..3] == b[..3] && (length(a) - length(b)).abs() < 1e-4 * length(b));
        }
    }
}

#[test]
fn what_comes_after_starts_from_the_last_deformation() {
    let m = method(CONFIG, false);
    let canonical = m.canonical.activated();
    let begin = m.deformed(canonical.geometry(), m.times.last_field);
    let mut moves = ParticleState::default();
    let t = f64::from(1.5f32);
    m.dynamics.integrate(m.start(&canonical, &begin.means, m.times.last_field), t, &mut 0.0, &mut moves);
    let ahead = splats(&m, 1.5);
    assert_eq!(ahead.means, moves.means);
    assert_eq!(splats(&m, 1.5), ahead, "what is kept gives the same again");
    assert_eq!(
        splats(&m, 0.3).geometry(),
        m.deformed(canonical.geometry(), f64::from(0.3f32)).view(),
        "inside, the field alone"
    );
    let step = method(PhysicsConfig { inside: Inside::Step, ..CONFIG }, false);
    assert_ne!(splats(&step, 0.3), splats(&m, 0.3));
    assert_eq!(splats(&step, 1.5), ahead, "the ways differ inside only");
}

/// What a thread takes up while it waits may ask for another such time.
#[test]
fn times_after_the_last_field_time_may_be_asked_for_together() {
    const TIMES: [f32; 8] = [0.7, 1.5, 0.8, 1.4, 0.9, 1.3, 1.0, 1.2];
    let (answer, answered) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let m = method(CONFIG, false);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
        let together: Vec<Splats> = pool.install(|| TIMES.par_iter().map(|t| splats(&m, *t)).collect());
        // After the time-out nobody listens.
        answer.send(together).ok();
    });
    let together = answered.recv_timeout(Duration::from_secs(60)).expect("no thread waits for itself");
    let m = method(CONFIG, false);
    assert_eq!(together, TIMES.map(|t| splats(&m, t)));
}

/// `T_def` is 0.6.
#[test]
fn motions_before_the_last_field_time_are_those_of_that_time() {
    fn given<D: Dynamics>(m: &Advected<DefMlp, D>, t: f64) -> bool {
        let x = splats(m, t as f32).means;
        let want = m.dynamics.motions(m.start(&m.canonical.activated(), &x, f64::from(t as f32)));
        let rows: Vec<_> =
            want.iter().map(|m| [m.twist.v, m.twist.w, m.rate.v, m.rate.w, m.jerk.v, m.jerk.w]).collect();
        m.twists_at(f64::from(t as f32)).is_some_and(|found| found == rows)
    }
    let law = |config| method_of(Law::new(&LawConfig::small(), Vec3::ZERO, 0.1, 1).unwrap(), config, false);
    let m = law(CONFIG);
    assert!(given(&m, 0.3) && m.twists_at(0.7).is_none(), "it goes on after that time alone");
    assert!(law(PhysicsConfig { settle: 0.3, ..CONFIG }).twists_at(0.3).is_none(), "and before, where it has settled");
    let flow = VelocityConfig { hidden: 8, depth: 2, ..VelocityConfig::small() };
    let flow = VelocityField::new(&flow, [Vec3::splat(-2.0), Vec3::splat(2.0)], 0.1, 1).unwrap();
    let m = method_of(flow, PhysicsConfig { settle: 0.3, ..CONFIG }, false);
    assert!(given(&m, 0.3) && given(&m, 0.9), "a flow is evaluated at every time");
}

#[test]
fn settings_without_effect_are_named() {
    let all = PhysicsConfig { refit: true, slack: 0.01, bodies: 3, ..CONFIG };
    let law = |integrator, config| {
        let law = LawConfig { integrator, ..LawConfig::small() };
        method_of(Law::new(&law, Vec3::ZERO, 0.1, 1).unwrap(), config, true).warnings()
    };
    let warnings = law(Integrator::Rk2, all);
    assert!(
        warnings.len() == 2 && warnings[0].contains("physics.slack") && warnings[1].contains("physics.bodies"),
        "{warnings:?}"
    );
    assert!(law(Integrator::Se3Mid, all).is_empty() && law(Integrator::Rk2, CONFIG).is_empty());
    assert_eq!(method(all, true).warnings().len(), 3);
}

#[test]
fn impossible_settings_are_named() {
    for (config, name) in [
        (PhysicsConfig { step_frames: 0.0, ..CONFIG }, "step_frames"),
        (PhysicsConfig { reach_until: 0.0, ..CONFIG }, "reach_until"),
        (PhysicsConfig { back_frames: f32::NAN, ..CONFIG }, "back_frames"),
        (PhysicsConfig { start: 1.0, ..CONFIG }, "start"),
        (PhysicsConfig { slack: -0.1, ..CONFIG }, "slack"),
        (PhysicsConfig { bodies: 1001, ..CONFIG }, "bodies"),
        (PhysicsConfig { settle: 1.5, ..CONFIG }, "settle"),
        (PhysicsConfig { settle_frames: -1.0, ..CONFIG }, "settle_frames"),
    ] {
        assert!(config.check().unwrap_err().contains(name));
    }
}
