//! What lies behind the scene while it is learnt, and when it is scored.

use serde::{Deserialize, Serialize};

/// What lies behind the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Background {
    /// `(0, 0, 0)`.
    Black,
    /// `(1, 1, 1)`.
    White,
    /// Another colour each step, uniform in the unit cube; evaluation is over black.
    Random,
}

impl Background {
    /// The colour for a training step, RGB in 0..1. Only that of [`Self::Random`] depends on seed and step.
    pub fn color(self, seed: u64, step: u32) -> [f32; 3] {
        match self {
            Background::Black => [0.0; 3],
            Background::White => [1.0; 3],
            Background::Random => {
                let mut rng = gs_core::Rng::new(seed, "background", step, 0);
                std::array::from_fn(|_| rng.uniform())
            }
        }
    }

    /// The colour evaluation is made over.
    pub(crate) fn evaluation_color(self) -> [f32; 3] {
        if self == Background::White { [1.0; 3] } else { [0.0; 3] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn random_backgrounds_are_pure_functions_of_the_step() {
        let b = Background::Random;
        assert_eq!(b.color(1, 5), b.color(1, 5));
        assert_ne!(b.color(1, 5), b.color(1, 6));
        assert_eq!((b.evaluation_color(), Background::White.color(0, 0)), ([0.0; 3], [1.0; 3]));
    }
}
