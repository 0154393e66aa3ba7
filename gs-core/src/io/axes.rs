//! Axes of splat files, and scenes carried from one convention to another.
//!
//! | files | x, y, z point | up |
//! |---|---|---|
//! | `.ply`, `.splat` (and [`RawSplats`]) | right, down, front | −y |
//! | `.spz` | right, up, back, unless an extension names others | +y |
//! | `.glb` | left, up, front | +y |
//!
//! The three are rotations of one another, so a scene written in each looks the same in every viewer that knows them.

use super::RawSplats;
use crate::rot::{self, Mat3};
use crate::sh::{ShRotation, coeffs};
use glam::{DMat3, DQuat, DVec3, Vec3};

/// In which axes each SH function from the second on is odd: bit 2 for x, 1 for y, 0 for z.
const ODD: [u8; 15] = [2, 1, 4, 6, 3, 0, 5, 0, 2, 7, 2, 1, 4, 1, 4];

/// Sign of each SH function from the second on when the signs of some axes change.
fn sh_signs(flipped: [bool; 3]) -> [f32; 15] {
    let mask = flipped.iter().fold(0, |mask, &f| mask << 1 | u8::from(f));
    ODD.map(|odd| if (odd & mask).count_ones() % 2 == 1 { -1.0 } else { 1.0 })
}

impl RawSplats {
    /// The scene with the signs of some axes changed: a rotation by 180° if they are two, a mirror image if one or three. Exact.
    pub fn flipped(mut self, axes: [bool; 3]) -> Self {
        let [x, y, z] = axes.map(|flip| if flip { -1.0f32 } else { 1.0 });
        for mean in &mut self.means {
            *mean *= Vec3::new(x, y, z);
        }
        for [_, i, j, k] in &mut self.quats {
            (*i, *j, *k) = (y * z * *i, x * z * *j, x * y * *k);
        }
        let (signs, width) = (sh_signs(axes), self.sh_width());
        for row in self.sh.chunks_exact_mut(width) {
            for (rgb, sign) in row.as_chunks_mut::<3>().0.iter_mut().skip(1).zip(signs) {
                *rgb = rgb.map(|v| sign * v);
            }
        }
        self
    }

    /// The scene under a rotation, or a rotation and a reflection, given by the rows of its matrix: centres `M m`, covariances
    /// `M Σ Mᵀ`, colours `f(Mᵀ d)`.
    pub fn mapped(mut self, map: &Mat3<f64>) -> Self {
        let matrix = DMat3::from_cols_array_2d(map).transpose();
        for mean in &mut self.means {
            *mean = (matrix * mean.as_dvec3()).as_vec3();
        }
        // A Gaussian does not change with the signs of its axes: of a reflection, the rotation in it is enough.
        let turn = rot::from_glam(DQuat::from_mat3(&(matrix * matrix.determinant())).as_quat());
        for quat in &mut self.quats {
            *quat = rot::hamilton(turn, *quat);
        }
        if self.degree > 0 {
            let rotation = ShRotation::new(&map.map(|row| row.map(|v| v as f32)), self.degree);
            let width = 3 * coeffs(self.degree);
            for row in self.sh.chunks_exact_mut(width) {
                rotation.apply(row);
            }
        }
        self
    }
}

/// The rotation by the shortest way that makes the direction `up` of a scene the up direction of `.ply` files, −y, by rows;
/// none if `up` has no direction.
///
/// ```
/// use gs_core::io::upright;
///
/// let rows = upright(glam::DVec3::Z).unwrap(); // z up, as in Blender
/// assert_eq!(rows.map(|row| row[2].round()), [0.0, -1.0, 0.0]);
/// assert!(upright(glam::DVec3::ZERO).is_none());
/// ```
pub fn upright(up: DVec3) -> Option<Mat3<f64>> {
    let up = up.try_normalize()?;
    // Of the half turns that put a scene on its feet, the one about x keeps what is right.
    let turn = if up.dot(DVec3::Y) > 1.0 - 1e-9 {
        DQuat::from_rotation_x(std::f64::consts::PI)
    } else {
        DQuat::from_rotation_arc(up, DVec3::NEG_Y)
    };
    Some(DMat3::from_quat(turn).transpose().to_cols_array_2d())
}

/// The axes that the `.spz` extension of Adobe can name, in the order of its numbers from 1 on: where x, y and z point, each
/// `L`eft, `R`ight, `U`p, `D`own, `F`ront or `B`ack.
const NAMED: [&[u8; 3]; 16] = [
    b"LDB", b"RDB", b"LUB", b"RUB", b"LDF", b"RDF", b"LUF", b"RUF", b"LFD", b"RFD", b"LFU", b"RFU", b"LBD", b"RBD",
    b"LBU", b"RBU",
];

