//! Charts, the islands of a texture: faces connected by edges shared both on the mesh and in the texture.

use glam::Vec2;

/// A vertex and the bits of its texture coordinate.
type End = (u32, [u32; 2]);

/// Chart of each face, numbered by lowest face. Charts beyond 65535 share the last number.
pub(super) fn of_faces(faces: &[[u32; 3]], uvs: &[Vec2], face_uvs: &[[u32; 3]]) -> Vec<u16> {
    let mut sides: Vec<([End; 2], u32)> = Vec::with_capacity(3 * faces.len());
    for (f, (face, uv)) in faces.iter().zip(face_uvs).enumerate() {
        let end = |i: usize| (face[i], uvs[uv[i] as usize].to_array().map(|v| (v + 0.0).to_bits()));
        for i in 0..3 {
            let (a, b) = (end(i), end((i + 1) % 3));
            sides.push(([a.min(b), a.max(b)], f as u32));
        }
    }
    sides.sort_unstable();
    let mut parent: Vec<u32> = (0..faces.len() as u32).collect();
    for same in sides.chunk_by(|a, b| a.0 == b.0) {
        for pair in same.windows(2) {
            let (a, b) = (root(&mut parent, pair[0].1), root(&mut parent, pair[1].1));
            parent[a.max(b) as usize] = a.min(b);
        }
    }
    let mut number = vec![u16::MAX; faces.len()];
    let mut next = 0u16;
    (0..faces.len() as u32)
        .map(|f| {
            let r = root(&mut parent, f);
            // The root is the lowest face of its chart, so it is met first.
            if r == f {
                number[f as usize] = next;
                next = next.saturating_add(1);
            }
            number[r as usize]
        })
        .collect()
}

/// The lowest face of a chart (union-find with path halving).
fn root(parent: &mut [u32], mut f: u32) -> u32 {
    while parent[f as usize] != f {
        parent[f as usize] = parent[parent[f as usize] as usize];
        f = parent[f as usize];
    }
    f
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seam_on_the_mesh_or_in_the_texture_parts_charts() {
        let uvs = [[0.0, 0.0], [0.5, 0.0], [0.5, 0.5], [0.0, 0.5], [0.0, 0.0], [0.5, 0.0]].map(Vec2::from_array);
        let whole = of_faces(&[[0, 1, 2], [0, 2, 3]], &uvs, &[[0, 1, 2], [4, 2, 3]]);
        assert_eq!(whole, [0, 0], "copies of a coordinate are one");
        let parted = of_faces(&[[0, 1, 2], [4, 5, 3], [0, 2, 6]], &uvs, &[[0, 1, 2], [0, 2, 3], [0, 2, 3]]);
        assert_eq!(parted, [0, 1, 0], "touching in the texture alone is not joined");
    }
}
