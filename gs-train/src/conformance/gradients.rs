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
//! for single rows, a fault if it is more than half of them. A direction that fails is measured once more at `h/2`. Where the
//! two differences agree within `ρ E/2 + κ`, the functional is smooth and the gradient is **wrong**; where they do not, `L`
//! jumps or bends within the step and the direction is an **outlier**. Outliers are not accepted, they are counted: at most
//! one in [`Rules::outliers`] of all directions of a method (or one), and less than half of those of a block.

use crate::method::{LossValue, MethodError, RenderView, ViewCtx};
use crate::model::Model;
use crate::timestamp::Timestamp;
use gs_core::{Camera, Params, Rng, Splats, SplatsGrad, SplatsRef};
use gs_raster::reference::{self, Cutoff, Scene};
use gs_raster::{ClampGrad, FrameGrad, RasterOptions, ScreenStats, Workspace, render, render_backward};
use std::fmt;

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

/// A view whose image the functional is made of.
pub struct View {
    at: Timestamp,
    camera: Camera,
    step: u32,
    options: RasterOptions,
    weights: Vec<f32>,
}

impl View {
    /// The view of a camera at a timestamp, in step `step` of the schedule. It is rendered without the visible steps at α =
    /// 1/255 and T = 1e-4, which no gradient accounts for.
    pub fn new(model: &Model, step: u32, at: Timestamp, camera: Camera) -> Self {
        let options = model.raster_options([0.2, 0.4, 0.6]);
        let options = RasterOptions { min_alpha: 1e-7, stop: 1e-9, clamp_grad: ClampGrad::Exact, ..options };
        let (width, height) = (camera.width as usize, camera.height as usize);
        let patches = width.div_ceil(8);
        let weight = |i: usize| {
            let (pixel, channel) = (i / 3, i % 3);
            let patch = pixel / width / 8 * patches + pixel % width / 8;
            Rng::new(1, "weights", channel as u32, patch as u64).normal()
        };
        let weights = (0..3 * width * height).map(weight).collect();
        Self { at, camera, step, options, weights }
    }

    /// Timestamp at which the splats are asked for.
    pub fn at(&self) -> &Timestamp {
        &self.at
    }

    /// Camera from which the image is rendered.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The gradients of the functional as a training step finds them.
    ///
    /// # Errors
    /// If the step fails.
    pub fn gradients(&self, model: &mut Model) -> Result<Vec<BlockGradient>, MethodError> {
        model.clear_grads();
        self.step(model, &mut Backward { view: self, stats: ScreenStats::default() })?;
        Ok(gradients(model))
    }

    /// The splats that a training step renders; none if it leaves the view unrendered.
    ///
    /// # Errors
    /// If the step fails.
    pub fn splats(&self, model: &mut Model) -> Result<Splats, MethodError> {
        let mut record = Record::default();
        self.step(model, &mut record)?;
        Ok(record.splats)
    }

    /// The functional of splats; NaN if there are none.
    pub fn value(&self, scene: &Scene<f64>) -> f64 {
        if scene.means.is_empty() {
            return f64::NAN;
        }
        let frame = reference::render(scene, &self.camera, &self.options, Cutoff::Hard);
        frame.rgb.as_flattened().iter().zip(&self.weights).map(|(v, w)| v * f64::from(*w)).sum()
    }

    /// The functional of the present parameters; NaN if the step fails.
    pub fn functional(&self, model: &mut Model) -> f64 {
        self.splats(model).map_or(f64::NAN, |splats| self.value(&Scene::new(&splats)))
    }

    fn step(&self, model: &mut Model, render: &mut dyn RenderView) -> Result<Vec<LossValue>, MethodError> {
        model.begin_step(self.step);
        model.step(&ViewCtx { at: self.at, camera: &self.camera, last: false }, render)
    }
}

/// Pulls the weights of the functional back to the splats.
struct Backward<'a> {
    view: &'a View,
    stats: ScreenStats,
}

