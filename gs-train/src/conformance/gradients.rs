//! Compares the gradients of a method with finite differences, block by block.
//!
//! The functional that [`View`] offers is `Σ w·rgb` over the pixels of a view, with one random weight per 8×8 patch and
//! channel. Gradients come from the production rasteriser in f32, as in training; differences are of the reference rasteriser
//! in f64, over the splats that the method renders in a training step. Regularisers take no part.
//!
//! A method that leaves a path out of its gradient on purpose either exempts the blocks concerned ([`Rules::exempt`]) or is
//! given a functional of its own that leaves the path out as well.
//!
//! Let `L(θ)` be a functional, `b` a block of `n` values in `r` rows of `w`, `g` the gradient that the method wrote for it.
//! Along a direction `d` with `|d| = 1` and a step `h`
//! ```text
//! measured   m = (L(θ + h d) − L(θ − h d)) / 2h            central difference, in f64
//! predicted  p = Σ g_i (θ⁺_i − θ⁻_i) / 2h                  of the two points as they are in f32
//! ```
//! # Directions
//! | kind | number | expected size `E` of the derivative |
//! |---|---|---|
//! | random in the whole block | [`Rules::directions`] | `‖g‖/√n` |
//! | random in one row, for rows in random order | up to [`Rules::rows`] | `max(‖g_row‖/√w, ‖g‖/2√n)` |
//! | along `g` | 1 | `‖g‖` |
//!
//! Random directions see a part of a block that has no gradient; the direction along `g` has the best ratio of signal to
//! rounding and sees a wrong factor.
//!
//! # Step
//! The rounding `σ` of `L` is estimated for each block from fourth differences (Moré and Wild 2011, "Estimating computational
//! noise"), in which nothing smooth remains: over [`POINTS`] points at distances `δ` along a random direction,
//! `σ = median |Δ⁴L| / (0.6745 √70)`, as for a normal distribution; a single jump does not change the median. The step of a
//! direction that is spread over `k = 1/Σ d⁴` values is
//! ```text
//! h = clamp(CONTRAST σ/E, MIN_DISPLACEMENT s √k, MAX_DISPLACEMENT s √k)      s = max(rms of the block's values, MIN_SCALE)
//! ```
//! so that `L` changes by about [`CONTRAST`] times its rounding, where that is possible near the block's values. At first `δ`
//! is a quarter of the smallest step. As long as that gives a longer step, σ is estimated again with `δ` a quarter of it, at
//! most [`ROUNDS`] times: a displacement that is lost in rounding at short distances shows at longer ones. `L` must be
//! computed in f64; a functional in f32 is a staircase whose steps fourth differences do not see.
//!
//! # Tolerance
//! `|m − p| ≤ ρ E + κ` with `ρ` = [`Rules::relative`] and the rounding of a central difference at [`SIGMAS`] standard
//! deviations, `κ = SIGMAS σ/(√2 h)`. A direction with `κ > E/5` could hide a wrong sign and counts as untested: a fault, or
//! for single rows, a fault if it is more than half of them.
//!
//! A functional has kinks (rectifiers) and jumps (splats that change their order in depth) that no gradient shows, and its
//! rounding now and then is far from a normal distribution. So a direction that fails is measured again over `2h`, from each
//! side and from both: `(L(θ + 2h d) − L(θ))/2h`, `(L(θ) − L(θ − 2h d))/2h` and their mean. None of these has more rounding
//! than `m`, and the tolerance is the same. Where one of them agrees with `p`, the gradient is the derivative of that side and
//! the direction is **bent**. Where none does, the direction is measured at `h/2`. If that agrees with `m` within
//! `ρ E/2 + κ`, the functional is smooth and the gradient is **wrong**; otherwise `L` jumps or bends near by and the direction
//! is an **outlier**. Outliers are not accepted, they are counted: at most one in [`Rules::outliers`] of all directions of a
//! method (or one). Bent ones and outliers together are less than half of those of a block.

mod block;
mod report;
mod view;

pub use report::{BlockReport, Direction, Fault, Kind, Report};
pub use view::View;

