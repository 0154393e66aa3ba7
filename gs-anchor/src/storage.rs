//! Bytes of a scene of anchors on disk, block by block, under two rules (MB = 10⁶ bytes, `f32` throughout).
//!
//! * **Paper rule**: everything that the released code writes and counts: one row per anchor with columns that are
//!   never used (normals, opacity, rotation), planes over the whole time axis, the unused networks of the deformation
//!   (a time network, the heads of opacity and spherical harmonics), one appearance row per camera, the list of
//!   canonical times. Two further tensors that it writes are counted separately.
//! * **As needed**: what rendering reads: no unused column, only the time rows that times 0 … 1 can reach, only the
//!   heads that are used, appearance folded into a bias (exact).
//!
//! ```text
//! planes      C_p Σ_m [ m² (XY + XZ + YZ) + m (X + Y + Z) R_t ]
//! Linear(a→b) a b + b
//! anchor      3 + 3k + C + 6 + logits   (paper: + 3 normals + 1 opacity + 4 rotation)
//! ```
//! ```
//! use gs_anchor::{AnchorShape, DecoderConfig, StorageSizes, StorageTable};
//!
//! let shape = AnchorShape { offsets: 10, features: 32, dynamics: 2 };
//! let (decoder, anchors) = (DecoderConfig::default(), 27_000);
//! let sizes =
//!     StorageSizes { anchors, shape, decoder, global: None, local: None, local_hash: None, cameras: 300, segments: 8 };
//! let table = StorageTable::of(&sizes);
//! assert_eq!(table.rows[0].paper_bytes(), 27_000 * 324);
//! assert_eq!(table.rows[0].needed_bytes(), 27_000 * 292);
//! ```

use crate::anchors::AnchorShape;
use crate::decode::DecoderConfig;
use gs_deform::PlaneNetConfig;
use gs_deform::encode::HexPlaneConfig;
use serde::{Deserialize, Serialize};

/// Sizes of all parts of a scene of anchors.
#[derive(Clone, Debug, PartialEq)]
pub struct StorageSizes {
    /// Number of anchors, `V`.
    pub anchors: usize,
    /// Sizes of an anchor's columns.
    pub shape: AnchorShape,
    /// Settings of the networks that decode anchors.
    pub decoder: DecoderConfig,
    /// Network of the global deformation of anchors, and the outputs of each head that it has; absent in a static scene.
    pub global: Option<(PlaneNetConfig, Vec<usize>)>,
    /// The same of the local deformation of Gaussians.
    pub local: Option<(PlaneNetConfig, Vec<usize>)>,
    /// Number of values of hash grids and of their network, where the local deformation has these in place of planes.
    pub local_hash: Option<[usize; 2]>,
    /// Number of cameras: the published code stores one appearance row for each.
    pub cameras: usize,
    /// Number of temporal intervals, `N`; 0: none.
    pub segments: usize,
}

/// Number of `f32` values of one block under both rules.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StorageRow {
    /// Name of the block: `anchors`, `color head`, …
    pub block: String,
    /// Number of values by the paper rule.
    pub paper_values: usize,
    /// Number of values that rendering needs.
    pub needed_values: usize,
}

/// A tensor that the released code writes but its count leaves out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct UnusedTensor {
    /// Name of the tensor in the released file.
    pub block: String,
    /// Size of the tensor, bytes.
    pub bytes: usize,
}

/// Storage of a scene, block by block.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StorageTable {
    /// The blocks of the scene; a part that is absent has no row.
    pub rows: Vec<StorageRow>,
    /// Tensors that the released code writes beside them; not in the sums.
    pub leftovers: Vec<UnusedTensor>,
}

impl StorageRow {
    fn new(block: &str, paper_values: usize, needed_values: usize) -> Self {
        Self { block: block.to_owned(), paper_values, needed_values }
    }

    /// Bytes of this block by the paper rule.
    pub fn paper_bytes(&self) -> usize {
        4 * self.paper_values
    }

    /// Bytes of this block that rendering needs.
    pub fn needed_bytes(&self) -> usize {
        4 * self.needed_values
    }
}

