//! Cameras in step are not flagged, and late ones are found where the check says that it finds them.

use super::{Spoilt, spoil};
use crate::images::{self, ImageChecks};
use crate::sample::Sample;
use crate::{Finding, Verdict, clock};
use gs_data::{Dataset, ImageCache, ImageSource, View};
use gs_synth::{SynthOptions, generate};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Moments at each end that are left out, so that a late camera has what was before.
const EDGE: u32 = 4;

/// A generated clip: scene, size, cameras, moments, and what is done to its images.
struct Clip {
    scene: &'static str,
    size: u32,
    cameras: u32,
    moments: u32,
    seed: u64,
    spoilt: Spoilt,
}

impl Clip {
    /// The clip with [`EDGE`] moments more at each end.
    fn data(&self) -> Dataset {
        let (size, cameras, moments, seed) = (self.size, self.cameras, self.moments + 2 * EDGE, self.seed);
        let options =
            SynthOptions { size, cameras, moments, seed, held_out: 1, variant: seed % 5, ..SynthOptions::default() };
        let mut data = generate(self.scene, &options).expect("scene").dataset;
        let images = ImageCache::new(0, 1.0);
        for (k, v) in lists(&mut data).into_iter().flatten().enumerate() {
            let mut image = (*images.get(v).expect("image")).clone();
            spoil(&mut image, self.spoilt, k as u64);
            v.image = ImageSource::Memory(Arc::new(image));
        }
        data.has_alpha &= self.spoilt != Spoilt::Opaque;
        data
    }
}

/// The lists of views of a clip.
fn lists(data: &mut Dataset) -> [&mut Vec<View>; 4] {
    [&mut data.train, &mut data.val, &mut data.test, &mut data.extrapolate]
}

/// A clip without its ends, in which the views of a camera have the images of `lag` moments before, as one that runs late has them.
fn delayed(whole: &Dataset, camera: u32, lag: isize) -> Dataset {
    let mut data = whole.clone();
    let mut own: Vec<&mut View> = lists(&mut data).into_iter().flatten().filter(|v| v.camera_id == camera).collect();
    own.sort_by(|a, b| a.time.normalised.total_cmp(&b.time.normalised));
    let before: Vec<ImageSource> = own.iter().map(|v| v.image.clone()).collect();
    let times: Vec<f32> = own.iter().map(|v| v.time.normalised).collect();
    let last = before.len() as isize - 1;
    for (k, v) in (0..).zip(own) {
        v.image = before[(k - lag).clamp(0, last) as usize].clone();
    }
    let edge = EDGE as usize;
    let kept = times[edge]..=times[times.len() - 1 - edge];
    lists(&mut data).into_iter().for_each(|l| l.retain(|v| kept.contains(&v.time.normalised)));
    data
}

fn examined(data: &Dataset) -> Vec<Finding> {
    let checked: ImageChecks = images::check(data, &Sample::of(data, true), None, &|_, _| ());
    clock::check(data, &checked)
}

/// Whether findings say that a camera so many moments off would be found.
fn promised(lag: isize, sound: &[Finding]) -> bool {
    let Some(power) = sound.iter().find(|f| f.code == "time.power") else { return false };
    let numbers: Vec<f64> = power.what.split(|c: char| !c.is_ascii_digit()).filter_map(|n| n.parse().ok()).collect();
    let [found, tried] = if lag.abs() == 2 { [numbers[1], numbers[2]] } else { [numbers[4], numbers[5]] };
    found >= 0.9 * tried
}

/// Sets in which a fault was said to be found, those of them in which it was, the others, those of them in which it was, and cameras
/// flagged without fault.
#[derive(Default)]
struct Row([usize; 5]);

#[derive(Default)]
struct Table {
    rows: BTreeMap<isize, Row>,
    alarms: Vec<String>,
}

