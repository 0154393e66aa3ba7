//! A whole step on the device.

use crate::field::{self, Field, Known};
use crate::images::Images;
use crate::kernels::Kernels;
use crate::loss::{self, ImageLoss, View};
use crate::pass::At;
use crate::store::{Store, moments};
use crate::uniforms::Uniforms;
use gs_core::cast::to_u32;
use gs_core::{Camera, sh};
use gs_data::ImageU8;
use gs_gpu::{Array, Gpu, GpuError, Readback, Renderer, Shape, groups};
use gs_raster::DeviceError;
use gs_train::device::{DeviceLoss, DeviceStep, DeviceSteps};
use gs_train::method::{Method, MovedCloud};
use std::ops::Range;
use std::sync::{Arc, OnceLock};

/// Threads of a workgroup.
const GROUP: u64 = 256;
/// Added to the rules of offsets: scales have no gradient.
const KEEPS_SIZES: u32 = 4;

/// Makes whole steps on a GPU.
pub struct Steps {
    gpu: Gpu,
    kernels: Arc<Kernels>,
    renderer: Renderer,
    store: Store,
    field: Field,
    /// The field has been prepared for the state that was loaded.
    field_ready: bool,
    loss: ImageLoss,
    images: Images,
    uniforms: Uniforms,
    counters: Array,
    /// Bound where a cloud has no such column.
    nothing: [Array; 2],
    readback: Readback,
}

/// What was read back of a step.
#[derive(Default)]
struct Results {
    /// Number of (tile, splat) pairs.
    total: u32,
    loss: Vec<[f32; 4]>,
    counters: Vec<u32>,
    regularisers: Vec<[f32; 2]>,
}

/// The blocks of a cloud by name.
const MEANS: &str = "cloud.means";
const QUATS: &str = "cloud.quats";
const LOG_SCALES: &str = "cloud.log_scales";
const LOGITS: &str = "cloud.logit_opacities";
const SH_DC: &str = "cloud.sh_dc";
const SH_REST: &str = "cloud.sh_rest";

