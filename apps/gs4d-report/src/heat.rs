//! Heat maps: columns of counts, darker for larger counts.

use super::ReportError;
use super::html::{escape, inline_image};
use gs_core::Image;

/// A histogram over training steps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HeatMap {
    /// Name of the attribute shown.
    pub name: String,
    /// Values at the lower and the upper edge of the image.
    pub span: [f32; 2],
    /// Training step of each column.
    pub steps: Vec<u64>,
    /// Counts of each column, from the lowest bin up; all columns have the same number of bins.
    pub counts: Vec<Vec<u32>>,
}

/// White, blue, dark blue.
const INKS: [[f32; 3]; 3] = [[1.0, 1.0, 1.0], [0.0, 0.447, 0.698], [0.03, 0.08, 0.2]];

/// An embedded heat map of columns of counts, each from the lowest bin up, with a caption below; empty with
/// fewer than two columns, which show no change.
///
/// # Errors
/// If the image cannot be encoded.
pub(crate) fn heat_map(counts: &[Vec<u32>], alt: &str, caption: &str) -> Result<String, ReportError> {
    let image = heat_image(counts);
    if counts.len() < 2 || image.data.is_empty() {
        return Ok(String::new());
    }
    let image = inline_image(&image, alt)?;
    Ok(format!("<span class=\"heat\">{image}<small>{}</small></span>\n", escape(caption)))
}

/// Renders columns of counts, `[bins, columns, 3]`: the square root of each count over the largest of its column gives its
/// colour.
fn heat_image(counts: &[Vec<u32>]) -> Image {
    let bins = counts.iter().map(Vec::len).min().unwrap_or(0);
    let mut image = Image::zeros(counts.len(), bins, 3);
    for (x, column) in counts.iter().enumerate() {
        let largest = column.iter().copied().max().unwrap_or(0).max(1);
        for y in 0..bins {
            let share = (column[bins - 1 - y] as f32 / largest as f32).sqrt();
            image.pixel_mut(x, y).copy_from_slice(&ink(share));
        }
    }
    image
}

/// The colour at 0..1 along [`INKS`].
fn ink(share: f32) -> [f32; 3] {
    let place = 2.0 * share.clamp(0.0, 1.0);
    let k = usize::from(place >= 1.0);
    let (from, to, part) = (INKS[k], INKS[k + 1], place - k as f32);
    std::array::from_fn(|c| (1.0 - part) * from[c] + part * to[c])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_steps_and_high_values_are_on_top() {
        let image = heat_image(&[vec![0, 0, 9], vec![4, 1, 0]]);
        assert_eq!(image.shape(), (2, 3, 3));
        assert_eq!(image.pixel(0, 0), INKS[2]);
        assert_eq!(image.pixel(0, 2), INKS[0]);
        assert_eq!(image.pixel(1, 2), INKS[2]);
        assert_eq!(image.pixel(1, 1), INKS[1], "a quarter of the count has half the ink");
        let shown = |counts: &[Vec<u32>]| heat_map(counts, "a", "a").unwrap();
        assert!(shown(&[]).is_empty() && shown(&[vec![1, 2]]).is_empty(), "nothing to compare");
        assert!(shown(&[vec![1, 2], vec![2, 1]]).contains("<img"));
    }
}
