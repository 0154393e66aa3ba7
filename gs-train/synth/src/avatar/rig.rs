//! Rings of cameras around a person, all upright, looking at the centre of its box.
//!
//! Ring 0 has a conditioning camera every 90°, a test camera half-way between two of these, and training cameras
//! between; the other rings train. With four cameras in a ring there is no half-way: then every second camera of
//! the other rings is held out.

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};
use gs_core::Camera;

use gs_data::DataError;
use gs_data::avatar::layout::Role;

/// Horizontal and vertical field of view, radians.
const FOV: f64 = 0.7;
/// Margin around the bounding sphere of the person, as a share of its radius.
const MARGIN: f64 = 0.05;
/// Elevation of the rings by their number, degrees.
const ELEVATIONS: [&[f64]; 3] = [&[8.0], &[5.0, 32.0], &[8.0, 38.0, -18.0]];

/// A camera and its role; its id is its index in the list.
pub(super) struct Rigged {
    pub(super) camera: Camera,
    pub(super) role: Role,
}

/// `rings` rings of `per_ring` cameras (a multiple of 4) of `size × size` pixels around the box.
pub(super) fn rings(per_ring: u32, rings: u32, size: u32, [low, high]: [Vec3; 2]) -> Result<Vec<Rigged>, DataError> {
    let middle = (0.5 * (low + high)).as_dvec3();
    let radius = 0.5 * f64::from((high - low).length()).max(1e-6);
    let distance = radius * (1.0 + MARGIN) / (0.5 * FOV).sin();
    let elevations = ELEVATIONS[(rings as usize - 1).min(ELEVATIONS.len() - 1)];
    let mut out = Vec::with_capacity((per_ring * rings) as usize);
    for (ring, elevation) in elevations.iter().enumerate() {
        for k in 0..per_ring {
            let turn = (f64::from(k) + 0.5 * ring as f64) / f64::from(per_ring) * TAU;
            let e = elevation.to_radians();
            let away = DVec3::new(e.cos() * turn.sin(), e.sin(), e.cos() * turn.cos());
            let eye = middle + distance * away;
            let camera = Camera::look_at(size, size, FOV, eye, middle, DVec3::Y);
            let camera = camera.map_err(|e| DataError::Option {
                name: "size",
                value: size.to_string(),
                rule: format!("a size whose cameras can be made ({e})"),
            })?;
            out.push(Rigged { camera, role: role(ring, k, per_ring) });
        }
    }
    Ok(out)
}

fn role(ring: usize, k: u32, per_ring: u32) -> Role {
    let quarter = per_ring / 4;
    match (ring, k % quarter) {
        (0, 0) => Role::Cond,
        (0, r) if r == quarter / 2 => Role::Test,
        (1.., _) if quarter == 1 && k % 2 == 1 => Role::Test,
        _ => Role::Train,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_rig_has_four_conditioning_cameras_and_tests_between_them() {
        let unit = [-Vec3::ONE, Vec3::ONE];
        for (per_ring, n, want) in
            [(8, 2, [8, 4, 4]), (8, 1, [0, 4, 4]), (16, 3, [40, 4, 4]), (4, 2, [2, 4, 2]), (12, 1, [4, 4, 4])]
        {
            let rig = rings(per_ring, n, 64, unit).unwrap();
            let count = |role| rig.iter().filter(|c| c.role == role).count();
            assert_eq!([count(Role::Train), count(Role::Cond), count(Role::Test)], want, "{per_ring}x{n}");
            let cond: Vec<DVec3> = rig.iter().filter(|c| c.role == Role::Cond).map(|c| c.camera.position()).collect();
            for (a, b) in cond.iter().zip(&cond[1..]) {
                let flat = |p: &DVec3| DVec3::new(p.x, 0.0, p.z).normalize();
                assert!(flat(a).dot(flat(b)).abs() < 1e-12, "a quarter turn apart");
            }
            // The corners of the box are seen by all.
            for (c, corner) in rig.iter().flat_map(|c| [-1.0, 1.0].map(|s| (c, DVec3::new(s, -s, 1.0)))) {
                let p = c.camera.to_pixel(c.camera.to_camera(corner));
                assert!(p.min_element() > 0.0 && p.max_element() < 64.0, "{p}");
            }
        }
    }
}
