//! Images and gradients of independent renderers (`tests/golden`, see its README for their origin and format).
//!
//! | what | tolerance |
//! |---|---|
//! | f64 reference against numpy, images and gradients | 1e-10, relative to the largest entry of each array |
//! | f32 production against numpy, images | 2e-5 |
//! | f32 production against numpy, gradients | relative L2 1e-4 (1e-3 anti-aliased) |
//! | both against gsplat's CUDA image (f32) | 1e-5 |

use crate::common::golden::{
    COLUMNS, SCENES, check_gsplat, check_scenes, gsplat_scene, load, max_error, raw_gradients, relative_max, variants,
};
use gs_raster::Workspace;
use gs_raster::reference::{
    Cutoff, Frame as ReferenceFrame, render as reference, render_backward as reference_backward,
};

fn reference_rgba(frame: &ReferenceFrame<f64>) -> Vec<f64> {
    frame.rgb.iter().zip(&frame.alpha).flat_map(|(c, a)| [c[0], c[1], c[2], *a]).collect()
}

#[test]
fn reference_reproduces_golden_images_and_gradients() {
    for name in SCENES {
        let g = load(name);
        for (suffix, options) in variants(name) {
            let check = |key: String, got: &[f64]| {
                let error = relative_max(got, &g.file.values(&key));
                println!("{name}: {key} {error:.1e}");
                assert!(error <= 1e-10, "{name}: {key} is off by {error:.2e}");
            };
            let frame = reference(&g.scene, &g.camera, &options, Cutoff::Hard);
            check(format!("image{suffix}"), &reference_rgba(&frame));
            let d: Vec<_> = g.weights.as_chunks().0.iter().map(|&[r, g, b, a]| ([r, g, b], a, 0.0)).collect();
            let (grad, _, _) = reference_backward(&g.scene, &g.camera, &options, Cutoff::Hard, &d);
            for (column, got) in COLUMNS.iter().zip(raw_gradients(&g.scene, &grad)) {
                check(format!("grad{suffix}_{column}"), &got);
            }
        }
    }
}

#[test]
fn production_reproduces_golden_images_and_gradients() {
    check_scenes(&mut Workspace::new());
}

#[test]
fn matches_gsplat_on_its_basic_scene() {
    check_gsplat(&mut Workspace::new());
    let (scene, camera, options, want) = gsplat_scene();
    let exact = max_error(&reference_rgba(&reference(&scene, &camera, &options, Cutoff::Hard)), &want);
    println!("gsplat: reference {exact:.1e}");
    assert!(exact <= 1e-5, "reference {exact:.2e}");
}
