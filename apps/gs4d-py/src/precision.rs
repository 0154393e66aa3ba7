//! What draws: the production path of gs-raster in `f32`, its reference in `f64`.

use glam::Vec3;
use gs_core::{Camera, Color, Kernel, Splats, SplatsGrad};
use gs_raster::channels::{join, split};
use gs_raster::reference::{self, Cutoff, Scalar, Scene};
use gs_raster::{
    CameraGrad, Channels, FrameGrad, RasterOptions, Screen, Workspace, render, render_channels,
    render_channels_backward,
};
use numpy::Element;

/// One camera's images, row-major, or their cotangents; empty stands for zero.
#[derive(Clone, Debug, Default)]
pub(crate) struct Images<T> {
    /// `[height, width, channels]`, over black.
    pub colors: Vec<T>,
    /// `[height, width]`.
    pub alphas: Vec<T>,
    /// `[height, width]`: `Σ w z`.
    pub depths: Vec<T>,
}

/// Gradients that one camera's images pull back.
pub(crate) struct Pulled<T> {
    /// Of the splats; `color` has the layout of the colours given.
    pub splats: Scene<T>,
    /// `[n]`: of the projected centres, per pixel.
    pub means2d: Vec<[T; 2]>,
    pub camera: CameraGrad,
}

/// Colours of all splats: `[n, channels]`, or `[n, (degree + 1)², channels]`.
pub(crate) struct Values<'a, T> {
    pub values: &'a [T],
    pub channels: usize,
    pub degree: Option<u8>,
}

/// A type of numbers that can be drawn in.
pub(crate) trait Precision: Scalar + Element + Default {
    /// Splats without colours.
    type Splats: Send + Sync;
    /// Their colours.
    type Colors: Send + Sync;
    /// What a frame leaves for its backward.
    type Memory: Default + Send;

    fn splats(geometry: Scene<Self>) -> Self::Splats;

    /// Takes the colours of `rows` splats.
    fn colors(rows: usize, values: Values<'_, Self>) -> Result<Self::Colors, String>;

    /// One camera's images, and where the splats lie on the screen.
    fn draw(
        splats: &Self::Splats,
        colors: &Self::Colors,
        camera: &Camera,
        options: &RasterOptions,
        memory: &mut Self::Memory,
    ) -> (Images<Self>, Screen);

    /// Must follow [`Precision::draw`] with the same memory.
    fn pull_back(
        splats: &Self::Splats,
        colors: &Self::Colors,
        camera: &Camera,
        options: &RasterOptions,
        memory: &mut Self::Memory,
        d: &Images<Self>,
    ) -> Pulled<Self>;
}

impl Precision for f32 {
    type Splats = Splats;
    type Colors = Channels;
    type Memory = Workspace;

    fn splats(geometry: Scene<f32>) -> Splats {
        Splats {
            means: geometry.means.into_iter().map(Vec3::from_array).collect(),
            quats: geometry.quats,
            scales: geometry.scales.into_iter().map(Vec3::from_array).collect(),
            opacities: geometry.opacities,
            color: Color::default(),
            kernel: Kernel::Gaussian,
        }
    }

    fn colors(rows: usize, Values { values, channels, degree }: Values<'_, f32>) -> Result<Channels, String> {
        Channels::new(rows, channels, values, degree).map_err(|e| e.to_string())
    }

    fn draw(
        splats: &Splats,
        colors: &Channels,
        camera: &Camera,
        options: &RasterOptions,
        workspace: &mut Workspace,
    ) -> (Images<f32>, Screen) {
        let frame = render_channels(splats, colors, camera, options, workspace);
        let images = Images { colors: frame.rgb.data, alphas: frame.alpha, depths: frame.depth };
        (images, workspace.screen(splats.len()))
    }

    fn pull_back(
        splats: &Splats,
        colors: &Channels,
        camera: &Camera,
        options: &RasterOptions,
        workspace: &mut Workspace,
        d: &Images<f32>,
    ) -> Pulled<f32> {
        let Images { colors: rgb, alphas: alpha, depths: depth } = d.clone();
        let d = FrameGrad { rgb, alpha, depth };
        let (grad, stats, camera) = render_channels_backward(splats, colors, camera, options, workspace, &d);
        Pulled { splats: scene_of(grad), means2d: stats.grad_means2d, camera }
    }
}

/// The same columns as those of a reference scene.
fn scene_of(grad: SplatsGrad) -> Scene<f32> {
    Scene {
        means: grad.means.into_iter().map(|m| m.to_array()).collect(),
        quats: grad.quats,
        scales: grad.scales.into_iter().map(|s| s.to_array()).collect(),
        opacities: grad.opacities,
        color: grad.color,
        ..Scene::new(&Splats::default())
    }
}

/// Colours in groups of three channels.
pub(crate) struct Groups {
    groups: Vec<Vec<f64>>,
    channels: usize,
    degree: Option<u8>,
}

impl Groups {
    /// The splats with the colours of each group.
    fn scenes<'a>(&'a self, geometry: &'a Scene<f64>) -> impl Iterator<Item = Scene<f64>> {
        let scene = |color: &Vec<f64>| Scene { color: color.clone(), degree: self.degree, ..geometry.clone() };
        self.groups.iter().map(scene)
    }
}