impl StorageTable {
    /// Counts the values of a scene of these sizes.
    pub fn of(sizes: &StorageSizes) -> Self {
        let s = &sizes.shape;
        let needed = 3 + 3 * s.offsets + s.features + 6 + s.dynamics;
        let mut rows =
            vec![StorageRow::new("anchors", sizes.anchors * (needed + UNUSED_PER_ANCHOR), sizes.anchors * needed)];
        rows.extend(decoder_rows(sizes));
        for (name, net, outputs, unused) in [
            ("global deformation", &sizes.global, vec![3, s.features, 3 * s.offsets, 6], vec![]),
            ("local deformation", &sizes.local, vec![3, 3, 4], vec![1, UNUSED_SH]),
        ] {
            let Some((net, heads)) = net else { continue };
            let [paper, needed] = plane_values(&net.hexplane);
            rows.push(StorageRow::new(&format!("{name}, planes"), paper, needed));
            let unused = TIME_NET + unused.iter().map(|&out| head_values(net.width, out)).sum::<usize>();
            let [paper, needed] = [&outputs, heads].map(|outputs| network_values(net, outputs));
            rows.push(StorageRow::new(&format!("{name}, networks"), paper + unused, needed));
        }
        for (part, values) in ["hash grids", "networks"].iter().zip(sizes.local_hash.iter().flatten()) {
            rows.push(StorageRow::new(&format!("local deformation, {part}"), *values, *values));
        }
        if sizes.segments > 0 {
            rows.push(StorageRow::new("canonical times", sizes.segments, sizes.segments));
        }
        let deformed = sizes.global.is_some() || sizes.local.is_some() || sizes.local_hash.is_some();
        let leftovers = [("deformation table (bool)", 1), ("deformation accumulator", 12)]
            .map(|(block, bytes)| UnusedTensor { block: block.to_owned(), bytes: bytes * sizes.anchors });
        Self { rows, leftovers: leftovers.into_iter().filter(|_| deformed).collect() }
    }

    /// Bytes of all blocks by the paper rule, leftovers not counted.
    pub fn paper_bytes(&self) -> usize {
        self.rows.iter().map(StorageRow::paper_bytes).sum()
    }

    /// Bytes of all blocks that rendering needs.
    pub fn needed_bytes(&self) -> usize {
        self.rows.iter().map(StorageRow::needed_bytes).sum()
    }
}

/// Values of an anchor's row that are never read: normals, opacity, rotation.
const UNUSED_PER_ANCHOR: usize = 3 + 1 + 4;
/// Values of the published time network, whose outputs are never read: 9 encoded inputs, 64 wide, 32 outputs.
const TIME_NET: usize = linear(9, 64) + linear(64, 32);
/// Outputs of the unused head of spherical harmonics.
const UNUSED_SH: usize = 48;

const fn linear(inputs: usize, outputs: usize) -> usize {
    inputs * outputs + outputs
}

fn head_values(width: usize, outputs: usize) -> usize {
    linear(width, width) + linear(width, outputs)
}

/// Values of the trunk and of heads with these numbers of outputs.
fn network_values(net: &PlaneNetConfig, outputs: &[usize]) -> usize {
    let trunk = linear(net.hexplane.channels * net.hexplane.levels.len(), net.width)
        + net.depth.saturating_sub(1) * linear(net.width, net.width);
    trunk + outputs.iter().map(|&out| head_values(net.width, out)).sum::<usize>()
}

/// Values of the planes over the whole time axis, and over the rows that can be reached.
fn plane_values(planes: &HexPlaneConfig) -> [usize; 2] {
    let [x, y, z, rows] = planes.resolution;
    [rows, planes.time_rows()].map(|rows| {
        let level = |m: &usize| m * m * (x * y + x * z + y * z) + m * (x + y + z) * rows;
        planes.channels * planes.levels.iter().map(level).sum::<usize>()
    })
}

