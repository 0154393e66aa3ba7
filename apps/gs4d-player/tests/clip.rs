//! Clips and spans against the scenes they were made from: the bound holds, bytes come back, damage is an error.

use glam::{Quat, Vec3};
use gs_core::rng::Rng;
use gs_core::{Camera, Color, Kernel, Splats, rot};
use gs_raster::{RasterOptions, Workspace, measure, render};
use gs4d_player::{Clip, Frames, Layer, Page, PlayerError, Spans, Start, Tolerance, read};

const FRAMES: usize = 24;

/// Splats of which some stand, some circle and turn, some fade, with harmonics and kernels.
fn scene(kernel: bool) -> (Vec<f32>, Vec<Splats>) {
    let base = measure::scene(300, 3);
    let times: Vec<f32> = (0..FRAMES).map(|k| k as f32 / (FRAMES - 1) as f32).collect();
    let at = |&t: &f32| {
        let mut s = base.clone();
        let mut coeffs = Vec::new();
        for i in 0..s.len() {
            let mut r = Rng::new(5, "clip", 0, i as u64);
            if i % 3 == 1 {
                let angle = 4.0 * t + r.range(0.0, 6.0);
                s.means[i] += 0.4 * Vec3::new(angle.cos(), 0.5 * angle.sin(), angle.sin());
                s.quats[i] = rot::from_glam(Quat::from_rotation_y(3.0 * t) * rot::to_glam(s.quats[i]));
            }
            if i % 3 == 2 {
                s.opacities[i] *= 0.5 + 0.5 * (5.0 * t + i as f32).sin();
            }
            coeffs.extend((0..27).map(|k| r.range(-0.3, 0.3) * if k < 3 { 6.0 } else { 1.0 }));
        }
        s.color = Color::Sh { degree: 2, coeffs };
        if kernel {
            let mut r = Rng::new(6, "clip", 0, 0);
            let lambdas = (0..s.len()).map(|_| r.range(0.1, 0.9)).collect();
            s.kernel = Kernel::Frequency { lambdas, betas: (0..s.len()).map(|_| r.range(0.1, 0.9)).collect() };
        }
        s
    };
    let splats = times.iter().map(at).collect();
    (times, splats)
}

fn camera() -> Camera {
    measure::camera(96)
}

fn psnr(a: &Splats, b: &Splats) -> f64 {
    let draw = |s: &Splats| render(s, &camera(), &RasterOptions::default(), &mut Workspace::new()).rgb.data;
    let (x, y) = (draw(a), draw(b));
    let sum: f64 = x.iter().zip(&y).map(|(p, q)| f64::from(p - q).powi(2)).sum();
    -10.0 * (sum / x.len() as f64).log10()
}

#[test]
fn the_image_stays_near_and_nearer_with_a_smaller_tolerance() {
    for kernel in [false, true] {
        let (times, splats) = scene(kernel);
        let frames = Frames::new(times.clone(), splats.clone()).unwrap();
        // The median: where two large splats pass each other in depth, any displacement may exchange them for a frame.
        let usual = |tolerance: f32| {
            let clip = Clip::fit(&frames, &[camera()], Tolerance(tolerance));
            assert_eq!(clip.len(), 300);
            let mut all: Vec<f64> = times.iter().zip(&splats).map(|(&t, s)| psnr(s, &clip.splats(t))).collect();
            all.sort_by(f64::total_cmp);
            all[FRAMES / 2]
        };
        let (coarse, fine) = (usual(0.4), usual(0.05));
        println!("kernel {kernel}: median frame {coarse:.1} dB at 0.4, {fine:.1} dB at 0.05");
        assert!(coarse > 33.0 && fine > 48.0, "{kernel}: {coarse} {fine}");
    }
}

#[test]
fn no_mean_is_displaced_by_more_than_the_bound() {
    let (times, splats) = scene(false);
    let frames = Frames::new(times.clone(), splats.clone()).unwrap();
    // Without cameras a pixel has no size: the bound is a share of the least standard deviation.
    let clip = Clip::fit(&frames, &[], Tolerance(0.3));
    let middle = &splats[FRAMES / 2];
    for (&t, s) in times.iter().zip(&splats) {
        let got = clip.splats(t);
        for i in 0..s.len() {
            let bound = 0.3 * middle.scales[i].min_element() + 1e-5;
            assert!((got.means[i] - s.means[i]).abs().max_element() <= bound, "{t} {i}");
        }
    }
    assert_eq!(clip.moving(), 100, "a third of the splats circle");
}

