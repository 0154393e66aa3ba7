//! Reused memory of a frame, and the layout of the lists that forward leaves for backward.
//!
//! An *entry* is a (tile, splat) pair; its *slot* is its position in the tile's list, counted over all chunks.

use crate::frame::Screen;
use crate::kernel::ProfileConsts;
use crate::project::View;
use crate::sort::Key;
use crate::tiles::{Grid, OpenTiles, ProjectedSplat};
use std::sync::atomic::AtomicU32;

/// Number of 4×4 blocks of a tile.
pub(crate) const BLOCKS: usize = 16;

/// One value per pixel of a tile: 16 lanes of each block.
pub(crate) type Plane<T> = [[T; 16]; BLOCKS];

/// State of a tile's pixels between chunks of splats; backward starts from it.
#[derive(Clone, Debug)]
pub(crate) struct TileState {
    pub transmittance: Plane<f32>,
    pub rgb: [Plane<f32>; 3],
    pub depth: Plane<f32>,
    /// One past the slot of the last blended entry; 0 for none.
    pub last: Plane<u32>,
    /// Per block, a bit for every pixel that is still open (its transmittance is above `stop`).
    pub open: [u16; BLOCKS],
    /// Entries of the tile's list so far.
    pub listed: u32,
}

impl Default for TileState {
    fn default() -> Self {
        Self {
            transmittance: [[1.0; 16]; BLOCKS],
            rgb: [[[0.0; 16]; BLOCKS]; 3],
            depth: [[0.0; 16]; BLOCKS],
            last: [[0; 16]; BLOCKS],
            open: [0; BLOCKS],
            listed: 0,
        }
    }
}

impl TileState {
    /// Resets the tile whose first pixel is `origin`; pixels outside the image are closed from the start.
    pub(crate) fn reset(&mut self, origin: [usize; 2], grid: &Grid) {
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

    /// Whether any pixel is open.
    pub(crate) fn is_open(&self) -> bool {
        self.open.iter().any(|&o| o != 0)
    }

    /// Length of the front part of the list that some pixel of the tile blended.
    pub(crate) fn used(&self) -> u32 {
        self.last.as_flattened().iter().copied().max().unwrap_or(0)
    }
}

/// Pixel `(x, y)` inside its tile of a lane of a block.
#[inline(always)]
pub(crate) const fn pixel_of(block: usize, lane: usize) -> [usize; 2] {
    [block % 4 * 4 + lane % 4, block / 4 * 4 + lane / 4]
}

/// One entry of a splat's list of tiles; it locates the gradient record.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Entry {
    pub tile: u32,
    /// Position in the tile's list within this chunk.
    pub chunk_slot: u32,
}

/// A contiguous range of the depth-sorted splats, and the lists of the tiles they touch.
#[derive(Debug, Default)]
pub(crate) struct Chunk {
    /// Rank (position in depth order) of the first splat.
    pub first: usize,
    /// The splats in depth order.
    pub projected: Vec<ProjectedSplat>,
    /// Per splat, start of its entries; one more at the end.
    pub splat_starts: Vec<u32>,
    /// Entries splat by splat, tiles ascending.
    pub entries: Vec<Entry>,
    /// Per tile, start of its list; one more at the end.
    pub tile_starts: Vec<u32>,
    /// Tile-major lists of positions in `projected`. Atomic only so that blocks of splats may fill it in parallel.
    pub list: Vec<AtomicU32>,
    /// Per tile, entries listed before this chunk.
    pub listed_before: Vec<u32>,
}

/// Scratch memory of one block of splats during binning.
#[derive(Debug, Default)]
pub(crate) struct Bin {
    /// Tiles of each splat, one after another.
    pub tiles: Vec<u32>,
    /// Per tile: number of entries, then offset of the next one in the chunk's list.
    pub offsets: Vec<u32>,
    /// Positions in the block of the splats that may reach an open tile.
    pub reaching: Vec<u32>,
}

/// Gradient sums of one entry: `o, sa, sb, saa, sab, sbb, r, g, b, depth`, two of the kernel's parameters, then padding
/// to one vector (see [`crate::blend_backward`]).
pub(crate) type Record = [f32; RECORD];