impl Steps {
    /// Compiles the kernels.
    ///
    /// # Errors
    /// The device failed.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Self::with_kernels(gpu, &OnceLock::new())
    }

    /// Takes the kernels that an earlier call compiled, or compiles them.
    pub(crate) fn with_kernels(gpu: &Gpu, compiled: &OnceLock<Arc<Kernels>>) -> Result<Self, GpuError> {
        const { assert!(Uniforms::fit(field::UNIFORMS + 16), "the uniforms of a step fit") };
        let kernels = match compiled.get() {
            Some(kernels) => Arc::clone(kernels),
            None => {
                let kernels = Arc::new(Kernels::new(gpu));
                // Kernels of a device that failed are not kept.
                gpu.check()?;
                Arc::clone(compiled.get_or_init(|| kernels))
            }
        };
        Ok(Self {
            kernels,
            renderer: Renderer::new(gpu),
            store: Store::new(gpu),
            field: Field::new(gpu),
            field_ready: false,
            loss: ImageLoss::new(gpu),
            images: Images::default(),
            uniforms: Uniforms::new(gpu)?,
            counters: Array::new(gpu, "counters"),
            nothing: [(); 2].map(|()| Array::new(gpu, "nothing")),
            readback: Readback::default(),
            gpu: gpu.clone(),
        })
    }

    /// Makes a step, again where the frame has more (tile, splat) pairs than there was room for: nothing was changed then.
    fn make(&mut self, step: &DeviceStep<'_>) -> Result<DeviceLoss, GpuError> {
        loop {
            let results = self.attempt(step)?;
            if results.total <= self.renderer.entries() {
                return Ok(self.loss_of(step, &results));
            }
            self.renderer.make_room_for_entries(results.total)?;
        }
    }

    fn attempt(&mut self, step: &DeviceStep<'_>) -> Result<Results, GpuError> {
        let gpu = self.gpu.clone();
        if self.images.get(step.view).is_none() {
            return Err(missing(&gpu, "the image of the step"));
        }
        let cloud = &step.cloud;
        let shape = Shape { splats: to_u32(cloud.cloud.len()), sh_degree: Some(cloud.sh_degree) };
        let moving = cloud.field.filter(|_| cloud.moves).and_then(Known::of);
        if let Some(field) = moving {
            if !self.field_ready {
                self.field.load(&gpu, &self.store, field, cloud.cloud.len())?;
                self.field_ready = true;
            }
            self.field.begin(&gpu, field, cloud.time)?;
        }
        self.renderer.make_room(shape)?;
        self.counters.resize(&gpu, 4 * self.store.counters())?;
        self.uniforms.clear();
        let [moves, rules] = moving.map_or([0; 2], |field| [self.field.moves(field), field.rules()]);
        let rules = rules + u32::from(cloud.keeps_sizes) * KEEPS_SIZES;
        let stored = 3 * sh::coeffs(cloud.cloud.sh_degree());
        let rendered = 3 * sh::coeffs(cloud.sh_degree);
        let sizes = [shape.splats, to_u32(rendered), to_u32(stored), moves, rules, 0, 0, 0];
        let sizes = self.uniforms.add(&sizes);

        let desc = wgpu::CommandEncoderDescriptor { label: Some("step") };
        let mut encoder = gpu.device().create_command_encoder(&desc);
        encoder.clear_buffer(self.counters.buffer(), 0, None);
        self.field.clear(&mut encoder);
        self.encode_splats(&mut encoder, &sizes, moving, shape, stored)?;
        self.renderer.encode_frame(&mut encoder, shape, step.camera, step.options)?;
        self.encode_loss(&mut encoder, step)?;
        self.renderer.encode_backward(&mut encoder)?;
        self.encode_gradients(&mut encoder, &sizes, moving, shape, stored)?;
        self.encode_update(&mut encoder, step)?;
        self.uniforms.upload(&gpu)?;
        self.read(encoder, moving)
    }

    /// From raw parameters to splats.
    fn encode_splats(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        sizes: &Range<usize>,
        moving: Option<Known<'_>>,
        shape: Shape,
        stored: usize,
    ) -> Result<(), GpuError> {
        let pass = &mut encoder.begin_compute_pass(&label("splats"));
        let Self { gpu, kernels, renderer, store, field, uniforms, nothing, .. } = self;
        let offsets = match moving {
            Some(known) => {
                let done = field.forward(&mut At { gpu, kernels, pass, uniforms }, store, known, MEANS);
                done.ok_or_else(|| missing(gpu, "a block of the field"))?;
                &field.offsets.values
            }
            None => &nothing[0],
        };
        let splats = renderer.splats();
        let value = |name: &str| store.value(name).unwrap_or_else(|| nothing[0].binding());
        let arrays = [
            uniforms.part(sizes),
            value(MEANS),
            value(QUATS),
            value(LOG_SCALES),
            offsets.binding(),
            splats.means.binding(),
            splats.quats.binding(),
            splats.scales.binding(),
        ];
        let n = u64::from(shape.splats);
        let kernel = &kernels.activate;
        kernel.run(pass, &kernel.bind_resources(gpu.device(), arrays.into_iter()), groups(n, GROUP));
        let arrays = [
            uniforms.part(sizes),
            value(LOGITS),
            value(SH_DC),
            value(SH_REST),
            splats.opacities.binding(),
            splats.colors.binding(),
        ];
        let kernel = &kernels.activate_colors;
        let size = groups(n * stored as u64, GROUP);
        kernel.run(pass, &kernel.bind_resources(gpu.device(), arrays.into_iter()), size);
        Ok(())
    }

    /// The cotangent of the frame.
    fn encode_loss(&mut self, encoder: &mut wgpu::CommandEncoder, step: &DeviceStep<'_>) -> Result<(), GpuError> {
        let Self { gpu, kernels, renderer, loss, images, uniforms, nothing, .. } = self;
        let view = view_of(step, images, &nothing[0]);
        loss.resize(gpu, &view)?;
        let pass = &mut encoder.begin_compute_pass(&label("loss"));
        loss.encode(&mut At { gpu, kernels, pass, uniforms }, &view, &renderer.frame());
        Ok(())
    }

    /// From gradients of splats to those of parameters.
    fn encode_gradients(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        sizes: &Range<usize>,
        moving: Option<Known<'_>>,
        shape: Shape,
        stored: usize,
    ) -> Result<(), GpuError> {
        let pass = &mut encoder.begin_compute_pass(&label("gradients"));
        let Self { gpu, kernels, renderer, store, field, uniforms, counters, nothing, .. } = self;
        let (splats, frame, n) = (renderer.splats(), renderer.frame(), u64::from(shape.splats));
        let kernel = &kernels.finite;
        let arrays = [frame.grads, frame.d_colors, counters];
        kernel.run(pass, &kernel.bind_part(gpu.device(), uniforms.part(sizes), &arrays), groups(n, GROUP));
        let grad = |name: &str| store.grad(name).unwrap_or_else(|| nothing[1].binding());
        let value = |name: &str| store.value(name).unwrap_or_else(|| nothing[0].binding());
        let [offsets, d_offsets] = match moving {
            Some(_) => [&field.offsets.values, &field.offsets.grads],
            None => [&nothing[0], &nothing[1]],
        };
        let arrays = [
            uniforms.part(sizes),
            frame.grads.binding(),
            value(QUATS),
            value(LOG_SCALES),
            offsets.binding(),
            grad(QUATS),
            grad(LOG_SCALES),
            d_offsets.binding(),
        ];
        let kernel = &kernels.activate_backward;
        kernel.run(pass, &kernel.bind_resources(gpu.device(), arrays.into_iter()), groups(n, GROUP));
        let arrays =
            [uniforms.part(sizes), frame.grads.binding(), splats.opacities.binding(), grad(MEANS), grad(LOGITS)];
        let kernel = &kernels.activate_rest_backward;
        kernel.run(pass, &kernel.bind_resources(gpu.device(), arrays.into_iter()), groups(n, GROUP));
        let arrays = [uniforms.part(sizes), frame.d_colors.binding(), grad(SH_DC), grad(SH_REST)];
        let kernel = &kernels.activate_colors_backward;
        let size = groups(n * stored as u64, GROUP);
        kernel.run(pass, &kernel.bind_resources(gpu.device(), arrays.into_iter()), size);
        if let Some(known) = moving {
            let done = field.backward(&mut At { gpu, kernels, pass, uniforms }, store, known, MEANS);
            done.ok_or_else(|| missing(gpu, "a block of the field"))?;
        }
        Ok(())
    }

    /// Adam, and the statistics of densification.
    fn encode_update(&mut self, encoder: &mut wgpu::CommandEncoder, step: &DeviceStep<'_>) -> Result<(), GpuError> {
        let pass = &mut encoder.begin_compute_pass(&label("update"));
        let Self { gpu, kernels, renderer, store, uniforms, counters, .. } = self;
        let (frame, entries) = (renderer.frame(), renderer.entries());
        if step.cloud.counts {
            let n = to_u32(step.cloud.cloud.len());
            let half = [step.camera.width, step.camera.height].map(|side| (0.5 * side as f32).to_bits());
            let sizes = uniforms.add(&[n, entries, half[0], half[1]]);
            let [grad_sum, seen, max_radius] = &store.statistics;
            let arrays = [frame.totals, frame.grads, grad_sum, seen, max_radius];
            let kernel = &kernels.statistics;
            kernel.run(pass, &kernel.bind_part(gpu.device(), uniforms.part(&sizes), &arrays), groups(n.into(), GROUP));
        }
        store.update(gpu, kernels, (pass, uniforms), step.update, (frame.totals, entries, counters))
    }

    /// Submits the step and reads its sums back.
    fn read(&mut self, encoder: wgpu::CommandEncoder, moving: Option<Known<'_>>) -> Result<Results, GpuError> {
        let mut results = Results::default();
        let frame = self.renderer.frame();
        let regularisers = moving.and_then(|field| self.field.partials(field));
        let arrays = [frame.totals, &self.loss.partials, &self.counters];
        let arrays: Vec<&Array> = arrays.into_iter().chain(regularisers).collect();
        self.readback.submit(&self.gpu, encoder, &arrays, |i, bytes| match i {
            0 => results.total = bytemuck::pod_collect_to_vec::<u8, u32>(bytes).last().copied().unwrap_or(0),
            1 => results.loss = bytemuck::pod_collect_to_vec(bytes),
            2 => results.counters = bytemuck::pod_collect_to_vec(bytes),
            _ => results.regularisers = bytemuck::pod_collect_to_vec(bytes),
        })?;
        Ok(results)
    }

    fn loss_of(&self, step: &DeviceStep<'_>, results: &Results) -> DeviceLoss {
        let view = view_of(step, &self.images, &self.nothing[0]);
        let mut loss = view.means(&results.loss);
        self.store.count(&results.counters, &mut loss);
        if !results.regularisers.is_empty() {
            loss.penalties = self.field.penalties(&results.regularisers);
        }
        loss
    }
}

