//! Size of a hash grid.

use super::level::Level;
use crate::DeformError;
use serde::{Deserialize, Serialize};

/// Values per table entry. The inner loops read two neighbours of two values as one register.
pub(crate) const FEATURES: usize = 2;

/// Largest number of values in all tables together: 2 GiB of `f32`.
const MAX_VALUES: u64 = 1 << 29;

const MAX_LEVELS: usize = 64;
const MAX_LOG2_TABLE: u32 = 28;

/// Largest resolution: beyond it an `f32` coordinate has fewer than seven bits left inside a cell.
const MAX_RESOLUTION: f32 = 131_072.0;

/// Size of a [`HashGrid`](super::HashGrid): resolution `base · (end / base)^(l / (levels − 1))` along each axis at
/// level `l`, every axis growing at its own rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HashGridConfig {
    /// Resolution of the first level along each axis: 2 … 131072.
    pub base: [f32; 3],
    /// Resolution of the last level along each axis; not used with one level.
    pub end: [f32; 3],
    /// Number of levels, at least 1.
    pub levels: usize,
    /// Largest table, as a power of two: 1 … 28. A level with more nodes than this is hashed.
    pub log2_table: u32,
}

impl HashGridConfig {
    /// Number of parameters of all tables; the largest number where there are too many levels or entries for any.
    pub fn param_count(&self) -> u64 {
        if self.levels > MAX_LEVELS || self.log2_table > MAX_LOG2_TABLE {
            return u64::MAX;
        }
        let entries = Level::all(self).iter().map(|l| l.entries as u64).sum::<u64>();
        entries.saturating_mul(FEATURES as u64)
    }

    /// Features per point of the grid.
    pub(crate) fn width(&self) -> usize {
        self.levels.saturating_mul(FEATURES)
    }

    pub(super) fn check(&self) -> Result<(), DeformError> {
        let reject =
            |field: &'static str, value: String, rule: &'static str| Err(DeformError::Config { field, value, rule });
        for (field, resolution) in [("base", self.base), ("end", self.end)] {
            if !resolution.iter().all(|r| (2.0..=MAX_RESOLUTION).contains(r)) {
                return reject(field, format!("{resolution:?}"), "between 2 and 131072 along every axis");
            }
        }
        if self.levels == 0 || self.levels > MAX_LEVELS {
            return reject("levels", self.levels.to_string(), "between 1 and 64");
        }
        if !(1..=MAX_LOG2_TABLE).contains(&self.log2_table) {
            return reject("log2_table", self.log2_table.to_string(), "between 1 and 28");
        }
        let values = self.param_count();
        if values > MAX_VALUES {
            return reject("log2_table", format!("{values} values"), "such that all tables hold at most 2^29 values");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_built_is_refused_by_name() {
        let good = HashGridConfig { base: [16.0; 3], end: [2048.0; 3], levels: 16, log2_table: 19 };
        assert_eq!(good.check(), Ok(()));
        let error = |change: &dyn Fn(&mut HashGridConfig)| {
            let mut c = good;
            change(&mut c);
            c.check().unwrap_err().to_string()
        };
        assert!(error(&|c| c.base[1] = 1.5).contains("`base` = [16.0, 1.5, 16.0]"));
        assert!(error(&|c| c.end[0] = f32::NAN).contains("`end` = [NaN"));
        assert!(error(&|c| c.end[2] = 1e6).contains("131072"));
        assert!(error(&|c| c.levels = 0).contains("`levels` = 0"));
        assert!(error(&|c| c.log2_table = 0).contains("`log2_table` = 0"));
        assert!(error(&|c| (c.levels, c.log2_table) = (64, 28)).contains("2^29"));
    }
}
