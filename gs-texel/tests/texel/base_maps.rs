//! Texel Gaussians of a whole map: base maps, warm-up, threads.

use crate::square::{WIDTH, at_rest, channels, square};
use glam::{Affine3A, Mat3A, Quat, Vec3};
use gs_core::rot;
use gs_core::{Color, Rng, SplatsGrad};
use gs_texel::gaussians::{
    BaseError, Covariance, DecodeOptions, TexelBase, decode, decode_backward, offset_penalty, warm_up,
};

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
        let same: f32 = base.rotations[k].iter().zip(other.rotations[k]).map(|(a, b)| a * b).sum();
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
