//! Images of one scene with exposures and white balances of their own. Every image has a map of colours: affine and learnt by gradients in Hierarchical 3D
//! Gaussians (Kerbl et al. 2024). Here each is found by least squares whenever its image is drawn, linear or, with [`ExposureConfig::offset`], affine.
//!
//! ```text
//! loss of image k:   E_k x against y          x: frame, y: image k, E_k constant
//! then               E_k ← ½ (E_k + M_k)      M_k: the map from x to y (gs_metrics::ColorMap)
//! and                E_j ← E_j Ē⁻¹            for all images j: their mean stays the identity
//! ```
//! With an offset `o` the maps are `4×4`, `(E o; 0 1)`, and act on a colour and its alpha: frames are premultiplied by their alpha `α`. The lines are the
//! same.
//!
//! A background `b` is no part of the scene and keeps its colour: `x` and `y` are what is before it, `1 − α` of it being seen, and it is added again after
//! the map.
//!
//! ```text
//! x ↦ E (x − (1 − α) b) + α o + (1 − α) b  =  E x + α o + (1 − α) (b − E b)
//! for the gradient g of the mapped colours:   dL/dx = Eᵀ g        dL/dα = (E b + o − b) · g
//! ```
//! So alpha has a gradient before a black background as well, where there is an offset.
//!
//! The mean holds the colours of the scene: brighter splats and darker maps would give the same images. Saturated values of an image are met by anything
//! above them, which then counts as they do and has no gradient.

#[cfg(test)]
mod tests;

use gs_core::{Image, cast};
use gs_metrics::color_map::SATURATED;
use gs_metrics::{ColorMap, MetricError};
use gs_raster::{Frame, FrameGrad};
use serde::{Deserialize, Serialize};

/// Section `[schedule.exposure]` of a configuration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExposureConfig {
    /// Whether frames are mapped to the colours of their image before they are compared.
    pub fit: bool,
    /// Share of the run after which they are.
    pub after: f64,
    /// What holds the maps near the identity ([`ColorMap::fit`]), above 0.
    pub ridge: f64,
    /// Whether the maps have offsets: affine ones, not linear ones.
    #[serde(default)]
    pub offset: bool,
}

impl Default for ExposureConfig {
    /// Frames are compared as they are.
    fn default() -> Self {
        Self { fit: false, after: 0.0, ridge: 1.0, offset: false }
    }
}

impl ExposureConfig {
    /// The ridge of the maps in a step, from 1, of so many; none where frames are compared as they are.
    pub(crate) fn at(&self, step: u32, steps: u32) -> Option<f64> {
        let share = f64::from(step.saturating_sub(1)) / f64::from(steps.max(1));
        (self.fit && share >= self.after).then_some(self.ridge)
    }
}

/// How a frame is mapped to the colours of its image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExposureFit {
    /// The map of the image.
    pub map: ColorMap,
    /// What holds the map that is fitted anew near the identity.
    pub ridge: f64,
    /// Whether that map has an offset.
    pub offset: bool,
}

/// A frame in the colours of its image, with buffers kept between calls.
#[derive(Default)]
pub(super) struct Mapped {
    /// Its colours.
    pub(super) colors: Image,
    /// Where a saturated value of the image took the place of one above it: there they are constants.
    met: Vec<usize>,
}

/// Adds `by` times what is seen of a background to the colours of a frame of this alpha.
fn add_background(colors: &mut Image, alpha: &[f32], background: [f32; 3], by: f32) {
    if background == [0.0; 3] {
        return;
    }
    for (pixel, alpha) in colors.data.as_chunks_mut::<3>().0.iter_mut().zip(alpha) {
        pixel.iter_mut().zip(background).for_each(|(v, b)| *v += by * (1.0 - alpha) * b);
    }
}

/// The map, with an offset if it may have one, that brings what `frame` shows before a background nearest to what `target` shows there ([`ColorMap::fit`]).
/// `colors` becomes what the frame shows.
pub(crate) fn fit_before(
    frame: &Frame,
    background: [f32; 3],
    target: &Image,
    mask: Option<&Image>,
    ridge: f64,
    offset: bool,
    colors: &mut Image,
) -> Result<ColorMap, MetricError> {
    let fit = |colors: &Image, shown: &Image| match offset {
        true => ColorMap::fit_with_offset(colors, &frame.alpha, shown, mask, ridge),
        false => ColorMap::fit(colors, shown, mask, ridge),
    };
    colors.clone_from(&frame.rgb);
    if background == [0.0; 3] {
        return fit(colors, target);
    }
    let mut shown = target.clone();
    [&mut *colors, &mut shown].into_iter().for_each(|image| add_background(image, &frame.alpha, background, -1.0));
    // Saturated colours stay so: they tell the map nothing.
    for ((shown, target), alpha) in shown.data.chunks_exact_mut(3).zip(target.data.chunks_exact(3)).zip(&frame.alpha) {
        if *alpha > 0.0 && target.iter().any(|y| *y >= SATURATED) {
            shown.fill(SATURATED);
        }
    }
    fit(colors, &shown)
}

