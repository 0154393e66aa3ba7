//! Bilinear reads of maps at fixed texture coordinates, as a sparse matrix, and the backward of these reads.

use super::{TexelTable, charts};
use crate::surface::{CHUNK, NONE, Rows};
use glam::{DVec2, Vec2};
use gs_core::Image;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// What a vertex on a seam reads; it has a coordinate in each of several charts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SeamRead {
    /// The mean over its coordinates.
    #[default]
    Mean,
    /// The coordinate of the lowest face (DUT's published code).
    First,
}

/// Bilinear reads at the vertices of a mesh: `out_i = Σ_t w_it map_t`.
///
/// Only valid texels of the charts that a vertex lies in count, and their weights sum to 1. A coordinate without such a texel around it
/// reads the nearest one; of any chart if its own has no texel at all.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MapReader {
    size: usize,
    /// Read `i` has the entries `begins[i]..begins[i + 1]`.
    begins: Vec<u32>,
    texels: Vec<u32>,
    weights: Vec<f32>,
}

/// A coordinate that a vertex reads.
struct Place {
    uv: Vec2,
    /// Charts whose texels count; none: those of any chart.
    charts: Vec<u16>,
    share: f64,
}

impl MapReader {
    /// A reader at the vertices of a mesh, one row per vertex; a vertex of no face reads 0. `faces` and `face_uvs` are those of
    /// the table.
    pub fn at_vertices(
        table: &TexelTable,
        vertices: usize,
        faces: &[[u32; 3]],
        uvs: &[Vec2],
        face_uvs: &[[u32; 3]],
        seams: SeamRead,
    ) -> Self {
        let of_face = charts::of_faces(faces, uvs, face_uvs);
        let mut owned: Vec<u16> = table.chart.clone();
        owned.sort_unstable();
        owned.dedup();
        let corners = faces.iter().flatten().enumerate().map(|(corner, &v)| (v, corner as u32));
        let of_vertex = Rows::from_pairs(vertices, corners);
        let places = |v: usize| {
            let mut met: Vec<Place> = Vec::new();
            for &corner in of_vertex.row(v) {
                let (face, k) = (corner as usize / 3, corner as usize % 3);
                let uv = uvs[face_uvs[face][k] as usize];
                let own = Some(of_face[face]).filter(|chart| owned.binary_search(chart).is_ok());
                let full = !met.is_empty() && seams == SeamRead::First;
                match met.iter_mut().find(|p| p.uv == uv) {
                    Some(place) => place.charts.extend(own),
                    None if full => {}
                    None => met.push(Place { uv, charts: own.into_iter().collect(), share: 0.0 }),
                }
            }
            let share = 1.0 / met.len().max(1) as f64;
            met.iter_mut().for_each(|p| p.share = share);
            met
        };
        Self::new(table, &(0..vertices).map(places).collect::<Vec<_>>())
    }

    fn new(table: &TexelTable, places: &[Vec<Place>]) -> Self {
        let taps = |places: &Vec<Place>| {
            let of_place = |p: &Place| taps(table, p).into_iter().map(|t| (t.0, p.share * t.1)).collect::<Vec<_>>();
            let mut row: Vec<(u32, f64)> = places.iter().flat_map(of_place).collect();
            row.sort_unstable_by_key(|t| t.0);
            row.dedup_by(|b, a| {
                a.0 == b.0 && {
                    a.1 += b.1;
                    true
                }
            });
            row
        };
        let rows: Vec<Vec<(u32, f64)>> = places.par_iter().with_min_len(CHUNK).map(taps).collect();
        let mut out = Self { size: table.size, begins: vec![0], ..Self::default() };
        for row in rows {
            out.texels.extend(row.iter().map(|t| t.0));
            out.weights.extend(row.iter().map(|t| t.1 as f32));
            out.begins.push(out.texels.len() as u32);
        }
        out
    }

    /// Number of reads, the rows of the result.
    pub fn len(&self) -> usize {
        self.begins.len().saturating_sub(1)
    }

