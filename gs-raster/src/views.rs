//! Several cameras per call, with colours of any number of channels: a frame of each, and gradients of the splats that are
//! summed over the cameras in their order.

use crate::camera_grad::CameraGrad;
use crate::channels::{Channels, add, render_channels, render_channels_backward};
use crate::frame::{Frame, FrameGrad, ScreenStats};
use crate::options::RasterOptions;
use crate::workspace::Workspace;
use gs_core::{Camera, SplatsGrad, SplatsRef};

/// Arguments that do not fit the cameras.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{argument}` has {got} entries for {cameras} cameras")]
pub struct ViewsError {
    /// Name of the argument.
    pub argument: &'static str,
    /// Number of entries that it has.
    pub got: usize,
    /// Number of cameras.
    pub cameras: usize,
}

/// Gradients over several cameras; all empty without a camera.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct ViewsGrad {
    /// Of the splats, summed over the cameras in their order; its colours are empty.
    pub splats: SplatsGrad,
    /// One for each [`Channels`] that was given, in the layout of its values; summed over the cameras that share it.
    pub colors: Vec<Vec<f32>>,
    /// Of each camera: screen-space statistics.
    pub stats: Vec<ScreenStats>,
    /// Of each camera: the gradient of its pose and intrinsics.
    pub cameras: Vec<CameraGrad>,
}

/// Renders `splats` from every camera: the frame of each is that of [`render_channels`], bit for bit. Images may differ in
/// size. `colors` has one entry for all cameras, or one for each.
///
/// `workspaces` is made as long as `cameras`; [`render_views_backward`] reads it. The result is the same bits for any number
/// of threads.
///
/// # Errors
/// If the number of `colors` does not fit.
///
/// ```
/// use gs_raster::{Channels, RasterOptions, measure, render_views};
///
/// let (splats, near, far) = (measure::scene(100, 0), measure::camera(32), measure::camera(16));
/// let colors = [Channels::new(100, 5, &[0.5; 100 * 5], None)?]; // five features of each splat
/// let frames = render_views(&splats, &colors, &[near, far], &RasterOptions::default(), &mut Vec::new())?;
/// assert_eq!((frames[0].rgb.shape(), frames[1].rgb.shape()), ((32, 32, 5), (16, 16, 5)));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn render_views<'a>(
    splats: impl Into<SplatsRef<'a>>,
    colors: &[Channels],
    cameras: &[Camera],
    options: &RasterOptions,
    workspaces: &mut Vec<Workspace>,
) -> Result<Vec<Frame>, ViewsError> {
    let splats = splats.into();
    check_colors(colors, cameras)?;
    workspaces.resize_with(cameras.len(), Workspace::new);
    let views = cameras.iter().zip(workspaces).zip(colors.iter().cycle());
    let frames = views.map(|((camera, workspace), colors)| render_channels(splats, colors, camera, options, workspace));
    Ok(frames.collect())
}

/// Gradients of the loss whose cotangents are `d`, one for each camera (see [`render_channels_backward`]).
///
/// Must follow [`render_views`] of the same splats, colours, cameras and options with the same workspaces. The result is the
/// same bits for any number of threads.
///
/// # Errors
/// If the number of `colors`, `workspaces` or `d` does not fit.
///
/// ```
/// use gs_raster::{Channels, FrameGrad, RasterOptions, measure, render_views, render_views_backward};
///
/// let (splats, options) = (measure::scene(100, 0), RasterOptions::default());
/// let cameras = [measure::camera(32), measure::camera(16)];
/// let colors = [Channels::new(100, 4, &[0.5; 100 * 4], None)?];
/// let mut workspaces = Vec::new();
/// let frames = render_views(&splats, &colors, &cameras, &options, &mut workspaces)?;
/// // The loss is the sum of all values of all images.
/// let ones = |rgb: &[f32]| FrameGrad { rgb: vec![1.0; rgb.len()], ..FrameGrad::default() };
/// let d: Vec<FrameGrad> = frames.iter().map(|frame| ones(&frame.rgb.data)).collect();
/// let grad = render_views_backward(&splats, &colors, &cameras, &options, &mut workspaces, &d)?;
/// assert_eq!((grad.splats.means.len(), grad.colors[0].len(), grad.cameras.len()), (100, 100 * 4, 2));
/// // An image is linear in the colours.
/// let sum = |v: &[f32]| v.iter().map(|&x| f64::from(x)).sum::<f64>();
/// let loss: f64 = frames.iter().map(|frame| sum(&frame.rgb.data)).sum();
/// assert!((0.5 * sum(&grad.colors[0]) / loss - 1.0).abs() < 1e-4);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn render_views_backward<'a>(
    splats: impl Into<SplatsRef<'a>>,
    colors: &[Channels],
    cameras: &[Camera],
    options: &RasterOptions,
    workspaces: &mut [Workspace],
    d: &[FrameGrad],
) -> Result<ViewsGrad, ViewsError> {
    let splats = splats.into();
    check_colors(colors, cameras)?;
    for (argument, got) in [("workspaces", workspaces.len()), ("d", d.len())] {
        check(got == cameras.len(), argument, got, cameras)?;
    }
    let mut total = ViewsGrad::default();
    let views = cameras.iter().zip(workspaces).zip(colors.iter().cycle()).zip(d);
    for (i, (((camera, workspace), channels), d)) in views.enumerate() {
        let (mut grad, stats, camera) = render_channels_backward(splats, channels, camera, options, workspace, d);
        let d_colors = std::mem::take(&mut grad.color);
        if i < colors.len() {
            total.colors.push(d_colors);
        } else {
            total.colors[0].iter_mut().zip(&d_colors).for_each(|(to, from)| *to += *from);
        }
        if i == 0 {
            total.splats = grad;
        } else {
            add(&mut total.splats, &grad);
        }
        total.stats.push(stats);
        total.cameras.push(camera);
    }
    Ok(total)
}

/// One for all cameras, or one for each.
fn check_colors(colors: &[Channels], cameras: &[Camera]) -> Result<(), ViewsError> {
    check(colors.len() == 1 || colors.len() == cameras.len(), "colors", colors.len(), cameras)
}

fn check(good: bool, argument: &'static str, got: usize, cameras: &[Camera]) -> Result<(), ViewsError> {
    if good { Ok(()) } else { Err(ViewsError { argument, got, cameras: cameras.len() }) }
}