/// What the loss of a step looks at.
fn view_of<'a>(step: &DeviceStep<'a>, images: &'a Images, nothing: &'a Array) -> View<'a> {
    View {
        camera: step.camera,
        background: step.options.background,
        l1: step.l1,
        dssim: step.dssim,
        image: images.get(step.view).unwrap_or(nothing),
    }
}

/// A step that was asked for without all that it needs.
fn missing(gpu: &Gpu, what: &str) -> GpuError {
    GpuError::Rejected { adapter: gpu.name().to_owned(), why: format!("{what} is not there") }
}

fn label(name: &str) -> wgpu::ComputePassDescriptor<'_> {
    wgpu::ComputePassDescriptor { label: Some(name), timestamp_writes: None }
}

impl DeviceSteps for Steps {
    fn lacks(&self, cloud: &MovedCloud<'_>, camera: &Camera) -> Option<String> {
        if cloud.cloud.kernel.is_some() {
            return Some("splats have a kernel of their own".to_owned());
        }
        let field = cloud.field.map(Known::of);
        if let Some(None) = field {
            return Some("the field is neither that of 4DGS nor that of Deformable 3D Gaussians".to_owned());
        }
        let field = field.flatten();
        let largest = [
            ("Adam's moments", moments(cloud.cloud, field)),
            ("the field's activations and gradients", field.map_or(0, |field| field.largest_array(cloud.cloud.len()))),
            ("gradients of SSIM", loss::largest_array(camera)),
        ];
        let allowed = self.gpu.largest_array();
        if let Some((what, need)) = largest.into_iter().find(|(_, need)| *need > allowed) {
            let [need, allowed] = [need.div_ceil(1 << 20), allowed >> 20];
            return Some(format!("{what} take {need} MiB in one buffer, and the device allows {allowed}"));
        }
        field.and_then(Known::lacks)
    }

    fn load(&mut self, method: &dyn Method) -> Result<(), DeviceError> {
        self.field_ready = false;
        self.store.load(&self.gpu, method).map_err(DeviceError::new)
    }

    fn has_image(&self, view: usize, scale: f64) -> bool {
        self.images.has(view, scale)
    }

    fn put_image(&mut self, view: usize, scale: f64, image: &ImageU8) -> Result<(), DeviceError> {
        self.images.put(&self.gpu, view, scale, image).map_err(DeviceError::new)
    }

    fn step(&mut self, step: &DeviceStep<'_>) -> Result<DeviceLoss, DeviceError> {
        self.make(step).map_err(DeviceError::new)
    }

    fn store(&mut self, method: &mut dyn Method) -> Result<(), DeviceError> {
        self.store.store(&self.gpu, method).map_err(DeviceError::new)
    }
}
