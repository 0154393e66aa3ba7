//! The fields that a device has, and the offsets they give.

use crate::net::Matrix;
use crate::network_field::{self, NetworkField};
use crate::pass::At;
use crate::plane_field::{self, PlaneField};
use crate::planes::MOST_LEVELS;
use crate::store::Store;
use gs_core::{Param, Params, Time};
use gs_deform::apply::{Apply, QuatRule, ScaleRule};
use gs_deform::{DefMlp, HexPlaneField};
use gs_gpu::{Array, Gpu, GpuError};
use gs_train::method::LossValue;
use std::any::Any;

/// Values of a splat's offsets: mean, scales, quaternion.
pub(crate) const OFFSETS: usize = 10;

/// Uniforms that a step of a field takes, at most.
pub(crate) const UNIFORMS: usize = 32 + 6 * MOST_LEVELS + 8 * plane_field::MOST_LAYERS;

const _: () = assert!(plane_field::MOST_LAYERS >= network_field::MOST_LAYERS, "the uniforms are for both");

/// The field of a method, as its type is known here.
#[derive(Clone, Copy)]
pub(crate) enum Known<'a> {
    Planes(&'a HexPlaneField),
    Network(&'a DefMlp),
}

impl<'a> Known<'a> {
    pub(crate) fn of(field: &'a dyn Any) -> Option<Self> {
        let planes = field.downcast_ref().map(Known::Planes);
        planes.or_else(|| field.downcast_ref().map(Known::Network))
    }

    fn rule(self) -> Apply {
        match self {
            Known::Planes(field) => field.rule(),
            Known::Network(field) => field.rule(),
        }
    }

    /// How offsets act; see `shaders/cloud.wgsl`.
    pub(crate) fn rules(self) -> u32 {
        let Apply { scale, quat, .. } = self.rule();
        u32::from(scale == ScaleRule::Add) + 2 * u32::from(quat == QuatRule::Unit)
    }

    pub(crate) fn visit(self, f: &mut dyn FnMut(&Param)) {
        match self {
            Known::Planes(field) => field.visit(f),
            Known::Network(field) => field.visit(f),
        }
    }

    /// Bytes of the largest array that the field of so many splats takes.
    pub(crate) fn largest_array(self, splats: usize) -> u64 {
        let most = match self {
            Known::Planes(field) => plane_field::largest_array(field, splats),
            Known::Network(field) => network_field::largest_array(field, splats),
        };
        4 * most.max(splats * OFFSETS) as u64
    }

    /// What of the field the device cannot compute, in words.
    pub(crate) fn lacks(self) -> Option<String> {
        let rule = self.rule();
        if rule.scale_limit.is_some() {
            return Some("scales have a limit (field.scale_rule is add)".to_owned());
        }
        if rule.quat == QuatRule::Compose {
            return Some("field.quat_rule is compose".to_owned());
        }
        match self {
            Known::Planes(field) => plane_field::lacks(field),
            Known::Network(field) => network_field::lacks(field),
        }
    }
}

/// Offsets of splats and their gradients, `[n, 10]`.
pub(crate) struct Offsets {
    pub values: Array,
    pub grads: Array,
}

impl Offsets {
    /// The offsets from one on.
    pub(crate) fn column(&self, at: usize) -> Matrix<'_> {
        Matrix { array: &self.values, at, stride: OFFSETS }
    }

    /// Their gradients.
    pub(crate) fn d_column(&self, at: usize) -> Matrix<'_> {
        Matrix { array: &self.grads, at, stride: OFFSETS }
    }
}

/// What fields need on the device.
pub(crate) struct Field {
    pub offsets: Offsets,
    planes: PlaneField,
    network: NetworkField,
}

impl Field {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        let [values, grads] = ["offsets of splats", "gradients of offsets"].map(|what| Array::new(gpu, what));
        Self { offsets: Offsets { values, grads }, planes: PlaneField::new(gpu), network: NetworkField::new(gpu) }
    }

    /// Prepares for steps on `rows` splats.
    pub(crate) fn load(&mut self, gpu: &Gpu, store: &Store, field: Known<'_>, rows: usize) -> Result<(), GpuError> {
        for array in [&mut self.offsets.values, &mut self.offsets.grads] {
            array.resize(gpu, 4 * (rows * OFFSETS) as u64)?;
        }
        match field {
            Known::Planes(field) => self.planes.load(gpu, store, field, rows),
            Known::Network(field) => self.network.load(gpu, field, rows),
        }
    }

    /// Sets the time of the step.
    pub(crate) fn begin(&mut self, gpu: &Gpu, field: Known<'_>, t: Time) -> Result<(), GpuError> {
        match field {
            Known::Planes(field) => {
                self.planes.begin(field, t);
                Ok(())
            }
            Known::Network(_) => self.network.begin(gpu, t),
        }
    }

    /// Which offsets there are: 1 of means, 2 of scales, 4 of quaternions.
    pub(crate) fn moves(&self, field: Known<'_>) -> u32 {
        match field {
            Known::Planes(_) => self.planes.moves(),
            Known::Network(_) => self.network.moves(),
        }
    }

    /// Before a pass with the field.
    pub(crate) fn clear(&self, encoder: &mut wgpu::CommandEncoder) {
        self.planes.planes.clear(encoder);
    }

    /// The offsets of all splats, at the means of this name; none if a block of the field was not loaded.
    pub(crate) fn forward(&self, at: &mut At<'_, '_>, store: &Store, field: Known<'_>, means: &str) -> Option<()> {
        match field {
            Known::Planes(_) => self.planes.forward(at, store, means, &self.offsets),
            Known::Network(_) => self.network.forward(at, store, means, &self.offsets),
        }
    }

    /// Gradients of the field's parameters from those of the offsets; those through the places are added to the means'.
    pub(crate) fn backward(&self, at: &mut At<'_, '_>, store: &Store, field: Known<'_>, means: &str) -> Option<()> {
        match field {
            Known::Planes(_) => self.planes.backward(at, store, means, &self.offsets),
            Known::Network(_) => self.network.backward(at, store, &self.offsets),
        }
    }

    /// What its regularisers leave to be read back, if it has any.
    pub(crate) fn partials(&self, field: Known<'_>) -> Option<&Array> {
        matches!(field, Known::Planes(_)).then_some(&self.planes.planes.partials)
    }

    /// The regularisers, weights applied, from what was read back.
    pub(crate) fn penalties(&self, partials: &[[f32; 2]]) -> Vec<LossValue> {
        self.planes.planes.penalties(partials)
    }
}
