//! Texel tables, attributes on them, maps read and written back: against what is known exactly.

use crate::scenes::{plate, sphere, two_spheres};
use glam::{Vec2, Vec3};
use gs_core::{Image, Rng};
use gs_texel::texels::{MapReader, SeamRead, TexelError, TexelOptions, TexelTable};

const SQUARE: [[f32; 2]; 4] = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
const HALVES: [[u32; 3]; 2] = [[0, 1, 2], [0, 2, 3]];

fn build(uvs: &[[f32; 2]], faces: &[[u32; 3]], size: usize) -> Result<TexelTable, TexelError> {
    let uvs: Vec<Vec2> = uvs.iter().map(|&p| Vec2::from_array(p)).collect();
    TexelTable::build(faces, &uvs, faces, size, &TexelOptions::default())
}

#[test]
fn a_square_owns_every_texel_once_however_it_is_turned() {
    for size in [1, 2, 7, 64, 100] {
        for faces in [HALVES, [[2, 1, 0], [0, 2, 3]], [[1, 2, 3], [3, 0, 1]]] {
            let table = build(&SQUARE, &faces, size).unwrap();
            assert_eq!((table.len(), table.report.overlaps), (size * size, 0));
        }
    }
}

#[test]
fn texels_cover_the_area_of_the_texture_up_to_its_outline() {
    let figure = two_spheres();
    let area: f64 = figure
        .face_uvs
        .iter()
        .map(|f| {
            let [a, b, c] = f.map(|k| figure.uvs[k as usize].as_dvec2());
            0.5 * (b - a).perp_dot(c - a).abs()
        })
        .sum();
    for size in [64, 128, 256, 512] {
        let table = figure.table(size);
        let got = table.len() as f64 / (size * size) as f64;
        assert!((got - area).abs() < 6.0 / size as f64, "{size}: {got} of {area}");
        assert_eq!((table.report.overlaps, table.report.charts), (0, 2));
        let ends = (0..table.len()).all(|k| table.weights(k).iter().all(|w| (-1e-6..=1.000_001).contains(w)));
        assert!(ends && table.valid.is_sorted());
    }
}

#[test]
fn an_attribute_linear_in_uv_is_reproduced() {
    let figure = plate(Vec3::ZERO, Vec3::X, Vec3::Y, 9, Vec2::splat(0.03), Vec2::new(0.9, 0.97));
    let table = figure.table(200);
    let linear = |uv: Vec2| [0.3 + 0.5 * uv.x - 0.25 * uv.y, uv.y];
    let attribute: Vec<[f32; 2]> = figure.uvs.iter().map(|&uv| linear(uv)).collect();
    let got = table.interp(&figure.faces, &attribute);
    for (k, got) in got.iter().enumerate() {
        let want = linear(table.uv(k));
        assert!((got[0] - want[0]).abs() < 1e-6 && (got[1] - want[1]).abs() < 1e-6, "{k}: {got:?} {want:?}");
    }
    let map = table.to_map(&got, -1.0);
    assert_eq!(table.from_map::<2>(&map), got);
    assert_eq!(map.pixel(0, 0), [-1.0, -1.0]);
}

#[test]
fn overlap_is_refused_unless_allowed_and_then_the_lower_face_wins() {
    let faces = [[0, 1, 2], [0, 2, 3], [3, 2, 0], [2, 3, 0]];
    let error = build(&SQUARE, &faces, 32).unwrap_err();
    assert!(matches!(error, TexelError::Overlap { first: 1, second: 2, .. }), "{error}");
    let uvs = SQUARE.map(Vec2::from_array);
    let options = TexelOptions { allow_overlap: true };
    let table = TexelTable::build(&faces, &uvs, &faces, 32, &options).unwrap();
    let shared = table.tri.iter().filter(|face| **face == 1).count();
    assert!(shared > 400 && table.tri.iter().all(|face| *face < 2));
    assert_eq!(table.report.overlaps, shared, "each texel counts once, however many faces it lies in");
}

#[test]
fn poor_texture_coordinates_are_counted_or_refused() {
    let mut uvs = SQUARE.to_vec();
    uvs.extend([[0.501, 0.2], [0.502, 0.2], [0.5015, 0.9], [0.3, 0.3]]);
    // A sliver between centres and a triangle without area.
    let table = build(&uvs, &[[0, 1, 2], [4, 5, 6], [7, 7, 7]], 16).unwrap();
    assert_eq!((table.report.degenerate, table.report.unseen_faces), (1, 1));
    assert!(table.report.unseen_area > 0.0 && table.report.unseen_area < 0.01);
    assert!(matches!(build(&SQUARE, &HALVES, 0), Err(TexelError::Size { size: 0 })));
    assert!(matches!(build(&[[0.0, 0.0], [1e-4, 0.0], [0.0, 1e-4]], &[[0, 1, 2]], 8), Err(TexelError::Empty { .. })));
    for bad in [f32::NAN, f32::INFINITY, 1e6] {
        let mut uvs = SQUARE;
        uvs[2][1] = bad;
        assert!(matches!(build(&uvs, &HALVES, 8), Err(TexelError::Coordinate { row: 2, .. })));
    }
    assert!(matches!(build(&SQUARE, &[[0, 1, 9]], 8), Err(TexelError::Mesh(_))));
}

