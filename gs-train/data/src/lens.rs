//! Lens distortion of Brown and Conrady, and of fisheye lenses, as OpenCV writes them, and resampling of a distorted image to its
//! pinhole camera.
//!
//! A point `(x, y)` of the plane `z = 1`, with `r² = x² + y²`, is imaged at
//! ```text
//! x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)
//! y' = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y
//! ```
//! (OpenCV `calib3d`, "Detailed Description"). COLMAP's `SIMPLE_RADIAL`, `RADIAL` and `OPENCV` are special cases.
//!
//! A fisheye lens (OpenCV `fisheye`; Kannala and Brandt 2006) images it at
//! ```text
//! (x', y') = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸) / r · (x, y)      θ = atan r
//! ```
//! COLMAP's `SIMPLE_RADIAL_FISHEYE`, `RADIAL_FISHEYE` and `OPENCV_FISHEYE`. What it sees at the sides is not in the pinhole image of the
//! same focal length; nothing that it sees behind can be.
//!
//! A sensor with skewed columns adds `skew · y'` to `x'` (Hartley and Zisserman 2004, 6.2.4, with `skew = s / fx`).

use std::f64::consts::FRAC_PI_2;

use glam::DVec2;
use gs_core::{Camera, cast};

use super::pixels::ImageU8;

/// Coefficients of the distortion; all zero is a pinhole, unless it is a fisheye.
///
/// ```
/// use gs_data::Lens;
/// use glam::DVec2;
///
/// let lens = Lens { k1: -0.1, ..Lens::default() };
/// let p = DVec2::new(0.5, 0.0);
/// assert!((lens.distort(p).x - 0.5 * (1.0 - 0.1 * 0.25)).abs() < 1e-15);
/// assert!(lens.undistort(lens.distort(p)).is_some_and(|q| q.abs_diff_eq(p, 1e-12)));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Lens {
    /// Whether it is a fisheye: radial coefficients are factors of powers of the angle, tangential ones are not used.
    pub fisheye: bool,
    /// Radial coefficient, factor of `r²`.
    pub k1: f64,
    /// Radial coefficient, factor of `r⁴`.
    pub k2: f64,
    /// Radial coefficient, factor of `r⁶`.
    pub k3: f64,
    /// Radial coefficient of a fisheye, factor of `θ⁸`.
    pub k4: f64,
    /// First tangential coefficient.
    pub p1: f64,
    /// Second tangential coefficient.
    pub p2: f64,
    /// Skew `s / fx` of the pixel columns.
    pub skew: f64,
}

/// Newton steps of the inverse; four suffice for usual lenses.
const MAX_STEPS: usize = 30;

impl Lens {
    /// The coefficients in a fixed order: `k1 k2 k3 p1 p2 skew k4`, and 1 for a fisheye.
    pub fn to_array(&self) -> [f64; 8] {
        let Self { fisheye, k1, k2, k3, k4, p1, p2, skew } = *self;
        [k1, k2, k3, p1, p2, skew, k4, f64::from(u8::from(fisheye))]
    }

    /// Whether it distorts nothing.
    pub fn is_pinhole(&self) -> bool {
        *self == Self::default()
    }

    /// The point of the distorted plane `z = 1` at which the lens images the point `p` of the undistorted one, skew included.
    pub fn distort(&self, p: DVec2) -> DVec2 {
        let distorted = self.bend(p);
        DVec2::new(distorted.x + self.skew * distorted.y, distorted.y)
    }

    /// The distortion without skew.
    fn bend(&self, p: DVec2) -> DVec2 {
        if self.fisheye {
            let r = p.length();
            return if r > 0.0 { p * (self.image_radius(r.atan())[0] / r) } else { p };
        }
        let r2 = p.length_squared();
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        let xy = p.x * p.y;
        p * radial
            + DVec2::new(
                2.0 * self.p1 * xy + self.p2 * (r2 + 2.0 * p.x * p.x),
                self.p1 * (r2 + 2.0 * p.y * p.y) + 2.0 * self.p2 * xy,
            )
    }

