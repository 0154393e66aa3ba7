//! Losses of a surface: analytic truths, gradients against differences of definitions written out plainly, `f32` against
//! `f64`, degenerate meshes.
//!
//! | what | tolerance |
//! |---|---|
//! | value against the definition, `f64` | 1e-12 relative |
//! | gradient against central differences, `f64` | 1e-5 of the largest entry |
//! | `f32` positions against `f64` ones | 2e-4 of the largest entry (positions are rounded, stretches are differences) |

use glam::{DVec3, Vec3};
use gs_core::Rng;
use gs_texel::surface::Topology;
use gs_texel::surface_loss::{
    Chamfer, ChamferError, Colors, Isometry, IsometryRule, NormalConsistency, NormalRule, SurfaceColors, SurfaceLoss,
    laplacian,
};
use std::collections::BTreeSet;

const DIFFERENCE: f64 = 1e-5;
const PRODUCTION: f64 = 2e-4;

/// A bumpy sheet of `n × n` vertices, of about a metre, with an open border.
fn sheet(n: usize, seed: u64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut rng = Rng::new(seed, "sheet", 0, 0);
    let mut jitter = || 0.2 / n as f64 * f64::from(rng.normal());
    let at = |i: usize| i as f64 / n as f64;
    let mut points = Vec::new();
    for i in 0..n * n {
        points.push(DVec3::new(at(i % n) + jitter(), at(i / n) + jitter(), 0.1 * (6.0 * at(i % n)).sin() + jitter()));
    }
    let mut faces = Vec::new();
    for i in (0..n * (n - 1)).filter(|i| i % n + 1 < n) {
        let [a, b, c, d] = [i, i + 1, i + n, i + n + 1].map(|v| v as u32);
        faces.extend([[a, b, c], [b, d, c]]);
    }
    (points, faces)
}

fn moved(points: &[DVec3], by: f64, seed: u64) -> Vec<DVec3> {
    let mut rng = Rng::new(seed, "moved", 0, 0);
    let mut some = || f64::from(rng.normal()) * by;
    points.iter().map(|p| *p + DVec3::new(some(), some(), some())).collect()
}

fn topology(faces: &[[u32; 3]], vertices: usize) -> Topology {
    Topology::new(faces, vertices).unwrap()
}

fn rings(faces: &[[u32; 3]], vertices: usize) -> Vec<Vec<u32>> {
    let mut rings = vec![BTreeSet::new(); vertices];
    for &[a, b, c] in faces {
        for (u, v) in [(a, b), (b, c), (c, a), (b, a), (c, b), (a, c)] {
            rings[u as usize].insert(v);
        }
    }
    rings.into_iter().map(|r| r.into_iter().collect()).collect()
}

/// Largest difference of gradient and central differences, relative to the largest entry of either.
fn against_differences(points: &[DVec3], grad: &[DVec3], value: impl Fn(&[DVec3]) -> f64) -> f64 {
    assert!(grad.iter().all(|g| g.is_finite()));
    let h = 1e-6;
    let (mut worst, mut largest) = (0.0f64, 1e-30f64);
    for i in 0..points.len() {
        for k in 0..3 {
            let at = |step: f64| {
                let mut p = points.to_vec();
                p[i][k] += step;
                value(&p)
            };
            let want = (at(h) - at(-h)) / (2.0 * h);
            worst = worst.max((grad[i][k] - want).abs());
            largest = largest.max(want.abs()).max(grad[i][k].abs());
        }
    }
    worst / largest
}

fn narrow(points: &[DVec3]) -> Vec<Vec3> {
    points.iter().map(|p| p.as_vec3()).collect()
}

/// How far the loss of rounded positions is from that of exact ones.
fn apart(a: &SurfaceLoss, b: &SurfaceLoss) -> f64 {
    assert!(a.value.is_finite() && a.grad.iter().all(|g| g.is_finite()));
    let largest = b.grad.iter().map(|g| g.abs().max_element()).fold(1e-30, f64::max);
    let worst = a.grad.iter().zip(&b.grad).map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f64::max);
    (worst / largest).max((a.value - b.value).abs() / b.value)
}

