//! Any number of channels against the path of three, and against the f64 reference.

use crate::common;
use gs_core::{Color, SplatsRef, sh};
use gs_raster::reference::{Cutoff, Scene, render_backward as reference_backward};
use gs_raster::{
    CameraGrad, Channels, ChannelsError, Frame, FrameGrad, RasterOptions, Workspace, measure, render,
    render_backward_with_camera, render_channels, render_channels_backward,
};

/// Values of `rows` splats, colours of the given degree.
fn values(rows: usize, degree: Option<u8>, channels: usize) -> Vec<f32> {
    common::weights(7, rows * degree.map_or(1, sh::coeffs) * channels)
}

fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool")
}

#[test]
fn three_channels_have_the_bits_of_the_plain_path() {
    let (splats, camera) = (measure::scene(5000, 2), measure::camera(80));
    let options = RasterOptions::default();
    let channels = Channels::new(5000, 3, splats.color.as_flat(), Some(2)).expect("channels");
    let (mut plain, mut grouped) = (Workspace::new(), Workspace::new());
    let want = render(&splats, &camera, &options, &mut plain);
    assert_eq!(render_channels(&splats, &channels, &camera, &options, &mut grouped), want);
    let n = want.alpha.len();
    let w = common::weights(1, 5 * n);
    let d = FrameGrad { rgb: w[..3 * n].to_vec(), alpha: w[3 * n..4 * n].to_vec(), depth: w[4 * n..].to_vec() };
    let (mut grad, mut stats) = Default::default();
    let camera_grad = render_backward_with_camera(&splats, &camera, &options, &mut plain, &d, &mut grad, &mut stats);
    let want = (grad, stats, camera_grad);
    let screen = grouped.screen(5000);
    let mut seen = 0;
    for (i, (&radius, &want)) in
        screen.radii.iter().zip(&want.1.radii).enumerate().filter(|(_, (_, want))| **want > 0.0)
    {
        assert!((radius / want - 1.0).abs() < 1e-4, "radius {radius}, {want}");
        let point = camera.to_camera(splats.means[i].as_dvec3());
        assert!((f64::from(screen.depths[i]) - point.z).abs() < 1e-6);
        assert!((glam::DVec2::from(screen.means2d[i].map(f64::from)) - camera.to_pixel(point)).length() < 1e-4);
        seen += 1;
    }
    assert!(seen > 3000, "{seen} of 5000 splats were seen");
    assert_eq!(render_channels_backward(&splats, &channels, &camera, &options, &mut grouped, &d), want);
}

/// Each group of the frame is the frame of that group alone, bit for bit, with plain colours and SH.
#[test]
fn groups_have_the_bits_of_frames_of_their_own() {
    let (splats, camera) = (measure::scene(6000, 0), measure::camera(70));
    for (degree, count) in [(None, 1), (None, 8), (Some(1), 5)] {
        let values = values(6000, degree, count);
        let channels = Channels::new(6000, count, &values, degree).expect("channels");
        let options = RasterOptions::default();
        let frame = render_channels(&splats, &channels, &camera, &options, &mut Workspace::new());
        for first in (0..count).step_by(3) {
            let at = |row: &[f32], c: usize| row.get(first + c).copied().unwrap_or(0.0);
            let three = |v: &[f32]| v.chunks(count).map(|row| [0, 1, 2].map(|c| at(row, c))).collect::<Vec<_>>();
            let color = match degree {
                None => Color::Rgb(three(&values)),
                Some(degree) => Color::Sh { degree, coeffs: three(&values).as_flattened().to_vec() },
            };
            let alone = SplatsRef { color: &color, ..splats.view() };
            let Frame { rgb, alpha, depth } = render(alone, &camera, &options, &mut Workspace::new());
            assert_eq!((&frame.alpha, &frame.depth), (&alpha, &depth));
            for (pixel, want) in frame.rgb.data.chunks(count).zip(rgb.data.chunks(3)) {
                let part = &pixel[first..count.min(first + 3)];
                assert_eq!(part, &want[..part.len()]);
            }
        }
    }
}

