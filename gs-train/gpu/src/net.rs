//! Layers of a network: their products, forward and backward.

use crate::kernels::Kernels;
use crate::pass::At;
use crate::store::Store;
use bytemuck::{Pod, Zeroable};
use gs_core::cast::to_u32;
use gs_gpu::{Array, groups};

/// Side of the tile of one workgroup.
const TILE: u32 = 64;
/// Rows whose contributions to the gradient of a weight are summed by one workgroup.
const CHUNK: usize = 512;
/// Values of one workgroup of the sum over chunks.
const GROUP: u64 = 256;

/// What is done to a product, in this order.
const ADD: u32 = 1;
const BIAS: u32 = 2;
const RECTIFY: u32 = 4;
const MASK: u32 = 8;

/// A matrix in an array: where it begins, and the distance of its rows.
#[derive(Clone, Copy)]
pub(crate) struct Matrix<'a> {
    pub array: &'a Array,
    pub at: usize,
    pub stride: usize,
}

impl<'a> Matrix<'a> {
    /// All of an array, rows of so many values.
    pub(crate) fn whole(array: &'a Array, width: usize) -> Self {
        Self { array, at: 0, stride: width }
    }
}

/// Columns of a layer `y = x Wᵀ + b`.
#[derive(Clone)]
pub(crate) struct Layer<'a> {
    pub outputs: usize,
    /// Number of columns.
    pub inputs: usize,
    /// The first of them.
    first: usize,
    /// Columns of the whole weight.
    stride: usize,
    weight: wgpu::BindingResource<'a>,
    bias: wgpu::BindingResource<'a>,
    d_weight: wgpu::BindingResource<'a>,
    d_bias: wgpu::BindingResource<'a>,
}

impl<'a> Layer<'a> {
    /// The layer of this name, all of its columns.
    pub(crate) fn of(store: &'a Store, name: &str, [inputs, outputs]: [usize; 2]) -> Option<Self> {
        let [weight, bias] = ["weight", "bias"].map(|what| format!("{name}.{what}"));
        Some(Self {
            outputs,
            inputs,
            first: 0,
            stride: inputs,
            weight: store.value(&weight)?,
            bias: store.value(&bias)?,
            d_weight: store.grad(&weight)?,
            d_bias: store.grad(&bias)?,
        })
    }

    /// Some of the columns.
    pub(crate) fn columns(&self, columns: &std::ops::Range<usize>) -> Self {
        Self { first: self.first + columns.start, inputs: columns.len(), ..self.clone() }
    }

    /// The same with another bias.
    pub(crate) fn with_bias(self, bias: &'a Array) -> Self {
        Self { bias: bias.binding(), ..self }
    }

    /// The gradient of the bias.
    pub(crate) fn d_bias(&self) -> wgpu::BindingResource<'a> {
        self.d_bias.clone()
    }
}

/// What becomes of a product.
#[derive(Clone, Copy, Default)]
pub(crate) struct Then {
    /// It is added to what is there.
    pub add: bool,
    /// The bias is added.
    pub bias: bool,
    /// It goes through a rectifier with this slope below zero.
    pub rectify: Option<f32>,
}

/// See `shaders/linear.wgsl`.
#[derive(Clone, Copy, Pod, Zeroable, Default)]
#[repr(C)]
struct Product {
    rows: u32,
    inner: u32,
    columns: u32,
    chunk: u32,
    a_at: u32,
    a_row: u32,
    a_column: u32,
    b_row: u32,
    b_column: u32,
    b_at: u32,
    c_at: u32,
    c_row: u32,
    after: u32,
    extra_at: u32,
    ones: u32,
    leak: f32,
}

/// Appends products of so many rows to a pass.
pub(crate) struct Products<'a, 'b, 'c> {
    pub at: &'a mut At<'b, 'c>,
    pub rows: usize,
}

