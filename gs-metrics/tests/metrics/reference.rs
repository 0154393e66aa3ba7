//! SSIM by plain loops in `f64` straight from the published formula.

use gs_core::Image;

/// An `f64` image, interleaved.
#[derive(Clone)]
pub struct Image64 {
    pub width: usize,
    pub height: usize,
    pub channels: usize,
    pub data: Vec<f64>,
}

impl From<&Image> for Image64 {
    fn from(i: &Image) -> Self {
        let data = i.data.iter().map(|v| f64::from(*v)).collect();
        Self { width: i.width, height: i.height, channels: i.channels, data }
    }
}

impl Image64 {
    /// Value at a place, 0 outside the image.
    pub fn at(&self, x: isize, y: isize, c: usize) -> f64 {
        if x < 0 || y < 0 || x >= self.width as isize || y >= self.height as isize {
            return 0.0;
        }
        self.data[(y as usize * self.width + x as usize) * self.channels + c]
    }
}

/// Weights of the 11 × 11 window, `[dy + 5][dx + 5]`.
pub fn window64() -> [[f64; 11]; 11] {
    let g = |k: usize| (-(k as f64 - 5.0).powi(2) / 4.5).exp();
    let sum: f64 = (0..11).map(g).sum();
    std::array::from_fn(|y| std::array::from_fn(|x| g(x) * g(y) / (sum * sum)))
}

/// Local statistics at one pixel and channel: `[μx, μy, σx², σy², σxy]`, zeros outside the image.
fn statistics(a: &Image64, b: &Image64, x: isize, y: isize, c: usize, w: &[[f64; 11]; 11]) -> [f64; 5] {
    let mut mean = [0.0; 2];
    for (dy, row) in w.iter().enumerate() {
        for (dx, weight) in row.iter().enumerate() {
            let (px, py) = (x + dx as isize - 5, y + dy as isize - 5);
            mean[0] += weight * a.at(px, py, c);
            mean[1] += weight * b.at(px, py, c);
        }
    }
    let mut second = [0.0; 3];
    for (dy, row) in w.iter().enumerate() {
        for (dx, weight) in row.iter().enumerate() {
            let (px, py) = (x + dx as isize - 5, y + dy as isize - 5);
            let (u, v) = (a.at(px, py, c) - mean[0], b.at(px, py, c) - mean[1]);
            second[0] += weight * u * u;
            second[1] += weight * v * v;
            second[2] += weight * u * v;
        }
    }
    [mean[0], mean[1], second[0], second[1], second[2]]
}

/// Per channel: mean SSIM and mean of its contrast-structure factor, with the pixels of `margin` left out.
pub fn ssim64(a: &Image64, b: &Image64, margin: usize) -> Vec<(f64, f64)> {
    let (c1, c2) = (1e-4, 9e-4);
    let w = window64();
    let mut out = Vec::new();
    for c in 0..a.channels {
        let (mut full, mut contrast, mut n) = (0.0, 0.0, 0.0);
        for y in margin..a.height - margin {
            for x in margin..a.width - margin {
                let [mx, my, vx, vy, vxy] = statistics(a, b, x as isize, y as isize, c, &w);
                let cs = (2.0 * vxy + c2) / (vx + vy + c2);
                full += cs * (2.0 * mx * my + c1) / (mx * mx + my * my + c1);
                contrast += cs;
                n += 1.0;
            }
        }
        out.push((full / n, contrast / n));
    }
    out
}

/// Mean SSIM over pixels and channels.
pub fn mean_ssim64(a: &Image64, b: &Image64, margin: usize) -> f64 {
    ssim64(a, b, margin).iter().map(|s| s.0).sum::<f64>() / a.channels as f64
}

/// Gradient of [`mean_ssim64`] with respect to `a`, by scattering each pixel's derivative over its window.
pub fn ssim_grad64(a: &Image64, b: &Image64, margin: usize) -> Vec<f64> {
    let (c1, c2) = (1e-4, 9e-4);
    let w = window64();
    let mut grad = vec![0.0; a.data.len()];
    let n = ((a.height - 2 * margin) * (a.width - 2 * margin) * a.channels) as f64;
    for y in margin..a.height - margin {
        for x in margin..a.width - margin {
            for c in 0..a.channels {
                let [mx, my, vx, vy, vxy] = statistics(a, b, x as isize, y as isize, c, &w);
                let (a1, a2) = (2.0 * mx * my + c1, 2.0 * vxy + c2);
                let (b1, b2) = (mx * mx + my * my + c1, vx + vy + c2);
                let by_mean = (2.0 * my * a2 - 2.0 * mx * a1 * a2 / b1) / (b1 * b2);
                let by_var = -a1 * a2 / (b1 * b2 * b2);
                let by_cov = 2.0 * a1 / (b1 * b2);
                for (dy, row) in w.iter().enumerate() {
                    for (dx, weight) in row.iter().enumerate() {
                        let (px, py) = (x as isize + dx as isize - 5, y as isize + dy as isize - 5);
                        if px < 0 || py < 0 || px >= a.width as isize || py >= a.height as isize {
                            continue;
                        }
                        let d = by_mean + 2.0 * by_var * (a.at(px, py, c) - mx) + by_cov * (b.at(px, py, c) - my);
                        grad[(py as usize * a.width + px as usize) * a.channels + c] += weight * d / n;
                    }
                }
            }
        }
    }
    grad
}

/// Relative L2 distance of an `f32` gradient from an `f64` one.
pub fn relative_l2(got: &[f32], want: &[f64]) -> f64 {
    let (mut diff, mut norm) = (0.0, 0.0);
    for (g, w) in got.iter().zip(want) {
        diff += (f64::from(*g) - w).powi(2);
        norm += w * w;
    }
    (diff / norm.max(1e-300)).sqrt()
}
