use super::*;
use gs_core::Rng;

fn vector(rng: &mut Rng) -> DVec3 {
    DVec3::new(rng.normal().into(), rng.normal().into(), rng.normal().into())
}

fn random_rotation(rng: &mut Rng) -> DMat3 {
    let angle = f64::from(rng.range(-3.1, 3.1));
    DMat3::from_axis_angle(vector(rng).normalize(), angle)
}

fn moved(points: &[DVec3], r: &DMat3, t: DVec3) -> Vec<(DVec3, DVec3)> {
    points.iter().map(|&p| (p, *r * p + t)).collect()
}

fn angle(r: &DMat3) -> f64 {
    (0.5 * (r.x_axis.x + r.y_axis.y + r.z_axis.z - 1.0)).clamp(-1.0, 1.0).acos()
}

/// `√(Σ w |R p + t − q|² / Σ w)`.
fn residual(pairs: &[(DVec3, DVec3)], weights: Option<&[f64]>, motion: &Rigid) -> f64 {
    let weight = |i: usize| weights.map_or(1.0, |w| w[i]);
    let square = |(i, (p, q)): (usize, &(DVec3, DVec3))| weight(i) * motion.apply(*p).distance_squared(*q);
    let squares: f64 = pairs.iter().enumerate().map(square).sum();
    (squares / (0..pairs.len()).map(weight).sum::<f64>()).sqrt()
}

fn max_difference(a: &DMat3, b: &DMat3) -> f64 {
    let d = *a - *b;
    d.to_cols_array().iter().fold(0.0, |m, x| f64::max(m, x.abs()))
}

#[test]
fn rigid_motions_are_recovered() {
    for case in 0..200u64 {
        let mut rng = Rng::new(1, "kabsch", 0, case);
        let n = 3 + (case % 5) as usize;
        let points: Vec<DVec3> = (0..n).map(|_| vector(&mut rng)).collect();
        let (r, t) = (random_rotation(&mut rng), vector(&mut rng));
        let weights: Vec<f64> = (0..n).map(|_| rng.range(0.1, 3.0).into()).collect();
        let pairs = moved(&points, &r, t);
        for weights in [None, Some(&weights[..])] {
            let fit = kabsch(&pairs, weights);
            assert_eq!(fit.status, FitStatus::Unique, "{case}");
            assert!(
                max_difference(&fit.rotation, &r) < 1e-9 && (fit.translation - t).length() < 1e-9,
                "{case}: {}",
                max_difference(&fit.rotation, &r)
            );
            assert!(residual(&pairs, weights, &fit) < 1e-7);
        }
    }
}

#[test]
fn coplanar_points_and_half_turns() {
    let square = [DVec3::X, DVec3::Y, -DVec3::X, -DVec3::Y].map(|p| p + DVec3::Z);
    for axis in [DVec3::X, DVec3::Z, DVec3::new(1.0, 2.0, -0.5).normalize()] {
        let r = DMat3::from_axis_angle(axis, std::f64::consts::PI);
        let fit = kabsch(&moved(&square, &r, DVec3::ONE), None);
        assert!(max_difference(&fit.rotation, &r) < 1e-12 && fit.status == FitStatus::Unique);
    }
}

/// The mirror image of a set: the best answer is a rotation all the same, and no other rotation is better.
#[test]
fn no_reflection() {
    let mut rng = Rng::new(2, "mirror", 0, 0);
    let points: Vec<DVec3> = (0..12).map(|_| vector(&mut rng) * DVec3::new(3.0, 2.0, 1.0)).collect();
    let pairs: Vec<_> = points.iter().map(|&p| (p, p * DVec3::new(1.0, 1.0, -1.0))).collect();
    let sums = PairSums::of(&pairs, None);
    let fit = sums.fit(0.0);
    assert!((fit.rotation.determinant() - 1.0).abs() < 1e-12);
    let best = residual(&pairs, None, &fit);
    for k in 0..500 {
        let mut rng = Rng::new(3, "mirror", 0, k);
        let small = DMat3::from_axis_angle(vector(&mut rng).normalize(), f64::from(rng.range(0.0, 0.3)));
        for rotation in [random_rotation(&mut rng), small * fit.rotation] {
            let [p, q] = sums.means();
            let other = Rigid { rotation, translation: q - rotation * p, ..fit };
            assert!(residual(&pairs, None, &other) >= best - 1e-12);
        }
    }
}

