//! Images and gradients of independent renderers, and rasterisers against them (`tests/golden` has a README).

use glam::{DMat3, DVec3, Vec3};
use gs_core::{Camera, Color, Kernel, Splats};
use gs_raster::reference::{Cutoff, Scene, render as reference};
use gs_raster::{Frame, FrameGrad, RasterOptions, Rasterizer};
use safetensors::{Dtype, SafeTensors};
use std::path::Path;

pub const SCENES: [&str; 3] = ["single", "needles", "near_plane"];
pub const COLUMNS: [&str; 5] = ["means", "quats", "log_scales", "logits", "sh"];

/// A file of named arrays. A missing file or array fails the test.
pub struct Arrays {
    name: String,
    bytes: Vec<u8>,
}

impl Arrays {
    fn open(name: &str) -> Self {
        // The workspace's packages lie at different depths.
        let package = Path::new(env!("CARGO_MANIFEST_DIR"));
        let folders = package.ancestors().map(|folder| folder.join("tests/golden"));
        let path = folders.map(|f| f.join(format!("{name}.safetensors"))).find(|p| p.exists());
        let path = path.unwrap_or_else(|| panic!("tests/golden/{name}.safetensors is missing"));
        let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        Self { name: name.into(), bytes }
    }

    /// Shape and values of an array of `F32` or `F64`.
    fn array(&self, key: &str) -> (Vec<usize>, Vec<f64>) {
        let file = SafeTensors::deserialize(&self.bytes).unwrap_or_else(|e| panic!("{}: {e}", self.name));
        let tensor = file.tensor(key).unwrap_or_else(|e| panic!("{}: {key}: {e}", self.name));
        let values: Vec<f64> = match tensor.dtype() {
            Dtype::F32 => tensor.data().as_chunks().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect(),
            Dtype::F64 => tensor.data().as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect(),
            other => panic!("{}: {key} is {other:?}", self.name),
        };
        assert!(!values.is_empty(), "{}: {key} is empty", self.name);
        (tensor.shape().to_vec(), values)
    }

    pub fn values(&self, key: &str) -> Vec<f64> {
        self.array(key).1
    }
}

/// Activates raw parameters, named `keys`, in `f64`.
fn scene(file: &Arrays, keys: [&str; 5]) -> Scene<f64> {
    let [means, quats, log_scales, logits, sh] = keys.map(|k| file.values(k));
    let degree = (0..4).find(|&d| means.len() * gs_core::sh::coeffs(d) == sh.len()).expect("SH of degree 0 to 3");
    let mut scene = Scene::new(&Splats::default());
    scene.means = means.as_chunks().0.to_vec();
    scene.quats = quats.as_chunks().0.to_vec();
    scene.scales = log_scales.as_chunks().0.iter().map(|s: &[f64; 3]| s.map(f64::exp)).collect();
    scene.opacities = logits.iter().map(|o| 1.0 / (1.0 + (-o).exp())).collect();
    (scene.color, scene.degree) = (sh, Some(degree));
    scene
}

/// The same splats in `f32`.
fn to_splats(s: &Scene<f64>) -> Splats {
    let vec3 = |v: &[f64; 3]| Vec3::from_array(v.map(|x| x as f32));
    let splats = Splats {
        means: s.means.iter().map(vec3).collect(),
        quats: s.quats.iter().map(|q| q.map(|x| x as f32)).collect(),
        scales: s.scales.iter().map(vec3).collect(),
        opacities: s.opacities.iter().map(|&o| o as f32).collect(),
        color: Color::Sh { degree: s.degree.unwrap_or(0), coeffs: s.color.iter().map(|&c| c as f32).collect() },
        kernel: Kernel::Gaussian,
    };
    splats.check().expect("legal splats");
    splats
}

pub struct Golden {
    pub file: Arrays,
    pub scene: Scene<f64>,
    pub camera: Camera,
    /// The loss is `Σ weights · (rgb, alpha)`.
    pub weights: Vec<f64>,
}

pub fn load(name: &str) -> Golden {
    let file = Arrays::open(name);
    let scene = scene(&file, COLUMNS);
    let (shape, weights) = file.array("weights");
    let view = file.values("world_to_camera");
    let intrinsics = file.values("intrinsics");
    let camera = Camera {
        width: shape[1] as u32,
        height: shape[0] as u32,
        fx: intrinsics[0],
        fy: intrinsics[1],
        cx: intrinsics[2],
        cy: intrinsics[3],
        rotation: DMat3::from_cols_array_2d(&[0, 1, 2].map(|c| [view[c], view[4 + c], view[8 + c]])),
        translation: DVec3::new(view[3], view[7], view[11]),
    };
    Golden { file, scene, camera, weights }
}

/// Suffix of the arrays, options; the cap at 0.999 is stored for one scene.
pub fn variants(name: &str) -> Vec<(&'static str, RasterOptions)> {
    let classic = RasterOptions::default();
    let mut variants = vec![("", classic.clone()), ("_aa", RasterOptions { antialias: true, ..classic.clone() })];
    if name == "single" {
        variants.push(("_a999", RasterOptions { max_alpha: 0.999, ..classic }));
    }
    variants
}

