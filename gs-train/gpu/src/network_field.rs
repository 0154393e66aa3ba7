//! The field of Deformable 3D Gaussians on the device: encoded places, a time network, one wide network (gs_deform::field::defgs).
//!
//! Time is the same for all splats, so what it gives to the layers that take it is added to their biases, in products of one row.

use crate::field::{OFFSETS, Offsets};
use crate::net::{Layer, Matrix, Products, Then, parts_len};
use crate::pass::At;
use crate::store::Store;
use gs_core::Time;
use gs_core::cast::to_u32;
use gs_core::nn::encoding;
use gs_deform::{DefGsConfig, DefMlp};
use gs_gpu::{Array, Gpu, GpuError, groups};
use std::ops::Range;

/// Most layers.
pub(crate) const MOST_LAYERS: usize = 16;
/// Axes of space.
const AXES: usize = 3;
/// Threads of a workgroup.
const GROUP: u64 = 256;
/// Name, first offset and number of offsets of each head.
const HEADS: [(&str, usize, usize); 3] = [("means", 0, 3), ("quats", 6, 4), ("scales", 3, 3)];

/// What the field needs on the device.
pub(crate) struct NetworkField {
    config: DefGsConfig,
    rows: usize,
    position: Array,
    /// Outputs of the layers.
    hidden: Vec<Array>,
    /// Gradients of two layers at a time: those of layer i lie in i mod 2.
    d_hidden: [Array; 2],
    /// Biases of the layers with what time gives them.
    biases: Vec<Array>,
    /// Encoded time, and what the time network makes of it; its hidden units.
    time: Array,
    time_hidden: Array,
    time_features: Array,
    d_time_hidden: Array,
    d_time_features: Array,
    parts: Array,
}

/// What of a field the device cannot compute, in words.
pub(crate) fn lacks(field: &DefMlp) -> Option<String> {
    (field.config().depth > MOST_LAYERS).then(|| format!("the network has more than {MOST_LAYERS} layers"))
}

/// Numbers of the largest array that the field of so many splats takes.
pub(crate) fn largest_array(field: &DefMlp, rows: usize) -> usize {
    let config = field.config();
    (rows * config.width.max(encoding::width(AXES, config.bands_position))).max(parts(config, rows))
}

/// Numbers that gradients of weights take before they are summed.
fn parts(config: &DefGsConfig, rows: usize) -> usize {
    let [position, time] = [encoding::width(AXES, config.bands_position), encoding::width(1, config.bands_time)];
    let features = if config.time_hidden > 0 { config.time_features } else { time };
    let widest = position.max(config.width).max(features).max(time).max(config.time_hidden);
    parts_len(rows, widest, config.width.max(OFFSETS)).max(parts_len(1, widest, widest))
}