#[test]
fn chamfer_is_its_definition_by_brute_force() {
    let (points, _) = sheet(9, 1);
    let target = moved(&sheet(13, 2).0, 0.01, 3);
    let plain = |p: &[DVec3]| {
        let near = |a: &[DVec3], b: &[DVec3]| {
            let nearest = |x: &DVec3| b.iter().map(|y| x.distance_squared(*y)).fold(f64::INFINITY, f64::min);
            a.iter().map(nearest).sum::<f64>() / a.len() as f64
        };
        near(p, &target) + near(&target, p)
    };
    let chamfer = Chamfer::new(&target).unwrap();
    let loss = chamfer.evaluate(&points).unwrap();
    assert!((loss.value / plain(&points) - 1.0).abs() < 1e-12);
    let error = against_differences(&points, &loss.grad, plain);
    assert!(error < DIFFERENCE, "{error:e}");
    let production = Chamfer::new(&narrow(&target)).unwrap().evaluate(&narrow(&points)).unwrap();
    assert!(apart(&production, &loss) < PRODUCTION, "{:e}", apart(&production, &loss));
}

#[test]
fn chamfer_far_from_the_origin_keeps_its_neighbours() {
    let (points, _) = sheet(9, 1);
    let target = moved(&sheet(13, 2).0, 0.01, 3);
    let far = DVec3::new(3e6, -2e6, 1e6);
    let shift = |p: &[DVec3]| p.iter().map(|p| *p + far).collect::<Vec<_>>();
    let here = Chamfer::new(&target).unwrap().evaluate(&points).unwrap();
    let there = Chamfer::new(&shift(&target)).unwrap().evaluate(&shift(&points)).unwrap();
    assert!(apart(&there, &here) < 1e-7, "{:e}", apart(&there, &here));
}

#[test]
fn chamfer_of_a_shifted_plane_is_twice_its_squared_distance() {
    let grid: Vec<DVec3> = (0..100).map(|i| DVec3::new(f64::from(i % 10), f64::from(i / 10), 0.0)).collect();
    let lifted: Vec<DVec3> = grid.iter().map(|p| *p + 0.25 * DVec3::Z).collect();
    let loss = Chamfer::new(&grid).unwrap().evaluate(&lifted).unwrap();
    assert!((loss.value - 2.0 * 0.0625).abs() < 1e-15);
    assert!(loss.grad.iter().all(|g| (*g - 0.01 * DVec3::Z).length() < 1e-15));
}

#[test]
fn chamfer_along_normals_lets_vertices_slide() {
    let (points, faces) = sheet(9, 1);
    let target = moved(&sheet(13, 2).0, 0.01, 3);
    let normals = topology(&faces, points.len()).normals(&narrow(&points), &faces);
    let normals: Vec<DVec3> = normals.iter().map(|n| n.as_dvec3()).collect();
    let chamfer = Chamfer::new(&target).unwrap();
    let whole = chamfer.evaluate(&points).unwrap();
    assert!(apart(&chamfer.evaluate_anisotropic(&points, &normals, 1.0).unwrap(), &whole) < 1e-12);
    for slide in [0.0, 0.3] {
        let value = |p: &[DVec3]| chamfer.evaluate_anisotropic(p, &normals, slide).unwrap().value;
        let loss = chamfer.evaluate_anisotropic(&points, &normals, slide).unwrap();
        assert!(loss.value < whole.value);
        let error = against_differences(&points, &loss.grad, value);
        assert!(error < DIFFERENCE, "{slide}: {error:e}");
    }
    let along = chamfer.evaluate_anisotropic(&points, &normals, 0.0).unwrap();
    assert!(along.grad.iter().zip(&normals).all(|(g, n)| g.cross(*n).length() < 1e-12 * g.length() + 1e-18));
    // Neighbours along a plane do not count, those above it do.
    let grid: Vec<DVec3> = (0..100).map(|i| DVec3::new(f64::from(i % 10), f64::from(i / 10), 0.0)).collect();
    let lifted: Vec<DVec3> = grid.iter().map(|p| *p + DVec3::new(0.25, 0.0, 0.25)).collect();
    let loss = Chamfer::new(&grid).unwrap().evaluate_anisotropic(&lifted, &[DVec3::Z; 100], 0.0).unwrap();
    assert!((loss.value - 2.0 * 0.0625).abs() < 1e-15);
}

