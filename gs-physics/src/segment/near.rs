//! Nearest neighbours of points, by a k-d tree.

use glam::Vec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZero;

/// Points per rayon task.
const BLOCK: usize = 1024;

/// The rows of `points` nearest to each query, `[queries, count]`, nearest first. Entries beyond the number of points or
/// farther than `radius` (world units) repeat the nearest. Positions must be finite. None if there are no points, `count`
/// is 0, or no tree can be built (too many points at one position).
pub(super) fn nearest(points: &[Vec3], queries: &[Vec3], count: usize, radius: f32) -> Option<Vec<u32>> {
    let wanted = NonZero::new(count.min(points.len()))?;
    let flat: Vec<[f32; 3]> = points.iter().map(|p| p.to_array()).collect();
    let tree: ImmutableKdTree<f32, 3> = ImmutableKdTree::new_from_slice(&flat).ok()?;
    let mut out = vec![0; queries.len() * count];
    out.par_chunks_mut(BLOCK * count).zip(queries.par_chunks(BLOCK)).for_each(|(out, queries)| {
        for (row, query) in out.chunks_exact_mut(count).zip(queries) {
            let mut found: Vec<(f32, u32)> = tree
                .query(&query.to_array())
                .nearest_n::<SquaredEuclidean<f32>>(wanted)
                .execute()
                .iter()
                .map(|f| (f.distance, f.item))
                .collect();
            found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let first = found[0].1;
            for (slot, place) in row.iter_mut().enumerate() {
                *place = found.get(slot).filter(|f| f.0 <= radius * radius).map_or(first, |f| f.1);
            }
        }
    });
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    #[test]
    fn brute_force_agrees() {
        let draw = |i: u64| {
            let mut rng = Rng::new(4, "near", 0, i);
            Vec3::new(rng.normal(), rng.normal(), rng.normal())
        };
        let points: Vec<Vec3> = (0..400).map(draw).collect();
        let (count, radius) = (5, 0.5);
        let got = nearest(&points, &points, count, radius).unwrap();
        for (i, p) in points.iter().enumerate() {
            let mut all: Vec<(f32, u32)> = points.iter().map(|q| p.distance_squared(*q)).zip(0..).collect();
            all.sort_by(|a, b| a.0.total_cmp(&b.0));
            let want = all[..count].iter().map(|a| if a.0 <= radius * radius { a.1 } else { i as u32 });
            assert!(got[i * count..][..count].iter().copied().eq(want), "{i}");
        }
        assert_eq!(nearest(&points[..2], &points[..1], 4, 9.0), Some(vec![0, 1, 0, 0]));
        assert_eq!(nearest(&[], &points, 3, 1.0), None);
    }
}