/// Maps what a frame shows before a background, and puts it before the background again.
pub(crate) fn map_before(map: &ColorMap, frame: &Frame, background: [f32; 3], colors: &mut Image) {
    map.apply_premultiplied(colors, &frame.alpha);
    add_background(colors, &frame.alpha, background, 1.0);
}

impl Mapped {
    /// From the gradient with respect to its colours, to that with respect to colours and alpha of the frame.
    pub(super) fn pull_back(&self, map: &ColorMap, background: [f32; 3], grad: &mut FrameGrad) {
        self.met.iter().for_each(|&at| grad.rgb[at] = 0.0);
        if background != [0.0; 3] || map.offset != [0.0; 3] {
            let mut mapped = Image { width: 1, height: 1, channels: 3, data: background.to_vec() };
            map.apply(&mut mapped);
            let slope: [f32; 3] = std::array::from_fn(|c| mapped.data[c] - background[c]);
            let of = |g: &[f32; 3]| g.iter().zip(slope).map(|(g, s)| g * s).sum::<f32>();
            grad.alpha.clear();
            grad.alpha.extend(grad.rgb.as_chunks().0.iter().map(of));
        }
        map.pull_back(&mut grad.rgb);
    }
}

impl ExposureFit {
    /// Writes a frame in the colours of `target` to `mapped`, both over `background`; gives the map that fits best.
    pub(super) fn apply(
        &self,
        frame: &Frame,
        background: [f32; 3],
        target: &Image,
        mask: Option<&Image>,
        mapped: &mut Mapped,
    ) -> Result<ColorMap, MetricError> {
        let Mapped { colors, met } = mapped;
        let best = fit_before(frame, background, target, mask, self.ridge, self.offset, colors)?;
        map_before(&self.map, frame, background, colors);
        met.clear();
        for (at, (v, y)) in colors.data.iter_mut().zip(&target.data).enumerate() {
            if *y >= SATURATED && *v > *y {
                *v = *y;
                met.push(at);
            }
        }
        Ok(best)
    }
}

/// Share of a new map in that of its image.
const NEW: f64 = 0.5;

/// The maps of all training images; empty before the first was fitted.
#[derive(Clone, Debug, Default)]
pub(crate) struct Exposures {
    /// Matrices, row by row.
    matrices: Vec<[f32; 9]>,
    /// As many offsets; empty while all are 0.
    offsets: Vec<[f32; 3]>,
}

impl Exposures {
    /// From the values of a checkpoint: matrices, and as many offsets or none.
    pub(crate) fn of(matrices: &[f32], offsets: &[f32]) -> Self {
        Self { matrices: matrices.as_chunks().0.to_vec(), offsets: offsets.as_chunks().0.to_vec() }
    }

    /// For a checkpoint: matrices and offsets.
    pub(crate) fn values(&self) -> [&[f32]; 2] {
        [self.matrices.as_flattened(), self.offsets.as_flattened()]
    }

    /// The map of an image.
    pub(crate) fn map(&self, image: usize) -> ColorMap {
        let offset = self.offsets.get(image).map_or([0.0; 3], |offset| offset.map(f64::from));
        self.matrices.get(image).map_or(ColorMap::IDENTITY, |rows| ColorMap { offset, ..map_of(rows) })
    }

    /// Forgets all maps unless they are of so many images: those of another number are others.
    pub(crate) fn keep_of(&mut self, images: usize) {
        if self.matrices.len() != images {
            *self = Self::default();
        }
    }

    /// Another map was fitted to an image, of so many.
    pub(crate) fn blend_in(&mut self, image: usize, map: &ColorMap, images: usize) {
        self.keep_of(images);
        self.matrices.resize(images, rows_of(&ColorMap::IDENTITY));
        let blended = self.map(image).blend(map, NEW);
        self.set(image, &blended);
        if let Some(undo) = self.mean().inverse() {
            for image in 0..images {
                let map = self.map(image).after(&undo);
                self.set(image, &map);
            }
        }
    }

    fn set(&mut self, image: usize, map: &ColorMap) {
        self.matrices[image] = rows_of(map);
        if self.offsets.is_empty() && map.offset != [0.0; 3] {
            self.offsets.resize(self.matrices.len(), [0.0; 3]);
        }
        if let Some(offset) = self.offsets.get_mut(image) {
            *offset = map.offset.map(cast::to_f32);
        }
    }

    fn mean(&self) -> ColorMap {
        let images = self.matrices.len() as f64;
        let entry = |k: usize| self.matrices.iter().map(|map| f64::from(map[k])).sum::<f64>() / images;
        let offset = |c: usize| self.offsets.iter().map(|offset| f64::from(offset[c])).sum::<f64>() / images;
        ColorMap { offset: std::array::from_fn(offset), ..map_of(&std::array::from_fn(entry)) }
    }
}

fn map_of<T: Copy + Into<f64>>(rows: &[T; 9]) -> ColorMap {
    ColorMap::linear(std::array::from_fn(|row| std::array::from_fn(|c| rows[3 * row + c].into())))
}

fn rows_of(map: &ColorMap) -> [f32; 9] {
    std::array::from_fn(|k| cast::to_f32(map.matrix.as_flattened()[k]))
}
