//! The compute kernels: their WGSL, their bindings, their pipelines.

use crate::memory::Array;

/// What a binding of a kernel holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bind {
    /// A uniform.
    Uniform,
    /// A storage array that is read only.
    Read,
    /// A storage array that is written.
    Write,
}

use Bind::{Read, Uniform, Write};

/// One compute kernel.
pub struct Kernel {
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
}

/// All kernels of a frame and its gradient.
pub(crate) struct Kernels {
    pub project: Kernel,
    pub color: Kernel,
    pub histogram: Kernel,
    pub scatter: Kernel,
    pub scan_blocks: Kernel,
    pub scan_offsets: Kernel,
    pub gather_keys: Kernel,
    pub list: Kernel,
    pub ranges: Kernel,
    pub blend: Kernel,
    pub blend_backward: Kernel,
    pub gather: Kernel,
    pub geometry_backward: Kernel,
    pub color_backward: Kernel,
    pub camera_backward: Kernel,
}

/// WGSL of `workgroup_index`, the number of a workgroup of a dispatch by [`groups`](crate::groups).
pub const INDEX: &str = include_str!("shaders/index.wgsl");
const VIEW: &str = include_str!("shaders/view.wgsl");
const DOUBLE: &str = include_str!("shaders/double.wgsl");
const GEOMETRY: &str = include_str!("shaders/geometry.wgsl");
const PROFILE: &str = include_str!("shaders/profile.wgsl");
/// The type of a row, which profiles sample.
const ROW_TYPE: &str = include_str!("shaders/row_type.wgsl");
const ROW: &str = include_str!("shaders/row.wgsl");
const SPLAT_BACKWARD: &str = include_str!("shaders/splat_backward.wgsl");
const SH: &str = include_str!("shaders/sh.wgsl");

/// Four-component vectors of a projected splat.
pub(crate) fn projected_stride(with_profile: bool) -> u64 {
    if with_profile { 5 } else { 4 }
}

impl Kernels {
    /// Compiles all kernels. `native_exp2`: the device's own exponential is accurate enough; `atomics`: the sums of entries
    /// are added by float atomics.
    pub(crate) fn new(device: &wgpu::Device, with_profile: bool, native_exp2: bool, atomics: bool) -> Self {
        let stride = projected_stride(with_profile);
        let constants = format!(
            "const STRIDE: u32 = {stride}u;\nconst HAS_PROFILE: bool = {with_profile};\nconst NATIVE_EXP2: bool = {native_exp2};\n"
        );
        let make = |name, parts: &[&str], entry, binds: &[Bind]| {
            let source = [constants.as_str(), INDEX].into_iter().chain(parts.iter().copied()).collect::<String>();
            Kernel::new(device, name, &source, entry, binds)
        };
        let record =
            if atomics { include_str!("shaders/record_atomic.wgsl") } else { include_str!("shaders/record.wgsl") };
        let scan = include_str!("shaders/scan.wgsl");
        Self {
            project: make(
                "project",
                &[VIEW, DOUBLE, GEOMETRY, ROW_TYPE, PROFILE, include_str!("shaders/project.wgsl")],
                "main",
                &[Uniform, Read, Read, Read, Read, Read, Write, Write, Write],
            ),
            color: make(
                "color",
                &[VIEW, SH, include_str!("shaders/color.wgsl")],
                "main",
                &[Uniform, Read, Read, Write],
            ),
            histogram: make(
                "histogram",
                &[include_str!("shaders/histogram.wgsl")],
                "main",
                &[Uniform, Read, Read, Write],
            ),
            scatter: make(
                "scatter",
                &[include_str!("shaders/scatter.wgsl")],
                "main",
                &[Uniform, Read, Read, Read, Read, Read, Write, Write],
            ),
            scan_blocks: make("scan blocks", &[scan], "blocks", &[Write, Write]),
            scan_offsets: make("scan offsets", &[scan], "offsets", &[Write, Write]),
            gather_keys: make("gather keys", &[include_str!("shaders/gather_keys.wgsl")], "main", &[Read, Read, Write]),
            list: make(
                "list",
                &[VIEW, include_str!("shaders/list.wgsl")],
                "main",
                &[Uniform, Read, Read, Write, Read, Write, Write, Write],
            ),
            ranges: make("ranges", &[include_str!("shaders/ranges.wgsl")], "main", &[Read, Read, Write]),
            blend: make(
                "blend",
                &[VIEW, DOUBLE, ROW_TYPE, PROFILE, ROW, include_str!("shaders/blend.wgsl")],
                "main",
                &[Uniform, Read, Read, Read, Read, Write, Write, Write, Write],
            ),
            blend_backward: make(
                "blend backward",
                &[VIEW, DOUBLE, ROW_TYPE, PROFILE, ROW, record, include_str!("shaders/blend_backward.wgsl")],
                "main",
                &[Uniform, Read, Read, Read, Read, Read, Read, Read, Write],
            ),
            gather: make("gather", &[VIEW, include_str!("shaders/gather.wgsl")], "main", &[Uniform, Read, Read, Write]),
            geometry_backward: make(
                "geometry backward",
                &[VIEW, DOUBLE, GEOMETRY, SPLAT_BACKWARD, include_str!("shaders/geometry_backward.wgsl")],
                "main",
                &[Uniform, Read, Read, Read, Read, Read, Read, Write],
            ),
            camera_backward: make(
                "camera backward",
                &[VIEW, DOUBLE, GEOMETRY, SPLAT_BACKWARD, include_str!("shaders/camera_backward.wgsl")],
                "main",
                &[Uniform, Read, Read, Read, Read, Read, Read, Write, Write],
            ),
            color_backward: make(
                "color backward",
                &[VIEW, SH, include_str!("shaders/color_backward.wgsl")],
                "main",
                &[Uniform, Read, Read, Read, Read, Write, Write],
            ),
        }
    }
}

