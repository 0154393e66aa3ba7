//! Stable radix sort of 32-bit keys with 32-bit values, four bits a pass.

use crate::device::Gpu;
use crate::error::GpuError;
use crate::kernels::Kernels;
use crate::memory::Array;

/// Keys of one workgroup.
const BLOCK: u64 = 2048;
/// Values that one workgroup scans.
const SCAN_BLOCK: u64 = 1024;
/// Bits of a pass.
const BITS: u32 = 4;
/// Bytes between the parameters of two passes: the alignment of uniform bindings.
const STEP: u64 = 256;

/// Memory of sorts and scans.
pub(crate) struct Sorter {
    passes: Array,
    histogram: Array,
    sums: Array,
}

/// Keys and values, twice: a pass reads one pair and writes the other.
pub(crate) struct Pairs {
    pub keys: [Array; 2],
    pub values: [Array; 2],
}

impl Pairs {
    pub(crate) fn new(gpu: &Gpu, keys: &'static str, values: &'static str) -> Self {
        let two = |what| [Array::new(gpu, what), Array::new(gpu, what)];
        Self { keys: two(keys), values: two(values) }
    }

    pub(crate) fn resize(&mut self, gpu: &Gpu, rows: u64) -> Result<(), GpuError> {
        self.keys.iter_mut().chain(&mut self.values).try_for_each(|a| a.resize(gpu, 4 * rows))
    }
}

/// Most workgroups in one dimension (WebGPU's default).
const WIDTH: u64 = 65_535;

/// Workgroups for `rows` rows of `size` a group: columns and rows of a dispatch, so that one dimension never overflows.
pub fn groups(rows: u64, size: u64) -> [u32; 2] {
    let all = rows.div_ceil(size);
    [all.min(WIDTH), all.div_ceil(WIDTH)].map(|v| u32::try_from(v).unwrap_or(u32::MAX))
}

/// Bytes of the block sums of a scan of `rows` values: one a block, and the total.
pub(crate) fn sums_bytes(rows: u64) -> u64 {
    4 * (rows.max(4).div_ceil(SCAN_BLOCK) + 1)
}

/// Exclusive prefix sums of `values` within blocks, and of the blocks in `sums`.
pub(crate) fn scan(gpu: &Gpu, kernels: &Kernels, pass: &mut wgpu::ComputePass<'_>, values: &Array, sums: &Array) {
    let arrays = [values, sums];
    kernels.scan_blocks.run(
        pass,
        &kernels.scan_blocks.bind(gpu.device(), &arrays),
        groups(values.bytes() / 4, SCAN_BLOCK),
    );
    if values.bytes() / 4 > SCAN_BLOCK {
        kernels.scan_offsets.run(pass, &kernels.scan_offsets.bind(gpu.device(), &arrays), [1, 1]);
    }
}

impl Sorter {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        Self {
            passes: Array::new(gpu, "parameters of the sort"),
            histogram: Array::new(gpu, "histogram of the sort"),
            sums: Array::new(gpu, "block sums of the sort"),
        }
    }

    /// The parameters of all passes: shift, and whether the values are positions; eight of each kind, 256 bytes apart.
    fn upload_passes(&mut self, gpu: &Gpu) -> Result<(), GpuError> {
        let mut all = [[0u32; 64]; 16];
        for (i, pass) in (0..).zip(&mut all) {
            pass[0] = BITS * (i % 8);
            pass[1] = u32::from(i >= 8);
        }
        self.passes.upload(gpu, &all)
    }

    /// Makes room for sorts of up to `rows` keys.
    pub(crate) fn resize(&mut self, gpu: &Gpu, rows: u64) -> Result<(), GpuError> {
        self.upload_passes(gpu)?;
        let bins = 16 * rows.max(4).div_ceil(BLOCK);
        self.histogram.resize(gpu, 4 * bins)?;
        self.sums.resize(gpu, sums_bytes(bins))
    }

    /// Sorts by the lowest bits of the keys. Returns which of the pairs holds the result.
    pub(crate) fn sort(
        &mut self,
        gpu: &Gpu,
        kernels: &Kernels,
        pass: &mut wgpu::ComputePass<'_>,
        sort: &Sort<'_>,
    ) -> Result<usize, GpuError> {
        let rows = sort.keys.bytes() / 4;
        self.resize(gpu, rows)?;
        let blocks = groups(rows, BLOCK);
        let mut from: Option<usize> = sort.start;
        for digit in 0..sort.bits.div_ceil(BITS) {
            let (keys, values) = match from {
                None => (sort.keys, &sort.pairs.values[1]),
                Some(i) => (&sort.pairs.keys[i], &sort.pairs.values[i]),
            };
            let to = from.map_or(0, |i| 1 - i);
            let identity = u64::from(from.is_none());
            let parameters = || self.passes.part((8 * identity + u64::from(digit)) * STEP, 16);
            let k = &kernels.histogram;
            k.run(pass, &k.bind_part(gpu.device(), parameters(), &[sort.count, keys, &self.histogram]), blocks);
            scan(gpu, kernels, pass, &self.histogram, &self.sums);
            let arrays =
                [sort.count, keys, values, &self.histogram, &self.sums, &sort.pairs.keys[to], &sort.pairs.values[to]];
            let k = &kernels.scatter;
            k.run(pass, &k.bind_part(gpu.device(), parameters(), &arrays), blocks);
            from = Some(to);
        }
        Ok(from.unwrap_or(0))
    }
}

/// What to sort.
pub(crate) struct Sort<'a> {
    /// Its last entry is the number of keys.
    pub count: &'a Array,
    /// The keys of the first pass where `start` is none.
    pub keys: &'a Array,
    pub pairs: &'a Pairs,
    /// Which of the pairs to start from; with none, the keys are `keys` and the values their positions.
    pub start: Option<usize>,
    /// Bits of a key.
    pub bits: u32,
}
