//! Mean colours of texels over the frames of a recording.

use super::actor::{FrameError, Seen};
use gs_core::cast;
use gs_texel::inpaint::{InpaintMethod, inpaint};
use gs_texel::texels::TexelTable;

/// Mean colours over the recording, three per texel; empty where nothing asks for them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeanTextures {
    /// Of first textures, at GeoNet's texels: what GeoNet sees its colours less of.
    pub geo: Vec<f32>,
    /// At GauNet's texels: what GeoNet holds images against, and what Gaussians that no camera sees look like.
    pub gau: Vec<f32>,
    /// 1 at GauNet's texels whose colour was seen, 0 where it is in-painted; as many as texels.
    pub known: Vec<f32>,
}

impl MeanTextures {
    /// The rows of a texture.
    pub fn rows(values: &[f32]) -> &[[f32; 3]] {
        values.as_chunks().0
    }

    /// The colours of GauNet's texels, none where they are in-painted.
    pub(crate) fn seen(&self) -> impl Iterator<Item = Option<[f32; 3]>> {
        Self::rows(&self.gau).iter().zip(&self.known).map(|(color, known)| (*known > 0.0).then_some(*color))
    }
}

/// A mean texture of one table.
#[derive(Debug, Default)]
pub(crate) struct MeanTexture {
    /// Three values per texel.
    pub(crate) colors: Vec<f32>,
    /// 1 where the colour was seen, 0 where it is in-painted.
    pub(crate) known: Vec<f32>,
}

/// Colours of texels while they are added up.
pub(crate) struct Mean {
    sums: Vec<[f32; 3]>,
    counts: Vec<f32>,
}

impl Mean {
    /// Of so many texels.
    pub(crate) fn new(texels: usize) -> Self {
        Self { sums: vec![[0.0; 3]; texels], counts: vec![0.0; texels] }
    }

    /// Adds the texels that a frame shows.
    pub(crate) fn add(&mut self, seen: &Seen) {
        for (k, (color, _)) in seen.colors.iter().zip(&seen.views).enumerate().filter(|(_, (_, views))| **views > 0.0) {
            self.sums[k].iter_mut().zip(color).for_each(|(s, c)| *s += c);
            self.counts[k] += 1.0;
        }
    }

    /// The means. Where nothing was seen, the nearest of the chart, and in charts of which nothing was seen the mean of all.
    ///
    /// # Errors
    /// [`FrameError::Unseen`] if nothing was seen at all.
    pub(crate) fn texture(self, table: &TexelTable) -> Result<MeanTexture, FrameError> {
        let mean = |(s, n): (&[f32; 3], &f32)| s.map(|v| v / n.max(1.0));
        let mut colors: Vec<[f32; 3]> = self.sums.iter().zip(&self.counts).map(mean).collect();
        let known: Vec<bool> = self.counts.iter().map(|n| *n > 0.0).collect();
        let count = known.iter().filter(|k| **k).count();
        if count == 0 {
            return Err(FrameError::Unseen);
        }
        // What was not seen adds 0.
        let sum = |i: usize| colors.iter().map(|c| f64::from(c[i])).sum::<f64>();
        let of_all = [0, 1, 2].map(|i| cast::to_f32(sum(i) / count as f64));
        colors.iter_mut().zip(&known).filter(|(_, known)| !**known).for_each(|(c, _)| *c = of_all);
        inpaint(table, &mut colors, &known, InpaintMethod::Nearest)?;
        let known = known.into_iter().map(|k| f32::from(u8::from(k))).collect();
        Ok(MeanTexture { colors: colors.into_flattened(), known })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec2;
    use gs_texel::texels::TexelOptions;

    #[test]
    fn charts_that_no_frame_shows_have_the_mean_of_what_is_seen() {
        // Two triangles apart: each is a chart.
        let uvs = [[0.0, 0.0], [0.4, 0.0], [0.0, 0.8], [0.6, 0.0], [1.0, 0.0], [1.0, 0.8]].map(Vec2::from_array);
        let faces = [[0, 1, 2], [3, 4, 5]];
        let table = TexelTable::build(&faces, &uvs, &faces, 16, &TexelOptions::default()).unwrap();
        // Of the first, the first texel is not seen.
        let first = table.chart.iter().position(|c| *c == 0).unwrap();
        let shown = |k: usize| table.chart[k] == 0 && k != first;
        let rows = |value: &dyn Fn(usize) -> f32| (0..table.len()).map(value).collect::<Vec<f32>>();
        let views = rows(&|k| if shown(k) { 2.0 } else { 0.0 });
        let colors = rows(&|k| if shown(k) { 0.25 + 0.5 * table.uv(k).y } else { 0.0 });
        let mut mean = Mean::new(table.len());
        mean.add(&Seen { colors: colors.iter().map(|c| [*c, 0.5, 1.0]).collect(), views });
        let MeanTexture { colors: filled, known } = mean.texture(&table).unwrap();
        let count = (0..table.len()).filter(|k| shown(*k)).count();
        let of_all = colors.iter().sum::<f32>() / count as f32;
        for (k, row) in filled.chunks_exact(3).enumerate() {
            assert_eq!(known[k], if shown(k) { 1.0 } else { 0.0 });
            match table.chart[k] {
                1 => assert!((row[0] - of_all).abs() < 1e-5 && row[1..] == [0.5, 1.0], "{k}: {row:?} {of_all}"),
                _ if shown(k) => assert_eq!(row, [colors[k], 0.5, 1.0]),
                // A neighbour's, which lies at the end of the slope.
                _ => assert!(row[0] < of_all - 0.05 && row[1..] == [0.5, 1.0], "{k}: {row:?} {of_all}"),
            }
        }
        assert!(matches!(Mean::new(table.len()).texture(&table), Err(FrameError::Unseen)));
    }
}