use crate::model::Model;
use block::{Block, norm, spread};

/// Evaluations of the functional that its rounding is estimated from.
pub const POINTS: usize = 17;
/// Estimates of the rounding at most, each over a longer distance.
pub const ROUNDS: usize = 4;
/// Change of the functional over a step, in standard deviations of its rounding.
pub const CONTRAST: f64 = 120.0;
/// Standard deviations of rounding that are allowed for.
pub const SIGMAS: f64 = 5.0;
/// Smallest displacement of a value, as a share of the block's root mean square.
pub const MIN_DISPLACEMENT: f64 = 1e-4;
/// Largest displacement of a value, as a share of the block's root mean square.
pub const MAX_DISPLACEMENT: f64 = 1e-2;
/// Least root mean square that a block counts with (many begin at zero).
pub const MIN_SCALE: f64 = 0.1;

/// The gradient of one block of parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct BlockGradient {
    /// Dotted name of the block.
    pub name: String,
    /// Values per row, where the block has rows.
    pub row_width: Option<usize>,
    /// Gradient of every value of the block, in its own order.
    pub grad: Vec<f32>,
}

/// The gradients that a method holds.
pub fn gradients(method: &Model) -> Vec<BlockGradient> {
    let mut all = Vec::new();
    method.visit(&mut |p| {
        all.push(BlockGradient { name: p.name.clone(), row_width: p.row_width, grad: p.grad.clone() });
    });
    all
}

/// The functional as a function of one block: what the method's gradient of that block is meant to be the derivative of.
/// The second argument is the block's name.
pub type Functional<'a> = dyn FnMut(&mut Model, &str) -> f64 + 'a;

/// What is checked, and how strictly.
#[derive(Clone, Copy, Debug)]
pub struct Rules<'a> {
    /// Seed of the random directions.
    pub seed: u64,
    /// Random directions through each block.
    pub directions: usize,
    /// Rows of each block that are tried one by one, at most.
    pub rows: usize,
    /// Relative tolerance `ρ` of a directional derivative.
    pub relative: f64,
    /// One in so many directions of a method may be an outlier, one in any case; 0: none.
    pub outliers: usize,
    /// Beginnings of the names of blocks that must have a right gradient, not zero; `""` is that of every block. Each must be
    /// that of a block.
    pub required: &'a [&'a str],
    /// Beginnings of the names of blocks that are not checked, and why. Every block must be required or exempt; where it is
    /// both, the longer beginning counts.
    pub exempt: &'a [(&'a str, &'a str)],
}

impl Default for Rules<'_> {
    /// Every block, to 2 %, in 6 directions and 24 rows; one direction in 50 may be an outlier.
    fn default() -> Self {
        Self { seed: 7, directions: 6, rows: 24, relative: 0.02, outliers: 50, required: &[""], exempt: &[] }
    }
}

impl Rules<'_> {
    /// Whether a block is not checked.
    pub fn is_exempt(&self, block: &str) -> bool {
        let longest =
            |prefixes: &mut dyn Iterator<Item = &str>| prefixes.filter(|p| block.starts_with(p)).map(str::len).max();
        longest(&mut self.exempt.iter().map(|e| e.0)) > longest(&mut self.required.iter().copied())
    }
}

/// Checks every block of a method; its values are afterwards what they were.
pub fn check(
    method: &mut Model,
    gradients: &[BlockGradient],
    functional: &mut Functional<'_>,
    rules: &Rules<'_>,
) -> Report {
    let mut report = Report::default();
    let mut names = Vec::new();
    method.visit(&mut |p| names.push(p.name.clone()));
    for required in rules.required {
        if !names.iter().any(|n| n.starts_with(required)) {
            report.faults.push(((*required).to_owned(), Fault::Absent));
        }
    }
    for name in names {
        if rules.is_exempt(&name) {
            continue;
        }
        let required = rules.required.iter().any(|r| name.starts_with(r));
        match gradients.iter().find(|g| g.name == name).filter(|_| required) {
            Some(gradient) => report.blocks.push(check_block(method, gradient, functional, rules)),
            None => report.faults.push((name, Fault::Unlisted)),
        }
    }
    let judged = report.blocks.iter().map(|b| b.directions.len()).sum::<usize>();
    let outliers = report.blocks.iter().map(|b| b.outliers).sum::<usize>();
    let allowed = judged.checked_div(rules.outliers).map_or(0, |share| share.max(1));
    if outliers > allowed {
        report.faults.push((String::new(), Fault::Outliers(outliers, judged)));
    }
    report
}

