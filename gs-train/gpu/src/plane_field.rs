//! The field of 4DGS on the device: planes and the layers behind them.

use crate::field::{OFFSETS, Offsets};
use crate::net::{Layer, Matrix, Products, Then, parts_len};
use crate::pass::At;
use crate::planes::{MOST_LEVELS, Planes};
use crate::store::Store;
use gs_core::Time;
use gs_deform::HexPlaneField;
use gs_gpu::{Array, Gpu, GpuError};

/// Most layers of the trunk.
pub(crate) const MOST_LAYERS: usize = 16;
/// Units are zero below zero.
const RELU: f32 = 0.0;

/// What the field needs on the device.
pub(crate) struct PlaneField {
    pub planes: Planes,
    /// Outputs of the trunk's layers, then of the first layers of all heads; and their gradients.
    outputs: Vec<Array>,
    d_outputs: Vec<Array>,
    parts: Array,
    shape: Shape,
}

/// What the network looks like.
#[derive(Clone, Default)]
struct Shape {
    /// How the names of its parameters begin.
    name: String,
    width: usize,
    depth: usize,
    /// Name, first offset and number of offsets of each head.
    heads: Vec<(&'static str, usize, usize)>,
    rows: usize,
    points_learn: bool,
}

/// What of a field the device cannot compute, in words.
pub(crate) fn lacks(field: &HexPlaneField) -> Option<String> {
    let config = field.config();
    if config.hexplane.levels.len() > MOST_LEVELS {
        return Some(format!("the planes have more than {MOST_LEVELS} levels"));
    }
    (config.depth > MOST_LAYERS).then(|| format!("the network has more than {MOST_LAYERS} layers"))
}

/// Numbers of the largest array that the field of so many splats takes.
pub(crate) fn largest_array(field: &HexPlaneField, rows: usize) -> usize {
    let shape = Shape::of(field, rows);
    let layers = shape.layers(field.config().hexplane.channels * field.config().hexplane.levels.len());
    let of_layer = |(_, inputs, outputs): &(String, usize, usize)| rows * inputs.max(outputs);
    layers.iter().map(of_layer).max().unwrap_or(0).max(shape.parts(&layers))
}

impl PlaneField {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        Self {
            planes: Planes::new(gpu),
            outputs: Vec::new(),
            d_outputs: Vec::new(),
            parts: Array::new(gpu, "gradients of weights, by rows"),
            shape: Shape::default(),
        }
    }

    /// Prepares for steps on `rows` splats.
    pub(crate) fn load(
        &mut self,
        gpu: &Gpu,
        store: &Store,
        field: &HexPlaneField,
        rows: usize,
    ) -> Result<(), GpuError> {
        self.shape = Shape::of(field, rows);
        self.planes.load(gpu, store, field.hexplane(), rows)?;
        let bytes = |values: usize| 4 * values as u64;
        let layers = self.shape.layers(self.planes.width());
        for arrays in [&mut self.outputs, &mut self.d_outputs] {
            arrays.resize_with(self.shape.depth + 1, || Array::new(gpu, "activations"));
            for (array, (_, _, outputs)) in arrays.iter_mut().zip(&layers) {
                array.resize(gpu, bytes(rows * outputs))?;
            }
        }
        self.parts.resize(gpu, bytes(self.shape.parts(&layers)))
    }

    /// Which offsets there are: 1 of means, 2 of scales, 4 of quaternions.
    pub(crate) fn moves(&self) -> u32 {
        self.shape.heads.iter().map(|head| 1 << (head.1 / 3)).sum()
    }

    /// Sets the time of the step.
    pub(crate) fn begin(&mut self, field: &HexPlaneField, t: Time) {
        self.planes.begin(field.hexplane(), t, self.shape.points_learn);
    }

