//! Skinning against closed forms: what a blend of two turned bones does, the rotation that is nearest to it, and gradients
//! in three levels (closed form, `f64` twin against central differences, `f32` against the twin to 1e-6 of the largest).

use glam::{DAffine3, DMat3, DVec3, Vec3};
use gs_core::{Rng, rot};
use gs_texel::skeleton::{axis_angle, rotation_matrix};
use gs_texel::skin::{blend, blend_dual, quat_of, rotation_of, rotations, skin, skin_backward};
use gs_texel::surface::Topology;
use gs_texel::{Pose, SkinWeights, Skinning};

const IDENTITY: [f32; 4] = [1.0, 0.0, 0.0, 0.0];

/// Two joints at weight ½ on every vertex.
fn halves(n: usize) -> SkinWeights {
    let mut weights = SkinWeights::default();
    (0..n).for_each(|_| assert!(weights.push([(0, 0.5), (1, 0.5)], 0)));
    weights
}

fn turned(degrees: f64) -> [DAffine3; 2] {
    let turn = rotation_matrix(axis_angle(DVec3::X, degrees.to_radians()));
    [DAffine3::IDENTITY, DAffine3::from_mat3(turn)]
}

fn random_affine(r: &mut Rng) -> DAffine3 {
    let mut v = || DVec3::new(r.normal().into(), r.normal().into(), r.normal().into());
    let turn = rotation_matrix(axis_angle(v(), v().x));
    let stretch = DMat3::from_diagonal(DVec3::ONE + 0.2 * v().clamp(DVec3::splat(-2.0), DVec3::splat(2.0)));
    DAffine3::from_mat3_translation(turn * stretch, v())
}

/// Weights of four of six joints, and those joints.
fn random_rig(n: usize) -> (SkinWeights, Vec<DAffine3>) {
    let mut r = Rng::new(3, "rig", 0, 0);
    let joints = (0..6).map(|_| random_affine(&mut r)).collect();
    let mut weights = SkinWeights::default();
    for _ in 0..n {
        assert!(weights.push([0; 4].map(|_| (r.below(6), r.range(0.01, 1.0))), 0));
    }
    (weights, joints)
}

fn points(n: usize, purpose: &str) -> Vec<Vec3> {
    let point = |row| {
        let mut r = Rng::new(4, purpose, 0, row as u64);
        Vec3::new(r.normal(), r.normal(), r.normal())
    };
    (0..n).map(point).collect()
}

#[test]
fn twisted_bones_collapse_linearly_and_keep_their_radius_as_dual_quaternions() {
    let weights = halves(1);
    for degrees in [0.0f64, 30.0, 60.0, 90.0, 120.0, 150.0, 179.0] {
        let joints = turned(degrees);
        let radius = |skinning: Skinning| {
            let moved = skin(&[Vec3::new(0.3, 1.0, 0.0)], &skinning.blend(&weights, &joints))[0];
            assert!((moved.x - 0.3).abs() < 1e-6);
            f64::from(moved.y.hypot(moved.z))
        };
        let half = (0.5 * degrees).to_radians().cos();
        assert!((radius(Skinning::Lbs) - half).abs() < 1e-6, "{degrees}");
        assert!((radius(Skinning::Dqs) - 1.0).abs() < 1e-6, "{degrees}");
    }
}

/// Angle in degrees and length of the quaternion read off a matrix that is no rotation, as if it were one.
fn raw_quaternion(m: &DMat3) -> (f64, f64) {
    let w = 0.5 * (1.0 + m.x_axis.x + m.y_axis.y + m.z_axis.z).sqrt();
    let v = DVec3::new(m.y_axis.z - m.z_axis.y, m.z_axis.x - m.x_axis.z, m.x_axis.y - m.y_axis.x) / (4.0 * w);
    (2.0 * v.length().atan2(w).to_degrees(), w.hypot(v.length()))
}

