//! Textured spheres, boxes, wheels and a waving sheet, and their intersection with rays.
//!
//! A ray is `o + s d` with any length of `d`. The sphere is a quadratic, the box three slabs, the wheel a quadratic and a slab,
//! all in the body's frame; the sheet is a root of a function of one variable.

use glam::{DVec2, DVec3};
use serde::Serialize;

use super::motion::{Motion, RigidPose};

/// The shape of a body in its own frame, world units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Shape {
    /// A ball around the origin.
    Sphere {
        /// Radius of the ball, world units.
        radius: f64,
    },
    /// An axis-aligned box around the origin.
    Box {
        /// Half sides along x, y and z, world units.
        half: DVec3,
    },
    /// A solid disc around the origin with its axis along z.
    Wheel {
        /// Radius of the disc, world units.
        radius: f64,
        /// Half the width along the axis.
        half_width: f64,
    },
    /// A sheet over `[-x, x] × [-y, y]` whose material points move along z only:
    /// `z = ramp(x) Σ amplitude sin(wave·(x, y) − pace·rate·t)`, `ramp = (x/half.x + 1)/2`: it is fixed at `x = −half.x`.
    Sheet {
        /// Half sides along x and y, world units.
        half: DVec2,
        /// Travelling waves, which add up.
        waves: &'static [Wave],
        /// Factor on the rates of all waves.
        pace: f64,
    },
}

/// One wave of a sheet.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Wave {
    /// Amplitude where the ramp is 1, world units.
    pub amplitude: f64,
    /// Wave vector, radians per world unit.
    pub wave: DVec2,
    /// Angular frequency, radians per unit of normalised time.
    pub rate: f64,
}

/// Kind of motion of a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum MotionClass {
    /// The body does not move.
    Still,
    /// The body moves as a rigid whole.
    Global,
    /// The body changes its shape.
    Local,
}

/// A body: shape, motion and colours.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Body {
    /// Name, unique within its scene.
    pub name: &'static str,
    /// Shape in the body's frame.
    pub shape: Shape,
    /// Motion of the body's frame in the world.
    pub motion: Motion,
    /// The two colours of the pattern, display-encoded RGB in 0..1.
    pub colors: [[f64; 3]; 2],
    /// Spatial frequency of the pattern, radians per world unit.
    pub pattern: f64,
}

/// Intersection of a ray and a body, in the body's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LocalHit {
    /// Ray parameter.
    pub(crate) s: f64,
    /// The material point: for the sheet its rest position `(x, y, 0)`.
    pub(crate) point: DVec3,
    /// Unit normal in the body's frame.
    pub(crate) normal: DVec3,
}

impl Body {
    /// The colour at a material point, display-encoded: a smooth pattern fixed to the body.
    pub(crate) fn color(&self, p: DVec3) -> [f64; 3] {
        let q = p * self.pattern + DVec3::new(0.7, 1.1, 1.9);
        let w = (0.5 + 1.5 * q.x.sin() * q.y.sin() * q.z.sin()).clamp(0.0, 1.0);
        let [a, b] = self.colors;
        std::array::from_fn(|c| a[c] + (b[c] - a[c]) * w)
    }

    /// Whether the shape is a sheet: two-sided and deforming.
    pub(crate) fn is_sheet(&self) -> bool {
        matches!(self.shape, Shape::Sheet { .. })
    }

    /// Kind of motion: a sheet deforms, other shapes move rigidly or are at rest.
    pub fn class(&self) -> MotionClass {
        match self.is_sheet() {
            true => MotionClass::Local,
            false if self.motion.moves() => MotionClass::Global,
            false => MotionClass::Still,
        }
    }

    /// Cycles per unit of time of its fastest periodic motion; 0 at rest.
    pub(crate) fn cycles(&self) -> f64 {
        let pace = if let Shape::Sheet { pace, .. } = self.shape { pace } else { 0.0 };
        let own = self.shape.waves().iter().map(|w| pace * w.rate.abs() / std::f64::consts::TAU);
        own.fold(self.motion.cycles(), f64::max)
    }

    /// World position of a material point at time `t`.
    pub(crate) fn position_of(&self, material: DVec3, t: f64) -> DVec3 {
        let local = match self.shape {
            Shape::Sheet { .. } => DVec3::new(material.x, material.y, self.shape.height(material.truncate(), t)),
            _ => material,
        };
        self.motion.at(t).apply(local)
    }
}

