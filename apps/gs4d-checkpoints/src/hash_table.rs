//! Tables of Grid4D's hash grids in the order of gs4d.
//!
//! Both number the nodes of a level densely where they fit into the table, and hash them by the same primes where not. The code rounds the size of a level
//! twice, in double precision for the table and in single precision in its kernel, so that a level may count one node more along an axis there,
//! or hash where its nodes would fit. A dense level of gs4d is therefore gathered node by node; a hashed one is the same in both.

use crate::CheckpointError;
use crate::file::{Exported, misshapen};
use gs_deform::encode::HashGrid;
use gs_deform::encode::hash::config::HashGridConfig;
use gs_deform::encode::hash::level::Level;

const PRIMES: [u32; 2] = [2_654_435_761, 805_459_861];

/// Nodes along an axis beyond which more make no difference: such a level is hashed.
const MOST_NODES: f32 = 1e6;

/// A level as the code's kernel addresses it.
struct Foreign {
    res: [u64; 3],
    first: usize,
    entries: usize,
}

impl Foreign {
    fn hashed(&self) -> bool {
        self.res.iter().product::<u64>() > self.entries as u64
    }

    fn index(&self, [x, y, z]: [u32; 3]) -> usize {
        let entries = self.entries as u64;
        let at = match self.hashed() {
            true => u64::from(x ^ y.wrapping_mul(PRIMES[0]) ^ z.wrapping_mul(PRIMES[1])),
            false => u64::from(x) + self.res[0] * (u64::from(y) + self.res[1] * u64::from(z)),
        };
        usize::try_from(at % entries).unwrap_or(0)
    }
}

/// The table of the encoder `name` in the order of a grid of gs4d of the same settings, `[entries, 2]`.
pub(crate) fn table(file: &Exported<'_>, name: &str, config: &HashGridConfig) -> Result<Vec<f32>, CheckpointError> {
    let foreign = levels(file, name, config.levels)?;
    let rows = foreign.last().map_or(0, |l| l.first + l.entries);
    let values = file.values(&format!("{name}.embeddings"), &[rows, 2])?;
    // What the settings ask for is in the file, before memory is taken for it.
    if config.param_count() > values.len() as u64 {
        return Err(misshapen(&format!("{name}.embeddings"), &[rows, 2], format!("{} values", config.param_count())));
    }
    let grid = HashGrid::new(name, config, 0).map_err(|_| CheckpointError::Setting("grid_args"))?;
    let mut out = Vec::with_capacity(grid.table().len());
    for (own, level) in grid.levels().iter().zip(&foreign) {
        let rows = &values.as_chunks::<2>().0[level.first..][..level.entries];
        match own.hashed {
            true if level.hashed() && own.entries == level.entries => out.extend_from_slice(rows.as_flattened()),
            true => return Err(misshapen(&format!("{name}.offsets"), &[level.entries], format!("{}", own.entries))),
            false => out.extend(nodes(own).flat_map(|node| rows[level.index(node)])),
        }
    }
    Ok(out)
}

/// The nodes of a dense level in the order of its table.
fn nodes(level: &Level) -> impl Iterator<Item = [u32; 3]> {
    let [nx, ny, nz] = level.res;
    (0..nz).flat_map(move |z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z])))
}

fn levels(file: &Exported<'_>, name: &str, count: usize) -> Result<Vec<Foreign>, CheckpointError> {
    let numbers = |leaf: &str, count: usize| file.values(&format!("{name}.{leaf}"), &[count]);
    let (growth, base) = (numbers("per_level_scale", 3)?, numbers("base_resolution", 3)?);
    let offsets = numbers("offsets", count + 1)?;
    let wrong = || misshapen(&format!("{name}.offsets"), &[count + 1], "whole numbers that ascend".to_owned());
    let rising =
        offsets.first() == Some(&0.0) && offsets.windows(2).all(|w| w[1] > w[0] && w[1] < 1e9 && w[1].fract() == 0.0);
    if !rising {
        return Err(wrong());
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked above, and sizes are clamped")]
    let level = |(l, w): (usize, &[f32])| {
        let size = |d: usize| (((l as f32) * growth[d].log2()).exp2() * base[d] - 1.0).ceil().clamp(0.0, MOST_NODES);
        Foreign {
            res: std::array::from_fn(|d| size(d) as u64 + 1),
            first: w[0] as usize,
            entries: (w[1] - w[0]) as usize,
        }
    };
    Ok(offsets.windows(2).enumerate().map(level).collect())
}