#[test]
fn chamfer_to_faces_is_its_definition_and_rests_on_the_surface() {
    let (points, faces) = sheet(9, 1);
    let topology = topology(&faces, points.len());
    let target = moved(&sheet(13, 2).0, 0.01, 3);
    let chamfer = Chamfer::new(&target).unwrap();
    let value = |p: &[DVec3]| chamfer.evaluate_faces(p, &faces, &topology, None).unwrap().value;
    let loss = chamfer.evaluate_faces(&points, &faces, &topology, None).unwrap();
    let error = against_differences(&points, &loss.grad, value);
    assert!(error < DIFFERENCE, "{error:e}");
    // The nearest face may lie beyond those at the nearest vertices, but hardly ever: the definition by walking all faces.
    let nearest = |q: &DVec3| {
        let steps = (0..=60).flat_map(|i| (0..=60 - i).map(move |j| [i, j].map(|v| f64::from(v) / 60.0)));
        let on = |f: &[u32; 3], [s, t]: [f64; 2]| {
            let [a, b, c] = f.map(|v| points[v as usize]);
            a + s * (b - a) + t * (c - a)
        };
        let to_face = |f: &[u32; 3]| steps.clone().map(|w| on(f, w).distance_squared(*q)).fold(f64::INFINITY, f64::min);
        faces.iter().map(to_face).fold(f64::INFINITY, f64::min)
    };
    let plain = target.iter().map(nearest).sum::<f64>() / target.len() as f64;
    assert!((loss.value / plain - 1.0).abs() < 0.02, "{} {plain}", loss.value);
    // Points on the faces leave the surface where it is; points beside a triangle pull at its border.
    let near_corner = |f: &[u32; 3]| {
        let [a, b, c] = f.map(|v| points[v as usize]);
        0.8 * a + 0.1 * b + 0.1 * c
    };
    let on: Vec<DVec3> = faces.iter().map(near_corner).collect();
    let resting = Chamfer::new(&on).unwrap().evaluate_faces(&points, &faces, &topology, None).unwrap();
    assert!(resting.value < 1e-30 && resting.grad.iter().all(|g| g.length() < 1e-16));
    let triangle = [DVec3::ZERO, DVec3::X, DVec3::Y];
    let one = Topology::new(&[[0, 1, 2]], 3).unwrap();
    for (q, want) in [
        (DVec3::new(-1.0, -1.0, 0.0), 2.0),
        (DVec3::new(2.0, -0.5, 0.0), 1.25),
        (DVec3::new(-0.5, 3.0, 0.0), 4.25),
        (DVec3::new(0.5, -1.0, 1.0), 2.0),
        (DVec3::new(-1.0, 0.5, 0.0), 1.0),
        (DVec3::new(1.0, 1.0, 0.0), 0.5),
        (DVec3::new(0.2, 0.3, -3.0), 9.0),
    ] {
        let loss = Chamfer::new(&[q]).unwrap().evaluate_faces(&triangle, &[[0, 1, 2]], &one, None).unwrap();
        assert!((loss.value - want).abs() < 1e-12, "{q}: {} {want}", loss.value);
    }
}

/// Colours by place in the rest pose of a sheet.
struct Waves {
    rest: Vec<DVec3>,
    faces: Vec<[u32; 3]>,
}

impl Waves {
    fn color(x: DVec3) -> DVec3 {
        DVec3::new((5.0 * x.x).sin(), (4.0 * x.y + 1.0).sin(), (4.0 * (x.x - x.y)).cos())
    }
}

