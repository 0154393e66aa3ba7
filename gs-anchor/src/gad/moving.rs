//! Deformation of moving anchors only.
//!
//! An anchor with `M = 0` keeps its position, and one with `|m| < ε` changes by less than `ε` times the net's output.
//! If both hold the net is not evaluated for it. (All heads share one matrix product: leaving out single heads for some
//! rows would save next to nothing.)

use super::{Gad, GadHead, add_scaled, move_points};
use crate::{AnchorShape, Anchors, LocalAnchors};
use gs_core::Time;
use gs_core::nn::BLOCK;

impl Gad {
    /// Whether each anchor takes part in the deformation: `M ≠ 0` or `|m| ≥ below`.
    pub fn is_active(&self, anchors: &Anchors, below: f32) -> impl Iterator<Item = bool> {
        (0..anchors.len()).map(move |v| {
            let [global, local] = self.config.dynamics.weights(anchors.logits(v));
            global.value != 0.0 || local.value.abs() >= below
        })
    }

    /// [`Gad::forward`] for the anchors of [`Gad::is_active`]; the others stay canonical. The error of their values
    /// is at most `below` times the net's output; with `below` = 0 all take part.
    pub fn forward_active(&self, anchors: &Anchors, t_c: Time, below: f32, out: &mut LocalAnchors) {
        anchors.activate(out);
        let moving: Vec<usize> =
            self.is_active(anchors, below).enumerate().filter_map(|(v, moves)| moves.then_some(v)).collect();
        let points: Vec<_> = moving.iter().map(|&v| out.positions[v]).collect();
        let mut tape = Default::default();
        self.net.forward(&points, t_c, &mut tape);
        let AnchorShape { offsets: k, features: c, .. } = anchors.shape();
        for (block, rows) in tape.blocks().iter().zip(moving.chunks(BLOCK)) {
            for (h, head) in self.config.heads.iter().enumerate() {
                let deltas = block.head(h).chunks_exact(head.width(anchors.shape()));
                for (delta, &v) in deltas.zip(rows) {
                    let weights = [self.config.dynamics.weights(anchors.logits(v))];
                    match head {
                        GadHead::Positions => move_points(&mut out.positions[v..=v], delta, &weights),
                        GadHead::Features => add_scaled(&mut out.features[v * c..][..c], delta, &weights),
                        GadHead::Offsets => add_scaled(&mut out.offsets[v * 3 * k..][..3 * k], delta, &weights),
                        GadHead::Scales => add_scaled(&mut out.scales[v * 6..][..6], delta, &weights),
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::GadConfig;
    use glam::Vec3;
    use gs_core::Rng;
    use gs_deform::{Aabb, PlaneNetConfig};

    /// Three blocks of anchors: every third has both factors near zero, every third only a global factor of zero.
    #[test]
    fn static_anchors_stay_and_the_others_move_as_with_forward() {
        let shape = AnchorShape { offsets: 3, features: 8, dynamics: 2 };
        let n = 2 * BLOCK + 77;
        let mut rng = Rng::new(1, "moving", 0, 0);
        let points: Vec<Vec3> = (0..n).map(|_| Vec3::new(rng.normal(), rng.normal(), rng.normal())).collect();
        let mut anchors = Anchors::new(shape, &points, &vec![-2.0; n]);
        let logits = |v: usize| [[1.0, 0.5], [-10.0, -10.0], [-10.0, 2.0]][v % 3];
        let Some(dynamics) = &mut anchors.dynamics else { unreachable!("two logits") };
        dynamics.value = (0..n).flat_map(logits).collect();
        let net = PlaneNetConfig { width: 16, zero_init: false, ..PlaneNetConfig::default() };
        let aabb = Aabb::new(Vec3::splat(-2.0), Vec3::splat(2.0)).unwrap();
        let gad = Gad::new(&GadConfig { net, ..GadConfig::default() }, shape, aabb, 4).unwrap();

        let t = Time::new(0.4).unwrap();
        let (mut whole, mut rest) = <(LocalAnchors, LocalAnchors)>::default();
        gad.forward(&anchors, t, &mut Default::default(), &mut whole);
        anchors.activate(&mut rest);
        for (below, idle) in [(1e-4, (0..n).filter(|v| v % 3 == 1).count()), (0.0, 0)] {
            let mut few = LocalAnchors::default();
            gad.forward_active(&anchors, t, below, &mut few);
            assert_eq!(gad.is_active(&anchors, below).filter(|p| !p).count(), idle);
            for v in 0..n {
                let row = |l: &LocalAnchors| {
                    (l.positions[v], l.offsets[9 * v..][..9].to_vec(), l.features[8 * v..][..8].to_vec())
                };
                if idle > 0 && v % 3 == 1 {
                    assert_eq!(row(&few), row(&rest), "idle anchor {v}");
                }
                let (few, whole) = (row(&few), row(&whole));
                let pairs = few.1.iter().zip(&whole.1).chain(few.2.iter().zip(&whole.2));
                assert!(pairs.clone().all(|(a, b)| (a - b).abs() <= 5e-5 + 1e-6 * b.abs()), "anchor {v}");
                assert!((few.0 - whole.0).abs().max_element() <= 1e-6, "anchor {v}");
            }
        }
    }
}
