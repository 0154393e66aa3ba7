//! In-painting, camera weights and named maps.

use crate::scenes::plate;
use glam::{Vec2, Vec3};
use gs_texel::inpaint::{InpaintMethod, Inpainted, ViewWeights, inpaint};
use gs_texel::texels::TexelTable;

const METHODS: [InpaintMethod; 5] = [
    InpaintMethod::Nearest,
    InpaintMethod::Delaunay,
    InpaintMethod::Natural,
    InpaintMethod::PushPull,
    InpaintMethod::Harmonic,
];

/// Two charts side by side, a texel or two apart.
fn two_charts() -> TexelTable {
    let left = plate(Vec3::ZERO, Vec3::X, Vec3::Y, 4, Vec2::ZERO, Vec2::new(0.49, 1.0));
    left.join(&plate(Vec3::Z, Vec3::X, Vec3::Y, 4, Vec2::new(0.51, 0.0), Vec2::ONE)).table(64)
}

fn in_hole(uv: Vec2) -> bool {
    (uv - Vec2::new(0.25, 0.4)).length() < 0.15
}

#[test]
fn a_linear_field_is_restored_in_a_hole() {
    let table = two_charts();
    let truth = |uv: Vec2| [0.2 + 0.5 * uv.x, 1.0 - 0.7 * uv.y];
    let known: Vec<bool> = (0..table.len()).map(|k| !in_hole(table.uv(k))).collect();
    for (how, limit) in METHODS.into_iter().zip([0.12, 1e-6, 1e-5, 0.12, 1e-5]) {
        let mut rows: Vec<[f32; 2]> =
            (0..table.len()).map(|k| if known[k] { truth(table.uv(k)) } else { [9.0; 2] }).collect();
        let done = inpaint(&table, &mut rows, &known, how).unwrap();
        assert_eq!((done.left, done.filled), (0, known.iter().filter(|k| !**k).count()));
        let worst = (0..table.len()).fold(0.0f32, |m, k| {
            let want = truth(table.uv(k));
            m.max((rows[k][0] - want[0]).abs()).max((rows[k][1] - want[1]).abs())
        });
        assert!(worst < limit, "{how:?} {worst}");
    }
}

#[test]
fn a_harmonic_fill_is_the_mean_of_its_neighbours_and_keeps_within_its_border() {
    let table = two_charts();
    let wild = |uv: Vec2| [(40.0 * uv.x).sin() * (31.0 * uv.y).cos()];
    // Up to the chart's border, over which nothing flows.
    let known: Vec<bool> = (0..table.len()).map(|k| table.uv(k).x > 0.1 || table.chart[k] == 1).collect();
    let mut rows: Vec<[f32; 1]> = (0..table.len()).map(|k| wild(table.uv(k))).collect();
    let before = rows.clone();
    inpaint(&table, &mut rows, &known, InpaintMethod::Harmonic).unwrap();
    let (low, high) = rows.iter().fold((f32::MAX, f32::MIN), |(l, h), r| (l.min(r[0]), h.max(r[0])));
    for k in 0..table.len() {
        if known[k] {
            assert_eq!(rows[k], before[k]);
            continue;
        }
        let t = table.valid[k] as usize;
        let (x, y) = (t % table.size, t / table.size);
        let near = [(x.wrapping_sub(1), y), (x + 1, y), (x, y.wrapping_sub(1)), (x, y + 1)];
        let inside =
            near.into_iter().filter(|(x, y)| x.max(y) < &table.size).map(|(x, y)| table.row[y * table.size + x]);
        let values: Vec<f32> = inside.filter(|&r| (r as usize) < table.len()).map(|r| rows[r as usize][0]).collect();
        let mean = values.iter().sum::<f32>() / values.len() as f32;
        assert!((rows[k][0] - mean).abs() < 1e-5, "{} {mean}", rows[k][0]);
        assert!(rows[k][0] >= low && rows[k][0] <= high);
    }
}

#[test]
fn nothing_crosses_from_chart_to_chart() {
    let table = two_charts();
    // All of the right edge of the left chart is unknown, and the whole right chart but for a row.
    let known: Vec<bool> =
        (0..table.len()).map(|k| if table.chart[k] == 0 { table.uv(k).x < 0.3 } else { table.uv(k).y < 0.1 }).collect();
    for how in METHODS {
        let mut rows: Vec<[f32; 1]> = table.chart.iter().map(|&c| [f32::from(c)]).collect();
        (0..table.len()).filter(|&k| !known[k]).for_each(|k| rows[k] = [-5.0]);
        inpaint(&table, &mut rows, &known, how).unwrap();
        assert!(rows.iter().zip(&table.chart).all(|(r, &c)| (r[0] - f32::from(c)).abs() < 1e-6), "{how:?}");
    }
}

