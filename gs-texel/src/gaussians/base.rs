//! What the surface gives each texel: a point, a matrix, a rotation, a refinement of scale.

use crate::texels::TexelTable;
use glam::{Affine3A, DAffine3, DVec3, Vec3};
use gs_core::{Camera, rot};
use rayon::prelude::*;

/// Texels to a thread at least.
const CHUNK: usize = 1024;

/// The base maps of all valid texels, `K` rows in the order of [`TexelTable::valid`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TexelBase {
    /// `c`: points of the deformed bind pose.
    pub points: Vec<Vec3>,
    /// `[R | τ]`: blended skinning matrices, relative to whatever origin the vertices' were.
    pub transforms: Vec<Affine3A>,
    /// `q_R`: rotations `(w, x, y, z)` of the matrices.
    pub turns: Vec<[f32; 4]>,
    /// `κ`: factors on all three standard deviations.
    pub kappas: Vec<f32>,
}

/// Columns of vertices that do not belong together.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BaseError {
    /// One has another number of rows.
    #[error("`{column}` has {got} rows, the mesh has {want} vertices")]
    Length {
        /// Which column.
        column: &'static str,
        /// Its rows.
        got: usize,
        /// Rows needed.
        want: usize,
    },
    /// A value that is not finite.
    #[error("row {row} of `{column}` is not finite; check the pose and the offsets of this frame")]
    NotFinite {
        /// Which column.
        column: &'static str,
        /// The first such row.
        row: usize,
    },
    /// A face names a vertex that is not there.
    #[error("face {face} names a vertex beyond the {vertices} of the mesh")]
    Face {
        /// Which face.
        face: u32,
        /// Vertices there.
        vertices: usize,
    },
}

impl TexelBase {
    /// From columns of vertices: the deformed bind pose `v̄ + D`, the blended matrices and their rotations
    /// ([`crate::skin`]), and κ. Rotations are blended as quaternions, turned to the side of the first corner.
    ///
    /// # Errors
    /// If columns differ in length, a value is not finite, or a face names a vertex that is not there.
    pub fn new(
        table: &TexelTable,
        faces: &[[u32; 3]],
        points: &[Vec3],
        transforms: &[Affine3A],
        turns: &[[f32; 4]],
        kappas: &[f32],
    ) -> Result<Self, BaseError> {
        let want = points.len();
        for (column, got) in [("transforms", transforms.len()), ("rotations", turns.len()), ("kappas", kappas.len())] {
            if got != want {
                return Err(BaseError::Length { column, got, want });
            }
        }
        let bad = |face: &u32| faces.get(*face as usize).is_none_or(|f| f.iter().any(|v| *v as usize >= want));
        if let Some(&face) = table.tri.iter().find(|f| bad(f)) {
            return Err(BaseError::Face { face, vertices: want });
        }
        let finite = |column, row: Option<usize>| row.map_or(Ok(()), |row| Err(BaseError::NotFinite { column, row }));
        finite("points", points.iter().position(|p| !p.is_finite()))?;
        finite("transforms", transforms.iter().position(|t| !t.is_finite()))?;
        finite("rotations", turns.iter().position(|q| !q.iter().all(|v| v.is_finite())))?;
        finite("kappas", kappas.iter().position(|k| !k.is_finite()))?;
        let row = |k: usize| {
            let (face, w) = (faces[table.tri[k] as usize].map(|v| v as usize), table.weights(k));
            let mut transform = Affine3A::ZERO;
            let mut turn = [0.0f32; 4];
            for (v, w) in face.into_iter().zip(w) {
                transform.matrix3 += transforms[v].matrix3 * w;
                transform.translation += transforms[v].translation * w;
                let along: f32 = turns[v].iter().zip(turns[face[0]]).map(|(a, b)| a * b).sum();
                let w = if along < 0.0 { -w } else { w };
                turn = std::array::from_fn(|i| turn[i] + w * turns[v][i]);
            }
            let unit = rot::normalise(turn).wxyz;
            let turn = if unit == [0.0; 4] { [1.0, 0.0, 0.0, 0.0] } else { unit };
            let kappa = face.into_iter().zip(w).map(|(v, w)| kappas[v] * w).sum::<f32>();
            let point = face.into_iter().zip(w).map(|(v, w)| points[v] * w).sum::<Vec3>();
            (point, transform, turn, kappa)
        };
        let rows: Vec<_> = (0..table.len()).into_par_iter().with_min_len(CHUNK).map(row).collect();
        let mut base = Self::default();
        for (point, transform, turn, kappa) in rows {
            base.points.push(point);
            base.transforms.push(transform);
            base.turns.push(turn);
            base.kappas.push(kappa);
        }
        Ok(base)
    }

    /// Texels.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}

/// The joints' matrices with `origin` (the root's position, say) moved to zero, in `f64`: blend these.
pub fn about(joints: &[DAffine3], origin: DVec3) -> Vec<DAffine3> {
    let moved = |a: &DAffine3| DAffine3 { translation: a.translation - origin, ..*a };
    joints.iter().map(moved).collect()
}

/// The camera that sees a world moved by `−origin` as `camera` sees the world.
pub fn camera_about(camera: &Camera, origin: DVec3) -> Camera {
    Camera { translation: camera.translation + camera.rotation * origin, ..camera.clone() }
}