    /// Whether there are no reads.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The map at every coordinate: `len · C` values for `C` channels.
    ///
    /// # Panics
    /// If the map does not have the size of the table.
    pub fn read(&self, map: &Image) -> Vec<f32> {
        assert_eq!((map.width, map.height), (self.size, self.size), "a map of the table's size is read");
        let c = map.channels;
        let mut out = vec![0.0; self.len() * c];
        out.par_chunks_mut(c.max(1)).with_min_len(CHUNK).enumerate().for_each(|(i, out)| {
            for (texel, weight) in self.row(i) {
                let at = &map.data[texel * c..(texel + 1) * c];
                out.iter_mut().zip(at).for_each(|(o, m)| *o += weight * m);
            }
        });
        out
    }

    /// Backward of [`MapReader::read`]: cotangents of the values read (`len · channels`) to those of the map.
    ///
    /// # Panics
    /// If `d_read` has another length.
    pub fn adjoint(&self, d_read: &[f32], channels: usize) -> Image {
        assert_eq!(d_read.len(), self.len() * channels, "a cotangent for every value read");
        let mut map = Image::zeros(self.size, self.size, channels);
        for (i, d) in d_read.chunks_exact(channels.max(1)).enumerate() {
            for (texel, weight) in self.row(i) {
                let at = &mut map.data[texel * channels..(texel + 1) * channels];
                at.iter_mut().zip(d).for_each(|(m, d)| *m += weight * d);
            }
        }
        map
    }

    fn row(&self, i: usize) -> impl Iterator<Item = (usize, f32)> + '_ {
        let range = self.begins[i] as usize..self.begins[i + 1] as usize;
        self.texels[range.clone()].iter().map(|&t| t as usize).zip(self.weights[range].iter().copied())
    }
}

impl Place {
    /// Whether a texel is valid and of a chart that counts.
    fn reads(&self, table: &TexelTable, texel: usize) -> bool {
        let row = table.row[texel];
        row != NONE && (self.charts.is_empty() || self.charts.contains(&table.chart[row as usize]))
    }
}

/// The texels read at one coordinate and their weights, which sum to 1.
fn taps(table: &TexelTable, place: &Place) -> Vec<(u32, f64)> {
    let (size, last) = (table.size, table.size as i64 - 1);
    // Beyond the border the border is read.
    let p = (place.uv.as_dvec2() * size as f64 - 0.5).clamp(DVec2::splat(-1.0), DVec2::splat(size as f64));
    let (floor, part) = (p.floor(), p - p.floor());
    let mut out = Vec::with_capacity(4);
    for (dy, wy) in [(0, 1.0 - part.y), (1, part.y)] {
        for (dx, wx) in [(0, 1.0 - part.x), (1, part.x)] {
            let x = (floor.x as i64 + dx).clamp(0, last) as usize;
            let y = (floor.y as i64 + dy).clamp(0, last) as usize;
            if wx * wy > 0.0 && place.reads(table, y * size + x) {
                out.push(((y * size + x) as u32, wx * wy));
            }
        }
    }
    let total: f64 = out.iter().map(|t| t.1).sum();
    // A weight this small is a corner that is touched by rounding only.
    if total < 1e-6 {
        return nearest(table, place, p).map_or_else(Vec::new, |t| vec![(t, 1.0)]);
    }
    out.iter_mut().for_each(|t| t.1 /= total);
    out
}

/// The texel that counts nearest to a position in texels, searched in growing squares.
fn nearest(table: &TexelTable, place: &Place, p: DVec2) -> Option<u32> {
    let size = table.size as i64;
    let inside = p.clamp(DVec2::ZERO, DVec2::splat((size - 1) as f64));
    let (cx, cy) = (inside.x.round() as i64, inside.y.round() as i64);
    let mut best: Option<(f64, u32)> = None;
    for r in 0..=size {
        // Texels of square r are at least r − ½ away.
        if best.is_some_and(|b| b.0.sqrt() < r as f64 - 0.5) {
            break;
        }
        for y in (cy - r).max(0)..=(cy + r).min(size - 1) {
            let edge = (y - cy).abs() == r;
            let step = if edge || r == 0 { 1 } else { 2 * r };
            let mut x = cx - r;
            while x <= cx + r {
                if (0..size).contains(&x) && place.reads(table, (y * size + x) as usize) {
                    let d = (inside - DVec2::new(x as f64, y as f64)).length_squared();
                    if best.is_none_or(|b| d < b.0) {
                        best = Some((d, (y * size + x) as u32));
                    }
                }
                x += step;
            }
        }
    }
    best.map(|b| b.1)
}