/// Largest difference.
pub fn max_error(got: &[f64], want: &[f64]) -> f64 {
    assert_eq!(got.len(), want.len());
    got.iter().zip(want).fold(0.0, |m, (a, b)| (a - b).abs().max(m))
}

/// Largest difference relative to the largest entry.
pub fn relative_max(got: &[f64], want: &[f64]) -> f64 {
    max_error(got, want) / want.iter().fold(1e-300, |m, v| v.abs().max(m))
}

fn relative_l2(got: &[f64], want: &[f64]) -> f64 {
    assert_eq!(got.len(), want.len());
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
    norm(&mut got.iter().zip(want).map(|(a, b)| a - b)) / norm(&mut want.iter().copied()).max(1e-300)
}

fn rgba(frame: &Frame) -> Vec<f64> {
    let pixels = frame.rgb.data.as_chunks::<3>().0.iter().zip(&frame.alpha);
    pixels.flat_map(|(c, a)| [c[0], c[1], c[2], *a]).map(f64::from).collect()
}

/// Gradients of the raw parameters (log-scales, logits) from those of the activated ones, in the order of [`COLUMNS`].
pub fn raw_gradients(scene: &Scene<f64>, d: &Scene<f64>) -> [Vec<f64>; 5] {
    let scales = d.scales.as_flattened().iter().zip(scene.scales.as_flattened()).map(|(d, s)| d * s);
    let logits = d.opacities.iter().zip(&scene.opacities).map(|(d, o)| d * o * (1.0 - o));
    [
        d.means.as_flattened().to_vec(),
        d.quats.as_flattened().to_vec(),
        scales.collect(),
        logits.collect(),
        d.color.clone(),
    ]
}

/// The images and gradients of all scenes by a rasteriser.
pub fn check_scenes(rasterizer: &mut dyn Rasterizer) {
    for name in SCENES {
        let g = load(name);
        let splats = to_splats(&g.scene);
        for (suffix, options) in variants(name) {
            let margin = reference(&g.scene, &g.camera, &options, Cutoff::Hard).margin;
            assert!(margin.iter().all(|m| *m > 1e-5), "{name}{suffix}: a sample hangs on rounding");
            let mut frame = Frame::default();
            rasterizer.render_into(splats.view(), &g.camera, &options, &mut frame).expect("a frame");
            let error = max_error(&rgba(&frame), &g.file.values(&format!("image{suffix}")));
            println!("{name}{suffix}: image {error:.1e}");
            assert!(error <= 2e-5, "{name}{suffix}: image is off by {error:.2e}");
            let weights: Vec<[f32; 4]> =
                g.weights.as_chunks().0.iter().map(|w: &[f64; 4]| w.map(|x| x as f32)).collect();
            let d = FrameGrad {
                rgb: weights.iter().flat_map(|w| [w[0], w[1], w[2]]).collect(),
                alpha: weights.iter().map(|w| w[3]).collect(),
                depth: Vec::new(),
            };
            let (mut grad, mut stats) = Default::default();
            rasterizer
                .render_backward_into(splats.view(), &g.camera, &options, &d, &mut grad, &mut stats)
                .expect("a gradient");
            let mut wide = g.scene.zeros_like();
            wide.means = grad.means.iter().map(|v| v.to_array().map(f64::from)).collect();
            wide.quats = grad.quats.iter().map(|v| v.map(f64::from)).collect();
            wide.scales = grad.scales.iter().map(|v| v.to_array().map(f64::from)).collect();
            wide.opacities = grad.opacities.iter().map(|&v| f64::from(v)).collect();
            wide.color = grad.color.iter().map(|&v| f64::from(v)).collect();
            let limit = if options.antialias { 1e-3 } else { 1e-4 };
            for (column, got) in COLUMNS.iter().zip(raw_gradients(&g.scene, &wide)) {
                let error = relative_l2(&got, &g.file.values(&format!("grad{suffix}_{column}")));
                println!("{name}{suffix}: {column} {error:.1e}");
                assert!(error <= limit, "{name}{suffix}: gradient of {column} is off by {error:.2e}");
            }
        }
    }
}

/// gsplat's own basic scene, and its image as `f64` RGBA.
pub fn gsplat_scene() -> (Scene<f64>, Camera, RasterOptions, Vec<f64>) {
    let file = Arrays::open("gsplat_basic_case");
    let scene = scene(&file, ["means", "quats", "scales", "opacities", "coeffs"]);
    let camera = Camera {
        width: 123,
        height: 82,
        fx: 61.5,
        fy: 61.5,
        cx: 61.5,
        cy: 41.0,
        rotation: DMat3::IDENTITY,
        translation: DVec3::new(-0.123, -0.456, 8.0),
    };
    let options = RasterOptions { max_alpha: 0.999, ..Default::default() };
    (scene, camera, options, file.values("out_img"))
}

/// gsplat's image by a rasteriser.
pub fn check_gsplat(rasterizer: &mut dyn Rasterizer) {
    let (scene, camera, options, want) = gsplat_scene();
    let mut frame = Frame::default();
    rasterizer.render_into(to_splats(&scene).view(), &camera, &options, &mut frame).expect("a frame");
    let error = max_error(&rgba(&frame), &want);
    println!("gsplat: {error:.1e}");
    assert!(error <= 1e-5, "gsplat's image is off by {error:.2e}");
}
