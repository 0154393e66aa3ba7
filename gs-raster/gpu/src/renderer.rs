//! A frame and its gradient on the device.

use crate::backward::{Backward, RECORD};
use crate::device::Gpu;
use crate::error::GpuError;
use crate::kernels::{Kernels, projected_stride};
use crate::memory::{Array, Readback};
use crate::resident::Shape;
use crate::sort::{Pairs, Sort, Sorter, groups, scan, sums_bytes};
use crate::timer::Timer;
use crate::view::{View, profiles};
use gs_core::{Camera, Color, Image, Kernel, SplatsRef, cast};
use gs_raster::{Frame, RasterOptions};

/// Bytes of a four-component vector.
const VEC4: u64 = 16;
/// Entries per splat that the first frame makes room for.
const FIRST_ENTRIES: u32 = 8;
/// Fewest entries that a frame makes room for.
const LEAST_ENTRIES: u32 = 4096;
/// Splats of one workgroup.
const GROUP: u64 = 256;

/// Renders frames on a GPU and pulls gradients back, reusing its memory. Use one per concurrent caller.
///
/// ```
/// use gs_gpu::{Gpu, Renderer};
/// use gs_raster::{Frame, RasterOptions, measure};
///
/// let Ok(gpu) = Gpu::open() else { return Ok(()) }; // no GPU here
/// let (splats, camera) = (measure::scene(1000, 3), measure::camera(64)); // or your own
/// let (mut renderer, mut frame) = (Renderer::new(&gpu), Frame::default());
/// renderer.render_into(&splats, &camera, &RasterOptions::default(), &mut frame)?;
/// let cpu = gs_raster::render(&splats, &camera, &RasterOptions::default(), &mut Default::default());
/// assert_eq!(frame.rgb.data.len(), cpu.rgb.data.len());
/// let close = |(a, b): (&f32, &f32)| (a - b).abs() < 1e-2; // 2e-5 but for samples on a threshold
/// assert!(frame.rgb.data.iter().zip(&cpu.rgb.data).all(close));
/// # Ok::<(), gs_gpu::GpuError>(())
/// ```
pub struct Renderer {
    pub(crate) gpu: Gpu,
    pub(crate) columns: Columns,
    pub(crate) work: Work,
    pub(crate) backward: Backward,
    pub(crate) timer: Timer,
    readback: Readback,
    /// View of the last frame, and whether its kernel has a profile.
    pub(crate) last: Option<(View, bool)>,
}

/// The splats on the device.
pub(crate) struct Columns {
    pub means: Array,
    pub quats: Array,
    pub scales: Array,
    pub opacities: Array,
    pub profiles: Array,
    pub colors: Array,
}

/// What a frame computes on its way.
pub(crate) struct Work {
    /// The view of counting, and of everything else.
    pub counting: Array,
    pub view: Array,
    pub count: Array,
    pub projected: Array,
    pub low_keys: Array,
    pub keys: Array,
    pub splat_order: Pairs,
    pub sorter: Sorter,
    pub offsets: Array,
    pub sums: Array,
    pub spans: Array,
    pub entry_tiles: Array,
    pub entry_splats: Array,
    pub entry_order: Pairs,
    /// Which of the pairs `entry_order` holds the result.
    pub sorted: usize,
    pub ranges: Array,
    pub rgb: Array,
    pub depth: Array,
    pub transmittance: Array,
    pub last: Array,
}

impl Renderer {
    /// A renderer that holds no memory yet.
    pub fn new(gpu: &Gpu) -> Self {
        Self {
            gpu: gpu.clone(),
            columns: Columns::new(gpu),
            work: Work::new(gpu),
            backward: Backward::new(gpu),
            timer: Timer::new(),
            readback: Readback::default(),
            last: None,
        }
    }

