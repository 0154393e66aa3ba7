//! Gradients of the camera: closed forms of one splat, motions of the camera against those of all splats, the border where
//! the Jacobian is clamped, and the same bits from any number of threads.
//!
//! | what | tolerance | why |
//! |---|---|---|
//! | closed forms over the image plane | 2e-3 | pixel sums meet integrals up to pixels on the edge at 1/255 |
//! | the same of a splat of two pixels | 2e-2 | its edge is a larger share |
//! | motion of the camera against splats | 1e-5 of the sum of magnitudes | gradients of splats are rounded to f32 |

use crate::common;
use glam::{DMat3, DVec3, Vec3};
use gs_core::{Camera, Color, Kernel, Splats, SplatsGrad, rot, sh};
use gs_raster::{
    CameraGrad, FrameGrad, RasterOptions, ScreenStats, SimdLevel, Workspace, render, render_backward_with_camera,
};
use std::f64::consts::TAU;

const SIDE: u32 = 160;
const FOCAL: f64 = 100.0;
const DEPTH: f64 = 2.0;
const SCALE: f64 = 0.2;
const OPACITY: f64 = 0.8;
const DILATION: f64 = 0.3;

/// At the origin, along +z.
fn camera() -> Camera {
    let half = 0.5 * f64::from(SIDE);
    let (rotation, translation) = (DMat3::IDENTITY, DVec3::ZERO);
    Camera { width: SIDE, height: SIDE, fx: FOCAL, fy: FOCAL, cx: half, cy: half, rotation, translation }
}

/// A round splat on the optical axis.
fn splat(color: Color) -> Splats {
    Splats {
        means: vec![Vec3::new(0.0, 0.0, DEPTH as f32)],
        quats: vec![[1.0, 0.0, 0.0, 0.0]],
        scales: vec![Vec3::splat(SCALE as f32)],
        opacities: vec![OPACITY as f32],
        color,
        kernel: Kernel::Gaussian,
    }
}

fn both(splats: &Splats, camera: &Camera, options: &RasterOptions, d: &FrameGrad) -> (SplatsGrad, CameraGrad) {
    let mut workspace = Workspace::new();
    let _ = render(splats, camera, options, &mut workspace);
    let (mut grad, mut stats) = (SplatsGrad::default(), ScreenStats::default());
    let camera_grad = render_backward_with_camera(splats, camera, options, &mut workspace, d, &mut grad, &mut stats);
    (grad, camera_grad)
}

fn ones(per_pixel: usize) -> Vec<f32> {
    vec![1.0; per_pixel * (SIDE * SIDE) as usize]
}

fn near(what: &str, got: f64, want: f64, scale: f64) {
    assert!((got - want).abs() <= 2e-3 * scale, "{what}: {got}, closed form {want}");
}

/// Variance on the screen before dilation, its slope in depth, and the sums over pixels of `g` and of `dα/dΣ'` of a round
/// splat of opacity `o` and variance `v`, where `α > 1/255`: the share `τ = 1/(255 o)` of the mass of a Gaussian lies
/// below `g = τ`, and `Σ α q/2v` over the rest is `2π (o (1 − τ) − ln(1/τ)/255)`.
fn variance() -> (f64, f64) {
    let v = (FOCAL * SCALE / DEPTH).powi(2);
    (v, -2.0 * v / DEPTH)
}
fn mass(v: f64, o: f64) -> f64 {
    TAU * v * (1.0 - 1.0 / (255.0 * o))
}
fn mass_slope(o: f64) -> f64 {
    TAU * (o - 1.0 / 255.0 - (255.0 * o).ln() / 255.0)
}