    /// The offsets of all splats; none if a block is missing.
    pub(crate) fn forward(&self, at: &mut At<'_, '_>, store: &Store, means: &str, offsets: &Offsets) -> Option<()> {
        let shape = &self.shape;
        self.planes.forward(at, store, store.value(means)?);
        let mut products = Products { at, rows: shape.rows };
        let mut x = Matrix::whole(&self.planes.features, self.planes.width());
        for ((name, inputs, outputs), y) in shape.layers(x.stride).iter().zip(&self.outputs) {
            let y = Matrix::whole(y, *outputs);
            let then = Then { bias: true, rectify: Some(RELU), ..Then::default() };
            products.forward(&Layer::of(store, name, [*inputs, *outputs])?, x, y, then);
            x = y;
        }
        for (h, (name, first, outputs)) in shape.heads.iter().enumerate() {
            let layer = Layer::of(store, &shape.head(name), [shape.width, *outputs])?;
            let then = Then { bias: true, ..Then::default() };
            products.forward(&layer, Matrix { at: h * shape.width, ..x }, offsets.column(*first), then);
        }
        Some(())
    }

    /// Gradients of all parameters of the field from those of the offsets; those through the places are added to `means`.
    pub(crate) fn backward(&self, at: &mut At<'_, '_>, store: &Store, means: &str, offsets: &Offsets) -> Option<()> {
        let shape = &self.shape;
        let mut products = Products { at, rows: shape.rows };
        let stride = shape.heads.len() * shape.width;
        let (hidden, d_hidden) = (&self.outputs[shape.depth], &self.d_outputs[shape.depth]);
        for (h, (name, first, outputs)) in shape.heads.iter().enumerate() {
            let layer = Layer::of(store, &shape.head(name), [shape.width, *outputs])?;
            let own = |array| Matrix { array, at: h * shape.width, stride };
            let dy = offsets.d_column(*first);
            products.backward_weight(&layer, own(hidden), dy, true, &self.parts);
            let d = (dy, dy.array.binding());
            products.backward_input(&layer, d, own(d_hidden), false, Some((own(hidden), RELU)));
        }
        for (i, (name, inputs, outputs)) in shape.layers(self.planes.width()).iter().enumerate().rev() {
            let layer = Layer::of(store, name, [*inputs, *outputs])?;
            let dy = Matrix::whole(&self.d_outputs[i], *outputs);
            let (x, dx) = match i {
                0 => (&self.planes.features, &self.planes.d_features),
                _ => (&self.outputs[i - 1], &self.d_outputs[i - 1]),
            };
            let [x, dx] = [x, dx].map(|array| Matrix::whole(array, *inputs));
            products.backward_weight(&layer, x, dy, true, &self.parts);
            let behind = (i > 0).then_some((x, RELU));
            products.backward_input(&layer, (dy, dy.array.binding()), dx, false, behind);
        }
        self.planes.backward(at, store, store.value(means)?, store.grad(means)?);
        Some(())
    }
}

impl Shape {
    fn of(field: &HexPlaneField, rows: usize) -> Self {
        let config = field.config();
        let all = [
            ("means", 0, 3, config.move_means),
            ("scales", 3, 3, config.move_scales),
            ("quats", 6, 4, config.move_quats),
        ];
        let heads = all.into_iter().filter(|head| head.3).map(|(name, at, outputs, _)| (name, at, outputs)).collect();
        let first = &field.hexplane().plane(0, 0).name;
        Self {
            name: first.strip_suffix(".planes.xy.0").unwrap_or(first).to_owned(),
            width: config.width,
            depth: config.depth.max(1),
            heads,
            rows,
            points_learn: !config.detach_coordinates,
        }
    }

    /// Numbers that gradients of weights take before they are summed.
    fn parts(&self, layers: &[(String, usize, usize)]) -> usize {
        let of_layer = |(_, inputs, outputs): &(String, usize, usize)| parts_len(self.rows, *inputs, *outputs);
        layers.iter().map(of_layer).max().unwrap_or(0).max(parts_len(self.rows, self.width, OFFSETS))
    }

    /// Name, inputs and outputs of the layers before the heads' last ones: the trunk's, and the first of all heads as one.
    fn layers(&self, features: usize) -> Vec<(String, usize, usize)> {
        let inputs = |i: usize| if i == 0 { features } else { self.width };
        let trunk = (0..self.depth).map(|i| (format!("{}.trunk.{i}", self.name), inputs(i), self.width));
        let hidden = (format!("{}.hidden", self.name), self.width, self.heads.len() * self.width);
        trunk.chain(std::iter::once(hidden)).collect()
    }

    fn head(&self, name: &str) -> String {
        format!("{}.{name}", self.name)
    }
}