impl RenderView for Backward<'_> {
    fn render(&mut self, splats: SplatsRef<'_>, grad: &mut SplatsGrad) -> Result<&ScreenStats, MethodError> {
        let (View { camera, options, weights, .. }, mut workspace) = (self.view, Workspace::new());
        render(splats, camera, options, &mut workspace);
        let upstream = FrameGrad { rgb: weights.clone(), ..FrameGrad::default() };
        (*grad, self.stats) = render_backward(splats, camera, options, &mut workspace, &upstream);
        Ok(&self.stats)
    }
}

/// Keeps the splats and renders nothing.
#[derive(Default)]
struct Record {
    splats: Splats,
    stats: ScreenStats,
}

impl RenderView for Record {
    fn render(&mut self, splats: SplatsRef<'_>, grad: &mut SplatsGrad) -> Result<&ScreenStats, MethodError> {
        self.splats = splats.to_splats();
        grad.reset(splats);
        self.stats = ScreenStats { grad_means2d: vec![[0.0; 2]; splats.len()], radii: vec![0.0; splats.len()] };
        Ok(&self.stats)
    }
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
#[derive(Clone, Debug, PartialEq)]
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
             directions {:3}  outliers {}  untested rows {}",
            self.name,
            self.len,
            self.norm,
            self.noise,
            self.step,
            rounding,
            self.median(),
            worst,
            self.directions.len(),
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
    let mut start = Vec::new();
    method.visit(&mut |p| {
        if p.name == gradient.name {
            start.clone_from(&p.value);
        }
    });
    let mut block = Block { gradient, start, method, functional, seed: rules.seed };
    let (size, len) = (norm(&gradient.grad), gradient.grad.len());
    let mut report = BlockReport {
        name: gradient.name.clone(),
        len,
        norm: size,
        noise: 0.0,
        step: 0.0,
        directions: Vec::new(),
        outliers: 0,
        untested_rows: 0,
        faults: Vec::new(),
    };
    let right_length = block.start.len() == len;
    if !size.is_finite() || !right_length {
        report.faults.push(Fault::NotFinite);
        return report;
    }
    if size == 0.0 {
        report.faults.push(Fault::Zero);
        return report;
    }
    let scale = (norm(&block.start) / (len as f64).sqrt()).max(MIN_SCALE);
    let (mut noise, mut displacement) = (0.0, MIN_DISPLACEMENT * scale);
    for _ in 0..ROUNDS {
        noise = block.measure_noise(0.25 * displacement);
        let wanted = (CONTRAST * noise / size).min(MAX_DISPLACEMENT * scale);
        if wanted <= displacement {
            break;
        }
        displacement = wanted;
    }
    report.noise = noise;
    for (kind, direction, expected) in block.directions(rules, size) {
        let longest = scale * spread(&direction).sqrt();
        let step = (CONTRAST * noise / expected).clamp(MIN_DISPLACEMENT * longest, MAX_DISPLACEMENT * longest);
        let rounding = SIGMAS * noise / (2f64.sqrt() * step);
        if rounding > 0.2 * expected {
            match kind {
                Kind::Row(_) => report.untested_rows += 1,
                _ => report.faults.push(Fault::Untested(rounding / expected)),
            }
            continue;
        }
        let tolerance = rules.relative * expected + rounding;
        let [measured, predicted] = block.slopes(&direction, step);
        let found = Direction { kind, step, measured, predicted, tolerance, rounding: rounding / expected };
        if found.error() > 1.0 || !found.error().is_finite() {
            let [closer, _] = block.slopes(&direction, 0.5 * step);
            let smooth = (closer - measured).abs() <= 0.5 * rules.relative * expected + rounding;
            match smooth || !found.error().is_finite() {
                true => report.faults.push(Fault::Wrong(found.clone())),
                false => report.outliers += 1,
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

/// A block under test, with the values it started from.
struct Block<'a, 'f> {
    gradient: &'a BlockGradient,
    start: Vec<f32>,
    method: &'a mut Model,
    functional: &'a mut Functional<'f>,
    seed: u64,
}

impl Block<'_, '_> {
    /// The functional with other values of the block.
    fn at(&mut self, values: &[f32]) -> f64 {
        let name = &self.gradient.name;
        self.method.visit_mut(&mut |p| {
            if p.name == *name {
                p.value.copy_from_slice(values);
            }
        });
        (self.functional)(self.method, name)
    }

    fn restore(&mut self) {
        let (name, start) = (&self.gradient.name, &self.start);
        self.method.visit_mut(&mut |p| {
            if p.name == *name {
                p.value.copy_from_slice(start);
            }
        });
    }

    fn random(&self, purpose: &str, index: usize, len: usize) -> Vec<f64> {
        let purpose = format!("{purpose} {}", self.gradient.name);
        let mut rng = Rng::new(self.seed, &purpose, index as u32, 0);
        (0..len).map(|_| f64::from(rng.normal())).collect()
    }

    /// σ, from points between which each value moves by `displacement`.
    fn measure_noise(&mut self, displacement: f64) -> f64 {
        let direction = unit(self.random("noise", 0, self.start.len()));
        let distance = displacement * spread(&direction).sqrt();
        let mut values: Vec<f64> = (0..POINTS).map(|k| self.along(&direction, distance * k as f64).0).collect();
        for _ in 0..4 {
            values = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
        }
        values.iter_mut().for_each(|v| *v = v.abs());
        values.sort_by(f64::total_cmp);
        values[values.len() / 2] / (0.6745 * 70f64.sqrt())
    }

    /// The functional a step along a direction, and the values there.
    fn along(&mut self, direction: &[f64], step: f64) -> (f64, Vec<f32>) {
        let moved = |(v, d): (&f32, &f64)| (f64::from(*v) + step * d) as f32;
        let values: Vec<f32> = self.start.iter().zip(direction).map(moved).collect();
        (self.at(&values), values)
    }

    /// All directions of the block: what they run through, unit vectors, expected derivatives.
    fn directions(&self, rules: &Rules<'_>, norm_of_all: f64) -> Vec<(Kind, Vec<f64>, f64)> {
        let grad = &self.gradient.grad;
        let typical = norm_of_all / (grad.len() as f64).sqrt();
        let mut all = Vec::new();
        for k in 0..rules.directions {
            all.push((Kind::Whole, unit(self.random("whole", k, grad.len())), typical));
        }
        all.push((Kind::Along, unit(grad.iter().map(|g| f64::from(*g)).collect()), norm_of_all));
        let Some(width) = self.gradient.row_width else { return all };
        let rows = grad.len() / width;
        let mut order: Vec<usize> = (0..rows).collect();
        order.sort_by_key(|row| Rng::new(self.seed, "order of rows", 0, *row as u64).bits());
        for row in order.into_iter().take(rules.rows) {
            let here = row * width..(row + 1) * width;
            let mut direction = vec![0.0; grad.len()];
            direction[here.clone()].copy_from_slice(&unit(self.random("row", row, width)));
            let of_row = norm(&grad[here]) / (width as f64).sqrt();
            all.push((Kind::Row(row), direction, of_row.max(0.5 * typical)));
        }
        all
    }

    /// Measured and predicted slope along a unit direction.
    fn slopes(&mut self, direction: &[f64], step: f64) -> [f64; 2] {
        let (high, hi) = self.along(direction, step);
        let (low, lo) = self.along(direction, -step);
        let measured = high - low;
        let differences = hi.iter().zip(&lo).map(|(a, b)| f64::from(*a) - f64::from(*b));
        let predicted: f64 = differences.zip(&self.gradient.grad).map(|(d, g)| d * f64::from(*g)).sum();
        [measured, predicted].map(|change| change / (2.0 * step))
    }
}

fn norm(values: &[f32]) -> f64 {
    values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt()
}

/// Over how many values a unit direction is spread.
fn spread(direction: &[f64]) -> f64 {
    1.0 / direction.iter().map(|d| d.powi(4)).sum::<f64>()
}

fn unit(mut values: Vec<f64>) -> Vec<f64> {
    let norm = values.iter().map(|v| v * v).sum::<f64>().sqrt();
    values.iter_mut().for_each(|v| *v /= norm);
    values
}
