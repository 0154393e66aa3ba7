//! Texel Gaussians: layout, analytic truths, gradients against differences in `f64`, `f32` against `f64`, what is left out and
//! what that costs.
//!
//! | what | tolerance |
//! |---|---|
//! | gradient of a row in `f64` against central differences | 1e-5 of the largest entry |
//! | `f32` rows against `f64` ones, polar | 1e-5 of the largest entry |
//! | `f32` rows against `f64` ones, affine | 1e-4 (differences of standard deviations are divided by) |
//! | pictures about the root against pictures in the world | 2e-5 |

use glam::{Affine3A, DAffine3, DMat3, DQuat, DVec3, Mat3A, Quat, Vec2, Vec3};
use gs_core::rot::{self, Mat3};
use gs_core::{Camera, Color, Image, Rng, Splats, SplatsGrad, covariance};
use gs_raster::{RasterOptions, Workspace, render};
use gs_texel::gaussians::merge::{MergeOptions, merge};
use gs_texel::gaussians::row::{self, Base, Gaussian};
use gs_texel::gaussians::thin::{ThinOptions, select, worth_drawing};
use gs_texel::gaussians::{
    BaseError, Channels, ChannelsError, Covariance, DecodeOptions, TexelBase, about, camera_about, decode,
    decode_backward, offset_penalty, warm_up,
};
use gs_texel::texels::{TexelOptions, TexelTable};

const DIFFERENCE: f64 = 1e-5;
const BOTH: [Covariance; 2] = [Covariance::Polar, Covariance::Affine];
const RANGE: [f64; 2] = [-11.5, -0.7];
const WIDTH: usize = 23;

fn channels() -> Channels {
    Channels::new(1).unwrap()
}

/// The unit square as two triangles: every texel of a `size × size` map is valid.
fn square(size: usize) -> (Vec<Vec3>, Vec<[u32; 3]>, TexelTable) {
    let corners = [Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::ONE];
    let faces = vec![[0, 1, 2], [1, 3, 2]];
    let table = TexelTable::build(&faces, &corners, &faces, size, &TexelOptions::default()).unwrap();
    (corners.map(|p| p.extend(0.0)).to_vec(), faces, table)
}

/// The square at rest, as base maps.
fn at_rest(size: usize) -> (TexelTable, TexelBase) {
    let (points, faces, table) = square(size);
    let (still, turns) = (vec![Affine3A::IDENTITY; 4], vec![[1.0, 0.0, 0.0, 0.0]; 4]);
    let base = TexelBase::new(&table, &faces, &points, &still, &turns, &[1.0; 4]).unwrap();
    (table, base)
}

/// Rows of an opaque sheet whose colour is a slow wave of amplitude `wave`.
fn painted(base: &TexelBase, size: usize, wave: f32) -> Vec<f32> {
    let shade = |p: &Vec3| {
        let at = |f: f32, x: f32| 0.5 + wave * (f * x).sin();
        [at(7.0, p.x), at(9.0, p.y), at(5.0, p.x + p.y)]
    };
    let colors: Vec<[f32; 3]> = base.points.iter().map(shade).collect();
    let normals = vec![Vec3::Z; base.len()];
    let mut rows = warm_up::targets(channels(), &colors, &base.points, &normals, [1e-5, 0.5]).unwrap();
    for row in rows.chunks_exact_mut(WIDTH) {
        row[0] = (0.02 / size as f32).ln();
        row[7] = 3.0;
    }
    rows
}

fn camera(eye: DVec3, target: DVec3) -> Camera {
    Camera::look_at(96, 96, 0.8, eye, target, DVec3::Y).unwrap()
}

fn facing() -> Camera {
    camera(DVec3::new(0.5, 0.5, 1.6), DVec3::new(0.5, 0.5, 0.0))
}

/// Nothing but the middle of the square.
fn close() -> Camera {
    camera(DVec3::new(0.5, 0.5, 0.5), DVec3::new(0.5, 0.5, 0.0))
}

fn picture(splats: &Splats, camera: &Camera) -> Vec<f32> {
    render(splats, camera, &RasterOptions::default(), &mut Workspace::default()).rgb
}

fn psnr(a: &[f32], b: &[f32]) -> f64 {
    let mse: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / a.len() as f64;
    -10.0 * mse.log10()
}