impl Shape {
    /// Radius of a bounding sphere around the origin.
    pub(crate) fn bounding_radius(&self) -> f64 {
        match *self {
            Self::Sphere { radius } => radius,
            Self::Box { half } => half.length(),
            Self::Wheel { radius, half_width } => radius.hypot(half_width),
            Self::Sheet { half, .. } => half.extend(self.amplitude()).length(),
        }
    }

    /// First hit with `s > 0` of the ray `o + s d` given in the body's frame.
    pub(crate) fn hit(&self, o: DVec3, d: DVec3, t: f64) -> Option<LocalHit> {
        match *self {
            Self::Sphere { radius } => {
                let s = sphere(o, d, radius)?;
                let point = o + d * s;
                Some(LocalHit { s, point, normal: point / radius })
            }
            Self::Box { half } => slabs(o, d, half).filter(|&(s, ..)| s > 0.0).map(|(s, _, axis)| {
                let normal = DVec3::AXES[axis] * -d[axis].signum();
                LocalHit { s, point: o + d * s, normal }
            }),
            Self::Wheel { radius, half_width } => wheel(o, d, radius, half_width),
            Self::Sheet { .. } => self.sheet_hit(o, d, t),
        }
    }

    /// The waves of a sheet; none for other shapes.
    fn waves(&self) -> &'static [Wave] {
        if let Self::Sheet { waves, .. } = *self { waves } else { &[] }
    }

    /// A bound on the height of the sheet.
    fn amplitude(&self) -> f64 {
        self.waves().iter().map(|w| w.amplitude.abs()).sum()
    }

    /// Height of the sheet; 0 for other shapes.
    pub(crate) fn height(&self, p: DVec2, t: f64) -> f64 {
        let Self::Sheet { half, waves, pace } = *self else { return 0.0 };
        let sum: f64 = waves.iter().map(|w| w.amplitude * (w.wave.dot(p) - w.rate * (pace * t)).sin()).sum();
        0.5 * (p.x / half.x + 1.0) * sum
    }

    /// Gradient of [`Self::height`].
    pub(super) fn height_slope(&self, p: DVec2, t: f64) -> DVec2 {
        let Self::Sheet { half, waves, pace } = *self else { return DVec2::ZERO };
        let ramp = 0.5 * (p.x / half.x + 1.0);
        let one = |w: &Wave| {
            let (sin, cos) = (w.wave.dot(p) - w.rate * (pace * t)).sin_cos();
            w.wave * (w.amplitude * ramp * cos) + DVec2::X * (w.amplitude * 0.5 / half.x * sin)
        };
        waves.iter().map(one).sum()
    }

    /// Marches along the ray by steps that cannot pass the sheet (|f| divided by a bound on |f'|), but not below
    /// a fraction of a pixel, until the sign changes; then bisects and refines by Newton's method.
    fn sheet_hit(&self, o: DVec3, d: DVec3, t: f64) -> Option<LocalHit> {
        const MIN_STEP: f64 = 4e-3;
        let Self::Sheet { half, waves, .. } = *self else { return None };
        let amplitude = self.amplitude();
        let (enter, leave, _) = slabs(o, d, half.extend(amplitude))?;
        let f = |s: f64| {
            let p = o + d * s;
            p.z - self.height(p.truncate(), t)
        };
        let flat = d.truncate();
        let steepest: f64 = waves.iter().map(|w| w.amplitude.abs() * w.wave.dot(flat).abs()).sum();
        let slope = steepest + amplitude * 0.5 / half.x * flat.x.abs() + d.z.abs();
        let least = MIN_STEP / d.length();
        let (mut a, mut fa) = (enter.max(0.0), f(enter.max(0.0)));
        while a < leave {
            let b = (a + (fa.abs() / slope).max(least)).min(leave);
            let fb = f(b);
            if fa * fb <= 0.0 {
                return Some(self.sheet_root(o, d, t, a, b, fa));
            }
            (a, fa) = (b, fb);
        }
        None
    }

    fn sheet_root(&self, o: DVec3, d: DVec3, t: f64, mut a: f64, mut b: f64, fa: f64) -> LocalHit {
        let f = |s: f64| {
            let p = o + d * s;
            p.z - self.height(p.truncate(), t)
        };
        for _ in 0..6 {
            let mid = 0.5 * (a + b);
            if fa * f(mid) <= 0.0 {
                b = mid;
            } else {
                a = mid;
            }
        }
        let mut s = 0.5 * (a + b);
        for _ in 0..3 {
            let slope = d.z - self.height_slope((o + d * s).truncate(), t).dot(d.truncate());
            let next = s - f(s) / slope;
            s = if next >= a && next <= b { next } else { 0.5 * (a + b) };
        }
        let p = o + d * s;
        let g = self.height_slope(p.truncate(), t);
        LocalHit { s, point: DVec3::new(p.x, p.y, 0.0), normal: DVec3::new(-g.x, -g.y, 1.0).normalize_or_zero() }
    }
}

