//! Sound data is not accused, and faults are found where the check says that it finds them: the table of docs/guide/data.md.

use super::hull_fit::turned_by;
use super::{Finding, Verdict, poses, silhouettes};
use gs_core::{Rng, cast};
use gs_data::{Dataset, ImageCache, ImageSource, ImageU8, View};
use gs_synth::{SynthOptions, generate};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// A generated data set: scene, size, training views, and what was done to its images.
#[derive(Clone, Copy)]
struct Set {
    scene: &'static str,
    size: u32,
    views: u32,
    seed: u64,
    spoilt: Spoilt,
}

#[derive(Clone, Copy, PartialEq)]
enum Spoilt {
    Not,
    Noise,
    Blur,
    Opaque,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Fault {
    None,
    Turned(u32),
    Exchanged,
    Foreign,
    Focal,
}

const FAULTS: [Fault; 7] = [
    Fault::None,
    Fault::Turned(3),
    Fault::Turned(5),
    Fault::Turned(10),
    Fault::Exchanged,
    Fault::Foreign,
    Fault::Focal,
];

impl Set {
    fn data(self) -> Dataset {
        let options = SynthOptions {
            val_views: 2,
            seed: self.seed,
            variant: self.seed % 5,
            ..SynthOptions::of_views(self.size, self.views, 8)
        };
        let mut data = generate(self.scene, &options).expect("scene").dataset;
        let images = ImageCache::new(0, 1.0);
        for (k, v) in data.train.iter_mut().chain(&mut data.val).chain(&mut data.test).enumerate() {
            let mut image = (*images.get(v).expect("image")).clone();
            spoil(&mut image, self.spoilt, k as u64);
            v.image = ImageSource::Memory(Arc::new(image));
        }
        data.has_alpha &= self.spoilt != Spoilt::Opaque;
        data
    }
}

fn spoil(image: &mut ImageU8, how: Spoilt, seed: u64) {
    let mut r = Rng::new(seed, "spoilt", 0, 0);
    let before = image.clone();
    let (w, h) = (image.width, image.height);
    for i in 0..w * h {
        let (x, y) = (i % w, i / w);
        for c in 0..3 {
            let at = |dx: usize, dy: usize| {
                let [x, y] = [(x + dx).clamp(1, w) - 1, (y + dy).clamp(1, h) - 1];
                f32::from(before.data[4 * (y * w + x) + c])
            };
            let value = match how {
                Spoilt::Not => continue,
                Spoilt::Noise => at(1, 1) + 20.0 * (r.uniform() + r.uniform() - 1.0),
                Spoilt::Blur => (0..9).map(|k| at(k % 3, k / 3)).sum::<f32>() / 9.0,
                Spoilt::Opaque if before.data[4 * i + 3] < 128 => 40.0,
                Spoilt::Opaque => at(1, 1),
            };
            image.data[4 * i + c] = cast::to_u8(value.clamp(0.0, 255.0));
        }
        if how == Spoilt::Opaque {
            image.data[4 * i + 3] = 255;
        }
    }
}

/// Puts a fault into the data; names of the views concerned.
fn put(fault: Fault, data: &mut Dataset, foreign: &View) -> Vec<String> {
    let n = data.train.len();
    let (a, b) = (n / 3, 2 * n / 3 + 1);
    match fault {
        Fault::None => return Vec::new(),
        Fault::Turned(degrees) => {
            let c = &mut data.train[a].camera;
            *c = turned_by(c, f64::from(degrees).to_radians(), 1.0);
        }
        Fault::Exchanged => {
            let (first, second) = (data.train[a].camera.clone(), data.train[b].camera.clone());
            (data.train[a].camera, data.train[b].camera) = (second, first);
            return [a, b].map(|k| data.train[k].name.clone()).into();
        }
        Fault::Foreign => data.train[a].image = foreign.image.clone(),
        Fault::Focal => {
            let views = data.train.iter_mut().chain(&mut data.val).chain(&mut data.test);
            views.for_each(|v| (v.camera.fx, v.camera.fy) = (1.2 * v.camera.fx, 1.2 * v.camera.fy));
            return Vec::new();
        }
    }
    vec![data.train[a].name.clone()]
}

fn examined(data: &Dataset) -> Vec<Finding> {
    let largest = data.train.iter().map(|v| v.camera.width.max(v.camera.height)).max().unwrap_or(1);
    let images = ImageCache::new(256 << 20, (480.0 / f64::from(largest)).min(1.0));
    poses::check(data, &images, silhouettes::check(data).as_ref()).0
}

/// Whether findings say that a fault would be found.
fn promised(fault: Fault, sound: &[Finding]) -> bool {
    let text: String =
        sound.iter().filter(|f| ["poses.power", "poses.unsure"].contains(&f.code)).map(|f| f.what.clone()).collect();
    let nine_in_ten = |what: &str| {
        text.split_once(what).and_then(|(_, rest)| rest.split_once(" tried")).is_some_and(|(counts, _)| {
            let numbers: Vec<f64> =
                counts.split(|c: char| !c.is_ascii_digit()).filter_map(|n| n.parse().ok()).collect();
            numbers[0] >= 0.9 * numbers[1]
        })
    };
    match fault {
        Fault::None => false,
        Fault::Turned(d) => nine_in_ten(&format!("turned by {d} degrees (")),
        Fault::Exchanged => nine_in_ten("exchanged for another ("),
        Fault::Foreign => nine_in_ten("of something else ("),
        Fault::Focal => text.contains("a fifth would") && !text.contains("a fifth would not"),
    }
}

#[derive(Default)]
struct Row {
    promised: usize,
    kept: usize,
    silent: usize,
    silent_found: usize,
    innocents: usize,
}

/// Runs every fault on a set; false alarms are returned in words.
fn run(
    name: &str,
    make: &dyn Fn() -> Dataset,
    foreign: &dyn Fn(u32) -> View,
    rows: &mut BTreeMap<Fault, Row>,
) -> Vec<String> {
    let sound = examined(&make());
    let mut alarms: Vec<String> = Vec::new();
    for fault in FAULTS {
        let mut data = make();
        let size = data.train[0].camera.width;
        let guilty = put(fault, &mut data, &foreign(size));
        let found = examined(&data);
        let wrong: Vec<&Finding> = found.iter().filter(|f| f.verdict > Verdict::Note).collect();
        let row = rows.entry(fault).or_default();
        if fault == Fault::None {
            alarms.extend(wrong.iter().map(|f| format!("{name}: {} {:?}", f.what, f.places)));
            row.innocents += usize::from(!wrong.is_empty());
            row.silent += 1;
            continue;
        }
        let places: Vec<&String> = wrong.iter().filter(|f| f.code == "poses.view").flat_map(|f| &f.places).collect();
        let named = |n: &String| places.iter().any(|p| p.starts_with(&format!("{n}:")));
        let hit = match fault {
            Fault::Focal => wrong.iter().any(|f| f.code == "poses.focal"),
            _ => guilty.iter().all(named),
        };
        let innocent = places.iter().filter(|p| !guilty.iter().any(|n| p.starts_with(&format!("{n}:")))).count();
        row.innocents += innocent;
        if innocent > 0 {
            alarms.push(format!("{name} {fault:?} {guilty:?}: {places:?}"));
        }
        if promised(fault, &sound) {
            (row.promised, row.kept) = (row.promised + 1, row.kept + usize::from(hit));
            if !hit {
                println!("missed: {name} {fault:?} {guilty:?} {:?}", wrong);
            }
        } else {
            (row.silent, row.silent_found) = (row.silent + 1, row.silent_found + usize::from(hit));
        }
    }
    alarms
}

/// An image of another scene at a size.
fn other(scene: &'static str, size: u32) -> View {
    generate(scene, &SynthOptions::of_views(size, 3, 1)).expect("scene").dataset.train[1].clone()
}

#[test]
#[ignore = "minutes"]
fn table() {
    let seed: u64 = std::env::var("GS4D_SEED").map_or(21, |s| s.parse().expect("number"));
    let scenes = ["static", "balls", "sheet", "reach", "trio", "hinge", "spinner", "waves", "twins", "projectile"];
    let shapes = [(64, 17), (100, 50), (200, 150), (128, 17), (200, 50)];
    let spoilt = [Spoilt::Not, Spoilt::Noise, Spoilt::Blur, Spoilt::Opaque];
    let (mut rows, mut alarms) = (BTreeMap::new(), Vec::new());
    let mut count = 0;
    for (k, scene) in scenes.into_iter().enumerate() {
        for j in 0..3 {
            let (size, views) = shapes[(k + 2 * j) % 5];
            let set = Set { scene, size, views, seed: seed + j as u64, spoilt: spoilt[(k + j) % 4] };
            let name = format!("{scene} {size} px {views} views {}", (k + j) % 4);
            let foreign = if scene == "sheet" { "balls" } else { "sheet" };
            let (data, foreign) = (set.data(), other(foreign, size));
            let start = std::time::Instant::now();
            alarms.extend(run(&name, &|| data.clone(), &|_| foreign.clone(), &mut rows));
            println!("{name}: {:.1} s", start.elapsed().as_secs_f64());
            count += 1;
        }
    }
    println!("{count} sets");
    for (fault, r) in &rows {
        println!(
            "{fault:?}: promised {} kept {}; not promised {} found {}; innocents {}",
            r.promised, r.kept, r.silent, r.silent_found, r.innocents
        );
    }
    alarms.iter().for_each(|a| println!("alarm: {a}"));
}

#[test]
#[ignore = "minutes"]
fn captures() {
    let (mut rows, mut alarms) = (BTreeMap::new(), Vec::new());
    for name in
        ["dnerf_mutant_400", "fox_270x480", "neu3d_flame_steak_5view_llff_colmap", "panoptic_basketball_f040-069"]
    {
        let Some(dir) = gs_core::testkit::shared(&format!("data/{name}")) else { return };
        for step in [1, 3, 9] {
            let make = || {
                let mut data = Dataset::open(Path::new(&dir), &Default::default()).expect("data");
                data.train = data.train.into_iter().step_by(step).collect();
                data
            };
            if make().train.len() >= 4 {
                println!("{name} {step} {:?}", examined(&make()).iter().map(|f| f.what.clone()).collect::<Vec<_>>());
                let foreign = |_| {
                    let v = make().train[0].clone();
                    let mut image = (*ImageCache::new(0, 1.0).get(&v).expect("image")).clone();
                    let w = image.width;
                    image.data.as_chunks_mut::<4>().0.chunks_exact_mut(w).for_each(|row| row.reverse());
                    View { image: ImageSource::Memory(Arc::new(image)), ..v }
                };
                alarms.extend(run(&format!("{name} {step}"), &make, &foreign, &mut rows));
            }
        }
    }
    for (fault, r) in &rows {
        println!(
            "{fault:?}: promised {} kept {}; not promised {} found {}; innocents {}",
            r.promised, r.kept, r.silent, r.silent_found, r.innocents
        );
    }
    alarms.iter().for_each(|a| println!("alarm: {a}"));
}
