//! Any number of colour channels: groups of three over the same geometry.
//!
//! The blend carries three channels. Further ones are blended in groups of three over the lists of the first group, so
//! projection, depth order and lists are made once. A frame is linear in its colours, so the gradient of the geometry is
//! the sum over the groups; the cotangents of alpha and depth go with the first. What lies behind is black: add
//! `(1 − alpha) · background` for another.

use crate::backward::render_backward_with_camera;
use crate::camera_grad::CameraGrad;
use crate::forward::{Lists, recolor, render_lists};
use crate::frame::{Frame, FrameGrad, ScreenStats};
use crate::options::RasterOptions;
use crate::workspace::Workspace;
use gs_core::{Camera, Color, Image, SplatsGrad, SplatsRef, sh};

/// Channels of a group: those of the blend.
const GROUP: usize = 3;

/// Colours of any number of channels.
///
/// ```
/// use gs_raster::{Channels, RasterOptions, Workspace, measure, render_channels};
///
/// let (splats, camera) = (measure::scene(100, 0), measure::camera(32));
/// let values = vec![0.5; 100 * 7]; // seven features of each splat
/// let channels = Channels::new(100, 7, &values, None)?;
/// let frame = render_channels(&splats, &channels, &camera, &RasterOptions::default(), &mut Workspace::new());
/// assert_eq!(frame.rgb.shape(), (32, 32, 7));
/// assert!(frame.rgb.data.chunks(7).zip(&frame.alpha).all(|(pixel, a)| pixel.iter().all(|v| (v - 0.5 * a).abs() < 1e-5)));
/// # Ok::<(), gs_raster::ChannelsError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Channels {
    count: usize,
    groups: Vec<Color>,
}

/// Colours that do not fit the splats.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ChannelsError {
    /// There is no channel.
    #[error("a colour needs a channel at least, 0 were asked for")]
    Empty,
    /// An SH degree above 3.
    #[error("SH degree {0} is not supported (0 to 3)")]
    Degree(u8),
    /// The number of values is not that of rows, coefficients and channels.
    #[error("{rows} splats of {channels} channels need {want} values, {got} were given")]
    Length {
        /// Number of splats.
        rows: usize,
        /// Number of channels.
        channels: usize,
        /// Number of values needed.
        want: usize,
        /// Number of values given.
        got: usize,
    },
    /// A value is not finite.
    #[error("the colour of splat {row} has a channel of {value}: it must be finite")]
    Value {
        /// Index of the splat, from 0.
        row: usize,
        /// Value met.
        value: f32,
    },
}

impl Channels {
    /// Colours of `rows` splats of `channels` channels, in any unit: plain values, `[rows, channels]`, if `degree` is `None`,
    /// else SH coefficients of degree 0 to 3, `[rows, (degree + 1)², channels]`.
    ///
    /// # Errors
    /// If there is no channel, the number of values does not fit, or one is not finite.
    pub fn new(rows: usize, channels: usize, values: &[f32], degree: Option<u8>) -> Result<Self, ChannelsError> {
        if channels == 0 {
            return Err(ChannelsError::Empty);
        }
        if let Some(degree) = degree.filter(|d| *d > sh::MAX_DEGREE) {
            return Err(ChannelsError::Degree(degree));
        }
        let want = rows * degree.map_or(1, sh::coeffs) * channels;
        if values.len() != want {
            return Err(ChannelsError::Length { rows, channels, want, got: values.len() });
        }
        if let Some((at, &value)) = values.iter().enumerate().find(|(_, v)| !v.is_finite()) {
            return Err(ChannelsError::Value { row: at * rows / want, value });
        }
        let group = |coeffs: Vec<f32>| match degree {
            None => Color::Rgb(coeffs.as_chunks().0.to_vec()),
            Some(degree) => Color::Sh { degree, coeffs },
        };
        let groups = split(values, channels).into_iter().map(group).collect();
        Ok(Self { count: channels, groups })
    }

    /// Number of channels, 1 or more.
    pub fn count(&self) -> usize {
        self.count
    }
}

/// The options with black behind the splats.
fn over_black(options: &RasterOptions) -> RasterOptions {
    RasterOptions { background: [0.0; 3], ..options.clone() }
}

/// Splits rows of `channels` values into groups of three channels; the last one is filled up with zeros.
pub fn split<T: Copy + Default>(values: &[T], channels: usize) -> Vec<Vec<T>> {
    if channels == GROUP {
        return vec![values.to_vec()];
    }
    let group = |first: usize| {
        let rows = values.chunks_exact(channels);
        rows.flat_map(|row| (first..first + GROUP).map(|c| row.get(c).copied().unwrap_or_default())).collect()
    };
    (0..channels).step_by(GROUP).map(group).collect()
}

/// Rows of `channels` values from groups of three channels: the inverse of [`split`].
///
/// ```
/// use gs_raster::channels::{join, split};
///
/// let values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]; // two rows of four
/// let groups = split(&values, 4);
/// assert_eq!(groups, [[1.0, 2.0, 3.0, 5.0, 6.0, 7.0], [4.0, 0.0, 0.0, 8.0, 0.0, 0.0]]);
/// assert_eq!(join(groups, 4), values);
/// ```
pub fn join<T: Copy>(mut groups: Vec<Vec<T>>, channels: usize) -> Vec<T> {
    if channels == GROUP {
        return groups.pop().unwrap_or_default();
    }
    let rows = groups.first().map_or(0, |group| group.len() / GROUP);
    (0..rows)
        .flat_map(|row| (0..channels).map(move |c| (row, c)))
        .map(|(row, c)| groups[c / GROUP][row * GROUP + c % GROUP])
        .collect()
}