/// A row, a matrix that stretches and shears a little, and its rotation.
fn random_texel(seed: u64) -> (Vec<f64>, Base<f64>) {
    let mut rng = Rng::new(seed, "texel", 0, 0);
    let mut normal = || f64::from(rng.normal());
    let mut row: Vec<f64> = (0..WIDTH).map(|_| normal()).collect();
    (0..3).for_each(|i| row[i] = -3.0 + 0.7 * normal());
    (8..11).for_each(|i| row[i] *= 0.05);
    let turn = DQuat::from_xyzw(normal(), normal(), normal(), normal()).normalize();
    let shear = DMat3::from_cols_array(&std::array::from_fn(|i| f64::from(u8::from(i % 4 == 0)) + 0.2 * normal()));
    let linear = (DMat3::from_quat(turn) * shear).transpose().to_cols_array_2d();
    let turn = [turn.w, turn.x, turn.y, turn.z];
    let base = Base { point: [normal(), normal(), normal()], linear, shift: [1.0, 2.0, 3.0], turn, kappa: 1.3 };
    (row, base)
}

fn sigma(g: &Gaussian<f64>) -> [f64; 6] {
    let m = covariance::factor(&rot::matrix(rot::normalise(g.quat).wxyz), g.scale);
    covariance::covariance(&m)
}

/// A smooth function of a Gaussian as a shape (not of its quaternion), and its cotangents.
fn shape_loss(g: &Gaussian<f64>, w: &[f64; 10]) -> (f64, Gaussian<f64>) {
    let unit = rot::normalise(g.quat);
    let r = rot::matrix(unit.wxyz);
    let d_sigma: [f64; 6] = std::array::from_fn(|i| 100.0 * w[i]);
    let value = sigma(g).iter().zip(d_sigma).map(|(s, w)| s * w).sum::<f64>()
        + (0..3).map(|i| g.mean[i] * w[6 + i]).sum::<f64>()
        + g.opacity * w[9];
    let d_m = covariance::covariance_backward(&covariance::factor(&r, g.scale), d_sigma);
    let (d_r, scale) = covariance::factor_backward(&r, g.scale, &d_m);
    let quat = rot::normalise_backward(&unit, rot::matrix_backward(unit.wxyz, &d_r));
    (value, Gaussian { mean: [w[6], w[7], w[8]], quat, scale, opacity: w[9] })
}

#[test]
fn the_layout_has_23_channels_at_degree_1() {
    let widths = [0, 1, 2, 3].map(|d| Channels::new(d).unwrap().width());
    assert_eq!(widths, [14, 23, 38, 59]);
    assert_eq!(Channels::new(4), Err(ChannelsError::Degree(4)));
}

#[test]
fn rows_and_maps_hold_the_same() {
    let valid = [1u32, 3, 4, 8];
    let rows: Vec<f32> = (0..4 * WIDTH).map(|i| i as f32 + 1.0).collect();
    let map = channels().scatter(&rows, &valid, 3).unwrap();
    assert_eq!(map.shape(), (3, 3, WIDTH));
    assert_eq!(channels().gather(&map, &valid).unwrap(), rows);
    assert!(map.pixel(0, 0).iter().all(|v| *v == 0.0) && map.pixel(1, 0)[0] == 1.0);
    let e = channels().scatter(&rows, &[1, 3, 4, 9], 3).unwrap_err();
    assert_eq!(e, ChannelsError::Beyond { texel: 9, size: 3 });
    let e = channels().gather(&Image::zeros(3, 3, 14), &valid).unwrap_err();
    assert!(e.to_string().contains("(3, 3, 14)") && e.to_string().contains("(3, 3, 23)"), "{e}");
    assert!(matches!(channels().scatter(&rows[1..], &valid, 3), Err(ChannelsError::Length { want: 92, .. })));
}

#[test]
fn a_texel_at_rest_is_what_its_channels_say() {
    let mut row = vec![0.0f64; WIDTH];
    row[0] = -3.0;
    row[1] = -4.0;
    row[2] = -20.0;
    row[3] = 2.0;
    row[7] = 1.5;
    row[9] = 0.25;
    let linear = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
    let quarter = std::f64::consts::FRAC_1_SQRT_2;
    let turn = [quarter, 0.0, 0.0, quarter];
    let base = Base { point: [1.0, 2.0, 3.0], linear, shift: [10.0, 0.0, 0.0], turn, kappa: 2.0 };
    for mode in BOTH {
        let g = row::decode(&row, &base, mode, RANGE);
        assert!(g.mean.iter().zip([7.75, 1.0, 3.0]).all(|(a, b)| (a - b).abs() < 1e-15), "{mode:?}: {:?}", g.mean);
        assert!((g.opacity - 1.0 / (1.0 + (-1.5f64).exp())).abs() < 1e-15);
        // A quarter turn about z; σ along x stays with the texel's x, now the world's y.
        let want = [4.0 * (-8.0f64).exp(), 0.0, 0.0, 4.0 * (-6.0f64).exp(), 0.0, 4.0 * (-23.0f64).exp()];
        assert!(sigma(&g).iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-15), "{mode:?}: {:?}", sigma(&g));
    }
}

