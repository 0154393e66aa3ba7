//! One global, stable depth sort: splats front to back, ties by index.
//!
//! Three passes of an 11-bit radix sort over the bits of the `f32` depth (positive floats order like their bits), then
//! runs of equal keys are put in order of their `f64` depth, so the order is the one of exact depths.

const BITS: u32 = 11;
const BUCKETS: usize = 1 << BITS;

/// Sort key of one splat.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Key {
    /// Bits of the camera depth rounded to `f32`; the depth is positive.
    pub bits: u32,
    /// Row in the caller's columns.
    pub index: u32,
}

/// Sorts `keys` (given in index order) front to back. `depth` returns the `f64` camera depth of a row. Linear time.
pub(crate) fn sort(keys: &mut Vec<Key>, scratch: &mut Vec<Key>, depth: impl Fn(u32) -> f64) {
    scratch.clear();
    scratch.resize(keys.len(), Key { bits: 0, index: 0 });
    for pass in 0..3 {
        let shift = pass * BITS;
        let digit = |k: &Key| (k.bits >> shift) as usize & (BUCKETS - 1);
        let mut starts = [0u32; BUCKETS];
        for k in keys.iter() {
            starts[digit(k)] += 1;
        }
        if starts.iter().any(|&c| c as usize == keys.len()) {
            continue;
        }
        let mut sum = 0;
        for s in &mut starts {
            sum += std::mem::replace(s, sum);
        }
        for k in keys.iter() {
            let to = &mut starts[digit(k)];
            scratch[*to as usize] = *k;
            *to += 1;
        }
        std::mem::swap(keys, scratch);
    }
    for run in keys.chunk_by_mut(|a, b| a.bits == b.bits).filter(|r| r.len() > 1) {
        run.sort_by(|a, b| depth(a.index).total_cmp(&depth(b.index)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    #[test]
    fn agrees_with_a_stable_comparison_sort() {
        let mut rng = Rng::new(1, "sort", 0, 0);
        for n in [0usize, 1, 2, 17, 1000, 5000] {
            // Few distinct f32 depths, and f64 depths that differ below f32 precision.
            let depths: Vec<f64> =
                (0..n).map(|_| 0.5 + f64::from(rng.below(40)) * 0.37 + f64::from(rng.below(3)) * 1e-12).collect();
            let mut keys: Vec<Key> =
                (0..n).map(|i| Key { bits: (depths[i] as f32).to_bits(), index: i as u32 }).collect();
            sort(&mut keys, &mut Vec::new(), |i| depths[i as usize]);
            let mut want: Vec<u32> = (0..n as u32).collect();
            want.sort_by(|a, b| depths[*a as usize].total_cmp(&depths[*b as usize]));
            assert_eq!(keys.iter().map(|k| k.index).collect::<Vec<_>>(), want);
        }
    }
}