    /// Renders `splats` from `camera` into `frame`.
    ///
    /// `splats`, `camera` and `options` must have passed their `check`. The same call gives the same bits on the same
    /// adapter and driver; against the CPU the tolerance table of `gs-raster/tests/raster/production.rs` holds.
    ///
    /// # Errors
    /// Something does not fit the device, or it failed.
    pub fn render_into<'a>(
        &mut self,
        splats: impl Into<SplatsRef<'a>>,
        camera: &Camera,
        options: &RasterOptions,
        frame: &mut Frame,
    ) -> Result<(), GpuError> {
        let splats = splats.into();
        self.last = None;
        let with_profile = !matches!(splats.kernel, Kernel::Gaussian);
        if splats.is_empty() {
            background(camera, options, frame);
            self.last = Some((View::new(Shape::of(splats), camera, options, 0), with_profile));
            return Ok(());
        }
        self.upload(splats, options)?;
        let mut entries = self.room(cast::to_u32(splats.len()));
        loop {
            let view = View::new(Shape::of(splats), camera, options, entries);
            let total = self.attempt(&view, with_profile, frame)?;
            if total <= entries {
                // Gradients need a record for each pair that there is, not for each that fits.
                self.last = Some((view.holding(total), with_profile));
                return Ok(());
            }
            entries = self.with_reserve(total);
        }
    }

    /// Renders with room for a number of entries; returns the number that the frame has.
    fn attempt(&mut self, view: &View, with_profile: bool, frame: &mut Frame) -> Result<u32, GpuError> {
        let gpu = self.gpu.clone();
        let mut encoder = gpu.device().create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("frame") });
        self.encode(&mut encoder, view, with_profile)?;
        let w = &self.work;
        let mut total = 0;
        let [width, height] = view.size().map(|v| v as usize);
        (frame.rgb.width, frame.rgb.height, frame.rgb.channels) = (width, height, 3);
        self.readback.submit(&gpu, encoder, &[&w.sums, &w.rgb, &w.depth, &w.transmittance], |i, bytes| match i {
            0 => total = bytemuck::pod_collect_to_vec::<u8, u32>(bytes).last().copied().unwrap_or(0),
            1 => copy(bytes, 3 * width * height, &mut frame.rgb.data),
            2 => copy(bytes, width * height, &mut frame.depth),
            _ => {
                copy(bytes, width * height, &mut frame.alpha);
                frame.alpha.iter_mut().for_each(|v| *v = 1.0 - *v);
            }
        })?;
        Ok(total)
    }

    /// Entries that a frame of so many splats has room for.
    pub(crate) fn room(&self, splats: u32) -> u32 {
        let held = u32::try_from(self.work.entry_tiles.bytes() / 4).unwrap_or(u32::MAX);
        held.max(FIRST_ENTRIES.saturating_mul(splats).min(self.most_entries())).max(LEAST_ENTRIES)
    }

    /// Entries to make room for, where a frame had `total`. A reserve is no reason to refuse what fits.
    pub(crate) fn with_reserve(&self, total: u32) -> u32 {
        total.saturating_add(total / 8).min(self.most_entries().max(total))
    }

    /// Entries of which the gradient fits the device.
    fn most_entries(&self) -> u32 {
        u32::try_from(self.gpu.largest_array() / RECORD).unwrap_or(u32::MAX)
    }

    /// The passes of a frame of the splats in the columns.
    pub(crate) fn encode(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        view: &View,
        with_profile: bool,
    ) -> Result<(), GpuError> {
        let gpu = &self.gpu;
        // A fault of what was done before must not be taken for one of the kernels.
        gpu.check()?;
        let kernels = gpu.kernels(with_profile);
        self.work.resize(gpu, view, with_profile)?;
        self.work.counting.upload(gpu, &[*view])?;
        self.work.view.upload(gpu, &[view.writing()])?;
        encoder.clear_buffer(self.work.ranges.buffer(), 0, None);
        let (c, w, timer) = (&self.columns, &mut self.work, &mut self.timer);
        project(gpu, kernels, &mut timer.pass(encoder, "project"), c, w, view);
        sort_depths(gpu, kernels, &mut timer.pass(encoder, "depth order"), w, view)?;
        list(gpu, kernels, &mut timer.pass(encoder, "tile lists"), w, view)?;
        blend(gpu, kernels, &mut timer.pass(encoder, "blend"), w, view);
        Ok(())
    }

    fn upload(&mut self, splats: SplatsRef<'_>, options: &RasterOptions) -> Result<(), GpuError> {
        let (gpu, c) = (&self.gpu, &mut self.columns);
        c.means.upload(gpu, splats.means)?;
        c.quats.upload(gpu, splats.quats)?;
        c.scales.upload(gpu, splats.scales)?;
        c.opacities.upload(gpu, splats.opacities)?;
        match splats.kernel {
            Kernel::Gaussian => c.profiles.resize(gpu, 0)?,
            _ => c.profiles.upload(gpu, &profiles(splats, options))?,
        }
        match splats.color {
            Color::Rgb(rgb) => c.colors.upload(gpu, rgb),
            Color::Sh { coeffs, .. } => c.colors.upload(gpu, coeffs),
        }
    }
}

