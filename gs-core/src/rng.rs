//! Counter-based random numbers: every number is a pure function of `(seed, purpose, step, row, index)`.
//!
//! The generator is Philox4x32-10 (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3"). Because no state
//! is shared, results do not depend on scheduling, on the number of threads or on other streams, and a resumed run gets
//! the numbers of an uninterrupted one.
//!
//! ```
//! use gs_core::Rng;
//!
//! let offset = |row| Rng::new(42, "split", 1000, row).normal();
//! assert_eq!(offset(7), offset(7)); // the same stream, the same number, on any thread
//! assert_ne!(offset(7), offset(8));
//! let mut order = Rng::new(42, "view order", 0, 0).permutation(5);
//! order.sort();
//! assert_eq!(order, [0, 1, 2, 3, 4]);
//! ```

const MULTIPLIERS: [u32; 2] = [0xD251_1F53, 0xCD9E_8D57];
const WEYL: [u32; 2] = [0x9E37_79B9, 0xBB67_AE85];
const ROUNDS: usize = 10;

/// One block of Philox4x32-10: 128 random bits from a 128-bit counter and a 64-bit key.
fn philox(mut counter: [u32; 4], mut key: [u32; 2]) -> [u32; 4] {
    for _ in 0..ROUNDS {
        let a = u64::from(MULTIPLIERS[0]) * u64::from(counter[0]);
        let b = u64::from(MULTIPLIERS[1]) * u64::from(counter[2]);
        counter = [(b >> 32) as u32 ^ counter[1] ^ key[0], b as u32, (a >> 32) as u32 ^ counter[3] ^ key[1], a as u32];
        key = [key[0].wrapping_add(WEYL[0]), key[1].wrapping_add(WEYL[1])];
    }
    counter
}

/// 64-bit FNV-1a: a stable hash of a purpose's name.
const fn hash_name(name: &str) -> u64 {
    let bytes = name.as_bytes();
    let mut h = 0xcbf2_9ce4_8422_2325u64;
    let mut i = 0;
    while i < bytes.len() {
        h = (h ^ bytes[i] as u64).wrapping_mul(0x0000_0100_0000_01b3);
        i += 1;
    }
    h
}

/// The stream of random numbers of one `(seed, purpose, step, row)`. Cheap to make: make one per row.
#[derive(Clone, Debug)]
pub struct Rng {
    key: [u32; 2],
    step: u32,
    row: u64,
    block: u32,
    buffer: [u32; 4],
    used: usize,
}

impl Rng {
    /// The stream named by its four arguments. `purpose` is any short name; streams of different names are
    /// independent (up to 64-bit hash collisions).
    pub fn new(seed: u64, purpose: &str, step: u32, row: u64) -> Self {
        let key = hash_name(purpose) ^ seed.wrapping_mul(0x9E37_79B9_7F4A_7C15);
        Self { key: [key as u32, (key >> 32) as u32], step, row, block: 0, buffer: [0; 4], used: 4 }
    }

    /// The next 32 uniform random bits.
    pub fn bits(&mut self) -> u32 {
        if self.used == 4 {
            self.buffer = philox([self.block, self.row as u32, (self.row >> 32) as u32, self.step], self.key);
            self.block += 1;
            self.used = 0;
        }
        self.used += 1;
        self.buffer[self.used - 1]
    }

    /// Uniform in `[0, 1)`, a multiple of 2⁻²⁴.
    pub fn uniform(&mut self) -> f32 {
        (self.bits() >> 8) as f32 * (1.0 / 16_777_216.0)
    }

    /// Uniform in `[lo, hi)` (up to rounding).
    pub fn range(&mut self, lo: f32, hi: f32) -> f32 {
        lo + (hi - lo) * self.uniform()
    }

    /// Standard normal (mean 0, variance 1), by the Box–Muller transform in `f64`.
    pub fn normal(&mut self) -> f32 {
        let u = (f64::from(self.bits()) + 0.5) / 4_294_967_296.0;
        let v = f64::from(self.bits()) / 4_294_967_296.0;
        ((-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()) as f32
    }

    /// Uniform integer in `0..n` by multiplication (bias below `n / 2³²`). `n` must not be zero.
    pub fn below(&mut self, n: u32) -> u32 {
        debug_assert!(n > 0, "an empty range has no member");
        ((u64::from(self.bits()) * u64::from(n)) >> 32) as u32
    }

    /// A random order of `0..n` (Fisher–Yates).
    pub fn permutation(&mut self, n: usize) -> Vec<u32> {
        let mut order: Vec<u32> = (0..n as u32).collect();
        for i in (1..n).rev() {
            order.swap(i, self.below(i as u32 + 1) as usize);
        }
        order
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Known answers published with the Random123 library.
    #[test]
    fn philox_known_answers() {
        assert_eq!(philox([0; 4], [0; 2]), [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]);
        assert_eq!(philox([u32::MAX; 4], [u32::MAX; 2]), [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]);
    }

    #[test]
    fn streams_are_pure_and_distinct() {
        let draw = |seed, purpose: &str, step, row| {
            let mut r = Rng::new(seed, purpose, step, row);
            [r.bits(), r.bits(), r.bits(), r.bits(), r.bits()]
        };
        let base = draw(1, "split", 2, 3);
        assert_eq!(base, draw(1, "split", 2, 3));
        for other in [draw(2, "split", 2, 3), draw(1, "clone", 2, 3), draw(1, "split", 3, 3), draw(1, "split", 2, 4)] {
            assert_ne!(base, other);
        }
    }

    #[test]
    fn moments_are_right() {
        let mut r = Rng::new(7, "moments", 0, 0);
        let n = 200_000;
        let (mut mean, mut square, mut uniform) = (0.0f64, 0.0f64, 0.0f64);
        for _ in 0..n {
            let v = f64::from(r.normal());
            mean += v;
            square += v * v;
            uniform += f64::from(r.uniform());
        }
        let n = f64::from(n);
        assert!((mean / n).abs() < 0.01 && (square / n - 1.0).abs() < 0.02 && (uniform / n - 0.5).abs() < 0.005);
    }

    #[test]
    fn permutation_holds_every_member_once() {
        let mut p = Rng::new(9, "order", 0, 0).permutation(1000);
        assert_ne!(p, (0..1000).collect::<Vec<u32>>());
        p.sort_unstable();
        assert_eq!(p, (0..1000).collect::<Vec<u32>>());
    }
}
