//! Rows of texel Gaussians: layout, analytic truths, gradients against differences in `f64`, `f32` against `f64`.
//!
//! | what | tolerance |
//! |---|---|
//! | gradient of a row in `f64` against central differences | 1e-5 of the largest entry |
//! | `f32` rows against `f64` ones, polar | 1e-5 of the largest entry |
//! | `f32` rows against `f64` ones, affine and raw | 1e-4 (differences of standard deviations are divided by) |

use crate::square::{WIDTH, at_rest, channels};
use glam::{Affine3A, DMat3, DQuat, Quat, Vec3};
use gs_core::rot::{self, Mat3};
use gs_core::{Color, Image, Rng, SplatsGrad, covariance};
use gs_texel::gaussians::row::{self, Base, Gaussian};
use gs_texel::gaussians::{
    Channels, ChannelsError, Covariance, DecodeOptions, TexelBase, decode, decode_backward, offset_penalty,
};

const DIFFERENCE: f64 = 1e-5;
const ALL: [Covariance; 3] = [Covariance::Polar, Covariance::Affine, Covariance::Raw];
const RANGE: [f64; 2] = [-11.5, -0.7];

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
    let base = Base {
        point: [normal(), normal(), normal()],
        linear,
        translation: [1.0, 2.0, 3.0],
        rotation: turn,
        kappa: 1.3,
    };
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
    let base = Base { point: [1.0, 2.0, 3.0], linear, translation: [10.0, 0.0, 0.0], rotation: turn, kappa: 2.0 };
    for mode in ALL {
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
        assert!(sigma(&g).iter().all(|v| v.is_finite()));
        let worst = sigma(&g).iter().zip(want).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-13 * largest, "{seed}: {worst:e} of {largest:e}");
        let length: f64 = g.quat.iter().map(|v| v * v).sum();
        assert!((length - 1.0).abs() < 1e-12);
    }
}

#[test]
fn all_modes_agree_where_the_surface_is_rigid() {
    for seed in 0..20 {
        let (row, mut base) = random_texel(seed);
        base.linear = rot::matrix(base.rotation);
        let [a, b, c] = ALL.map(|mode| sigma(&row::decode(&row, &base, mode, RANGE)));
        assert!([b, c].iter().all(|o| a.iter().zip(o).all(|(a, o)| (a - o).abs() < 1e-15)), "{a:?} {b:?} {c:?}");
        // Also backward, even where all standard deviations are one.
        let mut round = row.clone();
        round[0..3].fill(-3.0);
        let d = Gaussian { mean: [0.0; 3], quat: [0.0; 4], scale: [1.0, 2.0, 3.0], opacity: 0.0 };
        let [a, b, c] = ALL.map(|mode| {
            let mut grad = vec![0.0; WIDTH];
            row::backward(&round, &base, mode, RANGE, &d, &mut grad);
            grad
        });
        assert!([&b, &c].iter().all(|o| a.iter().zip(*o).all(|(a, o)| (a - o).abs() < 1e-12)), "{a:?} {b:?} {c:?}");
    }
}

/// Two bones at half the weight each, 60° apart about z: the quaternion of the mean of their matrices is 0.964 long and turns
/// by 27.8° where 30° are right, and it is not normalised.
#[test]
fn raw_turns_fall_short_and_shrink() {
    let (row, mut base) = random_texel(3);
    let bend = DMat3::from_rotation_z(60f64.to_radians());
    let mean = (DMat3::IDENTITY + bend) * 0.5;
    base.linear = mean.transpose().to_cols_array_2d();
    let half = 30f64.to_radians() / 2.0;
    base.rotation = [half.cos(), 0.0, 0.0, half.sin()];
    let raw = gs_texel::skin::raw_quat(&base.linear);
    let length = raw.iter().map(|v| v * v).sum::<f64>().sqrt();
    assert!((length - 0.964).abs() < 5e-4 && raw[1] == 0.0 && raw[2] == 0.0, "{raw:?}");
    assert!((2.0 * raw[3].atan2(raw[0]).to_degrees() - 27.8).abs() < 0.05, "{raw:?}");
    let unit = rot::normalise([row[3], row[4], row[5], row[6]]).wxyz;
    let turned = rot::hamilton(raw, unit);
    let right = rot::matrix(rot::normalise(turned).wxyz);
    // (1 − n²) I + n² R.
    let share = length * length;
    let matrix: Mat3<f64> = std::array::from_fn(|r| {
        std::array::from_fn(|c| share * right[r][c] + (1.0 - share) * f64::from(u8::from(r == c)))
    });
    let scale: [f64; 3] = std::array::from_fn(|i| row[i].clamp(RANGE[0], RANGE[1]).exp() * base.kappa);
    let want = covariance::covariance(&covariance::factor(&matrix, scale));
    let [polar, raw] = [Covariance::Polar, Covariance::Raw].map(|c| sigma(&row::decode(&row, &base, c, RANGE)));
    let largest = want.iter().fold(0.0f64, |a, b| a.max(b.abs()));
    let worst = |got: &[f64; 6]| got.iter().zip(want).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / largest;
    assert!(worst(&raw) < 1e-12 && worst(&polar) > 1e-3, "{:e} {:e}", worst(&raw), worst(&polar));
    // No rotation, nothing finite: the identity.
    assert_eq!(gs_texel::skin::raw_quat(&[[f64::NAN; 3]; 3]), [1.0, 0.0, 0.0, 0.0]);
}

#[test]
fn gradient_of_a_row_matches_differences() {
    let mut worst = [0.0f64; 3];
    for (slot, mode) in ALL.into_iter().enumerate() {
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
            assert!(got.iter().all(|v| v.is_finite()));
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
    let mut worst = [0.0f64; 3];
    for (slot, (mode, limit)) in ALL.into_iter().zip([1e-5, 1e-4, 1e-4]).enumerate() {
        for seed in 0..40 {
            let (row, base) = random_texel(seed);
            let narrow: Vec<f32> = row.iter().map(|v| *v as f32).collect();
            let cast = |m: [f64; 3]| m.map(|v| v as f32);
            let single = Base {
                point: cast(base.point),
                linear: base.linear.map(cast),
                translation: cast(base.translation),
                rotation: base.rotation.map(|v| v as f32),
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
                assert!(b.iter().all(|v| v.is_finite()));
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
    for mode in ALL {
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
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; 4],
        kappas: vec![4.0; 4],
    };
    let mut rows = vec![0.0f32; 4 * WIDTH];
    for (row, v) in rows.chunks_exact_mut(WIDTH).zip([1e30f32, -1e30, 0.0, 1e-30]) {
        row[..8].fill(v);
    }
    for covariance in ALL {
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
    for (sh_active, active, values) in [(0, 0, 3), (1, 1, 12), (3, 1, 12)] {
        let options = DecodeOptions { sh_active, ..DecodeOptions::default() };
        let splats = decode(&rows, channels(), &base, &options).unwrap();
        let Color::Sh { degree, coeffs } = &splats.color else { panic!("texels have harmonics") };
        assert_eq!((*degree, coeffs.len()), (active, values * base.len()));
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