impl Products<'_, '_, '_> {
    /// `y` of columns of a layer.
    pub(crate) fn forward(&mut self, layer: &Layer<'_>, x: Matrix<'_>, y: Matrix<'_>, then: Then) {
        let product = Product {
            a_at: to_u32(x.at),
            a_row: to_u32(x.stride),
            a_column: 1,
            b_at: to_u32(layer.first),
            b_row: 1,
            b_column: to_u32(layer.stride),
            c_at: to_u32(y.at),
            c_row: to_u32(y.stride),
            after: flag(then.add, ADD) | flag(then.bias, BIAS) | flag(then.rectify.is_some(), RECTIFY),
            leak: then.rectify.unwrap_or(0.0),
            ..sizes(self.rows, layer.inputs, layer.outputs)
        };
        self.run(&product, [x.array.binding(), layer.weight.clone(), layer.bias.clone(), y.array.binding()]);
    }

    /// Cotangent of columns of a layer's input from that of its output `dy`, added to `dx` where `add` says so. Where the input lies
    /// behind a rectifier, `behind` has its values, laid out as `dx`, and the slope below zero.
    pub(crate) fn backward_input(
        &mut self,
        layer: &Layer<'_>,
        (dy, d_array): (Matrix<'_>, wgpu::BindingResource<'_>),
        dx: Matrix<'_>,
        add: bool,
        behind: Option<(Matrix<'_>, f32)>,
    ) {
        let product = Product {
            a_at: to_u32(dy.at),
            a_row: to_u32(dy.stride),
            a_column: 1,
            b_at: to_u32(layer.first),
            b_row: to_u32(layer.stride),
            b_column: 1,
            c_at: to_u32(dx.at),
            c_row: to_u32(dx.stride),
            after: flag(add, ADD) | flag(behind.is_some(), MASK),
            extra_at: to_u32(dx.at),
            leak: behind.map_or(0.0, |b| b.1),
            ..sizes(self.rows, layer.outputs, layer.inputs)
        };
        let extra = behind.map_or_else(|| layer.bias.clone(), |b| b.0.array.binding());
        self.run(&product, [d_array, layer.weight.clone(), extra, dx.array.binding()]);
    }

    /// Gradients of columns of a layer's weight, and of its bias where `bias` says so, by way of `parts`, which has room for
    /// [`parts_len`] values. A matrix `x` of stride 0 is the same row for all.
    pub(crate) fn backward_weight(
        &mut self,
        layer: &Layer<'_>,
        x: Matrix<'_>,
        dy: Matrix<'_>,
        bias: bool,
        parts: &Array,
    ) {
        let columns = layer.inputs + usize::from(bias);
        let product = Product {
            chunk: to_u32(CHUNK),
            a_at: to_u32(dy.at),
            a_row: 1,
            a_column: to_u32(dy.stride),
            b_at: to_u32(x.at),
            b_row: to_u32(x.stride),
            b_column: 1,
            c_row: to_u32(columns),
            ones: u32::from(bias),
            ..sizes(layer.outputs, self.rows, columns)
        };
        self.run(&product, [dy.array.binding(), x.array.binding(), layer.bias.clone(), parts.binding()]);
        let chunks = self.rows.div_ceil(CHUNK);
        let numbers = [layer.outputs, layer.inputs, chunks, layer.first, layer.stride, usize::from(bias), 0, 0];
        let numbers = self.at.uniforms.add(&numbers.map(to_u32));
        let kernel = &self.at.kernels.linear_sum;
        let arrays = [self.at.uniforms.part(&numbers), parts.binding(), layer.d_weight.clone(), layer.d_bias.clone()];
        let bound = kernel.bind_resources(self.at.gpu.device(), arrays.into_iter());
        kernel.run(self.at.pass, &bound, groups((layer.outputs * columns) as u64, GROUP));
    }

    fn run(&mut self, product: &Product, arrays: [wgpu::BindingResource<'_>; 4]) {
        let uniform = self.at.uniforms.add(product);
        let Kernels { linear, .. } = self.at.kernels;
        let all = std::iter::once(self.at.uniforms.part(&uniform)).chain(arrays);
        let bound = linear.bind_resources(self.at.gpu.device(), all);
        let [rows, columns] = [product.rows, product.columns].map(|n| u64::from(n.div_ceil(TILE)));
        let chunks = u64::from(product.inner.div_ceil(product.chunk).max(1));
        linear.run(self.at.pass, &bound, groups(rows * columns * chunks, 1));
    }
}

/// A bit, if it is on.
fn flag(on: bool, bit: u32) -> u32 {
    if on { bit } else { 0 }
}

fn sizes(rows: usize, inner: usize, columns: usize) -> Product {
    let [rows, inner, columns] = [rows, inner, columns].map(to_u32);
    Product { rows, inner, columns, chunk: inner.max(1), ..Product::default() }
}

/// Values that the gradient of a weight takes before its chunks are summed.
pub(crate) fn parts_len(rows: usize, inputs: usize, outputs: usize) -> usize {
    rows.div_ceil(CHUNK) * outputs * (inputs + 1)
}