impl NetworkField {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        let array = |what| Array::new(gpu, what);
        Self {
            config: DefGsConfig::default(),
            rows: 0,
            position: array("encoded places"),
            hidden: Vec::new(),
            d_hidden: [(); 2].map(|()| array("gradients of activations")),
            biases: Vec::new(),
            time: array("encoded time"),
            time_hidden: array("hidden units of time"),
            time_features: array("features of time"),
            d_time_hidden: array("gradients of hidden units of time"),
            d_time_features: array("gradients of features of time"),
            parts: array("gradients of weights, by rows"),
        }
    }

    /// Prepares for steps on `rows` splats.
    pub(crate) fn load(&mut self, gpu: &Gpu, field: &DefMlp, rows: usize) -> Result<(), GpuError> {
        (self.config, self.rows) = (field.config().clone(), rows);
        let bytes = |values: usize| 4 * values as u64;
        let (width, depth) = (self.config.width, self.config.depth);
        self.position.resize(gpu, bytes(rows * self.position_width()))?;
        self.hidden.resize_with(depth, || Array::new(gpu, "activations"));
        let arrays = self.hidden.iter_mut().chain(&mut self.d_hidden);
        for array in arrays {
            array.resize(gpu, bytes(rows * width))?;
        }
        self.biases.resize_with(depth, || Array::new(gpu, "biases"));
        self.biases.iter_mut().try_for_each(|a| a.resize(gpu, bytes(width)))?;
        for array in [&mut self.time_hidden, &mut self.d_time_hidden] {
            array.resize(gpu, bytes(self.config.time_hidden))?;
        }
        let features = self.time_width();
        for array in [&mut self.time_features, &mut self.d_time_features] {
            array.resize(gpu, bytes(features))?;
        }
        self.parts.resize(gpu, bytes(parts(&self.config, rows)))
    }

    /// All offsets are there.
    pub(crate) fn moves(&self) -> u32 {
        1 | 2 | 4
    }

    /// Sets the time of the step.
    pub(crate) fn begin(&mut self, gpu: &Gpu, t: Time) -> Result<(), GpuError> {
        let mut encoded = vec![0.0; self.encoded_width()];
        encoding::encode(&[t.normalised], 1, self.config.bands_time, &mut encoded);
        self.time.upload(gpu, &encoded)
    }

    /// The offsets of all splats; none if a block is missing.
    pub(crate) fn forward(&self, at: &mut At<'_, '_>, store: &Store, means: &str, offsets: &Offsets) -> Option<()> {
        let sizes = [to_u32(self.rows), to_u32(self.config.bands_position), self.config.coordinate_scale.to_bits(), 0];
        let sizes = at.uniforms.add(&sizes);
        let arrays = [at.uniforms.part(&sizes), store.value(means)?, self.position.binding()];
        let bound = at.kernels.encode.bind_resources(at.gpu.device(), arrays.into_iter());
        at.kernels.encode.run(at.pass, &bound, groups((AXES * self.rows) as u64, GROUP));
        self.fold_time(&mut Products { at, rows: 1 }, store)?;
        let mut products = Products { at, rows: self.rows };
        let leak = Some(self.config.leak);
        let position = Matrix::whole(&self.position, self.position_width());
        for i in 0..self.config.depth {
            let (layer, [place, _, from_hidden]) = (self.layer(store, i)?, self.columns(i));
            let y = Matrix::whole(&self.hidden[i], self.config.width);
            let takes_input = !place.is_empty();
            if takes_input {
                let rectify = leak.filter(|_| i == 0);
                let then = Then { bias: true, rectify, ..Then::default() };
                products.forward(&layer.columns(&place).with_bias(&self.biases[i]), position, y, then);
            }
            if i > 0 {
                let x = Matrix::whole(&self.hidden[i - 1], self.config.width);
                let then = Then { add: takes_input, bias: !takes_input, rectify: leak };
                products.forward(&layer.columns(&from_hidden), x, y, then);
            }
        }
        let last = Matrix::whole(self.hidden.last()?, self.config.width);
        for (name, first, outputs) in HEADS {
            let layer = Layer::of(store, &format!("field.{name}"), [self.config.width, outputs])?;
            products.forward(&layer, last, offsets.column(first), Then { bias: true, ..Then::default() });
        }
        Some(())
    }

    /// Gradients of all parameters of the field from those of the offsets.
    pub(crate) fn backward(&self, at: &mut At<'_, '_>, store: &Store, offsets: &Offsets) -> Option<()> {
        let (width, leak) = (self.config.width, self.config.leak);
        let mut products = Products { at, rows: self.rows };
        let last = Matrix::whole(self.hidden.last()?, width);
        for (k, (name, first, outputs)) in HEADS.into_iter().enumerate() {
            let layer = Layer::of(store, &format!("field.{name}"), [width, outputs])?;
            let dy = offsets.d_column(first);
            products.backward_weight(&layer, last, dy, true, &self.parts);
            let dx = Matrix::whole(&self.d_hidden[(self.hidden.len() - 1) % 2], width);
            let behind = (k + 1 == HEADS.len()).then_some((last, leak));
            products.backward_input(&layer, (dy, dy.array.binding()), dx, k > 0, behind);
        }
        let position = Matrix::whole(&self.position, self.position_width());
        for i in (0..self.config.depth).rev() {
            let (layer, [place, time, from_hidden]) = (self.layer(store, i)?, self.columns(i));
            let dy = Matrix::whole(&self.d_hidden[i % 2], width);
            if !place.is_empty() {
                products.backward_weight(&layer.columns(&place), position, dy, true, &self.parts);
                let same = Matrix { array: self.features(), at: 0, stride: 0 };
                products.backward_weight(&layer.columns(&time), same, dy, false, &self.parts);
            }
            if i > 0 {
                let layer = layer.columns(&from_hidden);
                let [x, dx] =
                    [&self.hidden[i - 1], &self.d_hidden[(i - 1) % 2]].map(|array| Matrix::whole(array, width));
                products.backward_weight(&layer, x, dy, place.is_empty(), &self.parts);
                products.backward_input(&layer, (dy, dy.array.binding()), dx, false, Some((x, leak)));
            }
        }
        self.backward_time(&mut Products { at, rows: 1 }, store)
    }

    /// What time gives to the layers that take it, added to their biases.
    fn fold_time(&self, products: &mut Products<'_, '_, '_>, store: &Store) -> Option<()> {
        let [time, hidden, features] = self.time_matrices();
        if self.config.time_hidden > 0 {
            let [first, second] = self.time_layers(store)?;
            products.forward(&first, time, hidden, Then { bias: true, rectify: Some(0.0), ..Then::default() });
            products.forward(&second, hidden, features, Then { bias: true, ..Then::default() });
        }
        let x = Matrix::whole(self.features(), self.time_width());
        for i in (0..self.config.depth).filter(|i| self.takes_input(*i)) {
            let layer = self.layer(store, i)?.columns(&self.columns(i)[1]);
            let y = Matrix::whole(&self.biases[i], self.config.width);
            products.forward(&layer, x, y, Then { bias: true, ..Then::default() });
        }
        Some(())
    }

    /// Gradients of the time network.
    fn backward_time(&self, products: &mut Products<'_, '_, '_>, store: &Store) -> Option<()> {
        if self.config.time_hidden == 0 {
            return Some(());
        }
        let [time, hidden, _] = self.time_matrices();
        let d_features = Matrix::whole(&self.d_time_features, self.time_width());
        for (k, i) in (0..self.config.depth).filter(|i| self.takes_input(*i)).enumerate() {
            let layer = self.layer(store, i)?.columns(&self.columns(i)[1]);
            let dy = Matrix { array: &self.d_time_features, at: 0, stride: self.config.width };
            products.backward_input(&layer, (dy, layer.d_bias()), d_features, k > 0, None);
        }
        let [first, second] = self.time_layers(store)?;
        let d_hidden = Matrix::whole(&self.d_time_hidden, self.config.time_hidden);
        products.backward_weight(&second, hidden, d_features, true, &self.parts);
        let d = (d_features, self.d_time_features.binding());
        products.backward_input(&second, d, d_hidden, false, Some((hidden, 0.0)));
        products.backward_weight(&first, time, d_hidden, true, &self.parts);
        Some(())
    }

    /// Encoded time, hidden units, features of the time network.
    fn time_matrices(&self) -> [Matrix<'_>; 3] {
        [
            Matrix::whole(&self.time, self.encoded_width()),
            Matrix::whole(&self.time_hidden, self.config.time_hidden),
            Matrix::whole(&self.time_features, self.time_width()),
        ]
    }

    fn time_layers<'a>(&self, store: &'a Store) -> Option<[Layer<'a>; 2]> {
        let hidden = self.config.time_hidden;
        Some([
            Layer::of(store, "field.time.0", [self.encoded_width(), hidden])?,
            Layer::of(store, "field.time.1", [hidden, self.time_width()])?,
        ])
    }

    fn layer<'a>(&self, store: &'a Store, i: usize) -> Option<Layer<'a>> {
        let inputs = self.columns(i)[2].end;
        Layer::of(store, &format!("field.layer.{i}"), [inputs, self.config.width])
    }

    /// What the layers take of time.
    fn features(&self) -> &Array {
        if self.config.time_hidden > 0 { &self.time_features } else { &self.time }
    }

    fn encoded_width(&self) -> usize {
        encoding::width(1, self.config.bands_time)
    }

    fn time_width(&self) -> usize {
        if self.config.time_hidden > 0 { self.config.time_features } else { self.encoded_width() }
    }

    fn position_width(&self) -> usize {
        encoding::width(AXES, self.config.bands_position)
    }

    fn takes_input(&self, layer: usize) -> bool {
        layer == 0 || layer == self.config.skip.saturating_add(1)
    }

    /// Columns of a layer's weight for the encoded place, for time, and for the units of the layer before.
    fn columns(&self, layer: usize) -> [Range<usize>; 3] {
        let (position, time) =
            if self.takes_input(layer) { (self.position_width(), self.time_width()) } else { (0, 0) };
        let hidden = if layer == 0 { 0 } else { self.config.width };
        [0..position, position..position + time, position + time..position + time + hidden]
    }
}