/// Renders `splats` with the colours of `channels` instead of their own, over black whatever `options` says. The frame's
/// [`Frame::rgb`] is `[height, width, channels]`; of three channels it has the bits of [`crate::render`].
///
/// `splats` and `camera` must have passed their `check`, and `channels` have as many rows. The result is the same bits
/// for any number of threads.
pub fn render_channels<'a>(
    splats: impl Into<SplatsRef<'a>>,
    channels: &Channels,
    camera: &Camera,
    options: &RasterOptions,
    workspace: &mut Workspace,
) -> Frame {
    let (splats, options) = (splats.into(), over_black(options));
    let mut frame = Frame::default();
    let mut images = Vec::with_capacity(channels.groups.len());
    let mut lists = Lists::New(camera);
    for color in &channels.groups {
        render_lists(SplatsRef { color, ..splats }, lists, &options, workspace, &mut frame);
        images.push(std::mem::take(&mut frame.rgb.data));
        lists = Lists::Kept;
    }
    let (width, height, channels) = (camera.width as usize, camera.height as usize, channels.count());
    frame.rgb = Image { width, height, channels, data: join(images, channels) };
    frame
}

/// Gradient of the loss whose cotangents are `d` (its `rgb` is `[height, width, channels]`), screen-space statistics, and
/// the gradient with respect to the camera. The cotangents of the colours have the layout of the values that `channels` was made from.
///
/// Must follow [`render_channels`] of the same splats, channels, camera and options with the same workspace. The result
/// is the same bits for any number of threads.
///
/// ```
/// use gs_raster::{Channels, FrameGrad, RasterOptions, Workspace, measure, render_channels, render_channels_backward};
///
/// let (splats, camera, options) = (measure::scene(100, 0), measure::camera(32), RasterOptions::default());
/// let channels = Channels::new(100, 4, &[0.5; 100 * 4], None)?;
/// let mut workspace = Workspace::new();
/// let frame = render_channels(&splats, &channels, &camera, &options, &mut workspace);
/// let d = FrameGrad { rgb: vec![1.0; frame.rgb.data.len()], ..FrameGrad::default() };
/// let (grad, _, _) = render_channels_backward(&splats, &channels, &camera, &options, &mut workspace, &d);
/// assert_eq!(grad.color.len(), 100 * 4);
/// // The image of a channel is the sum of the splats' weights times their colour.
/// let sum = |v: &[f32]| v.iter().map(|&x| f64::from(x)).sum::<f64>();
/// assert!((0.5 * sum(&grad.color) / sum(&frame.rgb.data) - 1.0).abs() < 1e-4);
/// # Ok::<(), gs_raster::ChannelsError>(())
/// ```
pub fn render_channels_backward<'a>(
    splats: impl Into<SplatsRef<'a>>,
    channels: &Channels,
    camera: &Camera,
    options: &RasterOptions,
    workspace: &mut Workspace,
    d: &FrameGrad,
) -> (SplatsGrad, ScreenStats, CameraGrad) {
    let (splats, options) = (splats.into(), over_black(options));
    let (mut total, mut stats, mut camera_grad) =
        (SplatsGrad::default(), ScreenStats::default(), CameraGrad::default());
    if let ([color], GROUP) = (channels.groups.as_slice(), channels.count()) {
        // The cotangents as they are.
        let splats = SplatsRef { color, ..splats };
        let camera = render_backward_with_camera(splats, camera, &options, workspace, d, &mut total, &mut stats);
        return (total, stats, camera);
    }
    let mut d_colors = Vec::with_capacity(channels.groups.len());
    let mut d_images = split(&d.rgb, channels.count()).into_iter();
    let mut d = FrameGrad { rgb: Vec::new(), alpha: d.alpha.clone(), depth: d.depth.clone() };
    for color in &channels.groups {
        let splats = SplatsRef { color, ..splats };
        d.rgb = d_images.next().unwrap_or_default();
        let (mut grad, mut part) = (SplatsGrad::default(), ScreenStats::default());
        if channels.groups.len() > 1 {
            recolor(splats, &options, workspace);
        }
        camera_grad += render_backward_with_camera(splats, camera, &options, workspace, &d, &mut grad, &mut part);
        d_colors.push(std::mem::take(&mut grad.color));
        if d_colors.len() == 1 {
            (total, stats) = (grad, part);
            (d.alpha, d.depth) = Default::default();
        } else {
            add(&mut total, &grad);
            add_rows(&mut stats.grad_means2d, &part.grad_means2d);
        }
    }
    total.color = join(d_colors, channels.count());
    (total, stats, camera_grad)
}

/// Adds the gradient of the same splats, but for the colours.
pub(crate) fn add(total: &mut SplatsGrad, group: &SplatsGrad) {
    total.means.iter_mut().zip(&group.means).for_each(|(to, from)| *to += *from);
    total.scales.iter_mut().zip(&group.scales).for_each(|(to, from)| *to += *from);
    add_rows(&mut total.quats, &group.quats);
    total.opacities.iter_mut().zip(&group.opacities).for_each(|(to, from)| *to += *from);
    total.kernel.iter_mut().zip(&group.kernel).for_each(|(to, from)| *to += *from);
}

fn add_rows<const N: usize>(to: &mut [[f32; N]], from: &[[f32; N]]) {
    to.as_flattened_mut().iter_mut().zip(from.as_flattened()).for_each(|(to, from)| *to += *from);
}
