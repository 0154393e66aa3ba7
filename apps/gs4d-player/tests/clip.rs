//! Clips and spans against the scenes they were made from: the bound holds, bytes come back, damage is an error. Pages of the guide
//! against the present player.

use glam::{Quat, Vec3};
use gs_core::rng::Rng;
use gs_core::{Camera, Color, Kernel, Splats, rot};
use gs_raster::{RasterOptions, Workspace, measure, render};
use gs4d_player::{Clip, Frames, Layer, Page, PlayerError, RenderSettings, Spans, Start, Tolerance, read, words};
use half::f16;
use std::fs;
use std::path::Path;

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
    psnr_at(96, a, b)
}

fn psnr_at(side: u32, a: &Splats, b: &Splats) -> f64 {
    let camera = measure::camera(side);
    let draw = |s: &Splats| render(s, &camera, &RasterOptions::default(), &mut Workspace::new()).rgb.data;
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

/// Balls, discs and needles up to a thousand times as long as wide, that move, turn and breathe.
fn needles(seed: u64) -> (Vec<f32>, Vec<Splats>) {
    let times: Vec<f32> = (0..FRAMES).map(|k| k as f32 / (FRAMES - 1) as f32).collect();
    let at = |&t: &f32| {
        let mut s = measure::scene(400, 0);
        s.opacities.fill(0.8);
        for i in 0..s.len() {
            let mut r = Rng::new(seed, "needles", 0, i as u64);
            let mut vector = |by: f32| Vec3::from_array([0; 3].map(|_| by * r.normal()));
            let (path, axis, size) = (vector(0.2), vector(1.0).normalize(), vector(1.0) * 2.0 - 3.0);
            let (speed, breath) = (vector(2.0).x.powi(2), vector(0.3));
            s.means[i] += path * (3.0 * t + i as f32).sin();
            s.quats[i] = rot::from_glam(Quat::from_axis_angle(axis, speed * t) * rot::to_glam(s.quats[i]));
            s.scales[i] = (size.clamp(Vec3::splat(-6.9), Vec3::ZERO) + breath * (5.0 * t).sin()).exp();
        }
        s
    };
    let splats = times.iter().map(at).collect();
    (times, splats)
}

/// The splats as the words of the renderer have them.
fn drawn(clip: &Clip, time: f32) -> Splats {
    let mut s = clip.splats(time);
    for (i, word) in words::bytes(&s, &camera()).as_chunks::<{ words::BYTES }>().0.iter().enumerate() {
        let short = |k: usize| [word[16 + 2 * k], word[17 + 2 * k]];
        s.quats[i] = rot::normalise([0, 1, 2, 3].map(|k| f32::from(i16::from_le_bytes(short(k))))).wxyz;
        s.scales[i] = Vec3::from_array([4, 5, 6].map(|k| f16::from_le_bytes(short(k)).to_f32().exp()));
    }
    s
}

/// The largest share of their bounds that means, turned ends and scales are off by.
fn shares(got: &Splats, want: &Splats, least: &[f32], tolerance: f32) -> [f32; 3] {
    let mut out = [0.0f32; 3];
    for (i, bound) in least.iter().map(|d| tolerance * d).enumerate() {
        let [p, q] = [got, want].map(|s| glam::Mat3::from_quat(rot::to_glam(s.quats[i]).normalize()));
        let ends = (0..3).map(|k| want.scales[i][k] * p.col(k).distance(q.col(k))).fold(0.0, f32::max);
        let factor = (got.scales[i] / want.scales[i]).to_array().map(|f| f.max(1.0 / f) - 1.0);
        let here = [
            (got.means[i] - want.means[i]).abs().max_element() / (bound + 1e-6),
            ends / bound.max(want.scales[i].max_element() / 8192.0),
            factor.into_iter().fold(0.0, f32::max) / tolerance.max(0.008),
        ];
        out = std::array::from_fn(|k| out[k].max(here[k]));
    }
    out
}

/// The least standard deviation of each splat, together with a pixel's at the camera.
fn least(splats: &[Splats], camera: Option<&Camera>) -> Vec<f32> {
    let blur = |m: Vec3| camera.map_or(0.0, |c| (0.3f64.sqrt() * c.to_camera(m.as_dvec3()).z / c.fx) as f32);
    let here = |s: &Splats, i: usize| [s.scales[i].min_element(), blur(s.means[i])];
    let of = |i| splats.iter().map(|s| here(s, i)).reduce(|[a, b], [c, d]| [a.min(c), b.min(d)]).unwrap();
    (0..splats[0].len()).map(of).map(|[scale, pixel]| scale.hypot(pixel)).collect()
}

/// Half way on the line between two frames.
fn halfway(from: &Splats, to: &Splats) -> Splats {
    let mut line = from.clone();
    for i in 0..line.len() {
        let [a, b] = [from, to].map(|s| rot::to_glam(s.quats[i]).normalize());
        line.means[i] = 0.5 * (from.means[i] + to.means[i]);
        line.quats[i] = rot::from_glam(a + if a.dot(b) < 0.0 { -b } else { b });
        line.scales[i] = (from.scales[i] * to.scales[i]).map(f32::sqrt);
    }
    line
}

#[test]
fn no_mean_end_or_scale_is_off_by_more_than_the_bound() {
    for (seed, tolerance, cameras) in [(1, 0.1, vec![camera()]), (2, 0.3, vec![]), (3, 0.02, vec![camera()])] {
        let (times, splats) = needles(seed);
        let clip = Clip::fit(&Frames::new(times.clone(), splats.clone()).unwrap(), &cameras, Tolerance(tolerance));
        let least = least(&splats, cameras.first());
        let (mut at, mut between) = ([0.0f32; 3], [0.0f32; 3]);
        let more = |most: &mut [f32; 3], got: &Splats, want: &Splats| {
            let here = shares(got, want, &least, tolerance);
            *most = std::array::from_fn(|k| most[k].max(here[k]));
        };
        for (k, &t) in times.iter().enumerate() {
            more(&mut at, &drawn(&clip, t), &splats[k]);
            if k > 0 {
                more(&mut between, &clip.splats(0.5 * (times[k - 1] + t)), &halfway(&splats[k - 1], &splats[k]));
            }
        }
        println!("tolerance {tolerance}: {at:.3?} of the bounds at frames, {between:.3?} between them");
        assert!(at.iter().all(|s| (0.4..=1.001).contains(s)), "{tolerance}: {at:?}");
        assert!(between.iter().zip([1.001, 1.415, 1.001]).all(|(s, most)| *s <= most), "{tolerance}: {between:?}");
    }
}

/// 25 000 splats with harmonics of degree 3, in colours that change from place to place, that all move, turn and breathe; what is
/// trained is off from them by noise.
fn many(times: &[f32], noise: f32) -> Vec<Splats> {
    let base = measure::scene(25_050, 3);
    let at = |&t: &f32| {
        let mut s = base.clone();
        let Color::Sh { coeffs, .. } = &mut s.color else { unreachable!() };
        for (i, row) in coeffs.as_chunks_mut::<48>().0.iter_mut().enumerate() {
            let (mut r, at) = (Rng::new(9, "many", 0, i as u64), s.means[i]);
            let mut vector = || noise * Vec3::from_array([0; 3].map(|_| r.normal()));
            let wave = Vec3::new(4.0 * t + 6.0 * at.x, 3.0 * t + 5.0 * at.y, 5.0 * t + 4.0 * at.z).map(f32::sin);
            s.means[i] += 0.15 * wave + vector() * s.scales[i];
            s.quats[i] = rot::from_glam(Quat::from_rotation_y(wave.y) * rot::to_glam(s.quats[i]).normalize());
            s.scales[i] *= (0.2 * wave + vector()).exp();
            row[3..].iter_mut().for_each(|c| *c *= 0.2);
            let color = (5.0 * at).map(f32::sin) + 0.2 * Vec3::from_slice(row) + vector();
            row[..3].copy_from_slice(&color.to_array());
        }
        s
    };
    times.iter().map(at).collect()
}

#[test]
#[ignore = "half a minute: cargo test -p gs4d-player --test clip -- --ignored --nocapture"]
fn a_page_of_25_000_moving_splats_holds_60_frames_in_8_mb_for_three_tenths_of_a_decibel() {
    let times: Vec<f32> = (0..60).map(|k| k as f32 / 59.0).collect();
    let (truth, trained) = (many(&times, 0.0), many(&times, 0.13));
    let cameras = [measure::camera(400)];
    let clip = Clip::fit(&Frames::new(times.clone(), trained.clone()).unwrap(), &cameras, Tolerance::default());
    let page = Page { title: "many".into(), start: Start::default(), background: [0.0; 3], clock: None };
    let html = page.html(&clip).unwrap();
    let (again, kept) = (read(&html).unwrap(), clip.moving());
    let mean = |of: &dyn Fn(usize) -> f64| (0..60).step_by(3).map(of).sum::<f64>() / 20.0;
    let before = mean(&|k| psnr_at(400, &trained[k], &truth[k]));
    let after = mean(&|k| psnr_at(400, &again.splats(times[k]), &truth[k]));
    let mb = html.len() as f64 / 1e6;
    println!(
        "{} splats, {kept} move: {mb:.2} MB, {before:.2} dB as trained, {after:.2} dB as the page has it",
        clip.len()
    );
    assert!(clip.len() >= 25_000 && kept >= 25_000 && mb <= 8.0, "{} {kept} {mb}", clip.len());
    assert!((32.0..35.0).contains(&before) && before - after <= 0.3, "{before} {after}");
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
    assert!(before[0] > 40.0 && before[1] > before[0] + 0.5, "{before:?}");
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
        let settings = RenderSettings { near: 0.2, dilation: 0.1, antialias: kernel };
        let clip = if kernel { clip.with_render_settings(settings) } else { clip };
        let page = Page {
            title: "a <b> {clip}".into(),
            start: Start::default(),
            background: [1.0; 3],
            clock: Some([0.0, 2.0]),
        };
        let html = page.html(&clip).unwrap();
        assert_eq!(read(&html).unwrap(), clip);
        assert_eq!(read(&html).unwrap().render_settings(), if kernel { settings } else { RenderSettings::default() });
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

/// The pages that the guide shows play as pages do that are written now.
#[test]
fn pages_of_the_guide_hold_the_present_player() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let read_text = |path: &Path| fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let files = |folder: &str| {
        let entries = fs::read_dir(here.join(folder)).unwrap();
        let mut all: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
        all.sort();
        all
    };
    let pages = files("../../docs/guide/pages");
    assert_eq!(pages.len(), 3, "{pages:?}");
    for page in &pages {
        let html = read_text(page);
        assert!(read(&html).unwrap().len() > 100, "{}", page.display());
        for part in &files("src/page") {
            let source = read_text(part);
            let present = match part.extension().is_some_and(|e| e == "html") {
                // But for the lines that the page fills in.
                true => source.lines().filter(|line| !line.contains('{')).all(|line| html.contains(line)),
                false => html.contains(&source),
            };
            let (page, part) = (page.display(), part.display());
            assert!(present, "{page} has another {part}: export it again, as docs/guide/player.md says");
        }
    }
}
