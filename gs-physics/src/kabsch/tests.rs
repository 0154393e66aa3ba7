use super::*;
use gs_core::Rng;

fn vector(rng: &mut Rng) -> DVec3 {
    DVec3::new(rng.normal().into(), rng.normal().into(), rng.normal().into())
}

fn turned(rng: &mut Rng) -> DMat3 {
    let angle = f64::from(rng.range(-3.1, 3.1));
    DMat3::from_axis_angle(vector(rng).normalize(), angle)
}

fn moved(points: &[DVec3], r: &DMat3, t: DVec3) -> Vec<(DVec3, DVec3)> {
    points.iter().map(|&p| (p, *r * p + t)).collect()
}

fn angle(r: &DMat3) -> f64 {
    (0.5 * (trace(r) - 1.0)).clamp(-1.0, 1.0).acos()
}

fn far(a: &DMat3, b: &DMat3) -> f64 {
    let d = *a - *b;
    d.to_cols_array().iter().fold(0.0, |m, x| f64::max(m, x.abs()))
}

#[test]
fn rigid_motions_are_recovered() {
    for case in 0..200u64 {
        let mut rng = Rng::new(1, "kabsch", 0, case);
        let n = 3 + (case % 5) as usize;
        let points: Vec<DVec3> = (0..n).map(|_| vector(&mut rng)).collect();
        let (r, t) = (turned(&mut rng), vector(&mut rng));
        let weights: Vec<f64> = (0..n).map(|_| rng.range(0.1, 3.0).into()).collect();
        let pairs = moved(&points, &r, t);
        for weights in [None, Some(&weights[..])] {
            let fit = kabsch(&pairs, weights);
            assert_eq!(fit.freedom, Freedom::None, "{case}");
            assert!(far(&fit.turn, &r) < 1e-9 && (fit.shift - t).length() < 1e-9, "{case}: {}", far(&fit.turn, &r));
            assert!(PairSums::of(&pairs, weights).residual(&fit) < 1e-7);
        }
    }
}

#[test]
fn coplanar_points_and_half_turns() {
    let square = [DVec3::X, DVec3::Y, -DVec3::X, -DVec3::Y].map(|p| p + DVec3::Z);
    for axis in [DVec3::X, DVec3::Z, DVec3::new(1.0, 2.0, -0.5).normalize()] {
        let r = DMat3::from_axis_angle(axis, std::f64::consts::PI);
        let fit = kabsch(&moved(&square, &r, DVec3::ONE), None);
        assert!(far(&fit.turn, &r) < 1e-12 && fit.freedom == Freedom::None);
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
    assert!((fit.turn.determinant() - 1.0).abs() < 1e-12);
    let best = sums.residual(&fit);
    for k in 0..500 {
        let mut rng = Rng::new(3, "mirror", 0, k);
        let small = DMat3::from_axis_angle(vector(&mut rng).normalize(), f64::from(rng.range(0.0, 0.3)));
        for turn in [turned(&mut rng), small * fit.turn] {
            let [p, q] = sums.means();
            assert!(sums.residual(&Rigid { turn, shift: q - turn * p, ..fit }) >= best - 1e-12);
        }
    }
}

#[test]
fn points_on_a_line_turn_as_little_as_they_can() {
    for case in 0..50 {
        let mut rng = Rng::new(4, "line", 0, case);
        let (from, to, at) = (vector(&mut rng).normalize(), vector(&mut rng).normalize(), vector(&mut rng));
        let steps = [-1.0, 0.5, 2.0, 3.0];
        let pairs: Vec<_> = steps.iter().map(|&s| (at + from * s, to * s - at)).collect();
        for pairs in [&pairs[..], &pairs[..2]] {
            let fit = kabsch(pairs, None);
            assert_eq!(fit.freedom, Freedom::Turn);
            assert!(pairs.iter().all(|&(p, q)| (fit.apply(p) - q).length() < 1e-9));
            assert!((angle(&fit.turn) - from.angle_between(to)).abs() < 1e-7, "{case}");
        }
    }
    let back = kabsch(&[(DVec3::X, -DVec3::X), (-DVec3::X, DVec3::X)], None);
    assert!((back.turn * DVec3::X + DVec3::X).length() < 1e-12 && back.freedom == Freedom::Turn);
}

#[test]
fn one_point_no_weight_and_nonsense() {
    let (p, q) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(-4.0, 0.5, 1.0));
    let one = kabsch(&[(p, q)], None);
    assert_eq!((one.turn, one.freedom), (DMat3::IDENTITY, Freedom::Turn));
    assert!((one.apply(p) - q).length() < 1e-12);
    let same = kabsch(&[(p, q); 7], Some(&[0.1, 0.2, 0.3, 0.7, 0.9, 1.1, 0.3]));
    assert!(angle(&same.turn) < 1e-6 && same.freedom == Freedom::Turn);
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
    let (r, t) = (turned(&mut rng), vector(&mut rng));
    let mut pairs = moved(&points, &r, t);
    pairs.push((DVec3::splat(5.0), DVec3::splat(-9.0)));
    let fit = kabsch(&pairs, Some(&[1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0]));
    assert!(far(&fit.turn, &r) < 1e-12);
}