#[test]
fn the_gutter_copies_the_nearest_texel() {
    let figure = plate(Vec3::ZERO, Vec3::X, Vec3::Y, 2, Vec2::splat(0.25), Vec2::splat(0.75));
    let table = figure.table(32);
    let rows: Vec<[f32; 1]> = (0..table.len()).map(|k| [k as f32]).collect();
    let mut map = table.to_map(&rows, -7.0);
    table.fill_gutter(&mut map, 2);
    assert_eq!(map.pixel(6, 10), map.pixel(8, 10), "two texels out");
    assert_eq!(map.pixel(5, 10), [-7.0], "three are beyond it");
    assert_eq!(map.pixel(7, 7), map.pixel(8, 8), "the corner");
    assert_eq!(table.from_map::<1>(&map), rows);
}

#[test]
fn reading_ignores_what_lies_off_the_charts_and_its_adjoint_is_its_transpose() {
    let figure = two_spheres();
    let table = figure.table(96);
    for seams in [SeamRead::Mean, SeamRead::First] {
        let n = figure.vertices.len() + 1;
        let reader = MapReader::at_vertices(&table, n, &figure.faces, &figure.uvs, &figure.face_uvs, seams);
        let constant = table.to_map(&vec![[2.5]; table.len()], -1e6);
        let read = reader.read(&constant);
        assert!(read[..n - 1].iter().all(|v| (v - 2.5).abs() < 1e-5));
        assert_eq!(read[n - 1], 0.0, "a vertex of no face");
        let mut rng = Rng::new(1, "adjoint", 0, 0);
        let mut random = |n: usize| (0..n).map(|_| rng.normal()).collect::<Vec<f32>>();
        let x = Image::from_data(96, 96, 3, random(96 * 96 * 3)).unwrap();
        let y = random(n * 3);
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
        let (forth, back) = (dot(&reader.read(&x), &y), dot(&x.data, &reader.adjoint(&y, 3).data));
        assert!((forth - back).abs() < 1e-4 * forth.abs().max(10.0), "{forth} {back}");
    }
}

#[test]
fn a_linear_map_is_read_exactly_and_seams_are_averaged() {
    let figure = sphere(Vec3::ZERO, 1.0, 24, 13, Vec2::splat(0.1), Vec2::splat(0.9));
    let table = figure.table(128);
    // u itself: 0.1 on one side of the seam, 0.9 on the other.
    let rows: Vec<[f32; 1]> = (0..table.len()).map(|k| [table.uv(k).x]).collect();
    let map = table.to_map(&rows, 0.0);
    let read = |seams| {
        let reader =
            MapReader::at_vertices(&table, figure.vertices.len(), &figure.faces, &figure.uvs, &figure.face_uvs, seams);
        reader.read(&map)[1 + 5 * 24..][..24].to_vec()
    };
    // Between the edges, around the middle of the chart.
    for (j, got) in read(SeamRead::Mean).into_iter().enumerate().skip(1) {
        let want = 0.1 + 0.8 * j as f32 / 24.0;
        assert!((want - got).abs() < 1e-6, "{j}: {want} {got}");
    }
    // The edge of a chart is read at the centre of its last texel.
    assert!((read(SeamRead::Mean)[0] - 0.5).abs() < 1.0 / 128.0);
    assert!((read(SeamRead::First)[0] - 0.1).abs() < 1.0 / 128.0);
}

#[test]
fn vertices_read_their_own_chart_however_near_another_lies() {
    // Two charts side by side without a gutter, and a thin one that has no texel at its tip, above the second.
    let left = plate(Vec3::ZERO, Vec3::X, Vec3::Y, 2, Vec2::ZERO, Vec2::new(0.5, 0.24));
    let split = left.vertices.len();
    let figure = left.join(&plate(Vec3::Z, Vec3::X, Vec3::Y, 2, Vec2::new(0.5, 0.0), Vec2::new(1.0, 0.24)));
    let mut uvs = figure.uvs.clone();
    let tip = uvs.len() as u32;
    uvs.extend([[5.0, 4.0], [14.0, 7.0], [14.0, 8.5]].map(|p| Vec2::from_array(p) / 16.0));
    let mut faces = figure.faces.clone();
    faces.push([tip, tip + 1, tip + 2]);
    // A chart between centres, which has no texel at all, under the thin one.
    let speck = uvs.len() as u32;
    uvs.extend([[12.1, 12.1], [12.2, 12.1], [12.1, 12.2]].map(|p| Vec2::from_array(p) / 16.0));
    faces.push([speck, speck + 1, speck + 2]);
    let table = TexelTable::build(&faces, &uvs, &faces, 16, &TexelOptions::default()).unwrap();
    assert_eq!((table.report.charts, table.report.unseen_faces), (4, 1));
    let rows: Vec<[f32; 1]> = table.chart.iter().map(|&c| [f32::from(c)]).collect();
    let map = table.to_map(&rows, -1e6);
    for seams in [SeamRead::Mean, SeamRead::First] {
        let read = MapReader::at_vertices(&table, uvs.len(), &faces, &uvs, &faces, seams).read(&map);
        let all = |vertices: &[f32], chart: f32| vertices.iter().all(|v| (v - chart).abs() < 1e-6);
        let thin = tip as usize;
        assert!(all(&read[..split], 0.0) && all(&read[split..thin], 1.0), "{read:?}");
        assert!(all(&read[thin..thin + 3], 2.0), "{read:?}");
        assert!(read[thin + 3..].iter().all(|v| (0.0..=2.0).contains(v)), "the nearest of any chart: {read:?}");
    }
}
