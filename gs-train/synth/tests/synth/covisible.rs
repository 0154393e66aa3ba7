//! Co-visibility by flow against the co-visibility that geometry gives: [`gs_synth::Truth::flow`] says for every pixel whether its
//! material point is visible to another camera at another time.
//!
//! Pixels without a body are left out. A ball of 22 pixels moves away; of the slab that it hid to every image of the set at most
//! 0.15 may count as co-visible, where the flow alone leaves about three quarters. Of the slab that images show at least 0.85
//! must: what is lost lies within 4 pixels of an edge. The ball moves further than the flow can follow, so it is lost as well, and
//! 0.75 of all pixels must agree with the truth.

use glam::DVec3;
use gs_core::{Camera, Image};
use gs_metrics::{CovisibleOptions, MetricError, seen};
use gs_synth::{self as synth, SynthOptions, Truth};

const SIDE: u32 = 128;

fn camera(eye: DVec3) -> Camera {
    Camera::look_at(SIDE, SIDE, synth::FOV_X, eye, DVec3::ZERO, DVec3::Z).unwrap()
}

fn truth(scene: &str) -> Truth {
    synth::truth(scene, &SynthOptions::default()).unwrap()
}

/// A camera at a time.
type Shot = (Camera, f64);

fn picture(truth: &Truth, shot: &Shot) -> Image {
    truth.picture(&shot.0, shot.1).over([0.0; 3])
}

/// The mask of `test`, and whether geometry says that enough of the set show each pixel.
fn masks(truth: &Truth, test: &Shot, set: &[Shot], rule: &CovisibleOptions) -> (Image, Vec<bool>) {
    let load = |k: usize| Ok::<_, MetricError>(picture(truth, &set[k]));
    let counts = seen(&picture(truth, test), set.len(), load, rule).unwrap();
    let needed = rule.needed(set.len());
    let mut shown = vec![0; counts.counts.len()];
    for (camera, time) in set {
        let map = truth.flow(&test.0, test.1, camera, *time);
        shown.iter_mut().zip(map.visible_after).for_each(|(n, visible)| *n += usize::from(visible));
    }
    (counts.mask(needed), shown.into_iter().map(|n| n >= needed).collect())
}

/// Share of the pixels for which `of` holds that the mask has.
fn share(mask: &Image, of: impl Fn(usize) -> bool) -> f64 {
    let kept: Vec<f64> = (0..mask.data.len()).filter(|k| of(*k)).map(|k| f64::from(mask.data[k])).collect();
    assert!(kept.len() > 200, "{} pixels are too few for a share", kept.len());
    kept.iter().sum::<f64>() / kept.len() as f64
}

#[test]
fn what_a_ball_hid_is_not_co_visible_after_it_has_moved_away() {
    let truth = truth("falling");
    let above = camera(DVec3::new(0.8, -1.2, 3.7));
    let (test, set) = ((above.clone(), 1.0), (0..8).map(|k| (above.clone(), 0.3 + 0.01 * f64::from(k))));
    let set: Vec<Shot> = set.collect();
    let rule = CovisibleOptions::default();
    let (mask, shown) = masks(&truth, &test, &set, &rule);
    let by_flow = masks(&truth, &test, &set, &CovisibleOptions { colors: false, ..rule }).0;
    let bodies = truth.segments(&test.0, test.1);
    let slab = |k: usize| bodies[k] == Some(1);
    let [hidden, flow_hidden] = [&mask, &by_flow].map(|m| share(m, |k| slab(k) && !shown[k]));
    let visible = share(&mask, |k| slab(k) && shown[k]);
    let right: Vec<f32> = mask.data.iter().zip(&shown).map(|(m, s)| f32::from((*m > 0.0) == *s)).collect();
    let agree = share(&Image { data: right, ..mask.clone() }, |k| bodies[k].is_some());
    println!(
        "co-visible: {hidden:.3} of the hidden slab ({flow_hidden:.3} by the flow alone), {visible:.3} of the visible \
         slab; {agree:.3} of all pixels agree with the truth"
    );
    assert!(hidden <= 0.15 && flow_hidden >= 0.5, "{hidden} {flow_hidden}");
    assert!(visible >= 0.85 && agree >= 0.75, "{visible} {agree}");
}

/// A camera on an arc of 20° around things at rest: the set shows all that its middle shows, and the mask says so.
#[test]
fn an_arc_around_things_at_rest_shows_its_middle() {
    let truth = truth("static");
    let at = |degrees: f64| {
        let turn = glam::DMat3::from_rotation_z(degrees.to_radians());
        (camera(turn * DVec3::new(2.6, -2.0, 2.2)), 0.0)
    };
    let set: Vec<Shot> = (0..12).map(|k| at(f64::from(k) * 20.0 / 11.0 - 10.0)).collect();
    let test = at(0.0);
    let (mask, shown) = masks(&truth, &test, &set, &CovisibleOptions::default());
    let bodies = truth.segments(&test.0, test.1);
    let really = shown.iter().map(|s| f32::from(*s)).collect();
    let [found, really] = [&mask, &Image { data: really, ..mask.clone() }].map(|m| share(m, |k| bodies[k].is_some()));
    println!("co-visible: {found:.4} of the bodies, {really:.4} really");
    assert!(found >= 0.97 && really >= 0.99, "{found} {really}");
}
