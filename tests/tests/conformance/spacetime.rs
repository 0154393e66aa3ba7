//! Spacetime Gaussians, lite (Li et al. 2024, arXiv 2312.16812, sections 3.1 and 4.2; colours are spherical harmonics).
//!
//! Every splat has a temporal centre `μ`. With `τ = t − μ`:
//! ```text
//! means(t)     = m + b₁ τ + b₂ τ² + b₃ τ³
//! quats(t)     = q + c τ
//! opacities(t) = σ(o) g,   g = exp(−s τ²),   s = exp(log_rate)
//! ```
//! Backward, with cotangents `d` of the moved splats and `o' = σ(o) g`:
//! ```text
//! d_m = d_means      d_bₖ = d_means τᵏ      d_q = d_quats      d_c = d_quats τ      d_σ(o) = d_opacities g
//! d_τ = d_means·(b₁ + 2 b₂ τ + 3 b₃ τ²) + d_quats·c − 2 s τ o' d_opacities
//! d_μ = −d_τ         d_log_rate = −s τ² o' d_opacities
//! ```

use glam::Vec3;
use gs_core::{Camera, Param, Params, Rng, Splats};
use gs_train::canonical::Canonical;
use gs_train::capabilities::{Capabilities, Inspect, Quantity};
use gs_train::method::{Buffer, BufferMut, Buffers, LossValue, Method, MethodError, RenderView, StepEvents, ViewCtx};
use gs_train::model::Model;
use gs_train::registry::{MethodEntry, parse_config};
use gs_train::report::{Chart, Curve, Scale, Section};
use gs_train::scene::{CloudConfig, InitConfig, SceneInfo};
use gs_train::schedule::Schedule;
use gs_train::step::StepCtx;
use gs_train::timestamp::Timestamp;
use serde::Deserialize;
use serde_json::Value;

/// The line in the list of methods.
pub const ENTRY: MethodEntry = MethodEntry {
    name: "spacetime",
    about: "Spacetime Gaussians, lite: polynomial motion and temporal opacity of each splat (Li et al. 2024)",
    defaults: &[include_str!("spacetime.toml")],
    presets: &[("paper", &[]), ("tiny", &[include_str!("spacetime.tiny.toml")])],
    domains: &[],
    needs_avatar: false,
    grows: None,
    effective: None,
    build,
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    #[serde(rename = "init")]
    _init: InitConfig,
    cloud: CloudConfig,
    time: TimeConfig,
    schedule: Schedule,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TimeConfig {
    /// Natural logarithm of the first `s`, per square of the normalised time.
    log_rate: f32,
}

struct Spacetime {
    canonical: Canonical,
    /// `[n, 9]`: b₁, b₂, b₃, world units.
    motion: Param,
    /// `[n, 4]`: c.
    spin: Param,
    /// `[n, 1]`: μ, normalised time.
    centers: Param,
    /// `[n, 1]`: ln s.
    log_rates: Param,
    moved: Splats,
}

/// The motion of one splat at one time.
struct Row {
    tau: f32,
    b: [Vec3; 3],
    c: [f32; 4],
    rate: f32,
    gate: f32,
}

fn build(table: &toml::Table, scene: &SceneInfo) -> Result<Model, MethodError> {
    let Config { cloud, time, mut schedule, .. } = parse_config(ENTRY.name, table)?;
    let canonical = Canonical::new(&cloud, &mut schedule, scene)?;
    let n = canonical.cloud.len();
    let center = |i| Rng::new(scene.seed, "spacetime-centers", 0, i as u64).uniform();
    let method = Spacetime {
        canonical,
        motion: Param::rows("motion.poly", 9, vec![0.0; 9 * n]),
        spin: Param::rows("motion.spin", 4, vec![0.0; 4 * n]),
        centers: Param::rows("time.centers", 1, (0..n).map(center).collect()),
        log_rates: Param::rows("time.log_rates", 1, vec![time.log_rate; n]),
        moved: Splats::default(),
    };
    Model::new(ENTRY.name, method, schedule)
}

impl Spacetime {
    fn row(&self, i: usize, t: f32) -> Row {
        let (tau, rate) = (t - self.centers.value[i], self.log_rates.value[i].exp());
        let b = std::array::from_fn(|k| Vec3::from_slice(&self.motion.value[9 * i + 3 * k..]));
        let c = std::array::from_fn(|k| self.spin.value[4 * i + k]);
        Row { tau, b, c, rate, gate: (-rate * tau * tau).exp() }
    }

    /// The canonical splats at time `t`.
    fn forward(&self, canonical: &Splats, t: f32, moved: &mut Splats) {
        moved.clone_from(canonical);
        for i in 0..canonical.len() {
            let Row { tau, b, c, gate, .. } = self.row(i, t);
            moved.means[i] += tau * (b[0] + tau * (b[1] + tau * b[2]));
            moved.quats[i].iter_mut().zip(c).for_each(|(q, c)| *q += tau * c);
            moved.opacities[i] *= gate;
        }
    }

    /// Pulls the cotangents of the splats at time `t` into the gradients of motion and time and, in place, to the canonical
    /// splats.
    fn backward(&mut self, t: f32) {
        for i in 0..self.moved.len() {
            let Row { tau, b, c, rate, gate } = self.row(i, t);
            let d = &mut self.canonical.d_splats;
            let (d_mean, d_quat, d_gate) = (d.means[i], d.quats[i], d.opacities[i] * self.moved.opacities[i]);
            d.opacities[i] *= gate;
            for (k, power) in [tau, tau * tau, tau * tau * tau].into_iter().enumerate() {
                let grad = &mut self.motion.grad[9 * i + 3 * k..][..3];
                grad.iter_mut().zip((power * d_mean).to_array()).for_each(|(g, d)| *g += d);
            }
            self.spin.grad[4 * i..][..4].iter_mut().zip(d_quat).for_each(|(g, d)| *g += tau * d);
            let d_tau = d_mean.dot(b[0] + tau * (2.0 * b[1] + 3.0 * tau * b[2]))
                + d_quat.iter().zip(c).map(|(d, c)| d * c).sum::<f32>()
                - 2.0 * rate * tau * d_gate;
            self.centers.grad[i] -= d_tau;
            self.log_rates.grad[i] -= rate * tau * tau * d_gate;
        }
    }
}

impl Params for Spacetime {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.canonical.cloud.visit(f);
        [&self.motion, &self.spin, &self.centers, &self.log_rates].into_iter().for_each(f);
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.canonical.cloud.visit_mut(f);
        [&mut self.motion, &mut self.spin, &mut self.centers, &mut self.log_rates].into_iter().for_each(f);
    }
}

