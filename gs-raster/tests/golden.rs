//! Golden images and gradients in f64 (independent of this code), where they are present.
//!
//! | what | tolerance |
//! |---|---|
//! | f64 reference, images and gradients | 1e-10, relative to the largest entry of each array |
//! | f32 production, images, classic | 2e-5 off the cutoff band |
//! | f32 production, gradients | relative L2 1e-4 (1e-3 anti-aliased) |
//! | gsplat's CUDA image (f32) | 1e-5 |

mod common;

use glam::Vec3;
use gs_core::io::{Limits, RawSplats, load_cameras, load_splats, npy};
use gs_core::testkit::shared;
use gs_core::{Camera, Color, Kernel, Splats};
use gs_raster::reference::{Cutoff, Form, Scene, render as reference, render_backward as reference_backward};
use gs_raster::{FrameGrad, RasterOptions, Workspace, render, render_backward};
use std::path::Path;

const SCENES: [&str; 6] = ["g1_single", "g2_random2000", "g3_needles", "g4_nearplane", "g5_stack", "g6_quats_huge"];

struct Golden {
    raw: RawSplats,
    scene: Scene<f64>,
    camera: Camera,
    weights: Vec<f64>,
}

fn array(dir: &Path, name: &str) -> Vec<f64> {
    let bytes = std::fs::read(dir.join(name)).expect("golden array");
    npy::read(&bytes, name, &Limits::default()).expect("a readable array").to_f64()
}

fn load(dir: &Path) -> Golden {
    let limits = Limits::default();
    let raw = load_splats(&dir.join("scene.ply"), &limits).expect("golden splats");
    let wide3 = |v: &Vec3| v.to_array().map(f64::from);
    let scene = Scene {
        means: raw.means.iter().map(wide3).collect(),
        quats: raw.quats.iter().map(|q| q.map(f64::from)).collect(),
        scales: raw.log_scales.iter().map(|s| wide3(s).map(f64::exp)).collect(),
        opacities: raw.logit_opacities.iter().map(|&o| 1.0 / (1.0 + (-f64::from(o)).exp())).collect(),
        color: raw.sh.iter().map(|&c| f64::from(c)).collect(),
        degree: Some(raw.degree),
        kernel: Vec::new(),
        form: Form::Gaussian,
    };
    let camera = load_cameras(&dir.join("camera.json"), &limits).expect("golden camera").remove(0).camera;
    Golden { raw, scene, camera, weights: array(dir, "W.npy") }
}

fn scenes() -> Vec<(&'static str, std::path::PathBuf)> {
    SCENES.iter().filter_map(|name| Some((*name, shared(&format!("golden/{name}"))?))).collect()
}

/// Largest difference relative to the largest entry.
fn worst(got: &[f64], want: &[f64]) -> f64 {
    assert_eq!(got.len(), want.len());
    let scale = want.iter().fold(1e-300f64, |m, v| m.max(v.abs()));
    got.iter().zip(want).fold(0.0f64, |m, (a, b)| m.max((a - b).abs())) / scale
}

fn relative_l2(got: &[f64], want: &[f64]) -> f64 {
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
    let w = norm(&mut want.iter().copied());
    norm(&mut got.iter().zip(want).map(|(a, b)| a - b)) / w.max(1e-300)
}

fn rgba(frame: &gs_raster::reference::Frame<f64>) -> Vec<f64> {
    frame.rgb.iter().zip(&frame.alpha).flat_map(|(c, a)| [c[0], c[1], c[2], *a]).collect()
}

