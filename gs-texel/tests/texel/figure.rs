//! The procedural characters: closed, charted without overlap, posed as their closed forms.

use glam::{DVec2, Vec3};
use gs_texel::figure::{Cylinder, body, cylinder, gown, person, plate, sphere};
use gs_texel::surface::Topology;
use gs_texel::{Character, Skinning};
use std::collections::HashMap;

fn all() -> Vec<(&'static str, Character)> {
    vec![
        ("person", person()),
        ("body", body()),
        ("gown", gown()),
        ("sphere", sphere(0.9, 24, 48)),
        ("cylinder", cylinder(&Cylinder::default())),
        ("plate", plate(1.0, 8)),
    ]
}

#[test]
fn surfaces_are_closed_and_face_outwards() {
    for (name, c) in all() {
        let (t, mut edges) = (&c.template, HashMap::new());
        for f in &t.faces {
            for k in 0..3 {
                *edges.entry((f[k], f[(k + 1) % 3])).or_insert(0) += 1;
            }
        }
        assert!(edges.values().all(|n| *n == 1), "{name}: an edge twice in one direction");
        let open = edges.keys().filter(|(a, b)| !edges.contains_key(&(*b, *a))).count();
        assert_eq!(open, if name == "plate" { 32 } else { 0 }, "{name}");
        let point = |v: u32| t.vertices[v as usize].as_dvec3();
        let volume: f64 = t.faces.iter().map(|f| point(f[0]).dot(point(f[1]).cross(point(f[2]))) / 6.0).sum();
        assert!(name == "plate" || volume > 0.03, "{name}: {volume}");
        let flat = |f: &&[u32; 3]| (point(f[1]) - point(f[0])).cross(point(f[2]) - point(f[0])).length() < 1e-9;
        assert_eq!(t.faces.iter().filter(flat).count(), 0, "{name}");
        println!("{name}: {} vertices, {} triangles, volume {volume:.4}", t.vertices.len(), t.faces.len());
    }
    let n = person().template.vertices.len();
    assert!((2000..4000).contains(&n), "{n}");
}

/// The person is eight closed surfaces that run into one another, the body is one.
#[test]
fn the_body_is_one_surface_whose_weights_change_smoothly() {
    for (c, wanted) in [(body(), 1), (person(), 8), (gown(), 5)] {
        let t = &c.template;
        let topology = Topology::new(&t.faces, t.vertices.len()).unwrap();
        let (mut reached, mut parts) = (vec![false; t.vertices.len()], 0);
        while let Some(start) = reached.iter().position(|r| !r) {
            let mut open = vec![start as u32];
            parts += 1;
            while let Some(v) = open.pop() {
                if !std::mem::replace(&mut reached[v as usize], true) {
                    open.extend(topology.ring.row(v as usize));
                }
            }
        }
        assert_eq!((parts, topology.non_manifold), (wanted, 0));
        // Euler: no handles.
        let euler = t.vertices.len() + t.faces.len() - topology.edges.len();
        assert_eq!(euler, 2 * wanted);
    }
    let t = body().template;
    let dense = |v: u32| {
        let mut row = [0.0f32; 17];
        t.weights.row(v as usize).for_each(|(joint, w)| row[joint as usize] = w);
        row
    };
    let mut steepest = (0.0f32, [Vec3::ZERO; 2]);
    for &[a, b] in &Topology::new(&t.faces, t.vertices.len()).unwrap().edges {
        let change: f32 = dense(a).iter().zip(dense(b)).map(|(a, b)| (a - b).abs()).sum();
        let ends = [a, b].map(|v| t.vertices[v as usize]);
        if change > steepest.0 {
            steepest = (change, ends);
        }
    }
    // 2 where one joint takes over from another within an edge.
    assert!(steepest.0 < 1.3, "{steepest:?}");
}

/// Twice the signed area.
fn area(f: &[DVec2; 3]) -> f64 {
    (f[1] - f[0]).perp_dot(f[2] - f[0])
}

#[test]
fn charts_do_not_overlap_and_keep_a_gutter() {
    const SIDE: usize = 512;
    for (name, c) in all() {
        let t = &c.template;
        let corners: Vec<[DVec2; 3]> =
            t.face_uvs.iter().map(|f| f.map(|k| t.uvs[k as usize].as_dvec2() * SIDE as f64)).collect();
        let mut owner = vec![0u32; SIDE * SIDE];
        for f in &corners {
            let twice = area(f);
            assert!(twice.abs() > 1e-6, "{name}: a triangle without area");
            let (low, high) = (f[0].min(f[1]).min(f[2]), f[0].max(f[1]).max(f[2]));
            assert!(low.min_element() > 1.0 && high.max_element() < (SIDE - 1) as f64, "{name}");
            for y in low.y.floor() as usize..=high.y as usize {
                for x in low.x.floor() as usize..=high.x as usize {
                    let q = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                    let inside = (0..3).all(|k| area(&[f[k], f[(k + 1) % 3], q]) / twice > 1e-9);
                    owner[y * SIDE + x] += u32::from(inside);
                }
            }
        }
        assert_eq!(owner.iter().filter(|n| **n > 1).count(), 0, "{name}");
        println!("{name}: {:.0} % of the atlas", 100.0 * owner.iter().sum::<u32>() as f64 / (SIDE * SIDE) as f64);
        let texture = t.materials[0].texture.as_ref().unwrap();
        assert!(texture.data.iter().all(|v| (0.0..=1.0).contains(v)));
    }
}