#[test]
fn charts_without_a_known_texel_are_left() {
    let table = two_charts();
    let known: Vec<bool> = table.chart.iter().map(|&c| c == 0).collect();
    let unknown = known.iter().filter(|k| !**k).count();
    let mut rows = vec![[0.5f32; 3]; table.len()];
    for how in METHODS {
        assert_eq!(inpaint(&table, &mut rows, &known, how).unwrap(), Inpainted { filled: 0, left: unknown });
    }
    // One known texel, then two in a line: no triangle at all.
    let first = known.iter().position(|k| !k).unwrap();
    for count in 1..3 {
        let mut some = known.clone();
        some[first..first + count].fill(true);
        for how in METHODS {
            let mut rows: Vec<[f32; 1]> = some.iter().map(|&k| [if k { 0.25 } else { 0.0 }]).collect();
            let done = inpaint(&table, &mut rows, &some, how).unwrap();
            // Known texels far from any hole take no part, those beside one do.
            assert_eq!(done.left, 0);
            assert!(rows.iter().all(|r| r[0] == 0.25), "{how:?}");
        }
    }
    assert!(inpaint(&table, &mut rows, &known[1..], InpaintMethod::Nearest).unwrap_err().to_string().contains("flags"));
}

#[test]
fn cameras_are_weighted_smoothly() {
    let around = |turn: f32| Vec3::new(turn.sin(), 0.0, turn.cos());
    let quarter = std::f32::consts::FRAC_PI_2;
    let mut directions: Vec<Vec3> = (0..4).map(|i| 3.0 * around(i as f32 * quarter)).collect();
    directions.push(Vec3::new(0.1, 2.0, 0.0));
    let views = ViewWeights::new(&directions, Vec3::Y).unwrap();
    for (i, d) in directions.iter().enumerate() {
        let largest = views.weights(*d).into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        assert!(largest.0 == i as u32 && largest.1 > 0.999, "{i} {largest:?}");
    }
    let half = views.weights(around(0.5 * quarter));
    assert!(half.len() == 2 && half.iter().all(|w| (w.1 - 0.5).abs() < 1e-5), "{half:?}");
    let mut last: Option<Vec<f64>> = None;
    for step in 0..400 {
        let turn = step as f32 * 4.0 * quarter / 400.0;
        let mut dense = vec![0.0; 5];
        views.weights(around(turn) + 0.3 * Vec3::Y).into_iter().for_each(|(i, w)| dense[i as usize] += w);
        assert!((dense.iter().sum::<f64>() - 1.0).abs() < 1e-9 && dense.iter().all(|&w| w >= -1e-12));
        if let Some(last) = last {
            assert!(dense.iter().zip(&last).all(|(a, b)| (a - b).abs() < 0.05), "no jump");
        }
        last = Some(dense);
    }
    assert!(ViewWeights::new(&[Vec3::X, Vec3::NAN], Vec3::Y).is_err());
    assert!(ViewWeights::new(&[Vec3::X, -Vec3::Y], Vec3::Y).is_err());
    assert!(ViewWeights::new(&[], Vec3::Y).unwrap().weights(Vec3::X).is_empty());
    assert_eq!(ViewWeights::new(&[Vec3::X], Vec3::Y).unwrap().weights(Vec3::Z), [(0, 1.0)]);
}

#[cfg(feature = "exr")]
#[test]
fn named_maps_come_back() {
    use gs_core::Image;
    use gs_core::io::Limits;
    use gs_core::io::exr::{Channel, save_channels};
    use gs_texel::maps_exr::{Kind, Layer, load_layers, save_layers};
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("maps.exr");
    let map = |channels: usize, scale: f32| {
        let data = (0..16 * 16 * channels).map(|i| i as f32 * scale).collect();
        Image::from_data(16, 16, channels, data).unwrap()
    };
    let layer = |name: &str, kind, half, map| Layer { name: name.into(), kind, half, map };
    let layers = [
        layer("P", Kind::Vector, false, map(3, 0.37)),
        layer("T1", Kind::Color, true, map(3, 0.25)),
        layer("gauss", Kind::Plain, false, map(23, -1.7)),
    ];
    save_layers(&path, &layers, false).unwrap();
    assert_eq!(load_layers(&path, &Limits::default()).unwrap(), layers);
    // Of a file of another program: one layer with channels of two kinds.
    let channel = |name: &str, value: f32| Channel { name: name.into(), half: false, values: vec![value; 4] };
    let mixed = [channel("a.R", 1.0), channel("a.G", 2.0), channel("a.X", 3.0), channel("a.Y", 4.0)];
    let other = folder.path().join("mixed.exr");
    save_channels(&other, (2, 2), &mixed, false).unwrap();
    let read = load_layers(&other, &Limits::default()).unwrap();
    let [color, vector] = &read[..] else { panic!("{} layers", read.len()) };
    assert_eq!((color.kind, &color.map.data[..2]), (Kind::Color, &[1.0, 2.0][..]));
    assert_eq!((vector.kind, &vector.map.data[..2]), (Kind::Vector, &[3.0, 4.0][..]));
    let fails = |layers: &[Layer]| assert!(save_layers(&folder.path().join("bad.exr"), layers, false).is_err());
    fails(&[]);
    fails(&[layer("a", Kind::Vector, false, map(5, 1.0))]);
    fails(&[layer("a", Kind::Plain, true, map(1, 1e6))]);
    fails(&[layer("a", Kind::Plain, false, map(1, 1.0)), layer("b", Kind::Plain, false, Image::zeros(8, 8, 1))]);
}