#[test]
fn affine_covariance_is_that_of_the_mapped_ellipsoid() {
    for seed in 0..50 {
        let (row, mut base) = random_texel(seed);
        if seed % 5 == 4 {
            // A mirrored and a flattened matrix.
            base.linear[2] = if seed % 2 == 0 { base.linear[2].map(|v| -v) } else { [0.0; 3] };
        }
        let g = row::decode(&row, &base, Covariance::Affine, RANGE);
        let unit = rot::normalise([row[3], row[4], row[5], row[6]]).wxyz;
        let scale: [f64; 3] = std::array::from_fn(|i| row[i].clamp(RANGE[0], RANGE[1]).exp() * base.kappa);
        let m = covariance::factor(&rot::matrix(unit), scale);
        let mapped: Mat3<f64> =
            std::array::from_fn(|r| std::array::from_fn(|c| (0..3).map(|k| base.linear[r][k] * m[k][c]).sum()));
        let want = covariance::covariance(&mapped);
        let largest = want.iter().fold(0.0f64, |a, b| a.max(b.abs()));
        let worst = sigma(&g).iter().zip(want).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-13 * largest, "{seed}: {worst:e} of {largest:e}");
        let length: f64 = g.quat.iter().map(|v| v * v).sum();
        assert!((length - 1.0).abs() < 1e-12);
    }
}

#[test]
fn both_modes_agree_where_the_surface_is_rigid() {
    for seed in 0..20 {
        let (row, mut base) = random_texel(seed);
        base.linear = rot::matrix(base.turn);
        let [a, b] = BOTH.map(|mode| sigma(&row::decode(&row, &base, mode, RANGE)));
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-15), "{a:?} {b:?}");
        // Also on the way back, even where all standard deviations are one.
        let mut round = row.clone();
        round[0..3].fill(-3.0);
        let d = Gaussian { mean: [0.0; 3], quat: [0.0; 4], scale: [1.0, 2.0, 3.0], opacity: 0.0 };
        let [a, b] = BOTH.map(|mode| {
            let mut grad = vec![0.0; WIDTH];
            row::backward(&round, &base, mode, RANGE, &d, &mut grad);
            grad
        });
        assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-12), "{a:?} {b:?}");
    }
}

#[test]
fn gradient_of_a_row_matches_differences() {
    let mut worst = [0.0f64; 2];
    for (slot, mode) in BOTH.into_iter().enumerate() {
        for seed in 0..40 {
            let (row, base) = random_texel(seed);
            let mut rng = Rng::new(seed, "weights", 0, 0);
            let w: [f64; 10] = std::array::from_fn(|_| f64::from(rng.normal()));
            let value = |row: &[f64], base: &Base<f64>| shape_loss(&row::decode(row, base, mode, RANGE), &w).0;
            let d = shape_loss(&row::decode(&row, &base, mode, RANGE), &w).1;
            let mut got = vec![0.0; WIDTH];
            let d_point = row::backward(&row, &base, mode, RANGE, &d, &mut got);
            let step = 1e-5;
            let want: Vec<f64> = (0..11)
                .map(|k| {
                    let (mut hi, mut lo) = (row.clone(), row.clone());
                    hi[k] += step;
                    lo[k] -= step;
                    (value(&hi, &base) - value(&lo, &base)) / (2.0 * step)
                })
                .collect();
            let largest = want.iter().fold(1e-3f64, |m, v| m.max(v.abs()));
            let error = got.iter().zip(&want).map(|(a, b)| (a - b).abs() / largest).fold(0.0, f64::max);
            worst[slot] = worst[slot].max(error);
            assert!(got[8..11].iter().zip(d_point).all(|(a, b)| *a == b), "an offset moves the point");
        }
    }
    println!("gradient against differences: polar {:.1e}, affine {:.1e}", worst[0], worst[1]);
    assert!(worst.iter().all(|w| *w < DIFFERENCE), "{worst:?}");
}

