//! What a check of gradients found.

use std::fmt;

/// What is wrong with a gradient.
#[derive(Clone, Debug, PartialEq)]
pub enum Fault {
    /// A required block does not exist.
    Absent,
    /// A block is neither required nor exempt, or has no gradient to check.
    Unlisted,
    /// Every value of a required gradient is zero.
    Zero,
    /// A value is not finite.
    NotFinite,
    /// Rounding could hide a wrong sign: κ/E.
    Untested(f64),
    /// Rounding could hide a wrong sign in so many of the rows that were tried, more than half of them.
    Rows(usize),
    /// Finite differences say something else.
    Wrong(Direction),
    /// More than half of the directions of a block are off: median of `|m − p|` over its tolerance.
    Median(f64),
    /// Too many outliers of so many directions.
    Outliers(usize, usize),
}

/// One direction that was measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Direction {
    /// Which values of the block it changes.
    pub kind: Kind,
    /// Step `h` along the unit direction.
    pub step: f64,
    /// Derivative `m` by finite differences.
    pub measured: f64,
    /// Derivative `p` by the method's gradient.
    pub predicted: f64,
    /// Tolerance `ρ E + κ` of `|m − p|`.
    pub tolerance: f64,
    /// Rounding over expected size, `κ/E`; untested above 1/5.
    pub rounding: f64,
}

/// What a direction runs through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// All values of the block, at random.
    Whole,
    /// One row of the block, at random.
    Row(usize),
    /// All values, along the gradient.
    Along,
}

impl Direction {
    /// `|m − p|` over the tolerance.
    pub fn error(&self) -> f64 {
        (self.measured - self.predicted).abs() / self.tolerance
    }
}

/// The result for one block.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BlockReport {
    /// Dotted name of the block.
    pub name: String,
    /// Number of values in the block.
    pub len: usize,
    /// Norm `‖g‖` of the gradient.
    pub norm: f64,
    /// Rounding `σ` of the functional, a standard deviation.
    pub noise: f64,
    /// h of the first direction.
    pub step: f64,
    /// Every direction that was judged, with its result.
    pub directions: Vec<Direction>,
    /// How many of them the gradient describes on one side, or over the double distance, alone.
    pub bent: usize,
    /// How many of them are outliers.
    pub outliers: usize,
    /// Rows whose own direction would be lost in rounding.
    pub untested_rows: usize,
    /// What is wrong; empty if the block passes.
    pub faults: Vec<Fault>,
}

impl BlockReport {
    /// Median of `|m − p|` over its tolerance.
    pub fn median(&self) -> f64 {
        let mut errors: Vec<f64> = self.directions.iter().map(Direction::error).collect();
        errors.sort_by(f64::total_cmp);
        errors.get(errors.len() / 2).copied().unwrap_or(0.0)
    }
}

impl fmt::Display for BlockReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let worst = self.directions.iter().map(Direction::error).fold(0.0, f64::max);
        let rounding = self.directions.first().map_or(0.0, |d| d.rounding);
        write!(
            f,
            "{:32} n {:6}  |g| {:9.2e}  noise {:8.1e}  step {:8.1e}  rounding {:6.3}  median {:6.3}  worst {:8.3}  \
             directions {:3}  bent {}  outliers {}  untested rows {}",
            self.name,
            self.len,
            self.norm,
            self.noise,
            self.step,
            rounding,
            self.median(),
            worst,
            self.directions.len(),
            self.bent,
            self.outliers,
            self.untested_rows
        )
    }
}

/// The result for a method.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Report {
    /// The blocks that were checked.
    pub blocks: Vec<BlockReport>,
    /// What is wrong beside them: name or beginning of a name, and the fault.
    pub faults: Vec<(String, Fault)>,
}

impl Report {
    /// Everything that is wrong, by block; the method's own faults have no block.
    pub fn all_faults(&self) -> Vec<(&str, &Fault)> {
        let of_blocks = self.blocks.iter().flat_map(|b| b.faults.iter().map(|f| (b.name.as_str(), f)));
        self.faults.iter().map(|(name, fault)| (name.as_str(), fault)).chain(of_blocks).collect()
    }

    /// Whether something is wrong with a block.
    pub fn has_fault(&self, block: &str) -> bool {
        self.all_faults().iter().any(|(name, _)| *name == block)
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.blocks.iter().try_for_each(|b| writeln!(f, "{b}"))?;
        self.all_faults().iter().try_for_each(|(name, fault)| writeln!(f, "{name}: {fault:?}"))
    }
}