/// First positive root of `|o + s d| = radius` seen from outside.
fn sphere(o: DVec3, d: DVec3, radius: f64) -> Option<f64> {
    let (a, b, c) = (d.length_squared(), o.dot(d), o.length_squared() - radius * radius);
    let disc = b * b - a * c;
    (disc >= 0.0).then(|| (-b - disc.sqrt()) / a).filter(|&s| s > 0.0)
}

/// First hit of a wheel seen from outside: the later of entering the infinite cylinder and entering the slab.
fn wheel(o: DVec3, d: DVec3, radius: f64, half_width: f64) -> Option<LocalHit> {
    let (across, from) = (d.truncate(), o.truncate());
    let (a, b, c) = (across.length_squared(), from.dot(across), from.length_squared() - radius * radius);
    let (side, out) = match (a > 0.0, b * b - a * c) {
        (true, disc) if disc >= 0.0 => ((-b - disc.sqrt()) / a, (-b + disc.sqrt()) / a),
        (false, _) if c <= 0.0 => (f64::NEG_INFINITY, f64::INFINITY),
        _ => return None,
    };
    let (face, back, _) = slabs(o, d, DVec3::new(f64::INFINITY, f64::INFINITY, half_width))?;
    let s = side.max(face);
    if s > out.min(back) || s <= 0.0 {
        return None;
    }
    let point = o + d * s;
    let normal = if side > face { point.with_z(0.0) / radius } else { DVec3::Z * -d.z.signum() };
    Some(LocalHit { s, point, normal })
}

/// Where a ray enters and leaves the block `[-half, half]`, and the axis through which it enters.
fn slabs(o: DVec3, d: DVec3, half: DVec3) -> Option<(f64, f64, usize)> {
    let (mut enter, mut leave, mut axis) = (f64::NEG_INFINITY, f64::INFINITY, 0);
    for k in 0..3 {
        if d[k] == 0.0 {
            if o[k].abs() > half[k] {
                return None;
            }
            continue;
        }
        let (a, b) = ((-half[k] - o[k]) / d[k], (half[k] - o[k]) / d[k]);
        if a.min(b) > enter {
            (enter, axis) = (a.min(b), k);
        }
        leave = leave.min(a.max(b));
    }
    (enter <= leave && leave > 0.0).then_some((enter, leave, axis))
}

/// A body at one time, prepared for many rays from one point.
pub(crate) struct Placed<'a> {
    pub(crate) body: &'a Body,
    pub(crate) pose: RigidPose,
    origin: DVec3,
    to_centre: DVec3,
    far: f64,
    t: f64,
}

impl<'a> Placed<'a> {
    /// The body at time `t`, seen from `eye`.
    pub(crate) fn new(body: &'a Body, t: f64, eye: DVec3) -> Self {
        let pose = body.motion.at(t);
        let (to_centre, r) = (eye - pose.translation, body.shape.bounding_radius());
        Self { body, pose, origin: pose.invert(eye), to_centre, far: to_centre.length_squared() - r * r, t }
    }

    /// Whether rays within `spread · depth` of the one along `d` (world, camera-space z = 1) may meet the body.
    pub(crate) fn may_meet(&self, d: DVec3, spread: f64) -> bool {
        let r = self.body.shape.bounding_radius();
        let near = r + spread * (self.to_centre.length() + r);
        let b = self.to_centre.dot(d);
        b * b >= d.length_squared() * (self.to_centre.length_squared() - near * near)
    }

