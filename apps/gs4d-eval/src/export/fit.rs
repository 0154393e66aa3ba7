//! Fits camera-independent splats with spherical harmonics to splats that depend on the camera.

use gs_core::{Camera, Color, Kernel, Splats, cast, sh};

/// Ridge regularisation of coefficients above degree 0, relative to the sum of opacities: bounds colours in directions that
/// no camera has seen.
const RIDGE: f64 = 5e-3;
/// Number of SH coefficients at the highest degree.
const MAX_COEFFS: usize = sh::MAX_COEFFS;

/// Opacity-weighted sums of one splat over cameras.
#[derive(Clone)]
struct Sums {
    /// Lower triangle of `Σ opacity · b bᵀ`.
    normal: [[f64; MAX_COEFFS]; MAX_COEFFS],
    /// `Σ opacity · (color − ½) bᵀ`.
    right: [[f64; MAX_COEFFS]; 3],
    /// `Σ opacity`.
    opacity: f64,
    /// `Σ opacity · scale`.
    scale: [f64; 3],
    /// `Σ opacity · quat`, with signs aligned to the first.
    quat: [f64; 4],
    /// `Σ opacity · mean`.
    mean: [f64; 3],
    /// `Σ opacity · kernel parameter`.
    kernel: [f64; 2],
}

/// Means of splats over cameras, weighted by opacity, with colours as SH by weighted least squares.
pub(super) struct Fit {
    degree: u8,
    first: Splats,
    sums: Vec<Sums>,
    cameras: usize,
}

impl Fit {
    /// An empty fit for splats with the rows and kernel of `first`.
    pub(super) fn new(first: &Splats, degree: u8) -> Self {
        let empty = Sums {
            normal: [[0.0; MAX_COEFFS]; MAX_COEFFS],
            right: [[0.0; MAX_COEFFS]; 3],
            opacity: 0.0,
            scale: [0.0; 3],
            quat: [0.0; 4],
            mean: [0.0; 3],
            kernel: [0.0; 2],
        };
        Self { degree, first: first.clone(), sums: vec![empty; first.len()], cameras: 0 }
    }

    /// Adds the splats as decoded for `camera`.
    pub(super) fn add(&mut self, splats: &Splats, camera: &Camera) {
        self.cameras += 1;
        let eye = camera.position().as_vec3();
        let columns = kernel_columns(&splats.kernel);
        for (i, sum) in self.sums.iter_mut().enumerate() {
            let weight = f64::from(splats.opacities[i]);
            if weight <= 0.0 {
                continue;
            }
            let towards = (splats.means[i] - eye).normalize_or_zero();
            let basis = sh::basis(towards.to_array().map(f64::from), self.degree);
            let color = shown(&splats.color, i, &basis);
            let k = sh::coeffs(self.degree);
            for (a, row) in sum.normal.iter_mut().enumerate().take(k) {
                row.iter_mut().zip(&basis).take(a + 1).for_each(|(n, b)| *n += weight * basis[a] * b);
            }
            for (row, c) in sum.right.iter_mut().zip(color) {
                row.iter_mut().zip(&basis).for_each(|(r, b)| *r += weight * b * (c - 0.5));
            }
            sum.opacity += weight;
            let quat = splats.quats[i];
            let dot: f64 = quat.iter().zip(&sum.quat).map(|(a, b)| f64::from(*a) * b).sum();
            let sign = if dot < 0.0 { -weight } else { weight };
            sum.quat.iter_mut().zip(quat).for_each(|(s, q)| *s += sign * f64::from(q));
            sum.scale.iter_mut().zip(splats.scales[i].to_array()).for_each(|(s, v)| *s += weight * f64::from(v));
            sum.mean.iter_mut().zip(splats.means[i].to_array()).for_each(|(s, v)| *s += weight * f64::from(v));
            sum.kernel.iter_mut().zip(&columns).for_each(|(s, c)| *s += weight * f64::from(c[i]));
        }
    }

    /// The fitted splats; rows that no camera sees have opacity 0.
    pub(super) fn finish(self) -> Splats {
        let k = sh::coeffs(self.degree);
        let mut out = self.first;
        let mut coeffs = Vec::with_capacity(3 * k * out.len());
        for (i, mut sum) in self.sums.into_iter().enumerate() {
            if sum.opacity <= 0.0 {
                out.opacities[i] = 0.0;
                coeffs.extend(std::iter::repeat_n(0.0, 3 * k));
                continue;
            }
            let share = 1.0 / sum.opacity;
            out.opacities[i] = cast::to_f32(sum.opacity / self.cameras as f64);
            out.scales[i] = glam::Vec3::from_array(sum.scale.map(|v| cast::to_f32(v * share)));
            out.means[i] = glam::Vec3::from_array(sum.mean.map(|v| cast::to_f32(v * share)));
            out.quats[i] = sum.quat.map(|v| cast::to_f32(v * share));
            set_kernel(&mut out.kernel, i, sum.kernel.map(|v| cast::to_f32(v * share)));
            (1..k).for_each(|a| sum.normal[a][a] += RIDGE * sum.opacity);
            solve(&mut sum.normal, &mut sum.right, k);
            coeffs.extend((0..k).flat_map(|a| sum.right.map(|channel| cast::to_f32(channel[a]))));
        }
        out.color = Color::Sh { degree: self.degree, coeffs };
        out
    }
}