/// `f32` production against the `f64` reference, value and gradient.
#[test]
fn production_follows_the_reference() {
    let mut worst = [0.0f64; 2];
    for (slot, (mode, limit)) in BOTH.into_iter().zip([1e-5, 1e-4]).enumerate() {
        for seed in 0..40 {
            let (row, base) = random_texel(seed);
            let narrow: Vec<f32> = row.iter().map(|v| *v as f32).collect();
            let cast = |m: [f64; 3]| m.map(|v| v as f32);
            let single = Base {
                point: cast(base.point),
                linear: base.linear.map(cast),
                shift: cast(base.shift),
                turn: base.turn.map(|v| v as f32),
                kappa: base.kappa as f32,
            };
            let w: [f64; 10] = std::array::from_fn(|k| 0.3 + 0.1 * k as f64);
            let d = shape_loss(&row::decode(&row, &base, mode, RANGE), &w).1;
            let d_single = Gaussian {
                mean: cast(d.mean),
                quat: d.quat.map(|v| v as f32),
                scale: cast(d.scale),
                opacity: d.opacity as f32,
            };
            let (mut want, mut got) = (vec![0.0; WIDTH], vec![0.0f32; WIDTH]);
            row::backward(&row, &base, mode, RANGE, &d, &mut want);
            row::backward(&narrow, &single, mode, RANGE, &d_single, &mut got);
            let (a, b) = (row::decode(&row, &base, mode, RANGE), row::decode(&narrow, &single, mode, RANGE));
            let values = |a: &[f64], b: &[f32]| {
                let largest = a.iter().fold(1e-30f64, |m, v| m.max(v.abs()));
                a.iter().zip(b).map(|(a, b)| (a - f64::from(*b)).abs() / largest).fold(0.0, f64::max)
            };
            let wide = Gaussian {
                mean: b.mean.map(f64::from),
                quat: b.quat.map(f64::from),
                scale: b.scale.map(f64::from),
                opacity: f64::from(b.opacity),
            };
            let shapes = sigma(&wide).map(|v| v as f32);
            let error = values(&want, &got).max(values(&a.mean, &b.mean)).max(values(&sigma(&a), &shapes));
            assert!(error < limit, "{mode:?}, texel {seed}: {error:e}");
            worst[slot] = worst[slot].max(error);
        }
    }
    println!("f32 against f64: polar {:.1e}, affine {:.1e}", worst[0], worst[1]);
}

#[test]
fn log_scales_out_of_range_are_held_and_learn_nothing() {
    let (mut row, base) = random_texel(3);
    row[0..3].copy_from_slice(&[-50.0, 40.0, -3.0]);
    let g = row::decode(&row, &base, Covariance::Polar, RANGE);
    assert_eq!(g.scale[0], RANGE[0].exp() * base.kappa);
    assert_eq!(g.scale[1], RANGE[1].exp() * base.kappa);
    for mode in BOTH {
        let d = Gaussian { mean: [1.0; 3], quat: [1.0; 4], scale: [1.0; 3], opacity: 1.0 };
        let mut grad = vec![0.0; WIDTH];
        row::backward(&row, &base, mode, RANGE, &d, &mut grad);
        assert_eq!(grad[0..2], [0.0; 2], "{mode:?}");
        assert!(grad[2] != 0.0 && grad.iter().all(|v| v.is_finite()), "{mode:?}");
    }
}

#[test]
fn extreme_rows_stay_finite() {
    let base = TexelBase {
        points: vec![Vec3::ZERO; 4],
        transforms: vec![Affine3A::IDENTITY, Affine3A::ZERO, Affine3A::from_scale(-Vec3::ONE), Affine3A::IDENTITY],
        turns: vec![[1.0, 0.0, 0.0, 0.0]; 4],
        kappas: vec![4.0; 4],
    };
    let mut rows = vec![0.0f32; 4 * WIDTH];
    for (row, v) in rows.chunks_exact_mut(WIDTH).zip([1e30f32, -1e30, 0.0, 1e-30]) {
        row[..8].fill(v);
    }
    for covariance in BOTH {
        let options = DecodeOptions { covariance, ..DecodeOptions::default() };
        let splats = decode(&rows, channels(), &base, &options).unwrap();
        splats.check().unwrap();
        // A quaternion without length is the identity in the bind pose, not in the world.
        if covariance == Covariance::Polar {
            assert_eq!(splats.quats[2], [1.0, 0.0, 0.0, 0.0]);
        }
        let mut d = SplatsGrad::zeros_like(&splats);
        d.quats.fill([1.0; 4]);
        d.scales.fill(Vec3::ONE);
        d.opacities.fill(1.0);
        let mut grad = vec![0.0; rows.len()];
        decode_backward(&rows, channels(), &base, &options, &d, &mut grad, None).unwrap();
        assert!(grad.iter().all(|g| g.is_finite()), "{covariance:?}");
        assert_eq!(grad[2 * WIDTH + 3..2 * WIDTH + 7], [0.0; 4]);
    }
}

