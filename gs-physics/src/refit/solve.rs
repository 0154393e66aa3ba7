//! Levenberg and Marquardt's method for few parameters, with differences as derivatives, and its covariance.

/// Largest number of accepted steps.
const STEPS: usize = 40;
/// A step that lowers the sum of squares by less than this share ends the search.
const GAIN: f64 = 1e-10;
/// Half the interval of the central differences; parameters are of the order of 1.
const DIFFERENCE: f64 = 1e-5;
/// Damping at first, when it is given up, and its factor.
const DAMPING: [f64; 3] = [1e-4, 1e8, 8.0];
/// Ridge of the normal equations, relative to their largest diagonal element.
const RIDGE: f64 = 1e-12;

/// A symmetric matrix, row by row.
pub(crate) type Square = Vec<Vec<f64>>;

/// The minimum of a sum of squares.
pub(super) struct Minimum {
    pub at: Vec<f64>,
    /// `(JᵀJ)⁻¹` there.
    pub spread: Square,
}

/// Minimises `Σ f(p)²` from `begin` on.
pub(super) fn minimise(begin: Vec<f64>, f: impl Fn(&[f64]) -> Vec<f64>) -> Minimum {
    let [mut damping, most, factor] = DAMPING;
    let (mut at, mut residuals) = (begin.clone(), f(&begin));
    let mut squares = sum(&residuals);
    let mut normal = Normal::new(&at, &residuals, &f);
    for _ in 0..STEPS {
        let next = loop {
            let step = normal.step(damping);
            let to: Vec<f64> = at.iter().zip(&step).map(|(p, d)| p - d).collect();
            let there = f(&to);
            if sum(&there) < squares {
                break Some((to, there));
            }
            damping *= factor;
            if damping > most {
                break None;
            }
        };
        let Some((to, there)) = next else { break };
        let less = squares - sum(&there);
        (at, residuals, squares, damping) = (to, there, squares - less, damping / factor);
        normal = Normal::new(&at, &residuals, &f);
        if less <= GAIN * squares {
            break;
        }
    }
    Minimum { spread: normal.inverse(), at }
}

fn sum(residuals: &[f64]) -> f64 {
    residuals.iter().map(|r| r * r).sum()
}

/// Columns of the derivatives of `f` at `p`.
pub(super) fn jacobian(p: &[f64], f: impl Fn(&[f64]) -> Vec<f64>) -> Vec<Vec<f64>> {
    let beside = |c: usize, h: f64| {
        let mut p = p.to_vec();
        p[c] += h;
        f(&p)
    };
    let column = |c| {
        let (ahead, behind) = (beside(c, DIFFERENCE), beside(c, -DIFFERENCE));
        ahead.iter().zip(behind).map(|(a, b)| (a - b) * (0.5 / DIFFERENCE)).collect()
    };
    (0..p.len()).map(column).collect()
}

/// `JᵀJ` and `Jᵀr`.
struct Normal {
    matrix: Square,
    right: Vec<f64>,
}

impl Normal {
    fn new(p: &[f64], residuals: &[f64], f: &impl Fn(&[f64]) -> Vec<f64>) -> Self {
        let columns = jacobian(p, f);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let matrix = columns.iter().map(|a| columns.iter().map(|b| dot(a, b)).collect()).collect();
        Self { matrix, right: columns.iter().map(|a| dot(a, residuals)).collect() }
    }

    fn step(&self, damping: f64) -> Vec<f64> {
        let mut matrix = self.matrix.clone();
        (0..matrix.len()).for_each(|i| matrix[i][i] *= 1.0 + damping);
        cholesky(matrix, self.right.clone(), RIDGE)
    }

    fn inverse(&self) -> Square {
        let n = self.right.len();
        let unit = |i: usize| (0..n).map(|j| f64::from(u8::from(i == j))).collect::<Vec<_>>();
        (0..n).map(|i| cholesky(self.matrix.clone(), unit(i), RIDGE)).collect()
    }
}

/// `a⁻¹ b` of a symmetric positive semi-definite matrix with a ridge on its diagonal, relative to its largest element.
pub(crate) fn cholesky<A: AsMut<[R]>, R: AsMut<[f64]> + AsRef<[f64]>, B: AsMut<[f64]>>(
    mut a: A,
    mut b: B,
    ridge: f64,
) -> B {
    let (rows, x) = (a.as_mut(), b.as_mut());
    let n = x.len();
    let ridge = ridge * (0..n).map(|i| rows[i].as_ref()[i]).fold(0.0, f64::max) + f64::MIN_POSITIVE;
    for i in 0..n {
        rows[i].as_mut()[i] += ridge;
        for j in 0..=i {
            let (row, other) = (rows[i].as_ref(), rows[j].as_ref());
            let sum: f64 = (0..j).map(|k| row[k] * other[k]).sum();
            let value = if i == j { (row[i] - sum).max(ridge * 1e-3).sqrt() } else { (row[j] - sum) / other[j] };
            rows[i].as_mut()[j] = value;
        }
    }
    for i in 0..n {
        let row = rows[i].as_ref();
        x[i] = (x[i] - (0..i).map(|k| row[k] * x[k]).sum::<f64>()) / row[i];
    }
    for i in (0..n).rev() {
        x[i] = (x[i] - (i + 1..n).map(|k| rows[k].as_ref()[i] * x[k]).sum::<f64>()) / rows[i].as_ref()[i];
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Amplitude, rate and offset of a decay, and the covariance of a straight line in closed form.
    #[test]
    fn minima_and_their_spread() {
        let t: Vec<f64> = (0..20).map(|k| f64::from(k) * 0.1).collect();
        let decay = |p: &[f64], t: f64| p[0] * (-p[1] * t).exp() + p[2];
        let truth = [2.0, 1.5, -0.5];
        let found = minimise(vec![1.0, 0.5, 0.0], |p| t.iter().map(|t| decay(p, *t) - decay(&truth, *t)).collect());
        assert!(found.at.iter().zip(truth).all(|(a, b)| (a - b).abs() < 1e-7));
        let line = minimise(vec![0.0, 0.0], |p| t.iter().map(|t| p[0] + p[1] * t - 3.0 * t).collect());
        let (n, mean) = (20.0, 0.95);
        let spread: f64 = t.iter().map(|t| (t - mean) * (t - mean)).sum();
        let want = [[1.0 / n + mean * mean / spread, -mean / spread], [-mean / spread, 1.0 / spread]];
        assert!((0..4).all(|i| (line.spread[i / 2][i % 2] - want[i / 2][i % 2]).abs() < 1e-8), "{:?}", line.spread);
    }
}