    /// The inverse of [`Self::distort`], by Newton's method from `seen`. None where the model folds over and no inverse is
    /// found.
    pub fn undistort(&self, seen: DVec2) -> Option<DVec2> {
        let distorted = DVec2::new(seen.x - self.skew * seen.y, seen.y);
        if self.fisheye {
            return self.undistort_fisheye(distorted);
        }
        let mut p = distorted;
        for _ in 0..MAX_STEPS {
            let error = self.bend(p) - distorted;
            if error.length() < 1e-13 {
                return Some(p);
            }
            let (a, b, c, d) = self.jacobian(p);
            let det = a * d - b * c;
            if det.is_nan() || det <= 1e-6 {
                return None;
            }
            p -= DVec2::new(d * error.x - b * error.y, a * error.y - c * error.x) / det;
        }
        ((self.bend(p) - distorted).length() < 1e-9).then_some(p)
    }

    /// Of a fisheye: how far from the middle it images a ray at angle `θ`, and the derivative.
    fn image_radius(&self, angle: f64) -> [f64; 2] {
        let Self { k1, k2, k3, k4, .. } = *self;
        let a2 = angle * angle;
        let value = 1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4)));
        let slope = 1.0 + a2 * (3.0 * k1 + a2 * (5.0 * k2 + a2 * (7.0 * k3 + a2 * 9.0 * k4)));
        [angle * value, slope]
    }

    /// The inverse of a fisheye: none at a right angle and beyond.
    fn undistort_fisheye(&self, distorted: DVec2) -> Option<DVec2> {
        let radius = distorted.length();
        if radius == 0.0 {
            return Some(distorted);
        }
        let mut angle = radius.min(FRAC_PI_2);
        for _ in 0..MAX_STEPS {
            let [value, slope] = self.image_radius(angle);
            if (value - radius).abs() < 1e-14 {
                break;
            }
            if slope.is_nan() || slope <= 1e-6 {
                return None;
            }
            angle -= (value - radius) / slope;
        }
        let found = (0.0..FRAC_PI_2 - 1e-9).contains(&angle) && (self.image_radius(angle)[0] - radius).abs() < 1e-9;
        found.then(|| distorted * (angle.tan() / radius))
    }

    /// `(∂x'/∂x, ∂x'/∂y, ∂y'/∂x, ∂y'/∂y)` without skew.
    fn jacobian(&self, p: DVec2) -> (f64, f64, f64, f64) {
        let r2 = p.length_squared();
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        let slope = 2.0 * (self.k1 + r2 * (2.0 * self.k2 + 3.0 * r2 * self.k3));
        let cross = slope * p.x * p.y + 2.0 * self.p1 * p.x + 2.0 * self.p2 * p.y;
        (
            radial + slope * p.x * p.x + 2.0 * self.p1 * p.y + 6.0 * self.p2 * p.x,
            cross,
            cross,
            radial + slope * p.y * p.y + 6.0 * self.p1 * p.y + 2.0 * self.p2 * p.x,
        )
    }

    /// Pixel coordinates in the distorted image of the pixel coordinates `at` of the pinhole `camera` with the same intrinsics.
    pub fn source_pixel(&self, camera: &Camera, at: DVec2) -> DVec2 {
        let p = self.distort(DVec2::new((at.x - camera.cx) / camera.fx, (at.y - camera.cy) / camera.fy));
        DVec2::new(camera.fx * p.x + camera.cx, camera.fy * p.y + camera.cy)
    }

    /// The inverse of [`Self::source_pixel`]: pixel coordinates of the pinhole camera for `(u, v)` of the distorted image. None
    /// where [`Self::undistort`] finds none.
    pub fn pinhole_pixel(&self, camera: &Camera, u: f64, v: f64) -> Option<DVec2> {
        let p = self.undistort(DVec2::new((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy))?;
        Some(DVec2::new(camera.fx * p.x + camera.cx, camera.fy * p.y + camera.cy))
    }

    /// Share of the pinhole image that lies outside the distorted image (and repeats its edge), on a 65×65 grid.
    pub(crate) fn outside_fraction(&self, camera: &Camera) -> f64 {
        const SIDE: u32 = 65;
        let (w, h) = (f64::from(camera.width), f64::from(camera.height));
        let mut outside = 0u32;
        for k in 0..SIDE * SIDE {
            let at = DVec2::new(f64::from(k % SIDE), f64::from(k / SIDE)) / f64::from(SIDE - 1) * DVec2::new(w, h);
            let s = self.source_pixel(camera, at);
            outside += u32::from(!(s.x >= -0.5 && s.x <= w + 0.5 && s.y >= -0.5 && s.y <= h + 0.5));
        }
        f64::from(outside) / f64::from(SIDE * SIDE)
    }
}