/// A frame of no splats.
fn background(camera: &Camera, options: &RasterOptions, frame: &mut Frame) {
    let [width, height] = [camera.width, camera.height].map(|v| v as usize);
    frame.rgb = Image::zeros(width, height, 3);
    frame.rgb.data.as_chunks_mut::<3>().0.fill(options.background);
    frame.alpha = vec![0.0; width * height];
    frame.depth = vec![0.0; width * height];
}

/// Copies `n` numbers out of bytes.
pub(crate) fn copy(bytes: &[u8], n: usize, to: &mut Vec<f32>) {
    to.resize(n, 0.0);
    bytemuck::cast_slice_mut(to).copy_from_slice(&bytes[..4 * n]);
}

impl Columns {
    fn new(gpu: &Gpu) -> Self {
        Self {
            means: Array::new(gpu, "means"),
            quats: Array::new(gpu, "quaternions"),
            scales: Array::new(gpu, "scales"),
            opacities: Array::new(gpu, "opacities"),
            profiles: Array::new(gpu, "kernel profiles"),
            colors: Array::new(gpu, "colours"),
        }
    }
}

impl Work {
    fn new(gpu: &Gpu) -> Self {
        Self {
            counting: Array::new(gpu, "view"),
            view: Array::new(gpu, "view"),
            count: Array::new(gpu, "number of splats"),
            projected: Array::new(gpu, "projected splats"),
            low_keys: Array::new(gpu, "depth keys"),
            keys: Array::new(gpu, "depth keys"),
            splat_order: Pairs::new(gpu, "sorted depths", "depth order"),
            sorter: Sorter::new(gpu),
            offsets: Array::new(gpu, "offsets of entries"),
            sums: Array::new(gpu, "block sums of entries"),
            spans: Array::new(gpu, "entries of each splat"),
            entry_tiles: Array::new(gpu, "tiles of entries"),
            entry_splats: Array::new(gpu, "splats of entries"),
            entry_order: Pairs::new(gpu, "sorted tiles", "order of entries"),
            sorted: 0,
            ranges: Array::new(gpu, "entries of each tile"),
            rgb: Array::new(gpu, "colours of pixels"),
            depth: Array::new(gpu, "depths of pixels"),
            transmittance: Array::new(gpu, "transmittances of pixels"),
            last: Array::new(gpu, "last entries of pixels"),
        }
    }

    fn resize(&mut self, gpu: &Gpu, view: &View, with_profile: bool) -> Result<(), GpuError> {
        let (n, entries) = (u64::from(view.splats()), u64::from(view.entries()));
        let [columns, rows] = view.tiles().map(u64::from);
        let [width, height] = view.size().map(u64::from);
        let pixels = width * height;
        self.count.upload(gpu, &[0, 0, 0, view.splats()])?;
        self.projected.resize(gpu, n * VEC4 * projected_stride(with_profile))?;
        self.low_keys.resize(gpu, 4 * n)?;
        self.keys.resize(gpu, 4 * n)?;
        self.splat_order.resize(gpu, n)?;
        self.offsets.resize(gpu, 4 * n)?;
        self.sums.resize(gpu, sums_bytes(n))?;
        self.spans.resize(gpu, 8 * n)?;
        self.entry_tiles.resize(gpu, 4 * entries)?;
        self.entry_splats.resize(gpu, 4 * entries)?;
        self.entry_order.resize(gpu, entries)?;
        self.ranges.resize(gpu, 8 * columns * rows)?;
        self.rgb.resize(gpu, 12 * pixels)?;
        self.depth.resize(gpu, 4 * pixels)?;
        self.transmittance.resize(gpu, 4 * pixels)?;
        self.last.resize(gpu, 4 * pixels)
    }
}

