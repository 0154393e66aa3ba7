//! Images at one time: renders of the stages, flows as colour wheels with arrows, the mask.

use gs_core::Image;
use gs_metrics::MetricError;
use gs_metrics::flow::{Flow, arrows, wheel};

use super::Still;

/// Images are enlarged by a whole factor until the shorter side has at least this many pixels.
const MIN_SIDE: usize = 256;
/// Distance of arrows in the enlarged image, pixels.
const ARROW_SPACING: usize = 24;
/// White gap between panels, pixels.
const GAP: usize = 4;

/// Caption and RGB image of every stage, every flow and the mask.
///
/// # Errors
/// If a flow is malformed.
pub(super) fn panels(still: &Still) -> Result<Vec<(String, Image)>, MetricError> {
    let factor = still.pictures.first().map_or(1, |(_, p)| MIN_SIDE.div_ceil(p.width.min(p.height).max(1)));
    let mut all: Vec<(String, Image)> = Vec::new();
    for (name, image) in &still.pictures {
        all.push(((*name).to_owned(), enlarged(image, factor)));
    }
    for step in &still.steps {
        let longest = step.flow.magnitudes().into_iter().fold(0.0, f32::max);
        let caption = format!("{} by {}, up to {longest:.1} px", step.name, step.by);
        all.push((caption, flow_image(&step.flow, factor)?));
    }
    let data = still.mask.data.iter().flat_map(|m| [*m; 3]).collect();
    let mask = Image { channels: 3, data, ..still.mask };
    all.push(("mask".to_owned(), enlarged(&mask, factor)));
    Ok(all)
}

/// All panels in one row, top-aligned on white.
///
/// # Errors
/// If a flow is malformed.
pub fn strip(still: &Still) -> Result<Image, MetricError> {
    let panels = panels(still)?;
    let height = panels.iter().map(|(_, p)| p.height).max().unwrap_or(0);
    let width = panels.iter().map(|(_, p)| p.width + GAP).sum::<usize>().saturating_sub(GAP);
    let mut out = Image { width, height, channels: 3, data: vec![1.0; 3 * width * height] };
    let mut left = 0;
    for (_, panel) in &panels {
        for y in 0..panel.height {
            let row = &panel.data[3 * y * panel.width..][..3 * panel.width];
            out.data[3 * (y * width + left)..][..row.len()].copy_from_slice(row);
        }
        left += panel.width + GAP;
    }
    Ok(out)
}

/// The colour wheel of a flow with arrows over it, enlarged.
fn flow_image(flow: &Flow, factor: usize) -> Result<Image, MetricError> {
    let plane = |data: &[f32]| {
        let image = Image { width: flow.width, height: flow.height, channels: 1, data: data.to_vec() };
        enlarged(&image, factor).data
    };
    let (width, height) = (flow.width * factor, flow.height * factor);
    let large = Flow { width, height, u: plane(&flow.u), v: plane(&flow.v) };
    arrows(&wheel(&large, None)?, &large, ARROW_SPACING, factor as f32, [0.0; 3])
}

/// Repeats every pixel `factor × factor` times.
fn enlarged(image: &Image, factor: usize) -> Image {
    let mut out = Image::zeros(image.width * factor, image.height * factor, image.channels);
    for y in 0..out.height {
        for x in 0..out.width {
            out.pixel_mut(x, y).copy_from_slice(image.pixel(x / factor, y / factor));
        }
    }
    out
}
