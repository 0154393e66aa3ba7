//! One resolution of a hash grid: its number of nodes and the table entry of each.
//!
//! ```text
//! R_d = base_d (end_d / base_d)^(l / (L−1))      scale_d = R_d − 1      res_d = ⌈R_d − 1e-4⌉      n = min(2^T, Π res_d)
//! dense  (Π res ≤ 2^T):   c_0 + res_0 (c_1 + res_1 c_2)
//! hashed (otherwise):     (c_0 xor 2654435761 c_1 xor 805459861 c_2) mod n,      n a power of two
//! ```
//! The published code takes `⌈R⌉` of the rounded growth in two places: 512.0000001 on one side is 513 rows there and
//! 512 here. The margin of 1e-4, taken once, removes that; `scale` is capped to `res − 1` so that 1 is the last node.

use super::config::HashGridConfig;

/// The primes of Teschner et al. 2003, as Instant NGP uses them (Müller et al. 2022, Eq. 4).
const PRIMES: [u32; 2] = [2_654_435_761, 805_459_861];

/// Size and table layout of one level; see the [module](self).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Nodes along each axis, at least 2.
    pub res: [u32; 3],
    /// Node spacings per unit of a coordinate.
    pub scale: [f32; 3],
    /// Entries in this level's table: at most `2^log2_table`, two values each.
    pub entries: usize,
    /// Number of entries in the tables of all coarser levels.
    pub start: usize,
    /// Whether nodes share entries by hashing; otherwise each has its own.
    pub hashed: bool,
}

impl Level {
    /// All levels of a grid, coarse to fine.
    pub(super) fn all(config: &HashGridConfig) -> Vec<Self> {
        let HashGridConfig { base, end, levels, log2_table } = *config;
        let mut start = 0;
        let mut level = |l: usize| {
            let share = if levels > 1 { l as f64 / (levels - 1) as f64 } else { 0.0 };
            let size: [f64; 3] = std::array::from_fn(|d| {
                let (base, end) = (f64::from(base[d]), f64::from(end[d]));
                base * (end / base).powf(share)
            });
            let res = size.map(|r| (r - 1e-4).ceil());
            let (nodes, limit) = (res.iter().product::<f64>(), (1u64 << log2_table) as f64);
            let level = Self {
                res: res.map(|r| r as u32),
                scale: std::array::from_fn(|d| (size[d].min(res[d]) - 1.0) as f32),
                entries: nodes.min(limit) as usize,
                start,
                hashed: nodes > limit,
            };
            start += level.entries;
            level
        };
        (0..levels).map(&mut level).collect()
    }

    /// The part of a node's index that depends on its second and third coordinate; [`Level::index`] adds the first
    /// (dense) or xors it in (hashed).
    #[inline(always)]
    pub(super) fn row(&self, c1: u32, c2: u32) -> u32 {
        if self.hashed {
            c1.wrapping_mul(PRIMES[0]) ^ c2.wrapping_mul(PRIMES[1])
        } else {
            self.res[0] * (c1 + self.res[1] * c2)
        }
    }

    /// Table entry of node `c` (each coordinate below [`Level::res`]), counted from the first entry of this level.
    #[inline(always)]
    pub fn index(&self, c: [u32; 3]) -> usize {
        let row = self.row(c[1], c[2]);
        if self.hashed { (c[0] ^ row) as usize & (self.entries - 1) } else { (c[0] + row) as usize }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn levels(base: [f32; 3], end: [f32; 3], levels: usize) -> Vec<Level> {
        Level::all(&HashGridConfig { base, end, levels, log2_table: 19 })
    }

    fn entries(levels: &[Level]) -> usize {
        levels.last().map_or(0, |l| l.start + l.entries)
    }

    fn first_hashed(levels: &[Level]) -> Option<usize> {
        levels.iter().position(|l| l.hashed)
    }

    #[test]
    fn nodes_are_hashed_as_published() {
        let level = Level { res: [2048; 3], scale: [2047.0; 3], entries: 1 << 19, start: 0, hashed: true };
        for (c, hash, entry) in [
            ([3, 5, 7], 1_191_511_397, 329_061),
            ([100, 200, 300], 3_655_970_992, 110_768),
            ([2047, 1, 1024], 2_540_251_726, 76_366),
        ] {
            assert_eq!((c[0] ^ level.row(c[1], c[2]), level.index(c)), (hash, entry));
        }
        let dense = Level { hashed: false, entries: 60, res: [5, 4, 3], ..level };
        assert_eq!((dense.index([0; 3]), dense.index([1, 2, 1]), dense.index([4, 3, 2])), (0, 31, 59));
    }

    #[test]
    fn the_canonical_grid_has_its_published_size() {
        let all = levels([16.0; 3], [2048.0; 3], 16);
        let res: Vec<u32> = all.iter().map(|l| l.res[0]).collect();
        assert_eq!(res, [16, 23, 31, 43, 59, 81, 112, 154, 213, 295, 407, 562, 777, 1073, 1483, 2048]);
        assert!(all.iter().all(|l| l.res == [l.res[0]; 3]));
        assert_eq!((first_hashed(&all), all.iter().filter(|l| l.hashed).count()), (Some(5), 11));
        assert_eq!(format!("{:.2}", entries(&all) as f64 / 1e6), "6.10");
        assert_eq!(all[15].scale, [2047.0; 3]);
    }

    #[test]
    fn temporal_grids_have_their_published_sizes() {
        let dnerf = levels([8.0; 3], [32.0, 32.0, 16.0], 32);
        let res = [0, 1, 10, 20, 31].map(|l| dnerf[l].res);
        assert_eq!(res, [[8, 8, 8], [9, 9, 9], [13, 13, 11], [20, 20, 13], [32, 32, 16]]);
        assert_eq!((entries(&dnerf), first_hashed(&dnerf)), (161_213, None));
        let mut distinct: Vec<_> = dnerf.iter().map(|l| l.res).collect();
        distinct.dedup();
        assert_eq!(distinct.len(), 25);
        for (end, size, hashed) in [([512.0, 512.0, 128.0], "9.59", 17), ([256.0, 256.0, 128.0], "8.35", 20)] {
            let all = levels([16.0; 3], end, 32);
            assert_eq!((first_hashed(&all), format!("{:.2}", entries(&all) as f64 / 1e6)), (Some(hashed), size.into()));
        }
    }
}