/// Checks one block of a method; its values are afterwards what they were.
pub fn check_block(
    method: &mut Model,
    gradient: &BlockGradient,
    functional: &mut Functional<'_>,
    rules: &Rules<'_>,
) -> BlockReport {
    let mut block = Block::new(method, gradient, functional, rules.seed);
    let (size, len) = (norm(&gradient.grad), gradient.grad.len());
    let mut report = BlockReport { name: gradient.name.clone(), len, norm: size, ..BlockReport::default() };
    if !size.is_finite() || block.start.len() != len {
        report.faults.push(Fault::NotFinite);
        return report;
    }
    if size == 0.0 {
        report.faults.push(Fault::Zero);
        return report;
    }
    let scale = (norm(&block.start) / (len as f64).sqrt()).max(MIN_SCALE);
    let noise = block.noise(scale, size);
    report.noise = noise;
    for (kind, direction, expected) in block.directions(rules, size) {
        let longest = scale * spread(&direction).sqrt();
        let step = (CONTRAST * noise / expected).clamp(MIN_DISPLACEMENT * longest, MAX_DISPLACEMENT * longest);
        let rounding = SIGMAS * noise / (2f64.sqrt() * step);
        match kind {
            _ if rounding <= 0.2 * expected => {}
            Kind::Row(_) => {
                report.untested_rows += 1;
                continue;
            }
            _ => {
                report.faults.push(Fault::Untested(rounding / expected));
                continue;
            }
        }
        let tolerance = rules.relative * expected + rounding;
        let [measured, predicted] = block.slopes(&direction, -step, step);
        let found = Direction { kind, step, measured, predicted, tolerance, rounding: rounding / expected };
        if found.error() > 1.0 || !found.error().is_finite() {
            let smooth = 0.5 * rules.relative * expected + rounding;
            match second_look(&mut block, &direction, &found, smooth) {
                Verdict::Bent => report.bent += 1,
                Verdict::Outlier => report.outliers += 1,
                Verdict::Wrong => report.faults.push(Fault::Wrong(found.clone())),
            }
        }
        report.directions.push(found);
    }
    block.restore();
    report.step = report.directions.first().map_or(0.0, |d| d.step);
    let rows = report.directions.iter().filter(|d| matches!(d.kind, Kind::Row(_))).count();
    if report.untested_rows > rows {
        report.faults.push(Fault::Rows(report.untested_rows));
    }
    if report.median() > 1.0 {
        report.faults.push(Fault::Median(report.median()));
    }
    report
}

/// What a direction is whose central difference is not what the gradient says.
enum Verdict {
    Bent,
    Outlier,
    Wrong,
}

/// Measures a direction that failed over other distances; `smooth` is how far the difference over `h/2` may be from that over
/// `h` where nothing bends.
fn second_look(block: &mut Block<'_, '_>, direction: &[f64], found: &Direction, smooth: f64) -> Verdict {
    if !found.error().is_finite() {
        return Verdict::Wrong;
    }
    let far = 2.0 * found.step;
    let agrees = |[measured, predicted]: [f64; 2]| (measured - predicted).abs() <= found.tolerance;
    if [(0.0, far), (-far, 0.0), (-far, far)].iter().any(|(from, to)| agrees(block.slopes(direction, *from, *to))) {
        return Verdict::Bent;
    }
    let [closer, _] = block.slopes(direction, -0.5 * found.step, 0.5 * found.step);
    match (closer - found.measured).abs() <= smooth {
        true => Verdict::Wrong,
        false => Verdict::Outlier,
    }
}
