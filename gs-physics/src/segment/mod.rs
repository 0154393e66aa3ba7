//! Segmentation of a scene into rigid parts.
//!
//! All particles of one rigid body share a twist, so twists cluster into bodies without supervision:
//! [`features`](features::features) makes a row of each motion, [`kmeans`](kmeans::kmeans) clusters the rows (TRACE; GVFi
//! 4.2), and [`merged`] merges clusters into bodies where their number is unknown. For scenes without physics, [`Ogc`]
//! learns labels from the paths of points.
//!
//! Labels are `0 …`, ordered by the weight of their particles, heaviest first. Results are bitwise equal for any number of
//! threads.
//!
//! Two bodies that move differently, with more clusters than bodies, are found as two:
//! ```
//! use glam::Vec3;
//! use gs_physics::segment::{FeatureOptions, KMeansOptions, MergeOptions, features, kmeans, merged};
//! use gs_physics::{Motion, Twist};
//!
//! let spin = Motion { twist: Twist { v: [0.0; 3], w: [0.0, 0.0, 2.0] }, ..Motion::default() };
//! let slide = Motion { twist: Twist { v: [1.0, 0.0, 0.0], w: [0.0; 3] }, ..Motion::default() };
//! let motions: Vec<_> = (0..30).map(|i| if i < 20 { spin } else { slide }).collect();
//! let means: Vec<_> = (0..30).map(|i| Vec3::new((i % 5) as f32, (i % 3) as f32, (i % 2) as f32)).collect();
//! let (rows, width) = features(&motions, &FeatureOptions::default());
//! let clusters = kmeans(&rows, width, None, &KMeansOptions { k: 6, ..KMeansOptions::default() });
//! let found = merged(&means, &motions, Vec3::ZERO, None, (&clusters.labels, clusters.k), &MergeOptions::default());
//! assert_eq!(found.bodies.len(), 2);
//! assert!(found.labels[..20].iter().all(|l| *l == 0) && found.labels[20..].iter().all(|l| *l == 1));
//! ```

pub mod choose;
pub mod features;
pub mod kmeans;
mod near;
pub mod ogc;

pub use choose::{MergeOptions, Merged, TwistSums, merged};
pub use features::{Feature, FeatureOptions, features, radius};
pub use kmeans::{Clusters, KMeansOptions, kmeans};
pub use ogc::{Ogc, OgcOptions};

/// Renumbers labels `< k` by decreasing weight (ties: the old order); gives the old label of each new one. Labels without
/// particles are dropped.
fn by_weight(labels: &mut [u32], weights: impl Fn(usize) -> f64, k: usize) -> Vec<usize> {
    let mut mass = vec![(0.0f64, 0usize); k];
    for (i, &label) in labels.iter().enumerate() {
        let (weight, count) = &mut mass[label as usize];
        *weight += weights(i);
        *count += 1;
    }
    let mut order: Vec<usize> = (0..k).filter(|&c| mass[c].1 > 0).collect();
    order.sort_by(|&a, &b| mass[b].0.total_cmp(&mass[a].0));
    let mut new = vec![0; k];
    order.iter().enumerate().for_each(|(to, &from)| new[from] = gs_core::cast::to_u32(to));
    labels.iter_mut().for_each(|l| *l = new[*l as usize]);
    order
}
