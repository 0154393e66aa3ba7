//! Local Gaussian deformation (LGD, MoDec-GS): from decoded Gaussians to those of a frame, by one of two fields.
//!
//! * [`LgdEncoder::Planes`]: feature planes and small heads, as published ([`HexPlaneField`]).
//! * [`LgdEncoder::Hash`]: the field of Grid4D without Fourier branch and gate ([`Grid4dField`]): hash grids over space and over space
//!   and time. Its cube is the smallest around the origin that holds the box; a Gaussian outside does not move. The grids are read
//!   at the means, which get no gradient through them.

use crate::Anchors;
use glam::Vec3;
use gs_core::{Geometry, GeometryRef, Param, Params, Time};
use gs_deform::apply::ScaleRule;
use gs_deform::encode::HashGridConfig;
use gs_deform::field::fourdgs::HexPlaneTape;
use gs_deform::field::grid4d::{Grid4dTape, SmoothConfig};
use gs_deform::{Aabb, DeformError, Field, FourDgsConfig, Grid4dConfig, Grid4dField, HexPlaneField, PlaneNetConfig};
use serde::{Deserialize, Serialize};

/// Most values of all hash tables together: 0.5 MB at 8 bits, with two `f32` for every 256 values.
const MAX_VALUES: u64 = 480_000;

/// The field of LGD.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LgdEncoder {
    /// Feature planes (MoDec-GS).
    #[default]
    Planes,
    /// Hash grids (Grid4D).
    Hash,
}

/// Size and regulariser of the hash grids of LGD. All tables together have at most 480 000 values: 0.5 MB in a compact file at 8 bits
/// per value, 1 MB at 16.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LgdHashConfig {
    /// Size of the grid over x, y, z.
    pub canonical: HashGridConfig,
    /// Size of each of the three grids over two coordinates and time (time last).
    pub temporal: HashGridConfig,
    /// Weight of the smoothness of the canonical grid; 0: none.
    pub lambda_s: f32,
    /// Weight of the smoothness of the temporal grids; 0: none.
    pub lambda_t: f32,
}

impl Default for LgdHashConfig {
    fn default() -> Self {
        let canonical = HashGridConfig { base: [8.0; 3], end: [64.0; 3], levels: 8, log2_table: 12 };
        let temporal = HashGridConfig { base: [8.0, 8.0, 4.0], end: [64.0, 64.0, 16.0], ..canonical };
        let SmoothConfig { lambda_s, lambda_t, .. } = Grid4dConfig::grid4d().smooth;
        Self { canonical, temporal, lambda_s, lambda_t }
    }
}

impl LgdHashConfig {
    /// Number of values of all tables.
    pub fn values(&self) -> u64 {
        self.temporal.param_count().saturating_mul(3).saturating_add(self.canonical.param_count())
    }
}

/// Settings of LGD.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LgdConfig {
    /// The field.
    #[serde(default)]
    pub encoder: LgdEncoder,
    /// Hash grids, with [`LgdEncoder::Hash`].
    #[serde(default)]
    pub hash: LgdHashConfig,
    /// Planes and network. A field of hash grids takes the width, the depth (as hidden layers before its head) and `zero_init`; it
    /// moves all columns, adds to scales, and gives coordinates no gradient.
    #[serde(flatten)]
    pub field: FourDgsConfig,
}

impl LgdConfig {
    /// [`FourDgsConfig::for_moments`]. Where that bounds the time nodes of planes, the grids have no more over times 0 … 1.
    pub fn for_moments(mut self, moments: f64) -> Self {
        let before = self.field.hexplane.resolution[3];
        self.field = self.field.for_moments(moments);
        if self.field.hexplane.resolution[3] < before {
            let most = self.field.hexplane.time_rows() as f32;
            let HashGridConfig { base, end, .. } = &mut self.hash.temporal;
            [base, end].into_iter().for_each(|resolution| resolution[2] = resolution[2].min(most));
        }
        self
    }

    /// Number of parameters; the largest number where that is beyond it.
    pub fn param_count(&self) -> u64 {
        match self.encoder {
            LgdEncoder::Planes => self.field.param_count(),
            LgdEncoder::Hash => self.grid4d(1.0).param_count(),
        }
    }

    /// The field of hash grids in the cube `[−bound, bound]³`. Shifts of its regulariser keep their ratio to the cube.
    fn grid4d(&self, bound: f32) -> Grid4dConfig {
        let LgdHashConfig { canonical, temporal, lambda_s, lambda_t } = self.hash;
        let FourDgsConfig { width, depth, zero_init, .. } = self.field;
        let plain = Grid4dConfig::grid4d();
        let SmoothConfig { eps, eps_t, .. } = plain.smooth;
        let ratio = bound / plain.bound;
        let (eps, eps_t) = (eps.map(|e| ratio * e), ratio * eps_t);
        let smooth = SmoothConfig { lambda_s, lambda_t, eps, eps_t, ..plain.smooth };
        Grid4dConfig { bound, canonical, temporal, width, depth, zero_init, smooth, ..plain }
    }