/// Gradients of the raw parameters (log-scales, logits) from those of the activated ones.
fn raw_gradients(g: &Golden, d: &Scene<f64>) -> [(&'static str, Vec<f64>); 5] {
    let scales = d.scales.as_flattened().iter().zip(g.scene.scales.as_flattened()).map(|(d, s)| d * s);
    let logits = d.opacities.iter().zip(&g.scene.opacities).map(|(d, o)| d * o * (1.0 - o));
    [
        ("means", d.means.as_flattened().to_vec()),
        ("quats", d.quats.as_flattened().to_vec()),
        ("log_scales", scales.collect()),
        ("logits", logits.collect()),
        ("sh", d.color.clone()),
    ]
}

#[test]
fn reference_reproduces_golden_images_and_gradients() {
    for (name, dir) in scenes() {
        let g = load(&dir);
        for (antialias, max_alpha, suffix) in [(false, 0.99, ""), (true, 0.99, "_aa"), (false, 0.999, "_a999")] {
            let options = RasterOptions { antialias, max_alpha, ..Default::default() };
            let frame = reference(&g.scene, &g.camera, &options, Cutoff::Hard);
            let error = worst(&rgba(&frame), &array(&dir, &format!("image{suffix}.npy")));
            println!("{name}{suffix}: image {error:.1e}");
            assert!(error <= 1e-10, "{name}{suffix}: image off by {error:.2e}");
            if suffix == "_a999" {
                continue;
            }
            let d: Vec<_> = g.weights.chunks_exact(4).map(|w| ([w[0], w[1], w[2]], w[3], 0.0)).collect();
            let (grad, _) = reference_backward(&g.scene, &g.camera, &options, Cutoff::Hard, &d);
            for (kind, got) in raw_gradients(&g, &grad) {
                let file = format!("grad{suffix}_{kind}.npy");
                let error = worst(&got, &array(&dir, &file));
                println!("{name}{suffix}: {kind} {error:.1e}");
                assert!(error <= 1e-10, "{name}{suffix}: {kind} off by {error:.2e}");
            }
        }
    }
}

#[test]
fn production_reproduces_golden_images_and_gradients() {
    for (name, dir) in scenes() {
        let g = load(&dir);
        let splats = g.raw.to_splats().expect("legal splats");
        for (antialias, suffix, limit) in [(false, "", 1e-4), (true, "_aa", 1e-3)] {
            let options = RasterOptions { antialias, ..Default::default() };
            let mut workspace = Workspace::new();
            let frame = render(&splats, &g.camera, &options, &mut workspace);
            let margin = reference(&g.scene, &g.camera, &options, Cutoff::Hard).margin;
            let want = array(&dir, &format!("image{suffix}.npy"));
            let error = (0..margin.len()).filter(|&i| margin[i] > 1e-5).fold(0.0f64, |m, i| {
                let alpha = (f64::from(frame.alpha[i]) - want[4 * i + 3]).abs();
                (0..3).fold(m.max(alpha), |m, c| m.max((f64::from(frame.rgb[3 * i + c]) - want[4 * i + c]).abs()))
            });
            println!("{name}{suffix}: image {error:.1e}");
            assert!(error <= 2e-5, "{name}{suffix}: image off by {error:.2e}");
            let w = |k: usize| g.weights[k] as f32;
            let n = margin.len();
            let d = FrameGrad {
                rgb: (0..3 * n).map(|k| w(4 * (k / 3) + k % 3)).collect(),
                alpha: (0..n).map(|i| w(4 * i + 3)).collect(),
                depth: Vec::new(),
            };
            let (grad, _) = render_backward(&splats, &g.camera, &options, &mut workspace, &d);
            let mut wide = g.scene.zeros_like();
            wide.means = grad.means.iter().map(|v| v.to_array().map(f64::from)).collect();
            wide.quats = grad.quats.iter().map(|v| v.map(f64::from)).collect();
            wide.scales = grad.scales.iter().map(|v| v.to_array().map(f64::from)).collect();
            wide.opacities = grad.opacities.iter().map(|&v| f64::from(v)).collect();
            wide.color = grad.color.iter().map(|&v| f64::from(v)).collect();
            for (kind, got) in raw_gradients(&g, &wide) {
                let error = relative_l2(&got, &array(&dir, &format!("grad{suffix}_{kind}.npy")));
                println!("{name}{suffix}: {kind} {error:.1e}");
                assert!(error <= limit, "{name}{suffix}: {kind} off by {error:.2e}");
            }
        }
    }
}

#[test]
fn matches_gsplat_on_its_basic_scene() {
    let Some(path) = shared("data/gsplat_reference_render_basic/basic_case.safetensors") else { return };
    let bytes = std::fs::read(path).expect("reference case");
    let file = safetensors::SafeTensors::deserialize(&bytes).expect("safetensors");
    let floats = |name: &str| -> Vec<f32> {
        let data = file.tensor(name).expect("tensor").data().to_vec();
        data.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
    };
    let vec3 = |v: &[f32]| v.as_chunks::<3>().0.iter().map(|&c| Vec3::from_array(c)).collect::<Vec<_>>();
    let log_scales = floats("scales");
    let splats = Splats {
        means: vec3(&floats("means")),
        quats: floats("quats").as_chunks::<4>().0.to_vec(),
        scales: vec3(&log_scales.iter().map(|s| s.exp()).collect::<Vec<_>>()),
        opacities: floats("opacities").iter().map(|o| 1.0 / (1.0 + (-o).exp())).collect(),
        color: Color::Sh { degree: 3, coeffs: floats("coeffs") },
        kernel: Kernel::Gaussian,
    };
    let camera = Camera {
        width: 123,
        height: 82,
        fx: 61.5,
        fy: 61.5,
        cx: 61.5,
        cy: 41.0,
        rotation: glam::DMat3::IDENTITY,
        translation: glam::DVec3::new(-0.123, -0.456, 8.0),
    };
    let options = RasterOptions { max_alpha: 0.999, ..Default::default() };
    let frame = render(&splats, &camera, &options, &mut Workspace::new());
    let exact = reference(&Scene::<f64>::new(&splats), &camera, &options, Cutoff::Hard);
    let want = floats("out_img");
    let (mut ours, mut theirs) = (0.0f32, 0.0f64);
    for (i, w) in want.chunks_exact(4).enumerate() {
        for (c, &value) in w[..3].iter().enumerate() {
            ours = ours.max((frame.rgb[3 * i + c] - value).abs());
            theirs = theirs.max((exact.rgb[i][c] - f64::from(value)).abs());
        }
        ours = ours.max((frame.alpha[i] - w[3]).abs());
        theirs = theirs.max((exact.alpha[i] - f64::from(w[3])).abs());
    }
    println!("gsplat: production {ours:.1e}, reference {theirs:.1e}");
    assert!(ours <= 1e-5 && theirs <= 1e-5, "production {ours:.2e}, reference {theirs:.2e}");
}