impl SurfaceColors for Waves {
    fn at(&self, face: usize, bary: [f64; 3]) -> (DVec3, [DVec3; 3]) {
        let at = self.faces[face].map(|v| self.rest[v as usize]);
        let x = bary[0] * at[0] + bary[1] * at[1] + bary[2] * at[2];
        let along = |d: DVec3| {
            let diagonal = -4.0 * (4.0 * (x.x - x.y)).sin() * (d.x - d.y);
            DVec3::new(5.0 * (5.0 * x.x).cos() * d.x, 4.0 * (4.0 * x.y + 1.0).cos() * d.y, diagonal)
        };
        (Self::color(x), at.map(along))
    }
}

#[test]
fn colours_of_points_say_how_far_a_surface_slid() {
    let (rest, faces) = sheet(9, 1);
    let paint = &Waves { rest: rest.clone(), faces: faces.clone() };
    let topology = topology(&faces, rest.len());
    // Points of the sheet, and some beside its border.
    let on = |k: usize, f: &[u32; 3]| {
        let [a, b, c] = f.map(|v| rest[v as usize]);
        let s = 0.1 + 0.8 * (k % 7) as f64 / 7.0;
        s * a + (1.0 - s) * (0.3 * b + 0.7 * c)
    };
    let mut target: Vec<DVec3> = faces.iter().enumerate().map(|(k, f)| on(k, f)).collect();
    let colors: Vec<[f32; 3]> = target.iter().map(|q| Waves::color(*q).as_vec3().to_array()).collect();
    let weighing = |weight| Colors { paint, points: &colors, weight };
    let resting = Chamfer::new(&target).unwrap();
    let at_rest = resting.evaluate_faces(&rest, &faces, &topology, Some(&weighing(0.05))).unwrap();
    assert!(at_rest.value < 1e-12 && at_rest.grad.iter().all(|g| g.length() < 1e-7), "{}", at_rest.value);
    let slid: Vec<DVec3> = rest.iter().map(|p| *p + 0.02 * DVec3::X).collect();
    let pull = |colors: Option<&Colors<'_>>| -> f64 {
        let loss = resting.evaluate_faces(&slid, &faces, &topology, colors).unwrap();
        loss.grad.iter().map(|g| g.x).sum()
    };
    assert!(pull(Some(&weighing(0.05))) > 4.0 * pull(None).abs(), "{} {}", pull(Some(&weighing(0.05))), pull(None));
    target.iter_mut().step_by(3).for_each(|q| *q += DVec3::new(0.03, -0.02, 0.04));
    let chamfer = Chamfer::new(&target).unwrap();
    for weight in [0.0, 0.05, 1.0] {
        let colors = weighing(weight);
        let evaluate = |p: &[DVec3]| chamfer.evaluate_faces(p, &faces, &topology, Some(&colors)).unwrap();
        let loss = evaluate(&slid);
        let error = against_differences(&slid, &loss.grad, |p| evaluate(p).value);
        assert!(error < DIFFERENCE, "{weight}: {error:e}");
        let narrowed = chamfer.evaluate_faces(&narrow(&slid), &faces, &topology, Some(&colors)).unwrap();
        assert!(apart(&narrowed, &loss) < PRODUCTION, "{weight}: {:e}", apart(&narrowed, &loss));
    }
    let few = Colors { points: &colors[1..], ..weighing(1.0) };
    let e = chamfer.evaluate_faces(&rest, &faces, &topology, Some(&few)).unwrap_err();
    assert_eq!(e, ChamferError::Colors { got: colors.len() - 1, want: colors.len() });
}

#[test]
fn chamfer_refuses_what_has_no_nearest() {
    let good = [Vec3::ZERO, Vec3::X];
    assert_eq!(Chamfer::new::<Vec3>(&[]).err(), Some(ChamferError::Empty("measured points")));
    let bad = Chamfer::new(&[Vec3::ZERO, Vec3::NAN]).err();
    assert_eq!(bad, Some(ChamferError::NotFinite { what: "measured points", row: 1 }));
    let chamfer = Chamfer::new(&good).unwrap();
    assert_eq!(chamfer.evaluate::<Vec3>(&[]).err(), Some(ChamferError::Empty("vertices")));
    let e = chamfer.evaluate(&[Vec3::INFINITY]).unwrap_err();
    assert!(e.to_string().contains("row 0 of the vertices is not finite"), "{e}");
}