#[test]
fn the_polar_factor_turns_by_half_where_the_raw_quaternion_falls_short() {
    // Angle between the bones, angle of the raw quaternion, its length.
    for (degrees, raw, length) in [(60.0, 27.8, 0.964), (90.0, 36.9, 0.913), (120.0, 38.2, 0.837), (150.0, 26.4, 0.750)]
    {
        let joints = turned(degrees);
        let mixed = (joints[0].matrix3 + joints[1].matrix3) * 0.5;
        let (angle, norm) = raw_quaternion(&mixed);
        assert!((angle - raw).abs() < 0.05 && (norm - length).abs() < 5e-4, "{degrees}: {angle} {norm}");
        let q = quat_of(&rotation_of(mixed).unwrap());
        let want = axis_angle(DVec3::X, (0.5f64 * degrees).to_radians());
        assert!(q.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-12), "{degrees}: {q:?}");
        let q = rotations(&halves(1), &joints, &blend(&halves(1), &joints))[0];
        assert!(q.iter().zip(want).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-6), "{degrees}: {q:?}");
    }
}

#[test]
fn the_nearest_rotation_of_stretched_matrices() {
    let mut r = Rng::new(5, "polar", 0, 0);
    for case in 0..2000 {
        let mut v = || DVec3::new(r.normal().into(), r.normal().into(), r.normal().into());
        let turn = rotation_matrix(axis_angle(v(), 3.0 * v().x));
        let axes = rotation_matrix(axis_angle(v(), 3.0));
        // Stretch along any axes, of any size, down to a determinant of about 1e-5 of the size cubed.
        let lengths = DVec3::new(1.0, v().x.abs() + 0.1, 10f64.powf(-(v().x.abs() * 2.0).min(3.5)));
        let size = 10f64.powf(3.0 * v().x);
        let stretch = axes * DMat3::from_diagonal(lengths * size) * axes.transpose();
        let Some(got) = rotation_of(turn * stretch) else {
            assert!(lengths.z * lengths.y < 1e-4, "case {case}: {lengths}");
            continue;
        };
        assert!(got.abs_diff_eq(turn, 1e-10), "case {case}: {got} {turn}");
        // Turned inside out: the rotation that maps ellipsoids alike.
        assert!(rotation_of(turn * stretch * -1.0).unwrap().abs_diff_eq(turn, 1e-10));
    }
    for bad in
        [DMat3::ZERO, DMat3::from_diagonal(DVec3::new(1.0, 1.0, 0.0)), DMat3::from_diagonal(DVec3::splat(f64::NAN))]
    {
        assert_eq!(rotation_of(bad), None);
    }
    assert_eq!(rotation_of(DMat3::IDENTITY * f64::INFINITY), None);
}

#[test]
fn a_collapsed_blend_takes_the_heaviest_joint() {
    let mut weights = SkinWeights::default();
    assert!(weights.push([(0, 0.5), (1, 0.5)], 0));
    assert!(weights.push([(0, 0.4999), (1, 0.5001)], 0));
    assert!(weights.push([(2, 1.0)], 0));
    let mut joints = turned(180.0).to_vec();
    joints.push(DAffine3::from_mat3(DMat3::ZERO));
    let q = rotations(&weights, &joints, &blend(&weights, &joints));
    assert_eq!(q[0], IDENTITY, "the first of equals");
    assert!((q[1][1].abs() - 1.0).abs() < 1e-6, "{:?}", q[1]);
    assert_eq!(q[2], IDENTITY, "a joint without rotation");
    // Dual quaternions at 180° still have a middle: 90°.
    let moved = skin(&[Vec3::Y; 3], &blend_dual(&weights, &joints));
    assert!((moved[0].length() - 1.0).abs() < 1e-6 && moved.iter().all(|p| p.is_finite()), "{moved:?}");
}

#[test]
fn one_joint_moves_its_vertices_as_it_moves_itself() {
    let mut r = Rng::new(6, "one", 0, 0);
    let joints = [random_affine(&mut r)];
    let mut weights = SkinWeights::default();
    assert!(weights.push([(0, 1.0)], 0));
    let p = Vec3::new(0.2, -1.5, 0.7);
    let want = joints[0].transform_point3(p.as_dvec3());
    for skinning in [Skinning::Lbs, Skinning::Dqs] {
        let got = skin(&[p], &skinning.blend(&weights, &joints))[0].as_dvec3();
        assert!(got.abs_diff_eq(want, 1e-6), "{skinning:?}: {got} {want}");
    }
}