impl Table {
    fn add(&mut self, name: &str, whole: &Dataset) {
        let cameras = whole.train.iter().map(|v| v.camera_id).max().unwrap_or(0);
        let camera = cameras / 3 + 1;
        let before = examined(&delayed(whole, camera, 0));
        for lag in [0, -4, -2, 2, 4] {
            let found = if lag == 0 { before.clone() } else { examined(&delayed(whole, camera, lag)) };
            let late: Vec<&String> = found.iter().filter(|f| f.code == "time.late").flat_map(|f| &f.places).collect();
            let right = |p: &&&String| {
                lag != 0 && p.starts_with(&format!("camera {camera} (")) && p.ends_with(&format!(" {lag:+} moments"))
            };
            let hits = late.iter().filter(right).count();
            let said = lag != 0 && promised(lag, &before);
            let hit = if lag == 0 { late.is_empty() } else { hits == 1 };
            let Row(row) = self.rows.entry(lag.abs()).or_default();
            row[if said { 0 } else { 2 }] += 1;
            row[if said { 1 } else { 3 }] += usize::from(hit);
            row[4] += late.len() - hits;
            if late.len() > hits || said && !hit {
                self.alarms.push(format!("{name} {lag:+}: {late:?}"));
            }
        }
        let words = before.iter().find(|f| ["time.power", "time.unsure"].contains(&f.code)).map(|f| &f.what);
        println!("{name}: {}", words.map_or("", |w| w));
    }

    fn print(&self) {
        for (lag, Row([said, kept, silent, right, alarms])) in &self.rows {
            println!("{lag}: said {said}, found {kept}; not said {silent}, right {right}; others flagged {alarms}");
        }
        self.alarms.iter().for_each(|a| println!("alarm: {a}"));
    }
}

#[test]
fn late_cameras_are_found_where_it_is_said_and_no_others() {
    let mut table = Table::default();
    let clip = Clip { scene: "waves", size: 128, cameras: 7, moments: 21, seed: 307, spoilt: Spoilt::Opaque };
    table.add("waves", &clip.data());
    let clip = Clip { scene: "sheet", size: 64, cameras: 3, moments: 20, seed: 5, spoilt: Spoilt::Not };
    table.add("sheet", &clip.data());
    table.print();
    assert!(table.alarms.is_empty(), "{:?}", table.alarms);
    // Early and late: of waves that pass, not of a sheet that always moves alike.
    assert_eq!([2, 4].map(|lag| table.rows[&lag].0), [[2, 2, 2, 0, 0]; 2]);
}

/// Where nothing can be told, it says so and accuses nobody.
#[test]
fn what_cannot_be_told_is_said() {
    for (scene, cameras, moments) in [("reach", 2, 24), ("reach", 6, 10), ("sheet", 6, 16)] {
        let data = Clip { scene, size: 48, cameras, moments, seed: 5, spoilt: Spoilt::Not }.data();
        let found = examined(&delayed(&data, 1, 4));
        let unsure = found.iter().find(|f| f.code == "time.unsure").expect("said");
        assert!(
            unsure.verdict == Verdict::Note && unsure.what.contains("cannot be told from these images"),
            "{unsure:?}"
        );
        assert!(!found.iter().any(|f| f.code == "time.late"), "{found:?}");
    }
}

/// Thirty generated clips; `GS4D_SEED` sets the cameras and variants.
#[test]
#[ignore = "minutes: cargo test -p gs4d-doctor --lib power::clocks -- --ignored --nocapture"]
fn table() {
    let seed: u64 = std::env::var("GS4D_SEED").map_or(307, |s| s.parse().expect("number"));
    let scenes = ["falling", "balls", "sheet", "reach", "trio", "hinge", "spinner", "waves", "twins", "projectile"];
    let shapes = [(64, 4, 16), (100, 5, 10), (200, 7, 21), (128, 5, 28), (200, 3, 17)];
    let spoilt = [Spoilt::Not, Spoilt::Noise, Spoilt::Blur, Spoilt::Opaque];
    let mut table = Table::default();
    for (k, scene) in scenes.into_iter().enumerate() {
        for j in 0..3 {
            let (size, cameras, moments) = shapes[(k + 2 * j) % 5];
            let clip = Clip { scene, size, cameras, moments, seed: seed + j as u64, spoilt: spoilt[(k + j) % 4] };
            let name = format!("{scene} {size} px {cameras} cameras {moments} moments {:?}", clip.spoilt);
            table.add(&name, &clip.data());
        }
    }
    table.print();
}

/// A real clip where it is at hand: 29 cameras; 22 of 30 moments.
#[test]
#[ignore = "minutes: cargo test -p gs4d-doctor --lib power::clocks -- --ignored --nocapture"]
fn capture() {
    let Some(dir) = gs_core::testkit::shared("data/panoptic_basketball_f040-069") else { return };
    let mut table = Table::default();
    table.add("basketball", &Dataset::open(&dir, &Default::default()).expect("data"));
    table.print();
}