#[test]
fn laplacian_is_its_definition() {
    let (points, faces) = sheet(7, 4);
    let (rings, topology) = (rings(&faces, points.len()), topology(&faces, points.len()));
    let plain = |p: &[DVec3]| {
        let one = |i: usize| {
            let mean = rings[i].iter().map(|&j| p[j as usize]).sum::<DVec3>() / rings[i].len() as f64;
            (mean - p[i]).length_squared()
        };
        (0..p.len()).map(one).sum::<f64>() / (3 * p.len()) as f64
    };
    let loss = laplacian(&points, &topology);
    assert!((loss.value / plain(&points) - 1.0).abs() < 1e-12);
    let error = against_differences(&points, &loss.grad, plain);
    assert!(error < DIFFERENCE, "{error:e}");
    let production = laplacian(&narrow(&points), &topology);
    assert!(apart(&production, &loss) < PRODUCTION, "{:e}", apart(&production, &loss));
    let alone = Topology::new(&[], points.len()).unwrap();
    assert_eq!(laplacian(&points, &alone), SurfaceLoss { value: 0.0, grad: vec![DVec3::ZERO; points.len()] });
}

/// Each form from its own definition.
fn plain_isometry(rest: &[DVec3], faces: &[[u32; 3]], rule: IsometryRule, p: &[DVec3]) -> f64 {
    let one = |a: u32, b: u32| {
        let length = |p: &[DVec3]| p[a as usize].distance(p[b as usize]);
        (length(p) - length(rest)).powi(2)
    };
    let rings = rings(faces, rest.len());
    match rule {
        IsometryRule::AllEdges => {
            let all: Vec<f64> = (0..).zip(&rings).flat_map(|(i, r)| r.iter().map(move |&j| one(i, j))).collect();
            all.iter().sum::<f64>() / all.len() as f64
        }
        IsometryRule::RingMean => {
            let mean = |(i, r): (u32, &Vec<u32>)| r.iter().map(|&j| one(i, j)).sum::<f64>() / r.len() as f64;
            (0..).zip(&rings).map(mean).sum::<f64>() / rest.len() as f64
        }
        IsometryRule::FirstEdge => faces.iter().map(|f| one(f[0], f[1])).sum::<f64>() / faces.len() as f64,
    }
}

#[test]
fn isometry_in_its_three_forms() {
    let (rest, faces) = sheet(7, 5);
    let topology = topology(&faces, rest.len());
    let points = moved(&rest, 0.02, 6);
    let mut values = Vec::new();
    for rule in [IsometryRule::AllEdges, IsometryRule::RingMean, IsometryRule::FirstEdge] {
        let plain = |p: &[DVec3]| plain_isometry(&rest, &faces, rule, p);
        let loss = Isometry::new(&rest, &faces, &topology, rule).evaluate(&points);
        assert!((loss.value / plain(&points) - 1.0).abs() < 1e-12, "{rule:?}");
        let error = against_differences(&points, &loss.grad, plain);
        assert!(error < DIFFERENCE, "{rule:?}: {error:e}");
        let production = Isometry::new(&narrow(&rest), &faces, &topology, rule).evaluate(&narrow(&points));
        assert!(apart(&production, &loss) < PRODUCTION, "{rule:?}: {:e}", apart(&production, &loss));
        values.push(loss.value);
        assert_eq!(Isometry::new(&rest, &faces, &topology, rule).evaluate(&rest).value, 0.0, "a template at rest");
    }
    assert!(values[0] != values[1] && values[1] != values[2]);
}