/// Colour of a row in a direction, given the SH basis there.
fn shown(color: &Color, i: usize, basis: &[f64; MAX_COEFFS]) -> [f64; 3] {
    match color {
        Color::Rgb(rgb) => rgb[i].map(f64::from),
        Color::Sh { coeffs, .. } => {
            let row = &coeffs[i * color.width()..][..color.width()];
            let sum = |c: usize| 0.5 + row.chunks_exact(3).zip(basis).map(|(v, b)| f64::from(v[c]) * b).sum::<f64>();
            [sum(0), sum(1), sum(2)]
        }
    }
}

/// The columns of a kernel's parameters.
fn kernel_columns(kernel: &Kernel) -> Vec<&[f32]> {
    match kernel {
        Kernel::Frequency { lambdas, betas } => vec![lambdas, betas],
        Kernel::Acutance { acutances } => vec![acutances],
        _ => Vec::new(),
    }
}

fn set_kernel(kernel: &mut Kernel, i: usize, values: [f32; 2]) {
    match kernel {
        Kernel::Frequency { lambdas, betas } => (lambdas[i], betas[i]) = (values[0], values[1]),
        Kernel::Acutance { acutances } => acutances[i] = values[0],
        _ => {}
    }
}

/// Solves `A x = b` in place for three right-hand sides and a positive definite `A`, given by its lower triangle, by Cholesky
/// factorisation.
fn solve(a: &mut [[f64; MAX_COEFFS]; MAX_COEFFS], right: &mut [[f64; MAX_COEFFS]; 3], n: usize) {
    for j in 0..n {
        for i in j..n {
            let dot: f64 = (0..j).map(|k| a[i][k] * a[j][k]).sum();
            a[i][j] = if i == j { (a[i][i] - dot).max(1e-12).sqrt() } else { (a[i][j] - dot) / a[j][j] };
        }
    }
    for b in right {
        for i in 0..n {
            let dot: f64 = (0..i).map(|k| a[i][k] * b[k]).sum();
            b[i] = (b[i] - dot) / a[i][i];
        }
        for i in (0..n).rev() {
            let dot: f64 = (i + 1..n).map(|k| a[k][i] * b[k]).sum();
            b[i] = (b[i] - dot) / a[i][i];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DVec3, Vec3};

    /// Looks at the origin from a direction.
    fn camera(from: DVec3) -> Camera {
        let up = DVec3::new(0.1, 1.0, 0.2).normalize();
        Camera::look_at(32, 32, 0.8, from * 4.0, DVec3::ZERO, up).unwrap()
    }

    fn scene(rgb: [f32; 3]) -> Splats {
        Splats {
            means: vec![Vec3::ZERO],
            quats: vec![[1.0, 0.0, 0.0, 0.0]],
            scales: vec![Vec3::ONE],
            opacities: vec![0.5],
            color: Color::Rgb(vec![rgb]),
            kernel: Kernel::Gaussian,
        }
    }

    #[test]
    fn colours_linear_in_the_direction_are_found() {
        let ring: Vec<DVec3> = (0..24)
            .map(|k| {
                let a = f64::from(k) * 2.4;
                DVec3::new(a.cos(), (f64::from(k) / 12.0 - 1.0) * 0.9, a.sin()).normalize()
            })
            .collect();
        let color = |d: DVec3| [0.5 + 0.2 * d.x as f32, 0.4 - 0.1 * d.y as f32, 0.6];
        let mut fit = Fit::new(&scene(color(DVec3::X)), 1);
        for from in &ring {
            // The direction is that of sight.
            fit.add(&scene(color(-*from)), &camera(*from));
        }
        let found = fit.finish();
        assert_eq!(found.opacities, [0.5]);
        for from in ring {
            let basis = sh::basis((-from).to_array(), 1);
            let got = shown(&found.color, 0, &basis);
            for (g, w) in got.iter().zip(color(-from)) {
                // The ridge takes a little.
                assert!((g - f64::from(w)).abs() < 0.02, "{g} {w}");
            }
        }
    }

    #[test]
    fn a_colour_without_view_dependence_stays() {
        let mut fit = Fit::new(&scene([0.9, 0.2, 0.4]), 2);
        for from in [DVec3::X, DVec3::Y, DVec3::Z, -DVec3::X] {
            fit.add(&scene([0.9, 0.2, 0.4]), &camera(from));
        }
        let found = fit.finish();
        let got = shown(&found.color, 0, &sh::basis([1.0, 0.0, 0.0], 2));
        assert!(got.iter().zip([0.9, 0.2, 0.4]).all(|(g, w)| (g - w).abs() < 0.02), "{got:?}");
    }

    #[test]
    fn what_no_camera_sees_is_invisible() {
        let mut nothing = scene([0.5; 3]);
        nothing.opacities[0] = 0.0;
        let mut fit = Fit::new(&nothing, 1);
        fit.add(&nothing, &camera(DVec3::Z));
        let found = fit.finish();
        found.check().unwrap();
        assert_eq!(found.opacities, [0.0]);
    }
}
