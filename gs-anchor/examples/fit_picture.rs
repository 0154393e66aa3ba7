//! Fits anchors to one image: `cargo run --release -p gs-anchor --example fit_picture [out.ppm]`.
//!
//! Points on a sphere become anchors; the visible ones are decoded to Gaussians and rendered. The gradient of the
//! squared error to a target image goes back to the networks, features, offsets and scales. Sixty sign-descent steps
//! show the error fall; `gs-train` has the real optimizer.

use glam::{DVec3, Vec3};
use gs_anchor::{
    AnchorInit, AnchorShape, DecodeTape, Decoder, DecoderConfig, LocalAnchors, LocalAnchorsGrad, VisibilityOptions,
    Visible,
};
use gs_anchor::{anchors_from_points, visible};
use gs_core::{Camera, Params, Rng, Splats};
use gs_raster::{Frame, FrameGrad, RasterOptions, Workspace, render, render_backward};

const STEPS: usize = 60;
/// Step length of the sign descent.
const RATE: f32 = 2e-3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let points: Vec<Vec3> = (0..20_000).map(|row| 0.5 * on_sphere(row)).collect();
    let shape = AnchorShape { offsets: 5, features: 16, dynamics: 0 };
    let start = anchors_from_points(&points, shape, &AnchorInit { voxel: 0.04, ..AnchorInit::default() })?;
    let (mut anchors, mut decoder) = (start.anchors, Decoder::new(&DecoderConfig::default(), shape, 1)?);
    let camera = Camera::look_at(128, 128, 0.8, DVec3::new(0.8, 0.4, -1.2), DVec3::ZERO, DVec3::Y)?;
    let target = target(&camera);

    let (mut local, mut tape, mut splats) = (LocalAnchors::default(), DecodeTape::default(), Splats::default());
    let (mut d_local, mut seen, mut workspace) = (LocalAnchorsGrad::default(), Vec::new(), Workspace::new());
    let mut frame = Frame::default();
    for step in 0..=STEPS {
        anchors.activate(&mut local);
        visible::conservative(&local, &camera, &VisibilityOptions::default(), &mut seen);
        decoder.forward(&local, Visible::List(&seen), camera.position(), &mut tape, &mut splats);
        frame = render(&splats, &camera, &RasterOptions::default(), &mut workspace);
        let error: Vec<f32> = frame.rgb.data.iter().zip(&target).map(|(p, t)| p - t).collect();
        if step % 20 == 0 {
            let mse = error.iter().map(|e| f64::from(e * e)).sum::<f64>() / error.len() as f64;
            let (all, some, n) = (anchors.len(), seen.len(), splats.len());
            println!("step {step:2}: {some} of {all} anchors, {n} Gaussians, PSNR {:.2} dB", -10.0 * mse.log10());
        }
        let d_frame = FrameGrad { rgb: error, ..FrameGrad::default() };
        let (d_splats, _) = render_backward(&splats, &camera, &RasterOptions::default(), &mut workspace, &d_frame);
        d_local.reset(&local);
        decoder.backward(&local, &mut tape, &d_splats, &mut d_local);
        anchors.activate_backward(&local, &d_local);
        anchors.visit_mut(&mut descend);
        decoder.visit_mut(&mut descend);
    }
    match std::env::args().nth(1) {
        Some(path) => write_ppm(&frame, path.as_ref()),
        None => Ok(()),
    }
}

/// One step against the sign of the gradient; positions are not trained.
fn descend(p: &mut gs_core::Param) {
    if p.name != "anchors.positions" {
        p.value.iter_mut().zip(&p.grad).for_each(|(v, g)| *v -= if *g == 0.0 { 0.0 } else { RATE * g.signum() });
    }
    p.clear_grad();
}

fn on_sphere(row: u64) -> Vec3 {
    let mut rng = Rng::new(1, "sphere", 0, row);
    Vec3::new(rng.normal(), rng.normal(), rng.normal()).normalize_or(Vec3::X)
}

/// Target image: a sphere coloured by its normals over black, by ray casting.
fn target(camera: &Camera) -> Vec<f32> {
    let eye = camera.position();
    let mut rgb = Vec::new();
    for (y, x) in (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (y, x))) {
        let ray = camera.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
        let (along, miss) = (-eye.dot(ray), 0.25 - eye.length_squared() + eye.dot(ray).powi(2));
        let normal = 2.0 * (eye + ray * (along - miss.max(0.0).sqrt()));
        rgb.extend(if miss > 0.0 { (normal * 0.5 + 0.5).as_vec3().to_array() } else { [0.0; 3] });
    }
    rgb
}

/// Writes a portable pixmap.
fn write_ppm(frame: &Frame, path: &std::path::Path) -> Result<(), Box<dyn std::error::Error>> {
    let mut bytes = format!("P6\n{} {}\n255\n", frame.rgb.width, frame.rgb.height).into_bytes();
    bytes.extend(frame.rgb.data.iter().map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8));
    Ok(std::fs::write(path, bytes)?)
}
