//! Networks of the published shapes with weights by a formula, for tests: the published weights are not ours.
#![expect(clippy::cast_possible_truncation, reason = "weights of tests")]

use safetensors::Dtype;
use safetensors::tensor::TensorView;

/// `n` multiples of 2⁻²⁴ in [0, 1) (SplitMix64).
pub fn unit(n: usize, salt: u64) -> impl Iterator<Item = f64> {
    (1..=n as u64).map(move |k| {
        let mut z = k.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(salt);
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 40) as f64 / 16_777_216.0
    })
}

/// A parameter by its name.
fn parameter(name: &str, shape: &[usize]) -> Vec<f32> {
    let salt = name.bytes().enumerate().map(|(k, c)| u64::from(c) * (k as u64 + 1)).sum();
    let n: usize = shape.iter().product();
    let scale = (24.0 / (n / shape[0]) as f64).sqrt();
    let value = |u: f64| match name {
        _ if name.starts_with("lin") => 0.1 * u,
        _ if name.ends_with("bias") => 0.1 * (u - 0.5),
        _ => (u - 0.5) * scale,
    };
    unit(n, salt).map(|u| value(u) as f32).collect()
}

/// A safetensors file of parameters with these names and shapes.
///
/// # Panics
/// If a name occurs twice.
pub fn file(shapes: &[(String, Vec<usize>)]) -> Vec<u8> {
    let bytes: Vec<(String, Vec<usize>, Vec<u8>)> = shapes
        .iter()
        .map(|(name, shape)| {
            let values = parameter(name, shape);
            (name.clone(), shape.clone(), values.iter().flat_map(|v| v.to_le_bytes()).collect())
        })
        .collect();
    let views =
        bytes.iter().map(|(name, shape, bytes)| (name, TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap()));
    safetensors::serialize(views, None).unwrap()
}

fn conv(name: &str, [outputs, inputs, kernel]: [usize; 3]) -> [(String, Vec<usize>); 2] {
    [(format!("{name}.weight"), vec![outputs, inputs, kernel, kernel]), (format!("{name}.bias"), vec![outputs])]
}

fn lines(channels: [usize; 5]) -> impl Iterator<Item = (String, Vec<usize>)> {
    channels.into_iter().enumerate().map(|(k, c)| (format!("lin{k}.model.1.weight"), vec![1, c, 1, 1]))
}

/// The parameters of LPIPS with AlexNet, by name.
pub fn alex() -> Vec<(String, Vec<usize>)> {
    let convs = [
        ("slice1.0", [64, 3, 11]),
        ("slice2.3", [192, 64, 5]),
        ("slice3.6", [384, 192, 3]),
        ("slice4.8", [256, 384, 3]),
        ("slice5.10", [256, 256, 3]),
    ];
    let convs = convs.into_iter().flat_map(|(name, shape)| conv(&format!("net.{name}"), shape));
    convs.chain(lines([64, 192, 384, 256, 256])).collect()
}

/// The parameters of LPIPS with VGG-16, by name.
pub fn vgg16() -> Vec<(String, Vec<usize>)> {
    let layers = [(1, 0, 64), (1, 2, 64), (2, 5, 128), (2, 7, 128), (3, 10, 256), (3, 12, 256), (3, 14, 256)];
    let more = [(4, 17, 512), (4, 19, 512), (4, 21, 512), (5, 24, 512), (5, 26, 512), (5, 28, 512)];
    let mut inputs = 3;
    let convs: Vec<_> = layers
        .into_iter()
        .chain(more)
        .flat_map(|(slice, index, outputs)| {
            let shape = [outputs, std::mem::replace(&mut inputs, outputs), 3];
            conv(&format!("net.slice{slice}.{index}"), shape)
        })
        .collect();
    convs.into_iter().chain(lines([64, 128, 256, 512, 512])).collect()
}

/// The parameters of VGG-19 up to `relu4_2`, by name.
pub fn vgg19() -> Vec<(String, Vec<usize>)> {
    let layers =
        [(0, 64), (2, 64), (5, 128), (7, 128), (10, 256), (12, 256), (14, 256), (16, 256), (19, 512), (21, 512)];
    let mut inputs = 3;
    let conv =
        |(index, outputs)| conv(&format!("features.{index}"), [outputs, std::mem::replace(&mut inputs, outputs), 3]);
    layers.into_iter().flat_map(conv).collect()
}