#[test]
fn active_degrees_are_drawn_and_learn() {
    let (_, base) = at_rest(4);
    let mut rng = Rng::new(1, "rows", 0, 0);
    let rows: Vec<f32> = (0..base.len() * WIDTH).map(|_| rng.normal()).collect();
    for (sh_active, drawn, values) in [(0, 0, 3), (1, 1, 12), (3, 1, 12)] {
        let options = DecodeOptions { sh_active, ..DecodeOptions::default() };
        let splats = decode(&rows, channels(), &base, &options).unwrap();
        let Color::Sh { degree, coeffs } = &splats.color else { panic!("texels have harmonics") };
        assert_eq!((*degree, coeffs.len()), (drawn, values * base.len()));
        assert_eq!(coeffs[values..2 * values], rows[WIDTH + 11..WIDTH + 11 + values]);
        let mut d = SplatsGrad::zeros_like(&splats);
        d.color.fill(2.0);
        let mut grad = vec![1.0; rows.len()];
        decode_backward(&rows, channels(), &base, &options, &d, &mut grad, None).unwrap();
        let row = &grad[WIDTH..2 * WIDTH];
        assert!(row[11..11 + values].iter().all(|g| *g == 3.0) && row[11 + values..].iter().all(|g| *g == 1.0));
    }
}

#[test]
fn points_get_their_cotangents_and_lengths_are_checked() {
    let (_, mut base) = at_rest(2);
    let turn = Quat::from_rotation_z(0.5);
    base.transforms.fill(Affine3A::from_quat(turn));
    let rows = vec![0.0; 4 * WIDTH];
    let options = DecodeOptions::default();
    let splats = decode(&rows, channels(), &base, &options).unwrap();
    let mut d = SplatsGrad::zeros_like(&splats);
    d.means.fill(Vec3::X);
    let (mut grad, mut d_points) = (vec![0.0; rows.len()], vec![Vec3::ONE; 4]);
    decode_backward(&rows, channels(), &base, &options, &d, &mut grad, Some(&mut d_points)).unwrap();
    let want = Vec3::ONE + turn.inverse() * Vec3::X;
    assert!(d_points.iter().all(|p| (*p - want).length() < 1e-6), "{d_points:?}");
    assert!(matches!(decode(&rows[1..], channels(), &base, &options), Err(ChannelsError::Length { .. })));
    let short = decode_backward(&rows, channels(), &base, &options, &d, &mut grad[1..], None);
    assert!(matches!(short, Err(ChannelsError::Length { column: "gradient", .. })));
}

#[test]
fn the_penalty_on_offsets_is_its_definition() {
    let mut rng = Rng::new(4, "rows", 0, 0);
    let rows: Vec<f32> = (0..3000 * WIDTH).map(|_| rng.normal()).collect();
    let mut grad = vec![0.0; rows.len()];
    let value = offset_penalty(&rows, channels(), 0.5, &mut grad);
    let squares = |rows: &[f32]| {
        rows.chunks_exact(WIDTH).flat_map(|r| &r[8..11]).map(|d| f64::from(*d).powi(2)).sum::<f64>() / 9000.0
    };
    assert!((value / (0.5 * squares(&rows)) - 1.0).abs() < 1e-12);
    let want = 2.0 * 0.5 * f64::from(rows[WIDTH + 9]) / 9000.0;
    assert!((f64::from(grad[WIDTH + 9]) / want - 1.0).abs() < 1e-6);
    assert_eq!((grad[WIDTH + 7], grad[WIDTH + 11]), (0.0, 0.0));
}

#[test]
fn base_maps_are_blends_of_vertices() {
    let (points, faces, table) = square(8);
    let turns: Vec<[f32; 4]> = [0.1f32, 0.2, 0.3, 0.4].map(|a| rot::from_glam(Quat::from_rotation_y(a))).to_vec();
    let flipped: Vec<[f32; 4]> = turns.iter().zip([1.0, -1.0, 1.0, -1.0]).map(|(q, s)| q.map(|v| s * v)).collect();
    let transforms: Vec<Affine3A> =
        points.iter().map(|p| Affine3A::from_mat3_translation(glam::Mat3::IDENTITY * (1.0 + p.x), *p)).collect();
    let kappas = [1.0, 2.0, 1.0, 2.0];
    let base = TexelBase::new(&table, &faces, &points, &transforms, &turns, &kappas).unwrap();
    let other = TexelBase::new(&table, &faces, &points, &transforms, &flipped, &kappas).unwrap();
    for k in 0..table.len() {
        let uv = table.uv(k);
        assert!((base.points[k] - uv.extend(0.0)).length() < 1e-6);
        assert!((base.kappas[k] - 1.0 - uv.x).abs() < 1e-6);
        assert!((base.transforms[k].matrix3.x_axis.x - 1.0 - uv.x).abs() < 1e-6);
        let same: f32 = base.turns[k].iter().zip(other.turns[k]).map(|(a, b)| a * b).sum();
        assert!((same.abs() - 1.0).abs() < 1e-6, "the sign of a quaternion does not matter");
    }
    let e = TexelBase::new(&table, &faces, &points, &transforms, &turns, &kappas[1..]).unwrap_err();
    assert_eq!(e, BaseError::Length { column: "kappas", got: 3, want: 4 });
    let mut bad = transforms.clone();
    bad[2].matrix3 = Mat3A::from_diagonal(Vec3::NAN);
    let e = TexelBase::new(&table, &faces, &points, &bad, &turns, &kappas).unwrap_err();
    assert_eq!(e, BaseError::NotFinite { column: "transforms", row: 2 });
    let e = TexelBase::new(&table, &[[0, 1, 2], [1, 9, 2]], &points, &transforms, &turns, &kappas).unwrap_err();
    assert_eq!(e, BaseError::Face { face: 1, vertices: 4 });
}

