//! Rigid parts of a scene.
//!
//! Every particle of one rigid body has the same twist, so twists cluster into bodies without any label:
//! [`features`](features::features) turns motions into rows, [`kmeans`](kmeans::kmeans) clusters them (TRACE; GVFi 4.2), and
//! [`merged`] counts the bodies where nobody says how many there are. For scenes without physics, [`Ogc`] learns labels from where
//! points go.
//!
//! Labels are `0 …`, ordered by the weight of their particles, heaviest first. Everything is bitwise equal for any number
//! of threads.

pub mod choose;
pub mod features;
pub mod kmeans;
mod near;
pub mod ogc;

pub use choose::{MergeOptions, Merged, TwistSums, merged, twist_sums};
pub use features::{Feature, FeatureOptions, features};
pub use kmeans::{Clusters, KMeansOptions, kmeans};
pub use ogc::{Ogc, OgcOptions};

/// New labels by decreasing weight (ties: the old order); and the old label of each new one. Labels that no particle has
/// are left out.
pub(crate) fn by_weight(labels: &mut [u32], weights: impl Fn(usize) -> f64, k: usize) -> Vec<usize> {
    let mut mass = vec![(0.0f64, 0usize); k];
    for (i, &label) in labels.iter().enumerate() {
        let (weight, count) = &mut mass[label as usize];
        *weight += weights(i);
        *count += 1;
    }
    let mut order: Vec<usize> = (0..k).filter(|&c| mass[c].1 > 0).collect();
    order.sort_by(|&a, &b| mass[b].0.total_cmp(&mass[a].0));
    let mut new = vec![0; k];
    order.iter().enumerate().for_each(|(to, &from)| new[from] = to as u32);
    labels.iter_mut().for_each(|l| *l = new[*l as usize]);
    order
}