fn decoder_rows(sizes: &StorageSizes) -> Vec<StorageRow> {
    let (k, c, decoder) = (sizes.shape.offsets, sizes.shape.features, &sizes.decoder);
    let head = |h: usize, extra: usize, outputs: usize| linear(decoder.inputs(c, h) + extra, c) + linear(c, outputs);
    let color = head(1, decoder.appearance, 3 * k);
    // Folded into the bias, the appearance needs no columns of the first layer.
    let folded = color - decoder.appearance * c;
    let bank = linear(4, c) + linear(c, 3);
    let opacity = head(0, 0, k);
    let covariance = head(2, 0, 7 * k);
    let mut rows = vec![
        StorageRow::new("opacity head", opacity, opacity),
        StorageRow::new("covariance head", covariance, covariance),
        StorageRow::new("color head", color, folded),
    ];
    if decoder.feature_bank {
        rows.push(StorageRow::new("feature bank", bank, bank));
    }
    if decoder.appearance > 0 {
        rows.push(StorageRow::new("appearance", sizes.cameras * decoder.appearance, 0));
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::decode::HeadInputs;

    fn net(resolution: [usize; 4]) -> PlaneNetConfig {
        let hexplane = HexPlaneConfig { resolution, channels: 16, ..HexPlaneConfig::default() };
        PlaneNetConfig { hexplane, ..PlaneNetConfig::default() }
    }

    fn published(offsets: usize) -> StorageSizes {
        StorageSizes {
            anchors: 27_000,
            shape: AnchorShape { offsets, features: 32, dynamics: 2 },
            decoder: DecoderConfig::default(),
            global: Some((net([32, 32, 32, 10]), vec![3, 32, 3 * offsets, 6])),
            local: Some((net([64, 64, 64, 100]), vec![3, 3, 4])),
            local_hash: None,
            cameras: 300,
            segments: 8,
        }
    }

    fn row<'a>(table: &'a StorageTable, block: &str) -> &'a StorageRow {
        table.rows.iter().find(|r| r.block == block).unwrap()
    }

    /// The row of a block: paper, needed.
    fn values(sizes: &StorageSizes, block: &str) -> [usize; 2] {
        let table = StorageTable::of(sizes);
        let row = row(&table, block);
        [row.paper_values, row.needed_values]
    }

    #[test]
    fn anchors_of_five_ten_and_twenty_offsets() {
        for (k, paper) in [(5, 264), (10, 324), (20, 444)] {
            let table = StorageTable::of(&published(k));
            let anchors = row(&table, "anchors");
            assert_eq!(anchors.paper_bytes(), paper * 27_000, "k = {k}");
            assert_eq!(anchors.paper_bytes() - anchors.needed_bytes(), 32 * 27_000, "k = {k}");
        }
    }

    #[test]
    fn planes_of_the_published_sizes() {
        for (resolution, paper) in [
            ([32, 32, 32, 10], 291_840),
            ([64, 64, 64, 100], 1_904_640),
            ([32, 32, 32, 50], 476_160),
            ([128, 128, 128, 150], 6_696_960),
        ] {
            let sizes = StorageSizes { local: Some((net(resolution), vec![3, 3, 4])), ..published(10) };
            assert_eq!(values(&sizes, "local deformation, planes")[0], paper, "{resolution:?}");
        }
        let [paper, needed] = values(&published(10), "local deformation, planes");
        assert_eq!(4 * (paper - needed), 1_806_336, "49 of 100 time rows are out of reach");
        assert_eq!(values(&published(10), "global deformation, planes"), [291_840, 291_840 - 16 * 3 * 96 * 4]);
    }

    #[test]
    fn networks_of_the_published_sizes() {
        let ten = published(10);
        assert_eq!(values(&ten, "global deformation, networks"), [82_151, 79_431]);
        assert_eq!(values(&ten, "local deformation, networks"), [97_115, 55_050]);
        assert_eq!(values(&ten, "opacity head"), [1482; 2]);
        assert_eq!(values(&ten, "covariance head"), [3462; 2]);
        assert_eq!(values(&ten, "color head"), [2654, 2654 - 16 * 32]);
        assert_eq!(values(&ten, "appearance"), [4800, 0]);
        assert_eq!(values(&ten, "canonical times"), [8; 2]);
        // Fewer or more offsets change the head of ΔO and the outputs of the decoder only.
        for (k, difference) in [(5usize, -15i64 * 129), (20, 30 * 129)] {
            let [paper, needed] = values(&published(k), "global deformation, networks");
            assert_eq!([paper, needed].map(|v| v as i64), [82_151 + difference, 79_431 + difference], "k = {k}");
            assert_eq!(values(&published(k), "opacity head")[0], 1152 + 33 * k);
            assert_eq!(values(&published(k), "covariance head")[0], 1152 + 33 * 7 * k);
            assert_eq!(values(&published(k), "color head")[0], 1664 + 33 * 3 * k);
            assert_eq!(values(&published(k), "local deformation, networks"), [97_115, 55_050]);
        }
    }

    #[test]
    fn the_published_average_is_twenty_seven_thousand_anchors() {
        let table = StorageTable::of(&published(10));
        let fixed = table.paper_bytes() - 324 * 27_000;
        assert_eq!(fixed, 4 * (291_840 + 1_904_640 + 82_151 + 97_115 + 1482 + 3462 + 2654 + 4800 + 8));
        assert!((fixed as f64 / 1e6 - 9.54).abs() < 0.02, "{fixed}");
        assert!((table.paper_bytes() as f64 / 1e6 - 18.3).abs() < 0.1);
        assert_eq!(table.leftovers.iter().map(|l| l.bytes).sum::<usize>(), 13 * 27_000);
        assert!(table.needed_bytes() < table.paper_bytes());
    }

    #[test]
    fn a_static_scene_has_anchors_and_decoder_only() {
        let shape = AnchorShape { offsets: 10, features: 32, dynamics: 0 };
        let decoder =
            DecoderConfig { appearance: 0, distance: HeadInputs::ALL, feature_bank: true, ..DecoderConfig::default() };
        let sizes = StorageSizes { shape, decoder, global: None, local: None, segments: 0, ..published(10) };
        let table = StorageTable::of(&sizes);
        let blocks: Vec<&str> = table.rows.iter().map(|r| r.block.as_str()).collect();
        assert_eq!(blocks, ["anchors", "opacity head", "covariance head", "color head", "feature bank"]);
        assert_eq!(values(&sizes, "opacity head"), [1482 + 32; 2]);
        assert_eq!(values(&sizes, "color head"), [2654 - 15 * 32; 2]);
        assert_eq!(values(&sizes, "feature bank"), [4 * 32 + 32 + 32 * 3 + 3; 2]);
        assert_eq!((table.leftovers.len(), row(&table, "anchors").needed_values), (0, 27_000 * (3 + 30 + 32 + 6)));
    }
}