#[test]
fn a_root_far_away_costs_no_precision() {
    let root = DVec3::new(4e6, -3e6, 2e6);
    let joints = [DAffine3::from_rotation_translation(DQuat::from_rotation_z(0.3), root)];
    let (points, faces, table) = square(16);
    let make = |joint: &DAffine3| {
        let m = joint.matrix3;
        let column = |v: DVec3| glam::Vec3A::from(v.as_vec3());
        let matrix3 = Mat3A::from_cols(column(m.x_axis), column(m.y_axis), column(m.z_axis));
        let one = Affine3A { matrix3, translation: column(joint.translation) };
        let turn = rot::from_glam(Quat::from_rotation_z(0.3));
        TexelBase::new(&table, &faces, &points, &[one; 4], &[turn; 4], &[1.0; 4]).unwrap()
    };
    let near = DAffine3::from_rotation_translation(DQuat::from_rotation_z(0.3), DVec3::ZERO);
    let local = about(&joints, root);
    assert_eq!(local[0], near);
    let rows = painted(&make(&near), 16, 0.3);
    let draw = |joint: &DAffine3, camera: &Camera| {
        let splats = decode(&rows, channels(), &make(joint), &DecodeOptions::default()).unwrap();
        picture(&splats, camera)
    };
    let view = facing();
    let far = Camera { translation: view.translation - view.rotation * root, ..view };
    let want = draw(&near, &view);
    let got = draw(&local[0], &camera_about(&far, root));
    let worst = got.iter().zip(&want).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst < 2e-5, "{worst}");
    // Without it, f32 means have a quarter of a metre.
    assert!(psnr(&draw(&joints[0], &far), &want) < 40.0);
}

#[test]
fn warm_up_targets_are_what_they_say() {
    let (_, base) = at_rest(8);
    let mut rng = Rng::new(6, "normals", 0, 0);
    let mut normals: Vec<Vec3> =
        (0..base.len()).map(|_| Vec3::new(rng.normal(), rng.normal(), rng.normal()).normalize()).collect();
    normals[0] = -Vec3::X;
    normals[1] = Vec3::X;
    normals[2] = Vec3::new(-1.0, 1e-4, 0.0).normalize();
    let colors: Vec<[f32; 3]> = (0..base.len()).map(|i| [i as f32 / 64.0, 0.5, 1.0]).collect();
    let rows = warm_up::targets(channels(), &colors, &base.points, &normals, [1e-5, 0.5]).unwrap();
    let splats = decode(&rows, channels(), &base, &DecodeOptions::default()).unwrap();
    let Color::Sh { coeffs, .. } = &splats.color else { panic!("texels have harmonics") };
    for (k, n) in normals.iter().enumerate() {
        assert!((rot::to_glam(splats.quats[k]) * Vec3::X - *n).length() < 1e-6, "{n}");
        assert_eq!((splats.opacities[k], splats.means[k]), (0.5, base.points[k]));
        let shown: [f32; 3] = std::array::from_fn(|c| 0.5 + coeffs[12 * k + c] * gs_core::sh::C0 as f32);
        assert!(shown.iter().zip(colors[k]).all(|(a, b)| (a - b).abs() < 1e-6));
        assert!(coeffs[12 * k + 3..12 * k + 12].iter().all(|v| *v == 0.0));
    }
    // On a lattice of spacing h: h inside, more at corners, never less than the mean.
    let h = 1.0f32 / 8.0;
    let inside = splats.scales[27].x;
    assert!(inside >= h && inside < 1.05 * h, "{inside}");
    assert!(splats.scales.iter().all(|s| s.x == s.y && s.y == s.z && s.x >= inside));
    let e = warm_up::targets(channels(), &colors[1..], &base.points, &normals, [1e-5, 0.5]).unwrap_err();
    assert!(e.to_string().contains("`colours` holds 63 values"), "{e}");
}

