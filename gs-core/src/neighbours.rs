//! Distances of points to their nearest neighbours, by a k-d tree.

use glam::Vec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZero;

/// Points per parallel task.
const BLOCK: usize = 1024;
/// Number of neighbours in the mean.
const K: usize = 3;

/// Points that no k-d tree can be built of.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the points cannot be indexed: {0}")]
pub struct NeighbourError(String);

/// Mean squared distance of each point to its 3 nearest neighbours (fewer if there are fewer points; 1 for a single
/// point), squared world units. Points must be finite. The same bits for any number of threads.
///
/// ```
/// use gs_core::neighbours::mean_squared_distances;
/// use glam::Vec3;
///
/// let points = [0.0, 1.0, 2.0, 3.0].map(|x| x * Vec3::X);
/// assert_eq!(mean_squared_distances(&points)?, [14.0 / 3.0, 2.0, 2.0, 14.0 / 3.0]);
/// # Ok::<(), gs_core::neighbours::NeighbourError>(())
/// ```
///
/// # Errors
/// If no k-d tree can be built of the points.
pub fn mean_squared_distances(points: &[Vec3]) -> Result<Vec<f32>, NeighbourError> {
    let k = points.len().saturating_sub(1).min(K);
    let Some(wanted) = NonZero::new(k + 1).filter(|_| k > 0) else { return Ok(vec![1.0; points.len()]) };
    let flat: Vec<[f32; 3]> = points.iter().map(|p| p.to_array()).collect();
    let tree: ImmutableKdTree<f32, 3> =
        ImmutableKdTree::new_from_slice(&flat).map_err(|e| NeighbourError(format!("{e:?}")))?;
    let mut out = vec![0.0; flat.len()];
    out.par_chunks_mut(BLOCK).zip(flat.par_chunks(BLOCK)).for_each(|(out, points)| {
        for (mean, point) in out.iter_mut().zip(points) {
            // The nearest of all is the point itself.
            let found = tree.query(point).nearest_n::<SquaredEuclidean<f32>>(wanted).execute();
            *mean = found.iter().map(|f| f.distance).sum::<f32>() / k as f32;
        }
    });
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;

    #[test]
    fn brute_force_agrees_with_duplicates_and_lattices() {
        let mut rng = Rng::new(2, "neighbours", 0, 0);
        let mut points: Vec<Vec3> = (0..300).map(|_| Vec3::new(rng.normal(), rng.normal(), rng.normal())).collect();
        points.extend([Vec3::splat(0.25); 200]);
        points.extend((0..125).map(|i| Vec3::new((i % 5) as f32, (i / 5 % 5) as f32, (i / 25) as f32)));
        let got = mean_squared_distances(&points).unwrap();
        for (i, p) in points.iter().enumerate() {
            let others = points.iter().enumerate().filter(|(j, _)| *j != i);
            let mut d: Vec<f32> = others.map(|(_, q)| p.distance_squared(*q)).collect();
            d.sort_by(f32::total_cmp);
            let want = (d[0] + d[1] + d[2]) / 3.0;
            assert!((got[i] - want).abs() <= 1e-5 * want, "{i}: {} {want}", got[i]);
        }
    }

    #[test]
    fn few_points_have_fewer_neighbours() {
        assert_eq!(mean_squared_distances(&[]).unwrap(), [0.0; 0]);
        assert_eq!(mean_squared_distances(&[Vec3::ONE]).unwrap(), [1.0]);
        assert_eq!(mean_squared_distances(&[Vec3::ZERO, 2.0 * Vec3::X]).unwrap(), [4.0; 2]);
    }
}
