//! The amplitude loss in `f64`: plain sums, rows first, then columns; long lines by a fast transform.

use crate::reference::Image64;
use gs_fft::num_complex::Complex64;

/// A complex number.
type Complex = [f64; 2];

/// Longest line that is summed by the definition.
const MAX_PLAIN: usize = 128;

/// `Σ_x f(x) e^{±2πi k x/n}` over a line.
fn line(f: &[Complex], sign: f64) -> Vec<Complex> {
    let n = f.len();
    if n > MAX_PLAIN {
        return fast_line(f, sign);
    }
    let turn: Vec<Complex> =
        (0..n).map(|k| (sign * std::f64::consts::TAU * k as f64 / n as f64).sin_cos()).map(|(s, c)| [c, s]).collect();
    let one = |k: usize| {
        f.iter().enumerate().fold([0.0; 2], |[re, im], (x, [a, b])| {
            let [c, s] = turn[k * x % n];
            [re + a * c - b * s, im + a * s + b * c]
        })
    };
    (0..n).map(one).collect()
}

fn fast_line(f: &[Complex], sign: f64) -> Vec<Complex> {
    let mut line: Vec<Complex64> = f.iter().map(|[re, im]| Complex64::new(*re, *im)).collect();
    let plan = if sign < 0.0 { gs_fft::complex_forward_f64 } else { gs_fft::complex_inverse_f64 };
    plan(line.len()).process(&mut line);
    line.iter().map(|v| [v.re, v.im]).collect()
}

/// The sum over a plane `[H, W]`.
fn plane(f: &[Complex], width: usize, sign: f64) -> Vec<Complex> {
    let height = f.len() / width;
    let rows: Vec<Complex> = f.chunks_exact(width).flat_map(|row| line(row, sign)).collect();
    let mut out = vec![[0.0; 2]; f.len()];
    for x in 0..width {
        let column: Vec<Complex> = (0..height).map(|y| rows[y * width + x]).collect();
        line(&column, sign).into_iter().enumerate().for_each(|(y, v)| out[y * width + x] = v);
    }
    out
}

/// Mean over bins and channels of the difference of orthonormal amplitudes, and its gradient with respect to `a`.
pub fn amplitude_loss64(a: &Image64, b: &Image64) -> (f64, Vec<f64>) {
    let (n, channels) = (a.width * a.height, a.channels);
    let unit = 1.0 / (n as f64).sqrt();
    let (mut value, mut grad) = (0.0, vec![0.0; a.data.len()]);
    for c in 0..channels {
        let of = |i: &Image64| {
            let f: Vec<Complex> = i.data.iter().skip(c).step_by(channels).map(|v| [*v, 0.0]).collect();
            plane(&f, i.width, -1.0)
        };
        let mut slopes = Vec::with_capacity(n);
        for (p, q) in of(a).into_iter().zip(of(b)) {
            let amplitude = |v: Complex| Some(unit * v[0].hypot(v[1])).filter(|a| *a >= 1e-6).unwrap_or(0.0);
            let d = amplitude(p) - amplitude(q);
            value += d.abs() / a.data.len() as f64;
            let keep = d != 0.0 && amplitude(p) > 0.0;
            slopes.push(if keep { p.map(|v| d.signum() * v / p[0].hypot(p[1])) } else { [0.0; 2] });
        }
        for (x, v) in plane(&slopes, a.width, 1.0).iter().enumerate() {
            grad[x * channels + c] = unit * v[0] / a.data.len() as f64;
        }
    }
    (value, grad)
}
