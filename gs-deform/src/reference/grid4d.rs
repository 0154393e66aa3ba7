//! A [`Grid4dField`] in `f64`: one splat at a time, every option written out, no optimisations.

use super::HashGridRef;
use crate::field::grid4d::{Fusion, GateMode, Grid4dConfig, Grid4dField, WaveTime, frequency};
use gs_core::{Params, Time, rot};
use std::collections::BTreeMap;

/// A [`Grid4dField`] in `f64`, one splat at a time.
#[derive(Clone, Debug)]
pub struct Grid4dRef {
    config: Grid4dConfig,
    grids: BTreeMap<&'static str, HashGridRef>,
    layers: BTreeMap<String, Vec<f64>>,
}

/// The grids' parameter names and the coordinates they read (3 is time).
const GRIDS: [(&str, [usize; 3]); 4] = [
    ("field.grids.xyz", [0, 1, 2]),
    ("field.grids.xyt", [0, 1, 3]),
    ("field.grids.yzt", [1, 2, 3]),
    ("field.grids.xzt", [0, 2, 3]),
];

impl Grid4dRef {
    /// Copies the parameters of a field.
    pub fn new(field: &Grid4dField) -> Self {
        let mut layers = BTreeMap::new();
        field.visit(&mut |p| {
            if p.name.starts_with("field.net") {
                layers.insert(p.name.clone(), p.value.iter().map(|&v| f64::from(v)).collect());
            }
        });
        let grids = GRIDS.iter().zip(field.grids()).map(|((name, _), grid)| (*name, HashGridRef::new(grid))).collect();
        Self { config: field.config().clone(), grids, layers }
    }

    /// The values of the parameter block `name`, to change them; `None` if there is none.
    pub fn block(&mut self, name: &str) -> Option<&mut Vec<f64>> {
        match self.grids.get_mut(name) {
            Some(grid) => Some(&mut grid.table),
            None => self.layers.get_mut(name),
        }
    }

    fn dense(&self, name: &str, x: &[f64]) -> Vec<f64> {
        let (weight, bias) =
            (&self.layers[&format!("field.net.{name}.weight")], &self.layers[&format!("field.net.{name}.bias")]);
        let dot = |(w, b): (&[f64], &f64)| w.iter().zip(x).map(|(w, x)| w * x).sum::<f64>() + b;
        weight.chunks(x.len()).zip(bias).map(dot).collect()
    }

    /// Position and time in coordinates of the unit cube.
    fn normalised(&self, x: [f64; 3], t: Time) -> [f64; 4] {
        let b = f64::from(self.config.bound);
        let t = (0.05 + 0.9 * f64::from(t.normalised)).clamp(0.0, 1.0);
        [(x[0] + b) / (2.0 * b), (x[1] + b) / (2.0 * b), (x[2] + b) / (2.0 * b), t]
    }

    /// `f_fre`, `[2m]`.
    fn waves(&self, z: &[f64], t: Time) -> Vec<f64> {
        let fourier = &self.config.fourier;
        let mut w = z.to_vec();
        for i in 0..=fourier.hidden.len() {
            w = self.dense(&format!("amplitude.{i}"), &w);
            if i < fourier.hidden.len() {
                w.iter_mut().for_each(|v| *v = v.max(0.0));
            }
        }
        let t = f64::from(t.normalised);
        let t = if fourier.time == WaveTime::Raw { t } else { 0.9 * f64::from(self.config.bound) * (2.0 * t - 1.0) };
        let angle = |i: usize| std::f64::consts::PI * frequency(i, fourier.bands, fourier.gamma_max) * t;
        let gain = fourier.gain;
        w.iter().enumerate().flat_map(|(i, w)| [gain * w * angle(i).sin(), gain * w * angle(i).cos()]).collect()
    }

    /// The head's outputs at a point `x`, world units: `[η_raw (with a gate), ρ 4, τ 3, Δr 4, Δs 3]`.
    pub fn head(&self, x: [f64; 3], t: Time) -> Vec<f64> {
        let at = self.normalised(x, t);
        let features = |k: usize| self.grids[GRIDS[k].0].features(GRIDS[k].1.map(|axis| at[axis]));
        let z = self.dense("space", &features(0));
        let sigmoid = |v: f64| 1.0 / (1.0 + (-v).exp());
        let a = z.iter().map(|v| if self.config.directional { 2.0 * sigmoid(*v) - 1.0 } else { sigmoid(*v) });
        let f = self.dense("time", &[features(1), features(2), features(3)].concat());
        let mut h: Vec<f64> = a.zip(f).map(|(a, f)| a * f.max(0.0)).collect();
        if self.config.fourier.on {
            let waves = self.waves(&z, t);
            h = match self.config.fourier.fusion {
                Fusion::Add => h.iter().zip(&waves).map(|(h, w)| h + w).collect(),
                Fusion::Mul => h.iter().zip(&waves).map(|(h, w)| h * (1.0 + w)).collect(),
                Fusion::Concat => self.dense("concat", &[h, waves].concat()),
            };
        }
        for i in 0..self.config.depth {
            h = self.dense(&format!("hidden.{i}"), &h);
            h.iter_mut().for_each(|v| *v = v.max(0.0));
        }
        self.dense("head", &h)
    }

    /// A splat (mean 3, quat 4, scale 3) at a timestamp. `x` is the point the grids are sampled at, the splat's mean;
    /// it is separate because gradients treat it as a constant.
    pub fn moved(&self, x: [f64; 3], splat: [f64; 10], t: Time) -> [f64; 10] {
        if !self.config.compat_grid4d && !self.normalised(x, t).iter().all(|c| (0.0..=1.0).contains(c)) {
            return splat;
        }
        let head = self.head(x, t);
        let (raw, motion) = head.split_at(head.len() - 14);
        let gate = raw.first().map_or(1.0, |v| 1.0 / (1.0 + (-v).exp()));
        let (mode, mean) = (self.config.gate.mode, [splat[0], splat[1], splat[2]]);
        let r = if mode == GateMode::ScaleParam { gate } else { 1.0 };
        let q: [f64; 4] = std::array::from_fn(|k| r * motion[k] + if k == 0 { 1.0 } else { 0.0 });
        let squared: f64 = q.iter().map(|v| v * v).sum();
        let q = if squared < 1e-12 { [1.0, 0.0, 0.0, 0.0] } else { q };
        let matrix = rot::matrix(rot::normalise(q).wxyz);
        let length = splat[3..7].iter().map(|v| v * v).sum::<f64>().sqrt();
        std::array::from_fn(|k| match k {
            0..3 => {
                let turned: f64 = (0..3).map(|c| matrix[k][c] * mean[c]).sum();
                let tau = motion[4 + k];
                match mode {
                    GateMode::ScaleParam | GateMode::TranslationOnly => turned + gate * tau,
                    GateMode::LerpPosition => (1.0 - gate) * mean[k] + gate * (turned + tau),
                    GateMode::Literal => gate * turned + gate * tau,
                }
            }
            3..7 => splat[k] + length * gate * motion[4 + k],
            _ => splat[k] + gate * motion[4 + k],
        })
    }
}