#[test]
fn isometry_does_not_feel_rigid_motion_and_feels_stretch() {
    let (rest, faces) = sheet(6, 7);
    let turn = glam::DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 2.0) / 3.0, 0.7);
    let rigid: Vec<DVec3> = rest.iter().map(|p| turn * *p + DVec3::new(1.0, 2.0, 3.0)).collect();
    let isometry = Isometry::new(&rest, &faces, &topology(&faces, rest.len()), IsometryRule::AllEdges);
    assert!(isometry.evaluate(&rigid).value < 1e-29);
    let twice: Vec<DVec3> = rest.iter().map(|p| 2.0 * *p).collect();
    let squares: f64 = (0..)
        .zip(rings(&faces, rest.len()))
        .flat_map(|(i, r)| r.into_iter().map(move |j| (i, j)))
        .map(|(i, j): (usize, u32)| rest[i].distance_squared(rest[j as usize]))
        .sum();
    let want = squares / (2.0 * isometry.len() as f64);
    assert!((isometry.evaluate(&twice).value / want - 1.0).abs() < 1e-12);
}

/// Both forms from their definitions, without degenerate faces.
fn plain_normals(faces: &[[u32; 3]], rule: NormalRule, p: &[DVec3]) -> f64 {
    let normal = |f: &[u32; 3]| {
        let [a, b, c] = f.map(|v| p[v as usize]);
        (b - a).cross(c - a).normalize()
    };
    match rule {
        NormalRule::FacePairs => {
            let shared = |f: &[u32; 3], g: &[u32; 3]| f.iter().filter(|v| g.contains(v)).count() == 2;
            let mut cosines = Vec::new();
            for (i, f) in faces.iter().enumerate() {
                cosines.extend(faces[..i].iter().filter(|g| shared(f, g)).map(|g| normal(f).dot(normal(g))));
            }
            1.0 - cosines.iter().sum::<f64>() / cosines.len() as f64
        }
        NormalRule::VertexRing => {
            let mut normals = vec![DVec3::ZERO; p.len()];
            for f in faces {
                for k in 0..3 {
                    let [a, b, c] = [0, 1, 2].map(|j| p[f[(k + j) % 3] as usize]);
                    normals[f[k] as usize] += (b - a).angle_between(c - a) * normal(f);
                }
            }
            let n: Vec<DVec3> = normals.iter().map(|n| n.normalize()).collect();
            let rings = rings(faces, p.len());
            let mean =
                |i: usize| rings[i].iter().map(|&j| 1.0 - n[i].dot(n[j as usize])).sum::<f64>() / rings[i].len() as f64;
            (0..p.len()).map(mean).sum::<f64>() / p.len() as f64
        }
    }
}

#[test]
fn normal_consistency_in_both_forms() {
    let (points, faces) = sheet(6, 8);
    for rule in [NormalRule::FacePairs, NormalRule::VertexRing] {
        let plain = |p: &[DVec3]| plain_normals(&faces, rule, p);
        let consistency = NormalConsistency::new(&faces, &topology(&faces, points.len()), rule);
        let loss = consistency.evaluate(&points);
        assert!((loss.value / plain(&points) - 1.0).abs() < 1e-12, "{rule:?}");
        let error = against_differences(&points, &loss.grad, plain);
        assert!(error < DIFFERENCE, "{rule:?}: {error:e}");
        let production = consistency.evaluate(&narrow(&points));
        assert!(apart(&production, &loss) < PRODUCTION, "{rule:?}: {:e}", apart(&production, &loss));
        let flat: Vec<DVec3> = points.iter().map(|p| DVec3::new(p.x, p.y, 0.5)).collect();
        assert!(consistency.evaluate(&flat).value.abs() < 1e-15, "{rule:?}: a plane");
    }
}