impl Precision for f64 {
    type Splats = Scene<f64>;
    type Colors = Groups;
    type Memory = ();

    fn splats(geometry: Scene<f64>) -> Scene<f64> {
        geometry
    }

    fn colors(rows: usize, Values { values, channels, degree }: Values<'_, f64>) -> Result<Groups, String> {
        // The same checks as in f32.
        let rounded: Vec<f32> = values.iter().map(|&v| gs_core::cast::to_f32(v)).collect();
        f32::colors(rows, Values { values: &rounded, channels, degree })?;
        Ok(Groups { groups: split(values, channels), channels, degree })
    }

    fn draw(
        splats: &Scene<f64>,
        colors: &Groups,
        camera: &Camera,
        options: &RasterOptions,
        (): &mut (),
    ) -> (Images<f64>, Screen) {
        let mut all = Images::default();
        let mut groups = Vec::new();
        for scene in colors.scenes(splats) {
            let frame = reference::render(&scene, camera, options, Cutoff::Hard);
            groups.push(frame.rgb.into_flattened());
            (all.alphas, all.depths) = (frame.alpha, frame.depth);
        }
        all.colors = join(groups, colors.channels);
        (all, screen(splats, camera, options))
    }

    fn pull_back(
        splats: &Scene<f64>,
        colors: &Groups,
        camera: &Camera,
        options: &RasterOptions,
        (): &mut (),
        d: &Images<f64>,
    ) -> Pulled<f64> {
        let pixels = camera.width as usize * camera.height as usize;
        let mut d_images = split(&d.colors, colors.channels).into_iter();
        let at = |values: &[f64], i: usize| values.get(i).copied().unwrap_or(0.0);
        let mut total = Pulled {
            splats: splats.zeros_like(),
            means2d: vec![[0.0; 2]; splats.means.len()],
            camera: CameraGrad::default(),
        };
        let mut d_colors = Vec::new();
        for (group, scene) in colors.scenes(splats).enumerate() {
            let rgb = d_images.next().unwrap_or_default();
            // Those of alpha and depth go with the first group.
            let once = |values: &[f64], i: usize| if group == 0 { at(values, i) } else { 0.0 };
            let pixel = |i: usize| ([0, 1, 2].map(|c| at(&rgb, 3 * i + c)), once(&d.alphas, i), once(&d.depths, i));
            let d: Vec<_> = (0..pixels).map(pixel).collect();
            let (mut grad, means2d, camera) = reference::render_backward(&scene, camera, options, Cutoff::Hard, &d);
            d_colors.push(std::mem::take(&mut grad.color));
            add_pulled(&mut total, &Pulled { splats: grad, means2d, camera });
        }
        total.splats.color = join(d_colors, colors.channels);
        total
    }
}

/// Where the splats lie on the screen, by the production path.
fn screen(geometry: &Scene<f64>, camera: &Camera, options: &RasterOptions) -> Screen {
    use gs_core::cast::to_f32;
    let vec3 = |v: &[f64; 3]| Vec3::from_array(v.map(to_f32));
    let n = geometry.means.len();
    let splats = Splats {
        means: geometry.means.iter().map(vec3).collect(),
        quats: geometry.quats.iter().map(|q| q.map(to_f32)).collect(),
        scales: geometry.scales.iter().map(vec3).collect(),
        opacities: geometry.opacities.iter().map(|&o| to_f32(o)).collect(),
        color: Color::Rgb(vec![[0.0; 3]; n]),
        kernel: Kernel::Gaussian,
    };
    let mut workspace = Workspace::new();
    render(&splats, camera, options, &mut workspace);
    workspace.screen(n)
}

/// Adds gradients of the same splats, colours included, in order.
pub(crate) fn add_pulled<T: Precision>(to: &mut Pulled<T>, from: &Pulled<T>) {
    fn add<T: Precision>(to: &mut [T], from: &[T]) {
        to.iter_mut().zip(from).for_each(|(to, from)| *to = *to + *from);
    }
    let (a, b) = (&mut to.splats, &from.splats);
    add(a.means.as_flattened_mut(), b.means.as_flattened());
    add(a.quats.as_flattened_mut(), b.quats.as_flattened());
    add(a.scales.as_flattened_mut(), b.scales.as_flattened());
    add(&mut a.opacities, &b.opacities);
    add(&mut a.color, &b.color);
    add(to.means2d.as_flattened_mut(), from.means2d.as_flattened());
    to.camera += from.camera;
}