/// The `f64` twin: a point moved by its weights.
fn twin(weights: &SkinWeights, joints: &[DAffine3], i: usize, v: DVec3) -> DVec3 {
    weights.row(i).map(|(j, w)| joints[j as usize].transform_point3(v) * f64::from(w)).sum::<DVec3>()
}

#[test]
fn points_and_gradients_follow_the_twin() {
    const N: usize = 400;
    let (weights, joints) = random_rig(N);
    let (v, g) = (points(N, "v"), points(N, "g"));
    let transforms = blend(&weights, &joints);
    let (x, back) = (skin(&v, &transforms), skin_backward(&transforms, &g));
    assert!(x.iter().chain(&back).all(|v| v.is_finite()));
    let (mut worst_x, mut worst_g) = (0.0f64, 0.0f64);
    for i in 0..N {
        let at = |v: DVec3| twin(&weights, &joints, i, v);
        worst_x = worst_x.max((x[i].as_dvec3() - at(v[i].as_dvec3())).length());
        let slope = |e: DVec3| {
            let h = 1e-6;
            (at(v[i].as_dvec3() + e * h) - at(v[i].as_dvec3() - e * h)).dot(g[i].as_dvec3()) / (2.0 * h)
        };
        let numeric = DVec3::new(slope(DVec3::X), slope(DVec3::Y), slope(DVec3::Z));
        let exact: DMat3 = weights.row(i).fold(DMat3::ZERO, |m, (j, w)| m + joints[j as usize].matrix3 * f64::from(w));
        let exact = exact.transpose() * g[i].as_dvec3();
        assert!(exact.abs_diff_eq(numeric, 1e-8), "{exact} {numeric}");
        worst_g = worst_g.max((back[i].as_dvec3() - exact).length());
    }
    assert!(worst_x < 5e-6 && worst_g < 5e-6, "{worst_x} {worst_g}");
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let (weights, joints) = random_rig(3000);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let transforms = blend(&weights, &joints);
            let dual = blend_dual(&weights, &joints);
            (rotations(&weights, &joints, &transforms), transforms, dual)
        })
    };
    let one = run(1);
    assert_eq!(one, run(3));
    assert!(one.0.iter().all(|q| q[0] >= 0.0 && (q.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5));
    let m = rot::matrix(one.0[0]);
    assert!(m.iter().flatten().all(|v| v.is_finite()));
}

#[test]
fn where_the_root_faces_is_not_in_the_root_free_normals() {
    let person = gs_texel::figure::person();
    let (t, skeleton) = (&person.template, &person.skeleton);
    let normals = Topology::new(&t.faces, t.vertices.len()).unwrap().normals(&t.vertices, &t.faces);
    let root_free = |pose: &Pose| -> Vec<Vec3> {
        let transforms = Skinning::Lbs.blend(&t.weights, &skeleton.skinning(pose));
        let back = skeleton.root_rotation(pose).transpose().as_mat3();
        normals.iter().zip(&transforms).map(|(n, m)| back * (m.matrix3 * *n)).collect()
    };
    let walking = person.clips[0].pose(skeleton, 0.3);
    let mut turned = walking.clone();
    turned.turn(skeleton.root, DVec3::new(0.3, 1.0, -0.2), 1.9);
    turned.locals[skeleton.root as usize].translation += DVec3::new(4.0, -1.0, 2.0);
    let off = |(a, b): (Vec3, Vec3)| (a - b).length();
    let worst = |a: Vec<Vec3>, b: Vec<Vec3>| a.into_iter().zip(b).map(off).fold(0.0f32, f32::max);
    assert!(worst(root_free(&walking), root_free(&turned)) < 1e-5);
    assert!(worst(root_free(&walking), root_free(&skeleton.rest_pose())) > 0.5, "other joints are in them");
}