/// `L = Σ α`: a shift along the axis changes the size of the ellipse, a focal length its width or height, and nothing else
/// matters.
#[test]
fn alpha_of_one_splat_has_the_closed_form() {
    let white = splat(Color::Rgb(vec![[1.0; 3]]));
    let d = FrameGrad { alpha: ones(1), ..FrameGrad::default() };
    let (_, grad) = both(&white, &camera(), &RasterOptions::default(), &d);
    let (v, v_z) = variance();
    let along = mass_slope(OPACITY) * v_z;
    near("shift along z", grad.viewmat[2][3], along, along.abs());
    // √(Σ'xx Σ'yy) changes by half of what Σ'xx does.
    let per_focal = mass_slope(OPACITY) * v / FOCAL;
    near("fx", grad.fx, per_focal, per_focal);
    near("fy", grad.fy, per_focal, per_focal);
    let turn = grad.twist(&camera());
    for (what, value) in [("cx", grad.cx), ("cy", grad.cy), ("shift x", turn[3]), ("shift y", turn[4])] {
        near(what, value, 0.0, mass(v, OPACITY) * FOCAL / DEPTH * 1e-2);
    }
    for (axis, value) in turn[..3].iter().enumerate() {
        near(&format!("turn {axis}"), *value, 0.0, mass(v, OPACITY) * FOCAL * 1e-2);
    }
}

/// `L = Σ α`: with anti-aliasing the opacity falls with the size, `o' = o v / (v + dilation)`.
#[test]
fn anti_aliased_opacity_has_the_closed_form() {
    let mut small = splat(Color::Rgb(vec![[1.0; 3]]));
    small.scales = vec![Vec3::splat(0.04)];
    let v = (FOCAL * 0.04 / DEPTH).powi(2);
    let v_z = -2.0 * v / DEPTH;
    let dilated = v + DILATION;
    let o = OPACITY * v / dilated;
    let d = FrameGrad { alpha: ones(1), ..FrameGrad::default() };
    let options = RasterOptions { antialias: true, ..RasterOptions::default() };
    let (_, grad) = both(&small, &camera(), &options, &d);
    let o_v = OPACITY * DILATION / (dilated * dilated);
    let along = (mass_slope(o) + mass(dilated, o) * o_v) * v_z;
    near("shift along z", grad.viewmat[2][3], along, 10.0 * along.abs());
    assert!(grad.viewmat[2][3] < 1.02 * mass_slope(o) * v_z, "the opacity factor counts");
}

/// `L = Σ x α`: the centre of the splat times its mass, whichever way the centre is moved.
#[test]
fn the_centre_of_one_splat_moves_with_the_camera() {
    let white = splat(Color::Rgb(vec![[1.0; 3]]));
    let columns = (0..SIDE * SIDE).map(|i| (i % SIDE) as f32 + 0.5 - 0.5 * SIDE as f32).collect();
    let d = FrameGrad { alpha: columns, ..FrameGrad::default() };
    let (_, grad) = both(&white, &camera(), &RasterOptions::default(), &d);
    // ∂α/∂u is taken where α > 1/255: the mass less what the moving edge carries, which has the form of the slope above.
    let (v, _) = variance();
    let per_pixel = mass_slope(OPACITY) * (v + DILATION);
    near("cx", grad.cx, per_pixel, per_pixel);
    near("cy", grad.cy, 0.0, per_pixel);
    let [about_x, about_y, about_z, x, y, _] = grad.twist(&camera());
    near("turn about y", about_y, FOCAL * per_pixel, FOCAL * per_pixel);
    near("shift x", x, FOCAL / DEPTH * per_pixel, FOCAL / DEPTH * per_pixel);
    for (what, value) in [("turn about x", about_x), ("turn about z", about_z), ("shift y", y)] {
        near(what, value, 0.0, FOCAL * per_pixel);
    }
}

/// `L = Σ depth = Σ α z`.
#[test]
fn depth_of_one_splat_has_the_closed_form() {
    let white = splat(Color::Rgb(vec![[1.0; 3]]));
    let d = FrameGrad { depth: ones(1), ..FrameGrad::default() };
    let (_, grad) = both(&white, &camera(), &RasterOptions::default(), &d);
    let (v, v_z) = variance();
    let along = OPACITY * mass(v + DILATION, OPACITY) + DEPTH * mass_slope(OPACITY) * v_z;
    near("shift along z", grad.viewmat[2][3], along, OPACITY * mass(v, OPACITY));
}