#[test]
fn spans_stay_near_and_files_give_them_back() {
    let (times, splats) = scene(false);
    let frames = Frames::new(times.clone(), splats.clone()).unwrap();
    let spans = |tolerance| Spans::fit(&frames, &[camera()], Tolerance(tolerance), 3.0);
    let (coarse, fine) = (spans(0.4), spans(0.05));
    assert!(fine.len() > coarse.len() && coarse.len() > 300, "{} {}", fine.len(), coarse.len());
    assert!((fine.duration() - 3.0 * FRAMES as f64 / (FRAMES - 1) as f64).abs() < 1e-6);
    let usual = |spans: &Spans| {
        let mut all: Vec<f64> = times.iter().zip(&splats).map(|(&t, s)| psnr(s, &spans.splats(t))).collect();
        all.sort_by(f64::total_cmp);
        all[FRAMES / 2]
    };
    let (bytes, before) = (fine.bytes().unwrap(), [usual(&coarse), usual(&fine)]);
    let again = Spans::read(&bytes).unwrap();
    let after = usual(&again);
    println!("median frame: {before:.1?} dB at 0.4 and 0.05, {after:.1} dB from the file of {} bytes", bytes.len());
    // What turns or fades is constant between two frames, so a smaller tolerance brings little.
    assert!(before[0] > 37.0 && before[1] > before[0] + 1.5, "{before:?}");
    assert!(after > before[1] - 1.0, "{after} {before:?}");
    assert_eq!((again.len(), bytes.clone()), (fine.len(), spans(0.05).bytes().unwrap()), "the same bytes every time");
    // As many splats as are seen at a time; those that fade out are not there.
    for (&t, s) in times.iter().zip(&splats) {
        let (got, all) = (again.splats(t).len(), s.len());
        assert!(got <= all && got >= all * 2 / 3, "{got} of {all} at {t}");
    }
    assert!(matches!(Spans::read(&bytes[..bytes.len() / 2]), Err(PlayerError::Damaged(_))));
    assert!(matches!(Spans::read(b"PK"), Err(PlayerError::Damaged(_))));
}

/// Coordinates far from the origin are rounded in f32 by more than small splats are off on the grid of the file.
#[test]
fn large_scenes_far_from_the_origin_are_written() {
    let mut still = measure::scene(20_000, 2);
    for mean in &mut still.means {
        *mean += Vec3::new(40.0, -60.0, 25.0);
    }
    let mut moved = still.clone();
    moved.means.iter_mut().for_each(|mean| *mean += Vec3::X);
    let frames = Frames::new(vec![0.0, 1.0], vec![still.clone(), moved]).unwrap();
    let spans = Spans::fit(&frames, &[], Tolerance::default(), 1.0);
    let again = Spans::read(&spans.bytes().unwrap()).unwrap();
    let count = frames.len();
    assert!(count > 19_000, "{count}");
    assert_eq!((again.len(), again.splats(0.0).len(), again.splats(1.0).len()), (2 * count, count, count));
    let mut scales: Vec<f32> = still.scales.iter().flat_map(|s| s.to_array()).collect();
    scales.sort_by(f32::total_cmp);
    // Files have their own order: the middle of all means.
    let mean = |s: &Splats| s.means.iter().map(|m| m.as_dvec3()).sum::<glam::DVec3>() / s.len() as f64;
    assert!(mean(&again.splats(0.0)).distance(mean(&still)) < 0.02 * f64::from(scales[scales.len() / 2]));
}