    /// Whether a field of hash grids can be what these settings say.
    fn check_hash(&self) -> Result<(), DeformError> {
        let FourDgsConfig { move_means, move_scales, move_quats, scale_rule, detach_coordinates, .. } = self.field;
        const MOST: (usize, u32) = (64, 24);
        let LgdHashConfig { canonical, temporal, .. } = &self.hash;
        if [canonical, temporal].iter().any(|g| g.levels > MOST.0 || g.log2_table > MOST.1) {
            let value = format!(
                "{} and {} levels of 2^{} and 2^{} entries",
                canonical.levels, temporal.levels, canonical.log2_table, temporal.log2_table
            );
            return Err(DeformError::Config {
                field: "lgd.hash",
                value,
                rule: "at most 64 levels of at most 2^24 entries",
            });
        }
        let values = self.hash.values();
        let rules = [
            (move_means, "lgd.move_means", "false".to_owned(), "true with hash grids"),
            (move_scales, "lgd.move_scales", "false".to_owned(), "true with hash grids"),
            (move_quats, "lgd.move_quats", "false".to_owned(), "true with hash grids"),
            (scale_rule == ScaleRule::Add, "lgd.scale_rule", "log".to_owned(), "add with hash grids"),
            (detach_coordinates, "lgd.detach_coordinates", "false".to_owned(), "true with hash grids"),
            (
                values <= MAX_VALUES,
                "lgd.hash",
                format!("{values} values"),
                "at most 480000 in all tables: fewer levels, or a smaller log2_table",
            ),
        ];
        let fault = rules.into_iter().find(|rule| !rule.0);
        fault.map_or(Ok(()), |(_, field, value, rule)| Err(DeformError::Config { field, value, rule }))
    }
}

/// The field of LGD, built. Its parameters are named `lgd.…`.
#[derive(Clone, Debug)]
pub enum Lgd {
    /// On feature planes.
    Planes(Box<HexPlaneField>),
    /// On hash grids.
    Hash(Box<Grid4dField>),
}

/// Activations of an [`Lgd`] between forward and backward, reused between calls.
#[derive(Clone, Debug, Default)]
pub struct LgdTape {
    planes: HexPlaneTape,
    hash: Grid4dTape,
}

impl Lgd {
    /// A field over the box `aabb`.
    ///
    /// # Errors
    /// If a setting is out of its domain, or not possible with hash grids; the message names it.
    pub fn new(config: &LgdConfig, aabb: Aabb, seed: u64) -> Result<Self, DeformError> {
        if config.encoder == LgdEncoder::Planes {
            return Ok(Self::Planes(Box::new(HexPlaneField::new("lgd", &config.field, aabb, seed)?)));
        }
        config.check_hash()?;
        let bound = aabb.min.abs().max(aabb.max.abs()).max_element();
        let mut field = Grid4dField::new(&config.grid4d(bound), seed)?;
        field.visit_mut(&mut |p| p.name = p.name.replacen("field.", "lgd.", 1));
        Ok(Self::Hash(Box::new(field)))
    }

    /// Moves Gaussians to timestamp `t`. Planes are asked at `places`, one for each (world units), hash grids at the means.
    ///
    /// # Panics
    /// If there are not as many places as Gaussians, on planes.
    pub fn forward_at(
        &self,
        places: &[Vec3],
        canonical: GeometryRef<'_>,
        t: Time,
        tape: &mut LgdTape,
        out: &mut Geometry,
    ) {
        match self {
            Self::Planes(field) => field.forward_at(places, canonical, t, &mut tape.planes, out),
            Self::Hash(field) => field.forward(canonical, t, &mut tape.hash, out),
        }
    }

    /// Backward of [`Self::forward_at`]: adds to the parameters' gradients and to `d_canonical`. The cotangents of the places go to
    /// `d_places`, or to the means where it is `None`; hash grids give none.
    pub fn backward(
        &mut self,
        canonical: GeometryRef<'_>,
        tape: &mut LgdTape,
        d_out: GeometryRef<'_>,
        d_canonical: &mut Geometry,
        d_places: Option<&mut [Vec3]>,
    ) {
        match (self, d_places) {
            (Self::Planes(field), None) => field.backward(canonical, &mut tape.planes, d_out, d_canonical),
            (Self::Planes(field), Some(d)) => field.backward_at(canonical, &mut tape.planes, d_out, d_canonical, d),
            (Self::Hash(field), _) => field.backward(canonical, &mut tape.hash, d_out, d_canonical),
        }
    }

    /// Adds the weighted gradients of the regularisers; their weighted values by name. Hash grids are smoothed around the anchors.
    pub fn regularise(&mut self, anchors: &Anchors, t: Time, step: u32) -> Vec<(&'static str, f32)> {
        let (names, values): (&[_], _) = match self {
            Self::Planes(field) => {
                let nowhere = Geometry::default();
                (&["local_tv", "local_smoothness", "local_l1"], field.regularise(nowhere.view(), t, step))
            }
            Self::Hash(field) => {
                let means: Vec<Vec3> =
                    anchors.positions.value.as_chunks().0.iter().map(|p| Vec3::from_array(*p)).collect();
                let around = GeometryRef { means: &means, quats: &[], scales: &[] };
                (&["local_space", "local_time"], field.regularise(around, t, step))
            }
        };
        names.iter().copied().zip(values.into_iter().map(|(_, value)| value)).collect()
    }

    /// Settings of the planes and their network, where it has them.
    pub fn net_config(&self) -> Option<PlaneNetConfig> {
        match self {
            Self::Planes(field) => Some(field.net_config()),
            Self::Hash(_) => None,
        }
    }

    /// Outputs of each head of that network; none where it has hash grids.
    pub fn head_widths(&self) -> Vec<usize> {
        match self {
            Self::Planes(field) => field.head_widths(),
            Self::Hash(_) => Vec::new(),
        }
    }

    /// Number of values of the hash grids, and of their network, where it has them.
    pub fn hash_values(&self) -> Option<[usize; 2]> {
        let Self::Hash(field) = self else { return None };
        let tables = field.grids().iter().map(|grid| grid.table().len()).sum();
        Some([tables, field.param_count() - tables])
    }
}

impl Params for Lgd {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        match self {
            Self::Planes(field) => field.visit(f),
            Self::Hash(field) => field.visit(f),
        }
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        match self {
            Self::Planes(field) => field.visit_mut(f),
            Self::Hash(field) => field.visit_mut(f),
        }
    }
}