#[test]
fn far_from_the_origin() {
    let mut rng = Rng::new(6, "offset", 0, 0);
    let away = DVec3::new(1e6, -2e6, 5e5);
    let points: Vec<DVec3> = (0..40).map(|_| away + vector(&mut rng)).collect();
    let r = turned(&mut rng);
    let pairs: Vec<_> = points.iter().map(|&p| (p, r * (p - away) - away)).collect();
    let fit = kabsch(&pairs, None);
    assert!(far(&fit.turn, &r) < 1e-8, "{}", far(&fit.turn, &r));
    assert!(pairs.iter().all(|&(p, q)| (fit.apply(p) - q).length() < 1e-8));
}

/// Changes a pair or its weight by a step.
type Poke<'a> = dyn Fn(&mut (DVec3, DVec3), &mut f64, f64) + 'a;

/// Analytic cotangents against central differences of the whole fit, for weights and both points.
#[test]
fn the_adjoint_is_the_derivative() {
    let mut rng = Rng::new(7, "adjoint", 0, 0);
    let n = 7;
    let mut pairs: Vec<_> = (0..n).map(|_| (vector(&mut rng), vector(&mut rng))).collect();
    let r = turned(&mut rng);
    pairs.iter_mut().for_each(|(p, q)| *q = r * *p + *q * 0.2);
    let mut weights: Vec<f64> = (0..n).map(|_| rng.range(0.2, 2.0).into()).collect();
    let g = DMat3::from_cols(vector(&mut rng), vector(&mut rng), vector(&mut rng));
    let d_shift = vector(&mut rng);
    let loss = |pairs: &[(DVec3, DVec3)], weights: &[f64]| {
        let fit = kabsch(pairs, Some(weights));
        trace(&(g.transpose() * fit.turn)) + d_shift.dot(fit.shift)
    };
    let sums = PairSums::of(&pairs, Some(&weights));
    let back = PairAdjoint::of(&sums, &sums.fit(0.0), &g, d_shift);
    let step = 1e-6;
    for i in 0..n {
        let (dw, dp, dq) = back.pair(weights[i], pairs[i].0, pairs[i].1);
        let mut check = |poke: &Poke<'_>, want: f64| {
            let (pair, weight) = (pairs[i], weights[i]);
            let [up, down] = [step, -step].map(|h| {
                poke(&mut pairs[i], &mut weights[i], h);
                let value = loss(&pairs, &weights);
                (pairs[i], weights[i]) = (pair, weight);
                value
            });
            let got = (up - down) / (2.0 * step);
            assert!((got - want).abs() < 1e-8 * (1.0 + want.abs()), "pair {i}: {got} {want}");
        };
        check(&|_, w, h| *w += h, dw);
        for axis in 0..3 {
            check(&|pair, _, h| pair.0[axis] += h, dp[axis]);
            check(&|pair, _, h| pair.1[axis] += h, dq[axis]);
        }
    }
}

#[test]
fn the_adjoint_stays_finite_where_the_rotation_is_free() {
    let line = [(DVec3::X, DVec3::Y), (-DVec3::X, -DVec3::Y), (DVec3::X * 2.0, DVec3::Y * 2.0)];
    let sums = PairSums::of(&line, None);
    let back = PairAdjoint::of(&sums, &sums.fit(0.0), &DMat3::IDENTITY, DVec3::ONE);
    let (dw, dp, dq) = back.pair(1.0, DVec3::X, DVec3::Y);
    assert!(dw.is_finite() && dp.is_finite() && dq.is_finite());
    let none = PairAdjoint::of(&sums, &Rigid::IDENTITY, &DMat3::IDENTITY, DVec3::ONE);
    assert_eq!(none.pair(1.0, DVec3::X, DVec3::Y), (0.0, DVec3::ZERO, DVec3::ZERO));
}
