//! A few plain network layers with hand-derived gradients: no graph, no framework.
//!
//! Rows (one per splat) are processed in blocks of [`BLOCK`]; inside a block every matrix product is a serial call
//! of [`gemm()`](gemm::gemm), and rayon runs over blocks. Parameter gradients are summed over at most [`CHUNKS`] runs of
//! consecutive blocks, and the runs are added in order: the split depends on the number of rows alone, so results are
//! bitwise equal for any number of threads.
//!
//! Layers of rows work on one block and are serial; the caller owns the loop over blocks, so that an encoder, several
//! networks and the use of their output share one pass through the cache. Layers of maps are parallel over rows of pixels.

pub mod activation;
pub mod conv;
pub mod dense;
pub mod encoding;
mod gather;
pub mod gemm;
pub mod heads;
pub mod jet;
pub mod map;
pub mod map_reference;
pub mod mlp;
pub mod norm;
pub mod resample;

pub use activation::Activation;
pub use conv::{Conv, ConvSpec, ConvTranspose};
pub use dense::{Dense, DenseGrad, Init};
pub use heads::{Heads, HeadsGrad, HeadsTape};
pub use jet::JetTape;
pub use map::{Map, Sites};
pub use mlp::{Mlp, MlpGrad, MlpTape};
pub use norm::{GroupNorm, NormTape};

/// Rows of one block: 256 × 64 values of `f32` fill 64 KiB, so a few activations fit the second-level cache.
pub const BLOCK: usize = 256;

/// Largest number of partial sums of a parameter gradient, hence of parallel tasks of a backward pass.
pub const CHUNKS: usize = 8;

/// Blocks in each chunk of a backward pass over `blocks` blocks (the last chunk may hold fewer).
pub fn blocks_per_chunk(blocks: usize) -> usize {
    blocks.div_ceil(CHUNKS).max(1)
}