#[test]
fn bind_poses_stand_and_motions_close() {
    for (name, c) in all() {
        let rest = c.posed(&c.skeleton.rest_pose(), Skinning::Lbs);
        let far = rest.iter().zip(&c.template.vertices).map(|(a, b)| (*a - *b).length()).fold(0.0, f32::max);
        assert!(far < 1e-6, "{name}: {far}");
    }
    for (who, person) in [("person", person()), ("body", body()), ("gown", gown())] {
        assert_eq!(person.skeleton.joints.len(), 17);
        for name in ["walk", "wave", "turn", "touch"] {
            let clip = person.clip(name).unwrap();
            let at = |t: f64| person.posed(&clip.pose(&person.skeleton, t), Skinning::Lbs);
            let (start, middle, end) = (at(0.0), at(0.4 * clip.duration()), at(clip.duration()));
            let far = |a: &[Vec3], b: &[Vec3]| a.iter().zip(b).map(|(a, b)| (*a - *b).length()).fold(0.0, f32::max);
            assert!(far(&start, &end) < 1e-5 && far(&start, &middle) > 0.1, "{who} {name}");
            assert!(middle.iter().all(|p| p.length() < 2.1));
            // The arms hang: nothing is wider than a stride.
            assert!(name == "wave" || start.iter().all(|p| p.x.abs() < 0.6), "{who} {name}");
        }
        for morph in &person.template.morphs {
            let most = morph.offsets.iter().map(|d| d.length()).fold(0.0, f32::max);
            assert!(most > 0.01 && most < 0.08, "{who} {}: {most}", morph.name);
        }
    }
}

/// The hem swings behind the waist, as the formula says.
#[test]
fn the_gown_swings_late() {
    let c = gown();
    let clip = c.clip("walk").unwrap();
    for k in 0..8 {
        let phase = std::f64::consts::TAU * f64::from(k) / 8.0;
        let pose = clip.pose(&c.skeleton, clip.duration() * f64::from(k) / 8.0);
        let (moved, p) = (c.template.morphed(&pose.morphs), phase as f32);
        for (v, m) in c.template.vertices.iter().zip(moved).filter(|(v, _)| v.y < 0.7) {
            let h = (1.06 - v.y) / 0.98;
            let want = h * h * Vec3::new(0.08 * (p - 1.2 * h).sin(), 0.0, 0.05 * (2.0 * p - 1.2 * h).sin());
            assert!((m - *v - want).length() < 1e-5, "{v} {m} {want}");
        }
        let above = c.template.vertices.iter().zip(&c.template.morphs[0].offsets).filter(|(v, _)| v.y > 1.07);
        assert!(above.into_iter().all(|(_, d)| *d == Vec3::ZERO));
    }
}

#[test]
fn the_cylinder_bends_and_twists_as_its_weights_say() {
    let shape = Cylinder::default();
    let c = cylinder(&shape);
    let ring = |posed: &[Vec3], y: f32| {
        let there = c.template.vertices.iter().zip(posed).filter(|(v, _)| (v.y - y).abs() < 1e-6 && v.x != 0.0);
        there.map(|(_, p)| p.x.hypot(p.z)).fold(0.0, f32::max)
    };
    let twist = c.clip("twist").unwrap().pose(&c.skeleton, 1.0);
    let (linear, dual) = (c.posed(&twist, Skinning::Lbs), c.posed(&twist, Skinning::Dqs));
    let half = std::f32::consts::FRAC_PI_4.cos();
    assert!((ring(&linear, 0.5) / shape.radius - half).abs() < 1e-5);
    assert!((ring(&dual, 0.5) / shape.radius - 1.0).abs() < 1e-5);
    assert!((ring(&linear, 1.0) / shape.radius - 1.0).abs() < 1e-5);
    let bend = c.clip("bend").unwrap().pose(&c.skeleton, 1.0);
    let tip = c.posed(&bend, Skinning::Lbs)[c.template.vertices.len() - 1];
    assert!((tip - Vec3::new(0.0, 0.5, 0.5)).length() < 1e-6, "{tip}");
    let ball = sphere(0.9, 24, 48);
    assert!(ball.template.vertices.iter().all(|v| (v.length() - 0.9).abs() < 1e-6));
}