/// Projects all splats and evaluates their colours.
fn project(gpu: &Gpu, kernels: &Kernels, pass: &mut wgpu::ComputePass<'_>, c: &Columns, w: &Work, view: &View) {
    let size = groups(view.splats().into(), GROUP);
    let arrays =
        [&w.view, &c.means, &c.quats, &c.scales, &c.opacities, &c.profiles, &w.projected, &w.keys, &w.low_keys];
    let k = &kernels.project;
    k.run(pass, &k.bind(gpu.device(), &arrays), size);
    let k = &kernels.color;
    k.run(pass, &k.bind(gpu.device(), &[&w.view, &c.means, &c.colors, &w.projected]), size);
}

/// Puts all splats in depth order.
fn sort_depths(
    gpu: &Gpu,
    kernels: &Kernels,
    pass: &mut wgpu::ComputePass<'_>,
    w: &mut Work,
    view: &View,
) -> Result<(), GpuError> {
    // By the low parts of the depths first, then by the depths: the sort is stable.
    let low = Sort { count: &w.count, keys: &w.low_keys, pairs: &w.splat_order, start: None, bits: 24 };
    let at = w.sorter.sort(gpu, kernels, pass, &low)?;
    let k = &kernels.gather_keys;
    let arrays = [&w.keys, &w.splat_order.values[at], &w.splat_order.keys[at]];
    k.run(pass, &k.bind(gpu.device(), &arrays), groups(view.splats().into(), GROUP));
    let high = Sort { count: &w.count, keys: &w.keys, pairs: &w.splat_order, start: Some(at), bits: 32 };
    w.sorter.sort(gpu, kernels, pass, &high)?;
    Ok(())
}

/// Where the depth order stands after its fourteen passes.
const DEPTH_ORDER: usize = 1;

/// Lists the splats of each tile, front to back.
fn list(
    gpu: &Gpu,
    kernels: &Kernels,
    pass: &mut wgpu::ComputePass<'_>,
    w: &mut Work,
    view: &View,
) -> Result<(), GpuError> {
    let size = groups(view.splats().into(), GROUP);
    let k = &kernels.list;
    for (i, uniform) in [&w.counting, &w.view].into_iter().enumerate() {
        let arrays = [
            uniform,
            &w.splat_order.values[DEPTH_ORDER],
            &w.projected,
            &w.offsets,
            &w.sums,
            &w.entry_tiles,
            &w.entry_splats,
            &w.spans,
        ];
        k.run(pass, &k.bind(gpu.device(), &arrays), size);
        if i == 0 {
            scan(gpu, kernels, pass, &w.offsets, &w.sums);
        }
    }
    let [columns, rows] = view.tiles();
    let bits = u32::BITS - (columns * rows).saturating_sub(1).leading_zeros();
    let sort = Sort { count: &w.sums, keys: &w.entry_tiles, pairs: &w.entry_order, start: None, bits: bits.max(1) };
    w.sorted = w.sorter.sort(gpu, kernels, pass, &sort)?;
    let k = &kernels.ranges;
    let arrays = [&w.sums, &w.entry_order.keys[w.sorted], &w.ranges];
    k.run(pass, &k.bind(gpu.device(), &arrays), groups(view.entries().into(), GROUP));
    Ok(())
}

/// Blends all tiles.
fn blend(gpu: &Gpu, kernels: &Kernels, pass: &mut wgpu::ComputePass<'_>, w: &Work, view: &View) {
    let arrays = [
        &w.view,
        &w.ranges,
        &w.entry_order.values[w.sorted],
        &w.entry_splats,
        &w.projected,
        &w.rgb,
        &w.depth,
        &w.transmittance,
        &w.last,
    ];
    let k = &kernels.blend;
    k.run(pass, &k.bind(gpu.device(), &arrays), view.tiles());
}