#[test]
fn warm_up_loss_is_a_weighted_sum_of_means() {
    let mut rng = Rng::new(7, "rows", 0, 0);
    let mut noise = || (0..2000 * WIDTH).map(|_| rng.normal()).collect::<Vec<f32>>();
    let (rows, targets) = (noise(), noise());
    let mut grad = vec![0.0; rows.len()];
    let value = warm_up::loss(&rows, &targets, channels(), &mut grad).unwrap();
    let group = |range: std::ops::Range<usize>| {
        let sum: f64 = (0..rows.len())
            .filter(|i| range.contains(&(i % WIDTH)))
            .map(|i| (f64::from(rows[i]) - f64::from(targets[i])).powi(2))
            .sum();
        sum / (2000 * range.len()) as f64
    };
    let want = group(0..3) + group(3..7) + 0.1 * group(7..8) + group(8..11) + group(11..14) + group(14..23);
    assert!((value / want - 1.0).abs() < 1e-12, "{value} {want}");
    // Quadratic, so a central difference is exact but for rounding.
    for at in [0, 5, 7, 9, 12, 20, 19 * WIDTH + 7] {
        let value = |h: f32| {
            let mut moved = rows.clone();
            moved[at] += h;
            warm_up::loss(&moved, &targets, channels(), &mut vec![0.0; rows.len()]).unwrap()
        };
        let want = (value(0.5) - value(-0.5)) / 1.0;
        assert!((f64::from(grad[at]) - want).abs() < 1e-5 * want.abs().max(1e-6), "{at}: {} {want}", grad[at]);
    }
    let mut grad = vec![0.0; rows.len()];
    assert_eq!(warm_up::loss(&rows, &rows, channels(), &mut grad).unwrap(), 0.0);
    assert!(grad.iter().all(|g| *g == 0.0));
    assert!(warm_up::loss(&rows, &targets[1..], channels(), &mut grad).is_err());
}

#[test]
fn dropping_the_transparent_changes_no_bit() {
    let (_, base) = at_rest(24);
    let mut rows = painted(&base, 24, 0.3);
    rows.chunks_exact_mut(WIDTH).step_by(3).for_each(|row| row[7] = -6.0);
    let splats = decode(&rows, channels(), &base, &DecodeOptions::default()).unwrap();
    let kept = worth_drawing(&splats, Some(&facing()), &ThinOptions::default());
    assert_eq!(kept.len(), 2 * splats.len() / 3);
    let thin = select(&splats, &kept);
    thin.check().unwrap();
    assert_eq!(picture(&thin, &facing()), picture(&splats, &facing()));
    // Off: everything stays.
    let off = ThinOptions { min_opacity: 0.0, min_pixels: 0.0 };
    assert_eq!(select(&splats, &worth_drawing(&splats, None, &off)), splats);
}

#[test]
fn dropping_the_small_costs_little() {
    let (_, base) = at_rest(24);
    let mut rows = painted(&base, 24, 0.3);
    rows.chunks_exact_mut(WIDTH).step_by(4).for_each(|row| row[0..3].fill(-9.0));
    let splats = decode(&rows, channels(), &base, &DecodeOptions::default()).unwrap();
    let options = ThinOptions { min_pixels: 0.3, ..ThinOptions::default() };
    let kept = worth_drawing(&splats, Some(&facing()), &options);
    let near = psnr(&picture(&select(&splats, &kept), &facing()), &picture(&splats, &facing()));
    println!("{} of {} kept, {near:.1} dB", kept.len(), splats.len());
    assert_eq!(kept.len(), 3 * splats.len() / 4);
    assert!(near > 30.0, "{near}");
    assert_eq!(worth_drawing(&splats, None, &options).len(), splats.len(), "no camera, no size");
}