/// `L = Σ rgb`: seen from aside, the colour of degree 1 changes. At +z its x coefficient enters as `−C1 x`.
#[test]
fn colours_change_with_the_camera_centre() {
    let mut coeffs = vec![0.0; 12];
    coeffs[9..].fill(0.3);
    let d = FrameGrad { rgb: ones(3), ..FrameGrad::default() };
    let (_, grad) = both(&splat(Color::Sh { degree: 1, coeffs }), &camera(), &RasterOptions::default(), &d);
    let (v, _) = variance();
    let c1 = sh::basis([1.0f64, 0.0, 0.0], 1)[3];
    let want = 3.0 * OPACITY * mass(v + DILATION, OPACITY) * c1 * 0.3 / DEPTH;
    let [about_x, about_y, about_z, x, y, _] = grad.twist(&camera());
    near("shift x", x, want, want.abs());
    // A turn leaves the centre of the camera where it is, and the sum of the image does not notice it.
    for (what, value) in [("about x", about_x), ("about y", about_y), ("about z", about_z), ("shift y", y)] {
        near(what, value, 0.0, want.abs());
    }
}

/// Moving the camera is moving every splat the other way: with colours that do not depend on the view, the twist is the
/// sum of what the same motion of means and rotations gives.
#[test]
fn a_motion_of_the_camera_is_one_of_all_splats() {
    let mut checked = 0;
    for seed in 0..64 {
        let mut case = common::case(seed, 60);
        let width = case.splats.color.width();
        let flat = case.splats.color.as_flat();
        case.splats.color = Color::Rgb(flat.chunks_exact(width).map(|c| [c[0], c[1], c[2]]).collect());
        // A quaternion of zeros stands for the identity, and nothing turns it.
        case.splats.quats.iter_mut().filter(|q| **q == [0.0; 4]).for_each(|q| q[0] = 1.0);
        let n = (case.camera.width * case.camera.height) as usize;
        let d = FrameGrad {
            rgb: common::weights(seed, 3 * n),
            alpha: common::weights(seed + 1, n),
            depth: common::weights(seed + 2, n),
        };
        let options = RasterOptions { antialias: seed % 3 == 0, ..RasterOptions::default() };
        let (grad, camera_grad) = both(&case.splats, &case.camera, &options, &d);
        let (mut want, mut magnitude) = ([0.0; 6], [0.0; 6]);
        for i in 0..case.splats.len() {
            let t = case.camera.to_camera(case.splats.means[i].as_dvec3());
            let shift = case.camera.rotation * grad.means[i].as_dvec3();
            let turned = case.camera.rotation * quaternion_turn(case.splats.quats[i], grad.quats[i]);
            let part = [t.cross(shift) + turned, shift];
            let sizes = [t.abs().element_sum() * shift.abs().element_sum() + turned.abs().element_sum(); 3];
            for k in 0..6 {
                want[k] += part[k / 3][k % 3];
                magnitude[k] += if k < 3 { sizes[k] } else { shift.abs().element_sum() };
            }
        }
        let got = camera_grad.twist(&case.camera);
        for k in 0..6 {
            checked += usize::from(want[k] != 0.0);
            let error = (got[k] - want[k]).abs();
            assert!(error <= 1e-5 * magnitude[k], "scene {seed} ({}), entry {k}: {} {}", case.kind, got[k], want[k]);
        }
    }
    assert!(checked > 250, "{checked} entries that are not zero");
}

/// Cotangent of a world-space turn `ω` of the splat: its quaternion moves by `½ (0, ω) ⊗ q`.
fn quaternion_turn(q: [f32; 4], d: [f32; 4]) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|axis| {
        let mut unit = [0.0; 4];
        unit[1 + axis] = 0.5;
        let moved = rot::hamilton(unit, q.map(f64::from));
        moved.iter().zip(d).map(|(m, d)| m * f64::from(d)).sum()
    }))
}