impl Kernel {
    /// The entry point `entry` of a WGSL source, its bindings numbered from 0 in group 0. A source that is not valid is a fault of
    /// the device, met by the next call that can fail.
    pub fn new(device: &wgpu::Device, name: &str, source: &str, entry: &str, binds: &[Bind]) -> Self {
        let entries: Vec<_> = (0..).zip(binds).map(|(binding, bind)| layout_entry(binding, *bind)).collect();
        let layout =
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(name), entries: &entries });
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(name),
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let source = wgpu::ShaderSource::Wgsl(source.into());
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some(name), source });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(name),
            layout: Some(&pipeline_layout),
            module: &module,
            entry_point: Some(entry),
            compilation_options: wgpu::PipelineCompilationOptions {
                // Every kernel writes its workgroup memory before it reads it.
                zero_initialize_workgroup_memory: false,
                ..wgpu::PipelineCompilationOptions::default()
            },
            cache: None,
        });
        Self { pipeline, layout }
    }

    /// Binds whole arrays, one for each binding in order.
    pub fn bind(&self, device: &wgpu::Device, arrays: &[&Array]) -> wgpu::BindGroup {
        self.bind_resources(device, arrays.iter().map(|a| a.binding()))
    }

    /// [`Kernel::bind`] where the first binding is a part of an array.
    pub fn bind_part(
        &self,
        device: &wgpu::Device,
        part: wgpu::BindingResource<'_>,
        arrays: &[&Array],
    ) -> wgpu::BindGroup {
        self.bind_resources(device, std::iter::once(part).chain(arrays.iter().map(|a| a.binding())))
    }

    /// Binds arrays or parts of arrays, one for each binding in order.
    pub fn bind_resources<'a>(
        &self,
        device: &wgpu::Device,
        resources: impl Iterator<Item = wgpu::BindingResource<'a>>,
    ) -> wgpu::BindGroup {
        let entries: Vec<_> =
            (0..).zip(resources).map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }).collect();
        device.create_bind_group(&wgpu::BindGroupDescriptor { label: None, layout: &self.layout, entries: &entries })
    }

    /// Runs the kernel over columns and rows of workgroups.
    pub fn run(&self, pass: &mut wgpu::ComputePass<'_>, group: &wgpu::BindGroup, [x, y]: [u32; 2]) {
        if x == 0 || y == 0 {
            return;
        }
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, group, &[]);
        pass.dispatch_workgroups(x, y, 1);
    }
}

fn layout_entry(binding: u32, bind: Bind) -> wgpu::BindGroupLayoutEntry {
    let ty = match bind {
        Uniform => wgpu::BufferBindingType::Uniform,
        Read => wgpu::BufferBindingType::Storage { read_only: true },
        Write => wgpu::BufferBindingType::Storage { read_only: false },
    };
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    }
}

/// A kernel of one array in and one out.
pub(crate) fn probe(device: &wgpu::Device, source: &str) -> Kernel {
    Kernel::new(device, "probe", source, "main", &[Read, Write])
}
