//! Reused memory of a frame, and the layout of lists between forward and backward.

use crate::kernel::RowBend;
use crate::project::View;
use crate::sort::Key;
use crate::tiles::{Drawn, Grid, OpenTiles};
use std::sync::atomic::AtomicU32;

/// 4×4 blocks of a tile.
pub(crate) const BLOCKS: usize = 16;

/// One value per pixel of a tile, by block.
pub(crate) type Plane<T> = [[T; 16]; BLOCKS];

/// State of a tile's pixels between chunks of splats, and what backward starts from.
#[derive(Clone, Debug)]
pub(crate) struct TileState {
    pub transmittance: Plane<f32>,
    pub rgb: [Plane<f32>; 3],
    pub depth: Plane<f32>,
    /// One past the running number of the last blended entry (0: none).
    pub last: Plane<u32>,
    /// Per block, a bit for every pixel that still takes light.
    pub open: [u16; BLOCKS],
    /// Entries seen so far.
    pub seen: u32,
}

impl Default for TileState {
    fn default() -> Self {
        Self {
            transmittance: [[1.0; 16]; BLOCKS],
            rgb: [[[0.0; 16]; BLOCKS]; 3],
            depth: [[0.0; 16]; BLOCKS],
            last: [[0; 16]; BLOCKS],
            open: [0; BLOCKS],
            seen: 0,
        }
    }
}

impl TileState {
    /// Empties the tile at `origin`; pixels outside the image are closed from the start.
    pub fn reset(&mut self, origin: [usize; 2], grid: &Grid) {
        *self = Self::default();
        for (block, open) in self.open.iter_mut().enumerate() {
            for lane in 0..16 {
                let [x, y] = pixel_of(block, lane);
                if origin[0] + x < grid.width && origin[1] + y < grid.height {
                    *open |= 1 << lane;
                }
            }
        }
    }

    /// Whether any pixel still takes light.
    pub fn is_open(&self) -> bool {
        self.open.iter().any(|&o| o != 0)
    }

    /// Number of entries some pixel of the tile blended, counted from the front.
    pub fn used(&self) -> u32 {
        self.last.as_flattened().iter().copied().max().unwrap_or(0)
    }
}

/// Pixel `(x, y)` inside its tile of a lane of a block.
#[inline(always)]
pub(crate) const fn pixel_of(block: usize, lane: usize) -> [usize; 2] {
    [block % 4 * 4 + lane % 4, block / 4 * 4 + lane / 4]
}

/// One entry of a splat's list of tiles: where its gradient record will lie.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Entry {
    pub tile: u32,
    /// Position in the tile's list, counted over all chunks.
    pub number: u32,
}

/// A stretch of depth-sorted splats and the lists of the tiles they touch.
#[derive(Debug, Default)]
pub(crate) struct Chunk {
    /// First rank (position in depth order).
    pub first: usize,
    /// Splats in depth order.
    pub drawn: Vec<Drawn>,
    /// Per splat, start of its entries; one more at the end.
    pub splat_starts: Vec<u32>,
    /// Splat-major entries.
    pub entries: Vec<Entry>,
    /// Per tile, start of its list; one more at the end.
    pub tile_starts: Vec<u32>,
    /// Tile-major lists of positions in `drawn`. Atomic only so that blocks of splats may fill it side by side.
    pub list: Vec<AtomicU32>,
    /// Per tile, entries seen before this chunk.
    pub seen_before: Vec<u32>,
}

/// Scratch of one block of splats during binning.
#[derive(Debug, Default)]
pub(crate) struct Bin {
    /// Tiles of each splat, one after another.
    pub tiles: Vec<u32>,
    /// Per tile: number of entries, then next free place.
    pub places: Vec<u32>,
}

/// Sums of one (tile, splat) pair: `o, sa, sb, saa, sab, sbb, r, g, b, depth`, the two of the kernel, then
/// padding to one vector.
pub(crate) type Record = [f32; 16];

/// Reusable memory for drawing. Nothing is allocated per frame once it is warm; one per thread of callers.
#[derive(Debug, Default)]
pub struct Workspace {
    pub(crate) grid: Grid,
    pub(crate) view: Option<View>,
    pub(crate) open: OpenTiles,
    pub(crate) keys: Vec<Key>,
    pub(crate) key_scratch: Vec<Key>,
    pub(crate) key_blocks: Vec<Vec<Key>>,
    pub(crate) bins: Vec<Bin>,
    pub(crate) chunks: Vec<Chunk>,
    /// Chunks in use; the others are kept for their memory.
    pub(crate) chunk_count: usize,
    pub(crate) tiles: Vec<TileState>,
    /// Per splat of the caller: rank in depth order of those kept, or `u32::MAX`.
    pub(crate) rank_of: Vec<u32>,
    /// Per tile, start of its records; one more at the end.
    pub(crate) record_starts: Vec<u32>,
    pub(crate) records: Vec<Record>,
    /// Constants of bent kernels, per splat of the caller.
    pub(crate) bends: Vec<RowBend>,
}

impl Workspace {
    /// An empty workspace.
    pub fn new() -> Self {
        Self::default()
    }

    /// (tile, splat) pairs listed in the last frame.
    pub fn entries(&self) -> usize {
        self.chunks[..self.chunk_count].iter().map(|c| c.entries.len()).sum()
    }

    /// Splats listed in at least one tile in the last frame.
    pub fn splats_listed(&self) -> usize {
        let listed = |c: &Chunk| c.splat_starts.windows(2).filter(|w| w[0] < w[1]).count();
        self.chunks[..self.chunk_count].iter().map(listed).sum()
    }

    /// (tile, splat) pairs some pixel blended in the last frame.
    pub fn entries_used(&self) -> usize {
        self.tiles.iter().map(|t| t.used() as usize).sum()
    }

    /// Entries of their tile's list that all pixels went through up to their last blended one, in the last frame.
    pub fn entries_walked(&self) -> u64 {
        self.tiles.iter().flat_map(|t| t.last.as_flattened()).map(|&last| u64::from(last)).sum()
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let chunk = |c: &Chunk| {
            size_of_val(c.drawn.as_slice())
                + size_of_val(c.entries.as_slice())
                + 4 * (c.splat_starts.len() + c.tile_starts.len() + c.list.len() + c.seen_before.len())
        };
        self.chunks.iter().map(chunk).sum::<usize>()
            + size_of_val(self.tiles.as_slice())
            + size_of_val(self.records.as_slice())
            + size_of_val(self.bends.as_slice())
            + 8 * (self.keys.len() + self.key_scratch.len())
            + 4 * (self.rank_of.len() + self.record_starts.len())
    }
}