    /// First hit of the ray from the eye along `d` (world).
    pub(crate) fn hit(&self, d: DVec3) -> Option<LocalHit> {
        let b = self.to_centre.dot(d);
        if b * b < d.length_squared() * self.far {
            return None;
        }
        self.body.shape.hit(self.origin, self.pose.rotation.transpose() * d, self.t)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spheres_and_boxes_are_hit_where_they_are() {
        let ball = Shape::Sphere { radius: 0.5 };
        let h = ball.hit(DVec3::new(0.0, 0.0, -4.0), DVec3::Z * 2.0, 0.0).unwrap();
        assert!((h.s - 1.75).abs() < 1e-12 && (h.normal + DVec3::Z).length() < 1e-12);
        assert!(ball.hit(DVec3::new(0.0, 0.6, -4.0), DVec3::Z, 0.0).is_none());
        assert!(ball.hit(DVec3::new(0.0, 0.0, 4.0), DVec3::Z, 0.0).is_none(), "behind the eye");
        let block = Shape::Box { half: DVec3::new(1.0, 2.0, 3.0) };
        let h = block.hit(DVec3::new(5.0, 0.5, 0.5), -DVec3::X, 0.0).unwrap();
        assert_eq!((h.s, h.normal), (4.0, DVec3::X));
        assert!(block.hit(DVec3::new(5.0, 2.5, 0.5), -DVec3::X, 0.0).is_none());
    }

    #[test]
    fn wheels_are_hit_on_the_tread_and_on_the_faces() {
        let wheel = Shape::Wheel { radius: 0.5, half_width: 0.2 };
        let h = wheel.hit(DVec3::new(4.0, 0.0, 0.1), DVec3::X * -2.0, 0.0).unwrap();
        assert!((h.s - 1.75).abs() < 1e-12 && (h.normal - DVec3::X).length() < 1e-12);
        let h = wheel.hit(DVec3::new(0.3, 0.3, 4.0), -DVec3::Z, 0.0).unwrap();
        assert!((h.s - 3.8).abs() < 1e-12 && h.normal == DVec3::Z);
        let h = wheel.hit(DVec3::new(3.0, 0.0, 3.0), DVec3::new(-1.0, 0.0, -1.0), 0.0).unwrap();
        assert!((h.point - DVec3::new(0.2, 0.0, 0.2)).length() < 1e-12 && h.normal == DVec3::Z, "{h:?}");
        for (o, d) in [
            (DVec3::new(0.4, 0.4, 4.0), -DVec3::Z),
            (DVec3::new(4.0, 0.0, 0.3), -DVec3::X),
            (DVec3::new(4.0, 0.0, 0.1), DVec3::X),
            (DVec3::new(3.0, 0.0, 3.0), DVec3::new(-1.0, 0.0, -1.6)),
        ] {
            assert!(wheel.hit(o, d, 0.0).is_none(), "{o} {d}");
        }
    }

    #[test]
    fn hits_of_the_sheet_lie_on_the_sheet_and_nothing_is_missed() {
        const WAVES: &[Wave] = &[
            Wave { amplitude: 0.2, wave: DVec2::new(5.0, 2.0), rate: 6.0 },
            Wave { amplitude: 0.05, wave: DVec2::new(-3.0, 6.0), rate: 11.0 },
        ];
        let sheet = Shape::Sheet { half: DVec2::new(1.0, 0.7), waves: WAVES, pace: 1.0 };
        let mut hits = 0;
        for k in 0..400 {
            let target = DVec3::new(f64::from(k % 20) / 10.0 - 0.97, f64::from(k / 20) / 15.0 - 0.66, 0.0);
            let t = f64::from(k) / 400.0;
            let eye = DVec3::new(2.0, -3.0, 1.7);
            let d = target.with_z(sheet.height(target.truncate(), t)) - eye;
            let h = sheet.hit(eye, d, t).unwrap();
            let p = eye + d * h.s;
            assert!((p.z - sheet.height(p.truncate(), t)).abs() < 1e-10, "on the sheet");
            assert!(h.s <= 1.0 + 1e-9, "not behind the point aimed at");
            hits += usize::from((h.s - 1.0).abs() < 1e-9);
            let e = 1e-6;
            let dz =
                (sheet.height(p.truncate() + DVec2::X * e, t) - sheet.height(p.truncate() - DVec2::X * e, t)) / 2.0;
            assert!(h.normal.dot(DVec3::new(e, 0.0, dz)).abs() < 1e-12, "normal to the sheet");
        }
        assert!(hits > 300, "most points are seen directly: {hits}");
    }
}
