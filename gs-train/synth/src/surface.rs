//! Signed distance from the surface of a body, and a few material points on it.

use glam::{DVec2, DVec3};

use super::body::{Body, Shape};

impl Body {
    /// Signed distance of a world point from the surface at time `t`, negative inside. A sheet has no inside: its distance is
    /// that to the tangent plane below or above the point, exact to first order.
    pub fn distance(&self, world: DVec3, t: f64) -> f64 {
        let p = self.motion.at(t).invert(world);
        match self.shape {
            Shape::Sphere { radius } => p.length() - radius,
            Shape::Box { half } => {
                let q = p.abs() - half;
                q.max(DVec3::ZERO).length() + q.max_element().min(0.0)
            }
            Shape::Wheel { radius, half_width } => {
                let q = DVec2::new(p.truncate().length() - radius, p.z.abs() - half_width);
                q.max(DVec2::ZERO).length() + q.max_element().min(0.0)
            }
            Shape::Sheet { half, .. } => {
                let foot = p.truncate().clamp(-half, half);
                let above = p.z - self.shape.height(foot, t);
                let steep = (1.0 + self.shape.height_slope(foot, t).length_squared()).sqrt();
                (above / steep).hypot((p.truncate() - foot).length())
            }
        }
    }
}

impl Shape {
    /// Material points of the surface, in the body's frame: corners of a box, poles of a ball, eight points on each edge of a wheel, nine
    /// of a sheet at rest.
    pub fn landmarks(&self) -> Vec<DVec3> {
        let signs = [-1.0, 1.0];
        match *self {
            Self::Sphere { radius } => DVec3::AXES.iter().flat_map(|&a| signs.map(|s| a * (s * radius))).collect(),
            Self::Box { half } => {
                let corner = |k: usize| DVec3::new(signs[k & 1], signs[k >> 1 & 1], signs[k >> 2]);
                (0..8).map(|k| corner(k) * half).collect()
            }
            Self::Wheel { radius, half_width } => {
                let rim = |k: u32| DVec2::from_angle(std::f64::consts::FRAC_PI_4 * f64::from(k)) * radius;
                (0..8).flat_map(|k| signs.map(|s| rim(k).extend(s * half_width))).collect()
            }
            Self::Sheet { half, .. } => {
                let place = |k: u32| DVec2::new(f64::from(k % 3), f64::from(k / 3)) - DVec2::ONE;
                (0..9).map(|k| (place(k) * half).extend(0.0)).collect()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Motion;

    fn body(shape: Shape) -> Body {
        let motion = Motion { start: DVec3::X, velocity: DVec3::Y, ..Motion::default() };
        Body { name: "it", shape, motion, colors: [[0.0; 3]; 2], pattern: 1.0 }
    }

    #[test]
    fn distances_are_those_of_the_moved_shape() {
        let ball = body(Shape::Sphere { radius: 0.5 });
        assert!((ball.distance(DVec3::new(1.0, 1.0, 2.0), 1.0) - 1.5).abs() < 1e-15);
        assert!((ball.distance(DVec3::X, 0.0) + 0.5).abs() < 1e-15);
        let block = body(Shape::Box { half: DVec3::new(0.1, 0.2, 0.3) });
        assert!((block.distance(DVec3::new(1.0, 0.6, 0.6), 0.0) - 0.5).abs() < 1e-15, "from an edge");
        assert!((block.distance(DVec3::new(1.05, 0.0, 0.0), 0.0) + 0.05).abs() < 1e-15, "inside");
        let wheel = body(Shape::Wheel { radius: 0.5, half_width: 0.1 });
        assert!((wheel.distance(DVec3::new(1.8, 0.0, 0.5), 0.0) - 0.5).abs() < 1e-15, "from the rim");
        assert!((wheel.distance(DVec3::new(1.3, 0.0, 0.06), 0.0) + 0.04).abs() < 1e-15, "inside");
        let sheet = body(Shape::Sheet { half: DVec2::ONE, waves: &[], pace: 1.0 });
        assert!((sheet.distance(DVec3::new(1.2, 0.3, -0.3), 0.0) - 0.3).abs() < 1e-15);
        assert!((sheet.distance(DVec3::new(2.4, 0.0, 0.3), 0.0) - 0.5).abs() < 1e-15);
    }

    #[test]
    fn landmarks_lie_on_the_surface() {
        let wheel = Shape::Wheel { radius: 0.5, half_width: 0.1 };
        let block = Shape::Box { half: DVec3::new(0.1, 0.2, 0.3) };
        for (shape, n) in [(Shape::Sphere { radius: 0.5 }, 6), (block, 8), (wheel, 16)] {
            let (it, points) = (body(shape), shape.landmarks());
            assert_eq!(points.len(), n);
            assert!(points.iter().all(|&p| it.distance(it.position_of(p, 0.7), 0.7).abs() < 1e-14));
            let apart = |a: usize| (0..a).all(|b| (points[a] - points[b]).length() > 0.1);
            assert!((0..n).all(apart));
        }
        assert_eq!(Shape::Sheet { half: DVec2::ONE, waves: &[], pace: 1.0 }.landmarks().len(), 9);
    }
}