#[test]
fn a_span_moves_on_a_line_and_is_nowhere_else() {
    let times: Vec<f32> = (0..11).map(|k| 0.1 * k as f32).collect();
    let one = measure::scene(1, 0);
    let mut all = vec![one.clone(); times.len()];
    for (s, t) in all.iter_mut().zip(&times) {
        s.means[0] = one.means[0] + Vec3::new(2.0 * t, 0.0, (t - 0.5).abs());
        s.opacities[0] = 0.9;
    }
    let spans = Spans::fit(&Frames::new(times.clone(), all.clone()).unwrap(), &[], Tolerance(0.1), 3.3);
    assert_eq!(spans.len(), 3, "a line to the bend, a line from it, and the last frame");
    let again = Spans::read(&spans.bytes().unwrap()).unwrap();
    for (t, s) in times.iter().zip(&all) {
        let got = again.splats(*t);
        assert_eq!(got.len(), 1, "{t}");
        let off = got.means[0].distance(s.means[0]);
        assert!(off < 0.05 * one.scales[0].max_element() + 1e-4, "{off} at {t}");
        assert!((got.opacities[0] - 0.9).abs() < 0.003);
    }
    let halfway = again.splats(0.25).means[0];
    assert!((halfway.x - one.means[0].x - 0.5).abs() < 0.05 * one.scales[0].max_element() + 1e-4);
}

#[test]
fn pages_give_their_clip_back_and_fetch_nothing() {
    for kernel in [false, true] {
        let (times, splats) = scene(kernel);
        let clip = Clip::fit(&Frames::new(times, splats).unwrap(), &[camera()], Tolerance::default());
        let layer = Layer { name: "speed".into(), meaning: "red: fast".into(), colors: vec![[1, 2, 3]; 300] };
        let short = Layer { colors: vec![[0; 3]; 7], ..layer.clone() };
        let clip = clip.with_layers(vec![layer, short]);
        let page = Page {
            title: "a <b> {clip}".into(),
            start: Start::default(),
            background: [1.0; 3],
            clock: Some([0.0, 2.0]),
        };
        let html = page.html(&clip).unwrap();
        assert_eq!(read(&html).unwrap(), clip);
        assert!(html.contains("<title>a &lt;b&gt; {clip}</title>") && html.contains("default-src 'none'"));
        for outside in ["http://", "https://", "src=", "@import", "url("] {
            assert!(!html.contains(outside), "{outside}");
        }
    }
}

#[test]
fn frames_that_do_not_belong_together_are_refused() {
    let (times, splats) = scene(false);
    let error = |times: Vec<f32>, splats: Vec<Splats>| Frames::new(times, splats).unwrap_err().to_string();
    assert!(error(vec![], vec![]).contains("no frame"));
    assert!(error(vec![0.0, 0.0], splats[..2].to_vec()).contains("ascend"));
    assert!(error(vec![0.0, 1.0], vec![splats[0].clone(), splats[0].rows(&[0, 1])]).contains("frame 1: other splats"));
    let mut faint = splats[0].clone();
    faint.opacities.fill(0.001);
    assert!(error(vec![0.0], vec![faint.clone()]).contains("no splat is visible"));
    // What is never seen is left out.
    faint.opacities[7] = 0.5;
    assert_eq!(Frames::new(vec![0.0, 1.0], vec![faint.clone(), faint]).unwrap().len(), 1);
    assert_eq!(times.len(), FRAMES);
}

#[test]
fn damaged_pages_are_errors() {
    let (times, splats) = scene(true);
    let clip = Clip::fit(&Frames::new(times, splats).unwrap(), &[camera()], Tolerance::default());
    let page = Page { title: "t".into(), start: Start::default(), background: [0.0; 3], clock: None };
    let html = page.html(&clip).unwrap();
    assert!(matches!(read("<p>"), Err(PlayerError::Damaged(_))));
    let begin = html.find("<script id=\"clip\"").unwrap();
    let mut r = Rng::new(1, "damage", 0, 0);
    for _ in 0..200 {
        let mut bytes = html.clone().into_bytes();
        let at = begin + 40 + (r.uniform() * 20_000.0) as usize;
        bytes[at] = b"ABCxyz019+/"[(r.uniform() * 11.0) as usize];
        // A value or an error.
        let _ = read(&String::from_utf8(bytes).unwrap());
    }
    assert!(read(&html[..begin + 5000]).is_err());
}