#[test]
fn points_on_a_line_rotate_by_the_smallest_angle() {
    for case in 0..50 {
        let mut rng = Rng::new(4, "line", 0, case);
        let (from, to, at) = (vector(&mut rng).normalize(), vector(&mut rng).normalize(), vector(&mut rng));
        let steps = [-1.0, 0.5, 2.0, 3.0];
        let pairs: Vec<_> = steps.iter().map(|&s| (at + from * s, to * s - at)).collect();
        for pairs in [&pairs[..], &pairs[..2]] {
            let fit = kabsch(pairs, None);
            assert_eq!(fit.status, FitStatus::AmbiguousRotation);
            assert!(pairs.iter().all(|&(p, q)| (fit.apply(p) - q).length() < 1e-9));
            assert!((angle(&fit.rotation) - from.angle_between(to)).abs() < 1e-7, "{case}");
        }
    }
    let back = kabsch(&[(DVec3::X, -DVec3::X), (-DVec3::X, DVec3::X)], None);
    assert!((back.rotation * DVec3::X + DVec3::X).length() < 1e-12 && back.status == FitStatus::AmbiguousRotation);
}

#[test]
fn one_point_no_weight_and_nonsense() {
    let (p, q) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(-4.0, 0.5, 1.0));
    let one = kabsch(&[(p, q)], None);
    assert_eq!((one.rotation, one.status), (DMat3::IDENTITY, FitStatus::AmbiguousRotation));
    assert!((one.apply(p) - q).length() < 1e-12);
    let same = kabsch(&[(p, q); 7], Some(&[0.1, 0.2, 0.3, 0.7, 0.9, 1.1, 0.3]));
    assert!(angle(&same.rotation) < 1e-6 && same.status == FitStatus::AmbiguousRotation);
    assert_eq!(kabsch(&[(p, q), (q, p)], Some(&[0.0, 0.0])), Rigid::IDENTITY);
    assert_eq!(kabsch(&[], None), Rigid::IDENTITY);
    assert_eq!(kabsch(&[(p, q), (DVec3::splat(f64::NAN), q)], None), Rigid::IDENTITY);
    assert_eq!(PairSums::of(&[(p, q)], Some(&[1e-9])).fit(1e-6), Rigid::IDENTITY);
}

/// A pair without weight does not count, wherever it is.
#[test]
fn weights_select() {
    let mut rng = Rng::new(5, "select", 0, 0);
    let points: Vec<DVec3> = (0..6).map(|_| vector(&mut rng)).collect();
    let (r, t) = (random_rotation(&mut rng), vector(&mut rng));
    let mut pairs = moved(&points, &r, t);
    pairs.push((DVec3::splat(5.0), DVec3::splat(-9.0)));
    let fit = kabsch(&pairs, Some(&[1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0]));
    assert!(max_difference(&fit.rotation, &r) < 1e-12);
}

#[test]
fn far_from_the_origin() {
    let mut rng = Rng::new(6, "offset", 0, 0);
    let away = DVec3::new(1e6, -2e6, 5e5);
    let points: Vec<DVec3> = (0..40).map(|_| away + vector(&mut rng)).collect();
    let r = random_rotation(&mut rng);
    let pairs: Vec<_> = points.iter().map(|&p| (p, r * (p - away) - away)).collect();
    let fit = kabsch(&pairs, None);
    assert!(max_difference(&fit.rotation, &r) < 1e-8, "{}", max_difference(&fit.rotation, &r));
    assert!(pairs.iter().all(|&(p, q)| (fit.apply(p) - q).length() < 1e-8));
}