/// The image resampled to the pinhole `camera`: bilinear in premultiplied colour, the edge of the distorted image repeated
/// beyond it.
pub(crate) fn undistorted(image: &ImageU8, camera: &Camera, lens: &Lens) -> ImageU8 {
    let mut data = Vec::with_capacity(image.data.len());
    for j in 0..image.height {
        for i in 0..image.width {
            let at = lens.source_pixel(camera, DVec2::new(i as f64 + 0.5, j as f64 + 0.5));
            data.extend_from_slice(&bilinear(image, at - DVec2::splat(0.5)));
        }
    }
    ImageU8 { width: image.width, height: image.height, data }
}

/// Interpolates between pixel centres at whole coordinates.
fn bilinear(image: &ImageU8, at: DVec2) -> [u8; 4] {
    let (right, bottom) = ((image.width - 1) as f64, (image.height - 1) as f64);
    // `max` and `min` also turn a NaN (a lens far outside its domain) into the edge.
    let (x, y) = (at.x.max(0.0).min(right), at.y.max(0.0).min(bottom));
    let (i, j) = (cast::to_usize(x), cast::to_usize(y));
    let (fx, fy) = (x - x.floor(), y - y.floor());
    let (i1, j1) = ((i + 1).min(image.width - 1), (j + 1).min(image.height - 1));
    let corners = [
        (image.pixel(i, j), (1.0 - fx) * (1.0 - fy)),
        (image.pixel(i1, j), fx * (1.0 - fy)),
        (image.pixel(i, j1), (1.0 - fx) * fy),
        (image.pixel(i1, j1), fx * fy),
    ];
    let mut sum = [0.0f64; 4];
    for (p, w) in corners {
        let a = w * f64::from(p[3]);
        for c in 0..3 {
            sum[c] += a * f64::from(p[c]);
        }
        sum[3] += a;
    }
    if sum[3] <= 0.0 {
        return [0; 4];
    }
    let to_u8 = |v: f64| cast::to_u8(v + 0.5);
    [to_u8(sum[0] / sum[3]), to_u8(sum[1] / sum[3]), to_u8(sum[2] / sum[3]), to_u8(sum[3])]
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// The lens of a hand-held phone, and a stronger one.
    const LENSES: [Lens; 2] = [
        Lens { k1: 0.0578421, k2: -0.0805099, p1: -0.000980296, p2: 0.00015575, ..NONE },
        Lens { k1: -0.28, k2: 0.07, k3: -0.004, p1: 0.002, p2: -0.003, skew: 0.02, ..NONE },
    ];
    const NONE: Lens = Lens { fisheye: false, k1: 0.0, k2: 0.0, k3: 0.0, k4: 0.0, p1: 0.0, p2: 0.0, skew: 0.0 };
    /// The lens of an action camera, and one that images angles as they are.
    const FISHEYES: [Lens; 2] =
        [Lens { fisheye: true, k1: 0.054, k2: -0.012, k3: 0.004, k4: -0.0015, ..NONE }, Lens { fisheye: true, ..NONE }];

    fn camera() -> Camera {
        let c = Camera::look_at(270, 480, 0.748, DVec3::new(0.0, -3.0, 0.0), DVec3::ZERO, DVec3::Z).unwrap();
        Camera { cx: 138.6395, cy: 241.317, fx: 343.88, fy: 343.6225, ..c }
    }

    #[test]
    fn points_return_within_a_thousandth_of_a_pixel() {
        let c = camera();
        for lens in LENSES.into_iter().chain(FISHEYES) {
            for k in 0..100 {
                let at = DVec2::new(f64::from(k % 10) * 30.0, f64::from(k / 10) * 53.3);
                let seen = lens.distort(DVec2::new((at.x - c.cx) / c.fx, (at.y - c.cy) / c.fy));
                let p = lens.undistort(seen).unwrap();
                let back = DVec2::new(c.fx * p.x + c.cx, c.fy * p.y + c.cy);
                assert!((back - at).length() < 1e-3, "{lens:?} {at} came back at {back}");
            }
        }
        let folded = Lens { k1: -2.0, ..Lens::default() };
        assert_eq!(folded.undistort(DVec2::new(3.0, 0.0)), None, "no point is seen there");
    }

    #[test]
    fn fisheyes_image_angles() {
        let plain = FISHEYES[1];
        let at = |degrees: f64| DVec2::new(degrees.to_radians().tan(), 0.0);
        for degrees in [0.0, 1e-6, 10.0, 60.0, 89.0f64] {
            let seen = plain.distort(at(degrees));
            assert!((seen.x - degrees.to_radians()).abs() < 1e-12 && seen.y == 0.0, "{degrees}");
        }
        // θ = 1: 1 + 0.054 − 0.012 + 0.004 − 0.0015
        let seen = FISHEYES[0].distort(at(1f64.to_degrees()));
        assert!((seen.x - 1.0445).abs() < 1e-12, "{seen}");
        assert_eq!(plain.undistort(DVec2::new(1.6, 0.0)), None, "behind the image plane");
        assert_eq!(plain.undistort(DVec2::ZERO), Some(DVec2::ZERO));
        assert!(
            !plain.is_pinhole() && plain.outside_fraction(&camera()) == 0.0,
            "a fisheye sees more than the pinhole"
        );
    }

    #[test]
    fn the_jacobian_is_the_slope() {
        for lens in LENSES {
            let (p, h) = (DVec2::new(0.31, -0.52), 1e-6);
            let (a, b, c, d) = lens.jacobian(p);
            let dx = (lens.bend(p + DVec2::X * h) - lens.bend(p - DVec2::X * h)) / (2.0 * h);
            let dy = (lens.bend(p + DVec2::Y * h) - lens.bend(p - DVec2::Y * h)) / (2.0 * h);
            assert!((dx - DVec2::new(a, c)).length() < 1e-8 && (dy - DVec2::new(b, d)).length() < 1e-8);
        }
    }

    /// A smooth picture painted on the pinhole plane, photographed through the lens, comes back.
    #[test]
    fn a_photograph_is_straightened() {
        [LENSES[0], FISHEYES[0]].into_iter().for_each(straightened);
    }

    fn straightened(lens: Lens) {
        let c = camera();
        let paint = |u: f64, v: f64| 128.0 + 60.0 * (u * 0.2).sin() + 60.0 * (v * 0.15).cos();
        let picture = |f: &dyn Fn(DVec2) -> f64| {
            let mut data = Vec::new();
            for k in 0..270 * 480 {
                let v = f(DVec2::new(f64::from(k % 270) + 0.5, f64::from(k / 270) + 0.5));
                data.extend_from_slice(&[v.round() as u8, 0, 0, 255]);
            }
            ImageU8 { width: 270, height: 480, data }
        };
        let image = picture(&|at| {
            let p = lens.undistort(DVec2::new((at.x - c.cx) / c.fx, (at.y - c.cy) / c.fy)).unwrap();
            paint(c.fx * p.x + c.cx, c.fy * p.y + c.cy)
        });
        let straight = undistorted(&image, &c, &lens);
        let truth = picture(&|at| paint(at.x, at.y));
        let worst = |a: &ImageU8| {
            let at = |im: &ImageU8, k: usize| im.pixel(10 + k % 250, 10 + k / 250)[0];
            (0..250 * 460).map(|k| at(a, k).abs_diff(at(&truth, k))).max().unwrap()
        };
        assert!(worst(&straight) <= 2, "{lens:?}: worst difference {}", worst(&straight));
        assert!(worst(&image) > 10, "the test would see an uncorrected lens");
        assert_eq!(undistorted(&truth, &c, &Lens::default()), truth, "no distortion changes nothing");
    }

    #[test]
    fn the_part_outside_is_measured() {
        let c = camera();
        assert_eq!(Lens::default().outside_fraction(&c), 0.0);
        let pincushion = Lens { k1: 0.3, ..Lens::default() }.outside_fraction(&c);
        assert!(pincushion > 0.1 && pincushion < 0.5, "{pincushion}");
    }
}