impl Buffers for Spacetime {
    fn buffers(&self, f: &mut dyn FnMut(Buffer<'_>)) {
        self.canonical.buffers(f);
    }

    fn buffers_mut(&mut self, f: &mut dyn FnMut(BufferMut<'_>)) {
        self.canonical.buffers_mut(f);
    }
}

impl Method for Spacetime {
    fn begin_step(&mut self, at: &StepCtx) {
        self.canonical.begin_step(at);
    }

    fn splats(&self, at: &Timestamp, _camera: &Camera) -> Result<Splats, MethodError> {
        let mut moved = Splats::default();
        self.forward(&self.canonical.activated(), at.t.normalised, &mut moved);
        Ok(moved)
    }

    fn step(&mut self, view: &ViewCtx<'_>, render: &mut dyn RenderView) -> Result<Vec<LossValue>, MethodError> {
        let t = view.at.t.normalised;
        self.canonical.forward();
        let mut moved = std::mem::take(&mut self.moved);
        self.forward(&self.canonical.splats, t, &mut moved);
        self.moved = moved;
        let stats = render.render(self.moved.view(), &mut self.canonical.d_splats)?;
        self.backward(t);
        self.canonical.backward();
        self.canonical.accumulate(stats, view.camera);
        Ok(Vec::new())
    }

    fn needs_whole_rows(&self) -> bool {
        self.canonical.needs_whole_rows()
    }

    fn end_step(&mut self) -> Result<StepEvents, MethodError> {
        let blocks = &mut [&mut self.motion, &mut self.spin, &mut self.centers, &mut self.log_rates];
        let densified = self.canonical.densify_with(blocks, &mut [])?;
        Ok(StepEvents { densified, log: Vec::new() })
    }

    fn splat_count(&self) -> usize {
        self.canonical.cloud.len()
    }

    fn capabilities(&self) -> Capabilities<'_> {
        Capabilities { inspect: Some(self), growth: Some(self.canonical.growth()), ..Capabilities::default() }
    }
}

impl Inspect for Spacetime {
    /// `presence`: the factor of opacity at this time.
    fn quantities(&self, at: &Timestamp) -> Result<Vec<Quantity>, MethodError> {
        let presence = (0..self.splat_count()).map(|i| self.row(i, at.t.normalised).gate).collect();
        Ok(vec![Quantity::share("presence", presence)])
    }

    /// The mean of `presence` over time.
    fn report_section(&self, _events: &[Value]) -> Result<Option<Section>, MethodError> {
        let n = self.splat_count();
        let mean = |t: f32| (0..n).map(|i| f64::from(self.row(i, t).gate)).sum::<f64>() / n.max(1) as f64;
        let points = (0..=20).map(|k| k as f32 / 20.0).map(|t| (f64::from(t), mean(t))).collect();
        let chart = Chart {
            title: "Presence, mean over splats".into(),
            x: "normalised time".into(),
            scale: Scale::Linear,
            curves: vec![Curve { name: String::new(), points }],
        };
        Ok(Some(Section { title: "Temporal opacity".into(), charts: vec![chart], ..Section::default() }))
    }
}
