//! The plans against the definition of the transform, for lengths with and without small factors.

use gs_fft::num_complex::{Complex32, Complex64};
use std::f64::consts::TAU;

const LENGTHS: [usize; 9] = [1, 2, 3, 8, 30, 97, 128, 200, 211];

fn line(n: usize) -> Vec<Complex64> {
    (0..n).map(|x| Complex64::new((1.3 * x as f64).sin(), (0.7 * x as f64 + 1.0).cos())).collect()
}

fn definition(line: &[Complex64], sign: f64) -> Vec<Complex64> {
    let n = line.len();
    let of = |k: usize| (0..n).map(|x| line[x] * Complex64::cis(sign * TAU * ((k * x) % n) as f64 / n as f64)).sum();
    (0..n).map(of).collect()
}

fn error(a: &[Complex64], b: &[Complex64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let norm = b.iter().map(Complex64::norm_sqr).sum::<f64>().sqrt();
    a.iter().zip(b).map(|(a, b)| (a - b).norm_sqr()).sum::<f64>().sqrt() / norm
}

fn wide(line: &[Complex32]) -> Vec<Complex64> {
    line.iter().map(|v| Complex64::new(v.re.into(), v.im.into())).collect()
}

#[test]
fn complex_lines_are_transformed_as_defined() {
    for n in LENGTHS {
        for (sign, wide_plan, plan) in [
            (-1.0, gs_fft::complex_forward_f64(n), gs_fft::complex_forward(n)),
            (1.0, gs_fft::complex_inverse_f64(n), gs_fft::complex_inverse(n)),
        ] {
            let want = definition(&line(n), sign);
            let mut values = line(n);
            wide_plan.process(&mut values);
            assert!(error(&values, &want) < 1e-13, "{n}, f64: {}", error(&values, &want));
            let mut values: Vec<Complex32> = line(n).iter().map(|v| Complex32::new(v.re as f32, v.im as f32)).collect();
            plan.process(&mut values);
            let off = error(&wide(&values), &want);
            assert!(off < 1e-6, "{n}, f32: {off}");
        }
    }
}

#[test]
fn real_lines_keep_the_lower_half_and_come_back() {
    for n in LENGTHS {
        let real: Vec<f64> = line(n).iter().map(|v| v.im).collect();
        let complex: Vec<Complex64> = real.iter().map(|v| Complex64::new(*v, 0.0)).collect();
        let want = &definition(&complex, -1.0)[..n / 2 + 1];
        let plan = gs_fft::real_forward_f64(n);
        let mut spectrum = plan.make_output_vec();
        plan.process(&mut real.clone(), &mut spectrum).unwrap();
        assert!(want.len() == spectrum.len() && error(&spectrum, want) < 1e-13, "{n}");

        let mut line: Vec<f32> = real.iter().map(|v| *v as f32).collect();
        let plan = gs_fft::real_forward(n);
        let mut spectrum = plan.make_output_vec();
        plan.process(&mut line, &mut spectrum).unwrap();
        gs_fft::real_inverse(n).process(&mut spectrum, &mut line).unwrap();
        let off = line.iter().zip(&real).map(|(a, b)| (f64::from(*a) / n as f64 - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-6, "{n}: {off}");
    }
}