/// `twist` is the derivative along [`Camera::moved`], on top of any pose.
#[test]
fn the_twist_is_the_slope_along_moved() {
    let base = common::case(8, 1).camera;
    let grad = CameraGrad {
        viewmat: [[0.3, -1.0, 2.0, 0.5], [1.5, 0.2, -0.7, -1.0], [0.1, 0.9, 0.4, 2.0]],
        ..CameraGrad::default()
    };
    let linear = |c: &Camera| {
        let rows = c.rotation.transpose().to_cols_array_2d();
        (0..3)
            .map(|r| {
                (0..3).map(|k| grad.viewmat[r][k] * rows[r][k]).sum::<f64>() + grad.viewmat[r][3] * c.translation[r]
            })
            .sum::<f64>()
    };
    for (k, slope) in grad.twist(&base).into_iter().enumerate() {
        let at = |h: f64| {
            let mut step = [0.0; 6];
            step[k] = h;
            let [a, b, c, x, y, z] = step;
            linear(&base.moved(DVec3::new(a, b, c), DVec3::new(x, y, z)))
        };
        let numeric = (at(1e-5) - at(-1e-5)) / 2e-5;
        assert!((numeric - slope).abs() < 1e-8, "entry {k}: {slope} {numeric}");
    }
}

/// Beyond the border by more than 0.3 of half the image the Jacobian's ratio is held: there the shape of the ellipse follows
/// the principal point, and no longer the place of the splat.
#[test]
fn the_clamped_border_moves_with_the_principal_point() {
    let mut wide = splat(Color::Rgb(vec![[1.0; 3]]));
    // x/z = 1.2, clamped to (SIDE/2 + 0.15 SIDE)/f = 1.04.
    (wide.means[0].x, wide.scales[0]) = (1.2 * DEPTH as f32, Vec3::splat(0.5));
    let d = FrameGrad { alpha: common::weights(0, (SIDE * SIDE) as usize), ..FrameGrad::default() };
    let smooth = RasterOptions { min_alpha: 1e-6, stop: 0.0, ..RasterOptions::default() };
    let (_, grad) = both(&wide, &camera(), &smooth, &d);
    let loss = |c: &Camera| {
        use gs_raster::reference::{Cutoff, Scene, render};
        let frame = render(&Scene::<f64>::new(&wide), c, &smooth, Cutoff::Hard);
        frame.alpha.iter().zip(&d.alpha).map(|(a, w)| a * f64::from(*w)).sum::<f64>()
    };
    let slope = |field: fn(&mut Camera) -> &mut f64| {
        let at = |h: f64| {
            let mut c = camera();
            *field(&mut c) += h;
            loss(&c)
        };
        (at(1e-4) - at(-1e-4)) / 2e-4
    };
    for (what, got, want) in [
        ("cx", grad.cx, slope(|c| &mut c.cx)),
        ("cy", grad.cy, slope(|c| &mut c.cy)),
        ("fx", grad.fx, slope(|c| &mut c.fx)),
        ("x", grad.viewmat[0][3], slope(|c| &mut c.translation.x)),
        ("z", grad.viewmat[2][3], slope(|c| &mut c.translation.z)),
    ] {
        assert!((got - want).abs() < 1e-3 * want.abs().max(0.1), "{what}: {got} {want}");
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let (splats, camera) = (gs_raster::measure::scene(6000, 2), gs_raster::measure::camera(150));
    let d = FrameGrad { rgb: common::weights(1, 3 * 150 * 150), ..FrameGrad::default() };
    for simd in [SimdLevel::Auto, SimdLevel::Portable] {
        let options = RasterOptions { simd, ..RasterOptions::default() };
        let bits = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| both(&splats, &camera, &options, &d).1.to_array().map(f64::to_bits))
        };
        let one = bits(1);
        for threads in [2, 3, 8] {
            assert_eq!(bits(threads), one, "{threads} threads, {simd:?}");
        }
    }
}

/// A view of nothing has no gradient.
#[test]
fn an_empty_view_has_no_gradient() {
    let mut behind = splat(Color::Rgb(vec![[1.0; 3]]));
    behind.means[0].z = -1.0;
    let d = FrameGrad { alpha: ones(1), ..FrameGrad::default() };
    assert_eq!(both(&behind, &camera(), &RasterOptions::default(), &d).1, CameraGrad::default());
    assert_eq!(both(&Splats::default(), &camera(), &RasterOptions::default(), &d).1, CameraGrad::default());
}