/// Values of a [`Record`].
pub(crate) const RECORD: usize = 16;

/// Reusable memory of the rasteriser, and the state that [`crate::render_backward`] reads. Once it has held a frame of
/// the same size, further frames allocate next to nothing. Use one per concurrent caller.
///
/// ```
/// use gs_raster::{RasterOptions, Workspace, measure, render};
///
/// let (splats, camera) = (measure::scene(1000, 0), measure::camera(64));
/// let mut workspace = Workspace::new();
/// let first = render(&splats, &camera, &RasterOptions::default(), &mut workspace);
/// assert!(workspace.entries_used() <= workspace.entries() && workspace.splats_listed() <= 1000);
/// let again = render(&splats, &camera, &RasterOptions::default(), &mut workspace);
/// assert_eq!(first, again); // bit for bit
/// ```
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
    /// Chunks of the last frame; the vector keeps more for their memory.
    pub(crate) chunk_count: usize,
    pub(crate) tiles: Vec<TileState>,
    /// Per row of the caller: rank in depth order, or `u32::MAX` for splats in no tile.
    pub(crate) rank_of: Vec<u32>,
    /// Per tile, start of its records; one more element at the end.
    pub(crate) record_starts: Vec<u32>,
    pub(crate) records: Vec<Record>,
    /// Constants of the kernel profile, per row of the caller; empty for the Gaussian.
    pub(crate) kernel_consts: Vec<ProfileConsts>,
    /// Most entries of a chunk, of several splats.
    pub(crate) max_entries: MaxEntries,
}

/// Bounds the memory of splats that fill the screen: a chunk of more entries is cut.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MaxEntries(pub usize);

impl Default for MaxEntries {
    fn default() -> Self {
        Self(1 << 25)
    }
}

impl Workspace {
    /// A workspace that holds no memory yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Number of (16×16 tile, splat) pairs listed in the last frame.
    pub fn entries(&self) -> usize {
        self.chunks[..self.chunk_count].iter().map(|c| c.entries.len()).sum()
    }

    /// Number of splats listed in at least one tile in the last frame.
    pub fn splats_listed(&self) -> usize {
        let listed = |c: &Chunk| c.splat_starts.windows(2).filter(|w| w[0] < w[1]).count();
        self.chunks[..self.chunk_count].iter().map(listed).sum()
    }

    /// Number of (tile, splat) pairs up to the last one that some pixel of the tile blended, in the last frame.
    pub fn entries_used(&self) -> usize {
        self.tiles.iter().map(|t| t.used() as usize).sum()
    }

    /// Sum over pixels of the tile-list entries up to the pixel's last blended one, in the last frame.
    pub fn entries_walked(&self) -> u64 {
        self.tiles.iter().flat_map(|t| t.last.as_flattened()).map(|&last| u64::from(last)).sum()
    }

    /// Where the `n` splats of the last frame lie on the screen.
    pub fn screen(&self, n: usize) -> Screen {
        let mut screen = Screen { means2d: vec![[0.0; 2]; n], depths: vec![0.0; n], radii: vec![0.0; n] };
        for chunk in &self.chunks[..self.chunk_count] {
            let listed = chunk.projected.iter().zip(chunk.splat_starts.windows(2)).filter(|(_, w)| w[0] < w[1]);
            for (splat, _) in listed {
                let i = splat.index as usize;
                screen.means2d[i] = splat.center.map(|c| c as f32);
                screen.depths[i] = splat.depth;
                screen.radii[i] = splat.standard_radius() as f32;
            }
        }
        screen
    }

    /// Bytes held by the main buffers.
    pub fn bytes(&self) -> usize {
        let chunk = |c: &Chunk| {
            size_of_val(c.projected.as_slice())
                + size_of_val(c.entries.as_slice())
                + 4 * (c.splat_starts.len() + c.tile_starts.len() + c.list.len() + c.listed_before.len())
        };
        self.chunks.iter().map(chunk).sum::<usize>()
            + size_of_val(self.tiles.as_slice())
            + size_of_val(self.records.as_slice())
            + size_of_val(self.kernel_consts.as_slice())
            + 8 * (self.keys.len() + self.key_scratch.len())
            + 4 * (self.rank_of.len() + self.record_starts.len())
    }
}