/// Gradients of seven channels, alpha and depth: the sum over groups of the reference's. As in `production.rs`, cosine
/// at least 0.9999 and relative L2 at most 1e-3.
#[test]
fn gradients_match_the_reference() {
    let (count, mut checked) = (7, 0);
    for seed in [0, 1, 2, 6, 8, 9, 14] {
        let case = common::case(seed, 60);
        let (n, options) = (case.splats.len(), RasterOptions::default());
        let values = values(n, None, count);
        let channels = Channels::new(n, count, &values, None).expect("channels");
        let mut workspace = Workspace::new();
        let frame = render_channels(&case.splats, &channels, &case.camera, &options, &mut workspace);
        let mut scene = Scene::<f64>::new(&case.splats);
        scene.degree = None;
        scene.color = vec![0.0; 3 * n];
        let margins = gs_raster::reference::render(&scene, &case.camera, &options, Cutoff::Hard).margin;
        if margins.iter().any(|m| *m < 1e-5) {
            continue;
        }
        checked += 1;
        let pixels = frame.alpha.len();
        let w = common::weights(seed, (count + 2) * pixels);
        let (rgb, rest) = w.split_at(count * pixels);
        let d = FrameGrad { rgb: rgb.to_vec(), alpha: rest[..pixels].to_vec(), depth: rest[pixels..].to_vec() };
        let (grad, stats, camera_grad) =
            render_channels_backward(&case.splats, &channels, &case.camera, &options, &mut workspace, &d);

        let mut want_camera = CameraGrad::default();
        let mut want =
            vec![vec![0.0f64; 3 * n], vec![0.0; 4 * n], vec![0.0; n], vec![0.0; count * n], vec![0.0; 2 * n]];
        for first in (0..count).step_by(3) {
            let at = |row: &[f32], c: usize| row.get(first + c).copied().map_or(0.0, f64::from);
            scene.color = values.chunks(count).flat_map(|row| [0, 1, 2].map(|c| at(row, c))).collect();
            let once = if first == 0 { 1.0 } else { 0.0 };
            let d: Vec<_> = (0..pixels)
                .map(|i| {
                    let row = &d.rgb[count * i..][..count];
                    ([0, 1, 2].map(|c| at(row, c)), once * f64::from(d.alpha[i]), once * f64::from(d.depth[i]))
                })
                .collect();
            let (g, means2d, part) = reference_backward(&scene, &case.camera, &options, Cutoff::Hard, &d);
            want_camera += part;
            let columns = [g.means.as_flattened(), g.quats.as_flattened(), &g.opacities, &[], means2d.as_flattened()];
            for (to, from) in want.iter_mut().zip(columns) {
                to.iter_mut().zip(from).for_each(|(a, b)| *a += b);
            }
            for (i, row) in g.color.chunks(3).enumerate() {
                for (c, v) in row.iter().enumerate().filter(|(c, _)| first + c < count) {
                    want[3][i * count + first + c] = *v;
                }
            }
        }
        let wide = |v: &[f32]| v.iter().map(|&x| f64::from(x)).collect::<Vec<_>>();
        let got = [
            ("means", grad.means.iter().flat_map(|m| m.to_array()).map(f64::from).collect()),
            ("quats", wide(grad.quats.as_flattened())),
            ("opacities", wide(&grad.opacities)),
            ("color", wide(&grad.color)),
            ("means2d", wide(stats.grad_means2d.as_flattened())),
            ("camera", camera_grad.to_array().to_vec()),
        ];
        want.push(want_camera.to_array().to_vec());
        for ((kind, got), want) in got.iter().zip(&want) {
            assert_eq!(got.len(), want.len());
            let (mut dot, mut g2, mut w2, mut off) = (0.0, 0.0, 1e-300, 0.0);
            for (g, w) in got.iter().zip(want) {
                (dot, g2, w2, off) = (dot + g * w, g2 + g * g, w2 + w * w, off + (g - w) * (g - w));
            }
            let (cosine, l2) = (dot / (g2 * w2).sqrt().max(1e-300), (off / w2).sqrt());
            assert!(w2 < 1e-20 || (cosine >= 0.9999 && l2 <= 1e-3), "scene {seed}: {kind}: {cosine:.6} {l2:.1e}");
        }
    }
    assert!(checked >= 4, "{checked} scenes were free of near decisions");
}

#[test]
fn the_bits_do_not_depend_on_threads() {
    let (splats, camera, options) = (measure::scene(20_000, 0), measure::camera(96), RasterOptions::default());
    let channels = Channels::new(20_000, 5, &values(20_000, None, 5), None).expect("channels");
    let all = |threads| {
        pool(threads).install(|| {
            let mut workspace = Workspace::new();
            let frame = render_channels(&splats, &channels, &camera, &options, &mut workspace);
            let d = FrameGrad { rgb: common::weights(3, frame.rgb.data.len()), ..FrameGrad::default() };
            let grad = render_channels_backward(&splats, &channels, &camera, &options, &mut workspace, &d);
            (frame, grad)
        })
    };
    let one = all(1);
    assert!(all(2) == one && all(5) == one);
}

#[test]
fn colours_that_do_not_fit_are_refused() {
    assert_eq!(Channels::new(2, 0, &[], None), Err(ChannelsError::Empty));
    let short = Channels::new(2, 4, &[0.0; 7], None).unwrap_err().to_string();
    assert_eq!(short, "2 splats of 4 channels need 8 values, 7 were given");
    assert_eq!(Channels::new(1, 4, &[0.0; 100], Some(4)), Err(ChannelsError::Degree(4)));
    let nan = Channels::new(2, 2, &[0.0, 0.0, f32::NAN, 0.0], None).unwrap_err().to_string();
    assert_eq!(nan, "the colour of splat 1 has a channel of NaN: it must be finite");
}