/// The map from the axes with a number to those of `.ply` files, by rows; none for a number without a name.
pub(super) fn from_numbered(number: u32) -> Option<Mat3<f64>> {
    let name = NAMED.get(usize::try_from(number).ok()?.checked_sub(1)?)?;
    let columns = name.map(|letter| match letter {
        b'R' => DVec3::X,
        b'L' => DVec3::NEG_X,
        b'D' => DVec3::Y,
        b'U' => DVec3::NEG_Y,
        b'F' => DVec3::Z,
        _ => DVec3::NEG_Z,
    });
    Some(DMat3::from_cols_array_2d(&columns.map(|c| c.to_array())).transpose().to_cols_array_2d())
}

#[cfg(test)]
mod tests {
    use super::super::raw::tests::cloud;
    use super::*;
    use crate::sh;

    /// Largest difference of centres, covariances and colours along a direction.
    fn difference(a: &RawSplats, b: &RawSplats) -> f32 {
        let (p, q) = (a.to_splats().unwrap(), b.to_splats().unwrap());
        let mut worst = 0.0f32;
        for i in 0..p.len() {
            worst = worst.max((p.means[i] - q.means[i]).abs().max_element());
            let covariance = |s: &crate::Splats| {
                let m = rot::matrix(rot::normalise(s.quats[i]).wxyz);
                let v = s.scales[i].to_array().map(|x| x * x);
                [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]]
                    .map(|[r, c]| (0..3).map(|k| m[r][k] * v[k] * m[c][k]).sum())
            };
            for (x, y) in covariance(&p).into_iter().zip::<[f32; 6]>(covariance(&q)) {
                worst = worst.max((x - y).abs() / s_max(&p, i));
            }
        }
        a.sh.iter().zip(&b.sh).fold(worst, |w, (x, y)| w.max((x - y).abs()))
    }

    fn s_max(s: &crate::Splats, i: usize) -> f32 {
        s.scales[i].max_element().powi(2)
    }

    #[test]
    fn signs_follow_from_the_basis() {
        let d = [0.3f64, -0.5, 0.8];
        let plain = sh::basis(d, 3);
        for axes in [[true, false, false], [false, true, false], [false, false, true], [true, true, false]] {
            let flipped = sh::basis(std::array::from_fn(|a| if axes[a] { -d[a] } else { d[a] }), 3);
            for (k, sign) in sh_signs(axes).into_iter().enumerate() {
                assert!((flipped[k + 1] - f64::from(sign) * plain[k + 1]).abs() < 1e-12, "{axes:?} {k}");
            }
        }
    }

    #[test]
    fn a_flip_is_the_map_with_those_signs_and_its_own_inverse() {
        for axes in [[true, false, false], [false, true, true], [true, true, true]] {
            let raw = cloud(50, 3, 3);
            let diagonal = DMat3::from_diagonal(DVec3::from_array(axes.map(|f| if f { -1.0 } else { 1.0 })));
            let flipped = raw.clone().flipped(axes);
            assert!(difference(&flipped, &raw.clone().mapped(&diagonal.to_cols_array_2d())) < 1e-5);
            assert!(difference(&flipped, &raw) > 0.1);
            assert_eq!(flipped.flipped(axes), raw);
        }
    }

    #[test]
    fn a_map_and_its_inverse_give_the_scene_again() {
        let turn = DMat3::from_quat(DQuat::from_xyzw(0.1, -0.7, 0.3, 0.4).normalize());
        for map in [turn, -turn] {
            let raw = cloud(50, 3, 4);
            let there = raw.clone().mapped(&map.transpose().to_cols_array_2d());
            assert!(difference(&there, &raw) > 0.1);
            assert!(difference(&there.mapped(&map.to_cols_array_2d()), &raw) < 1e-5);
        }
    }

    #[test]
    fn upright_puts_up_at_minus_y() {
        for up in [DVec3::X, DVec3::Y, DVec3::NEG_Y, DVec3::NEG_Z, DVec3::new(0.3, -2.0, 1.0)] {
            let rows = upright(up).unwrap();
            let turned = DVec3::from_array(rows.map(|row| DVec3::from_array(row).dot(up.normalize())));
            assert!((turned - DVec3::NEG_Y).length() < 1e-9, "{up}: {turned}");
            assert!((DMat3::from_cols_array_2d(&rows).determinant() - 1.0).abs() < 1e-9);
        }
        assert_eq!(upright(DVec3::Y).unwrap()[0], [1.0, 0.0, 0.0]);
    }

    #[test]
    fn names_of_axes_give_their_maps() {
        let rows = |name: &[u8; 3]| from_numbered(1 + NAMED.iter().position(|n| *n == name).unwrap() as u32).unwrap();
        assert_eq!(rows(b"RDF"), [[1., 0., 0.], [0., 1., 0.], [0., 0., 1.]]);
        assert_eq!(rows(b"RUB"), [[1., 0., 0.], [0., -1., 0.], [0., 0., -1.]]);
        // Right, front, up: y is depth, −z is down.
        assert_eq!(rows(b"RFU"), [[1., 0., 0.], [0., 0., -1.], [0., 1., 0.]]);
        assert!(from_numbered(0).is_none() && from_numbered(17).is_none());
    }
}
