//! Size of a HexPlane and weights of its regularisers.

use super::hexplane::PAIRS;
use super::sample::LANES;
use crate::DeformError;
use serde::{Deserialize, Serialize};

/// Largest number of values in all planes together: 2 GiB of `f32`.
const MAX_VALUES: u64 = 1 << 29;

/// Size and regularisers of a [`HexPlane`](super::HexPlane). The defaults are those of 4D Gaussian Splatting for
/// synthetic scenes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HexPlaneConfig {
    /// Nodes along x, y, z and t at level 1; at least 2 each. About half of the time rows serve times 0 … 1.
    pub resolution: [usize; 4],
    /// Factors on the spatial resolution, one per level.
    pub levels: Vec<usize>,
    /// Channels per level, a multiple of 16.
    pub channels: usize,
    /// Weight of the mean squared second difference of the spatial planes.
    pub plane_tv: f32,
    /// Weight of the mean squared second difference in time of the time planes.
    pub time_smoothness: f32,
    /// Weight of the mean of `|1 − P|` over the time planes.
    pub time_l1: f32,
}

impl Default for HexPlaneConfig {
    fn default() -> Self {
        Self {
            resolution: [64, 64, 64, 75],
            levels: vec![1, 2],
            channels: 32,
            plane_tv: 1e-4,
            time_smoothness: 1e-2,
            time_l1: 1e-4,
        }
    }
}

impl HexPlaneConfig {
    /// Number of stored time rows: those that normalised times 0 … 1 can reach.
    pub fn time_rows(&self) -> usize {
        self.resolution[3] - self.first_time_row()
    }

    pub(crate) fn first_time_row(&self) -> usize {
        self.resolution[3].saturating_sub(1) / 2
    }

    /// Nodes along x, y, z and stored rows of t at a level factor.
    pub(crate) fn nodes(&self, factor: usize) -> [usize; 4] {
        let [x, y, z, _] = self.resolution.map(|r| r.saturating_mul(factor));
        [x, y, z, self.time_rows()]
    }

    /// Number of parameters of all planes; the largest number where that is beyond it.
    pub fn param_count(&self) -> u64 {
        let product = |numbers: [usize; 3]| numbers.iter().fold(1, |p: u64, &n| p.saturating_mul(n as u64));
        let planes = self.levels.iter().flat_map(|&factor| {
            let nodes = self.nodes(factor);
            PAIRS.map(|(a, b)| product([nodes[a], nodes[b], self.channels]))
        });
        planes.fold(0, u64::saturating_add)
    }

    pub(crate) fn check(&self) -> Result<(), DeformError> {
        let reject =
            |field: &'static str, value: String, rule: &'static str| Err(DeformError::Config { field, value, rule });
        if self.resolution.iter().any(|&r| r < 2) {
            return reject("resolution", format!("{:?}", self.resolution), "at least 2 nodes along every axis");
        }
        if self.levels.is_empty() || self.levels.contains(&0) {
            return reject("levels", format!("{:?}", self.levels), "at least one factor, each at least 1");
        }
        if self.channels == 0 || !self.channels.is_multiple_of(LANES) {
            return reject("channels", self.channels.to_string(), "a positive multiple of 16");
        }
        let total = self.param_count();
        if total > MAX_VALUES {
            return reject("resolution", format!("{total} values"), "at most 2^29 values in all planes");
        }
        for (field, w) in
            [("plane_tv", self.plane_tv), ("time_smoothness", self.time_smoothness), ("time_l1", self.time_l1)]
        {
            if !(w.is_finite() && w >= 0.0) {
                return reject(field, w.to_string(), "a finite weight, at least 0");
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_the_published_synthetic_setting() {
        let c = HexPlaneConfig::default();
        assert_eq!(c.check(), Ok(()));
        assert_eq!((c.time_rows(), c.first_time_row()), (38, 37));
        assert_eq!(c.nodes(2), [128, 128, 128, 38]);
    }

    #[test]
    fn what_cannot_be_built_is_refused_by_name() {
        let error = |change: &dyn Fn(&mut HexPlaneConfig)| {
            let mut c = HexPlaneConfig::default();
            change(&mut c);
            c.check().unwrap_err().to_string()
        };
        assert!(error(&|c| c.resolution[3] = 1).contains("`resolution` = [64, 64, 64, 1]"));
        assert!(error(&|c| c.resolution = [1 << 40; 4]).contains("2^29"));
        assert!(error(&|c| c.levels.clear()).contains("`levels` = []"));
        assert!(error(&|c| c.levels = vec![1, 0]).contains("`levels` = [1, 0]"));
        assert!(error(&|c| c.levels = vec![usize::MAX]).contains("2^29"));
        assert!(error(&|c| c.channels = 24).contains("`channels` = 24"));
        assert!(error(&|c| c.channels = 0).contains("`channels` = 0"));
        assert!(error(&|c| c.plane_tv = f32::NAN).contains("`plane_tv` = NaN"));
        assert!(error(&|c| c.time_l1 = -1.0).contains("`time_l1` = -1"));
    }
}