/// Folds of the surface at rest cost nothing, and pull nowhere.
#[test]
fn normals_from_rest_leave_the_surface_at_rest() {
    let (rest, faces) = sheet(6, 8);
    for rule in [NormalRule::FacePairs, NormalRule::VertexRing] {
        let flat = NormalConsistency::new(&faces, &topology(&faces, rest.len()), rule);
        let length = |loss: &SurfaceLoss| loss.grad.iter().map(|g| g.length_squared()).sum::<f64>().sqrt();
        assert!(length(&flat.evaluate(&rest)) > 1e-3, "{rule:?}: folds pull");
        let consistency = flat.from_rest(&rest);
        let still = consistency.evaluate(&rest);
        assert!(still.value == 0.0 && length(&still) < 1e-15, "{rule:?}: {:e}", length(&still));
        let points = moved(&rest, 0.02, 11);
        let loss = consistency.evaluate(&points);
        let error = against_differences(&points, &loss.grad, |p| consistency.evaluate(p).value);
        assert!(loss.value > 1e-4 && error < DIFFERENCE, "{rule:?}: {error:e}");
        let production = consistency.evaluate(&narrow(&points));
        assert!(apart(&production, &loss) < PRODUCTION, "{rule:?}: {:e}", apart(&production, &loss));
    }
}

#[test]
fn a_right_angled_fold_costs_one_pair() {
    let points = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(0.5, 0.0, 1.0)];
    let faces = [[0, 1, 2], [1, 0, 3]];
    let consistency = NormalConsistency::new(&faces, &topology(&faces, 4), NormalRule::FacePairs);
    assert!((consistency.evaluate(&points).value - 1.0).abs() < 1e-15);
}

/// A sheet with a face of no area, in the middle of things: nothing changes and nothing is NaN.
#[test]
fn degenerate_faces_contribute_nothing() {
    let (rest, mut faces) = sheet(5, 9);
    let points = moved(&rest, 0.02, 10);
    let with = |faces: &[[u32; 3]]| {
        let iso = [IsometryRule::AllEdges, IsometryRule::RingMean, IsometryRule::FirstEdge]
            .map(|r| Isometry::new(&rest, faces, &topology(faces, rest.len()), r).evaluate(&points));
        iso.to_vec()
    };
    let before = with(&faces);
    faces.extend([[3, 3, 20], [7, 7, 7], [0, 24, 24]]);
    assert_eq!(with(&faces), before);

    // Faces that collapse under the deformation, by two corners and by three.
    for rule in [NormalRule::FacePairs, NormalRule::VertexRing] {
        let (mut points, faces) = sheet(5, 9);
        points[6] = points[7];
        points[12] = points[7];
        let loss = NormalConsistency::new(&faces, &topology(&faces, points.len()), rule).evaluate(&points);
        assert!(loss.value.is_finite() && loss.grad.iter().all(|g| g.is_finite()), "{rule:?}");
        let flat = [[0, 0, 1], [0, 1, 1]];
        let all = NormalConsistency::new(&flat, &topology(&flat, 2), rule).evaluate(&[DVec3::ZERO, DVec3::X]);
        assert_eq!(all, SurfaceLoss { value: 0.0, grad: vec![DVec3::ZERO; 2] }, "{rule:?}");
    }
    // Three corners on a line.
    let line = [
        DVec3::new(0.5563841462135315, -0.4091322422027588, -0.297284871339798),
        DVec3::new(-0.34131866693496704, -0.26483234763145447, 0.15485335886478424),
        DVec3::new(0.257149875164032, -0.36103227734565735, -0.14657212793827057),
    ];
    let q = DVec3::new(-0.0060662333853542805, -0.37707632780075073, -0.02630871720612049);
    let one = topology(&[[0, 1, 2]], 3);
    let none = Chamfer::new(&[q]).unwrap().evaluate_faces(&line, &[[0, 1, 2]], &one, None).unwrap();
    assert_eq!(none, SurfaceLoss { value: 0.0, grad: vec![DVec3::ZERO; 3] });
    let point = Isometry::new(&[DVec3::ZERO; 3], &[[0, 1, 2]], &topology(&[[0, 1, 2]], 3), IsometryRule::AllEdges);
    assert!(point.is_empty());
}

/// The Chamfer queries are the only parallel part.
#[test]
fn threads_do_not_change_bits() {
    let (points, target) = (sheet(40, 11).0, moved(&sheet(50, 12).0, 0.01, 13));
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| Chamfer::new(&target).unwrap().evaluate(&points).unwrap())
    };
    assert_eq!(run(1), run(4));
}
