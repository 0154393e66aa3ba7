//! Selections of many things in order.

use gs_core::{Rng, cast};

/// Indices, ascending, of at most `most` of `total` things in order: all of a few; of many one of each of `most` consecutive runs of
/// equal length, at random. A fixed step would, of a rig's views in order of time, take the same camera each time. The same numbers
/// give the same selection.
///
/// ```
/// let chosen = gs_data::spread(1000, 10);
/// assert!(chosen.len() == 10 && chosen.iter().enumerate().all(|(k, i)| i / 100 == k));
/// assert_eq!(gs_data::spread(3, 10), [0, 1, 2]);
/// ```
pub fn spread(total: usize, most: usize) -> Vec<usize> {
    if total <= most {
        return (0..total).collect();
    }
    let run = |k: usize| k * total / most;
    let one = |k: usize| {
        let length = cast::to_u32(run(k + 1) - run(k));
        run(k) + Rng::new(0, "data.spread", 0, k as u64).below(length) as usize
    };
    (0..most).map(one).collect()
}

/// Indices, ascending, of at most `most` of `total` things in order: all of a few; of many the first of each of `most` consecutive runs of
/// equal length, as far as whole numbers allow. Of a rig's views in order of time they may all be of one camera: [`spread`] draws others.
///
/// ```
/// assert!(gs_data::evenly(10, 4).eq([0, 2, 5, 7]));
/// assert!(gs_data::evenly(3, 10).eq(0..3) && gs_data::evenly(0, 10).eq(0..0));
/// ```
pub fn evenly(total: usize, most: usize) -> impl Iterator<Item = usize> {
    let count = total.min(most);
    (0..count).map(move |k| k * total / count)
}