#[test]
fn merging_a_plain_sheet_leaves_a_quarter_and_the_picture() {
    let size = 32;
    let (table, base) = at_rest(size);
    let (normals, offsets) = (vec![Vec3::Z; base.len()], vec![Vec3::ZERO; base.len()]);
    let plain = decode(&painted(&base, size, 0.0), channels(), &base, &DecodeOptions::default()).unwrap();
    let waved = decode(&painted(&base, size, 0.05), channels(), &base, &DecodeOptions::default()).unwrap();
    let run = |splats: &Splats, options: MergeOptions| merge(splats, &table, &normals, &offsets, &options).unwrap();
    let off = run(&plain, MergeOptions { levels: 0, ..MergeOptions::default() });
    assert_eq!(off.1.after, plain.len());
    assert_eq!(psnr(&picture(&off.0, &facing()), &picture(&plain, &facing())), f64::INFINITY);
    let bare = MergeOptions { keep_borders: false, ..MergeOptions::default() };
    for (levels, part, least) in [(1, 4, 60.0), (2, 16, 60.0)] {
        let (merged, report) = run(&plain, MergeOptions { levels, ..bare });
        merged.check().unwrap();
        assert_eq!((report.after, report.blocks[levels as usize]), (plain.len() / part, plain.len() / part));
        assert!(report.color_rms < 1e-6);
        // From so near that no border is seen: the surface stays closed and of one colour.
        let near = psnr(&picture(&merged, &close()), &picture(&plain, &close()));
        let (kept, bordered) = run(&plain, MergeOptions { levels, ..MergeOptions::default() });
        let outline = |splats: &Splats| psnr(&picture(splats, &facing()), &picture(&plain, &facing()));
        println!(
            "levels {levels}: {} of {}, {near:.1} dB inside, {:.1} dB outside; borders kept: {}, {:.1} dB",
            report.after,
            report.before,
            outline(&merged),
            bordered.after,
            outline(&kept)
        );
        assert!(near > least, "{near}");
        assert!(outline(&kept) > outline(&merged) + 10.0);
    }
    // A wave merges where it is flat only, and the tolerance bounds what colours change.
    let (_, report) = run(&waved, bare);
    assert!(report.after > plain.len() / 4 && report.after < plain.len(), "{report:?}");
    assert!(report.color_rms > 0.0 && report.color_rms < 2.0 / 255.0);
    assert_eq!(report.blocks[0] + 4 * report.blocks[1], plain.len());
}

#[test]
fn what_differs_is_not_merged() {
    let size = 8;
    let (table, base) = at_rest(size);
    let rows = painted(&base, size, 0.0);
    let splats = decode(&rows, channels(), &base, &DecodeOptions::default()).unwrap();
    let (normals, offsets) = (vec![Vec3::Z; base.len()], vec![Vec3::ZERO; base.len()]);
    let count = |splats: &Splats, table: &TexelTable, normals: &[Vec3], offsets: &[Vec3]| {
        let options = MergeOptions { keep_borders: false, ..MergeOptions::default() };
        merge(splats, table, normals, offsets, &options).unwrap().1.after
    };
    assert_eq!(count(&splats, &table, &normals, &offsets), 16);
    let mut bent = normals.clone();
    bent[0] = Vec3::new(0.2, 0.0, 1.0).normalize();
    assert_eq!(count(&splats, &table, &bent, &offsets), 19);
    let mut moved = offsets.clone();
    moved[0] = 0.1 * Vec3::Z;
    assert_eq!(count(&splats, &table, &normals, &moved), 19);
    let mut faint = splats.clone();
    faint.opacities[0] = 0.5;
    assert_eq!(count(&faint, &table, &normals, &offsets), 19);
    let mut tinted = splats.clone();
    if let Color::Sh { coeffs, .. } = &mut tinted.color {
        // A degree-1 coefficient alone: the colour differs from some directions.
        coeffs[4] = 0.05;
    }
    assert_eq!(count(&tinted, &table, &normals, &offsets), 19);
    let mut cut = table.clone();
    cut.chart[0] = 1;
    assert_eq!(count(&splats, &cut, &normals, &offsets), 19);
    let mut hole = table.clone();
    hole.row[0] = gs_texel::surface::NONE;
    assert_eq!(count(&splats, &hole, &normals, &offsets), 18, "the hole itself is gone");
    let e = merge(&splats, &table, &normals[1..], &offsets, &MergeOptions::default()).unwrap_err();
    assert!(matches!(e, ChannelsError::Length { column: "normals", .. }));
}

#[test]
fn threads_do_not_change_bits() {
    let (_, base) = at_rest(64);
    let mut rng = Rng::new(9, "rows", 0, 0);
    let rows: Vec<f32> = (0..base.len() * WIDTH).map(|_| rng.normal()).collect();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let options = DecodeOptions { covariance: Covariance::Affine, ..DecodeOptions::default() };
            let splats = decode(&rows, channels(), &base, &options).unwrap();
            let mut d = SplatsGrad::zeros_like(&splats);
            d.means.iter_mut().zip(&splats.means).for_each(|(d, m)| *d = *m);
            d.quats.clone_from(&splats.quats);
            d.scales.clone_from(&splats.scales);
            let mut grad = vec![0.0; rows.len()];
            decode_backward(&rows, channels(), &base, &options, &d, &mut grad, None).unwrap();
            let penalty = offset_penalty(&rows, channels(), 0.01, &mut grad);
            let warm = warm_up::loss(&rows, &grad.clone(), channels(), &mut grad).unwrap();
            (splats, grad, penalty.to_bits(), warm.to_bits())
        })
    };
    assert!(run(1) == run(5));
}
