//! What draws: the production path of gs-raster in `f32`, its reference in `f64`.

use glam::Vec3;
use gs_core::{Camera, Color, Kernel, Splats, SplatsGrad};
use gs_raster::channels::{join, split};
use gs_raster::reference::{self, Cutoff, PixelGrad, Scalar, Scene};
use gs_raster::{
    CameraGrad, Channels, Frame, FrameGrad, RasterOptions, Screen, ViewsError, Workspace, render, render_views,
    render_views_backward,
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

/// Gradients over all cameras.
pub(crate) struct Pulls<T> {
    /// Of the splats but for their colours, summed over the cameras.
    pub splats: Scene<T>,
    /// One for all cameras, or one for each, in the layout of the colours given.
    pub colors: Vec<Vec<T>>,
    /// `[n]` of each camera: of the projected centres, per pixel.
    pub means2d: Vec<Vec<[T; 2]>>,
    /// One of each camera.
    pub cameras: Vec<CameraGrad>,
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
    /// What frames leave for their backward.
    type Memory: Default + Send;

    fn splats(geometry: Scene<Self>) -> Self::Splats;

    /// Takes the colours of `rows` splats.
    fn colors(rows: usize, values: Values<'_, Self>) -> Result<Self::Colors, String>;

    /// The images of each camera, and where the splats lie in them. There is one of `colors` for all cameras, or for each.
    fn draw(
        splats: &Self::Splats,
        colors: &[Self::Colors],
        cameras: &[Camera],
        options: &RasterOptions,
        memory: &mut Self::Memory,
    ) -> Result<(Vec<Images<Self>>, Vec<Screen>), ViewsError>;

    /// Gradients of the loss whose cotangents are `d`, one for each camera. Must follow [`Precision::draw`] with the same memory.
    fn pull_back(
        splats: &Self::Splats,
        colors: &[Self::Colors],
        cameras: &[Camera],
        options: &RasterOptions,
        memory: &mut Self::Memory,
        d: Vec<Images<Self>>,
    ) -> Result<Pulls<Self>, ViewsError>;
}

impl Precision for f32 {
    type Splats = Splats;
    type Colors = Channels;
    type Memory = Vec<Workspace>;

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
        colors: &[Channels],
        cameras: &[Camera],
        options: &RasterOptions,
        workspaces: &mut Vec<Workspace>,
    ) -> Result<(Vec<Images<f32>>, Vec<Screen>), ViewsError> {
        let frames = render_views(splats, colors, cameras, options, workspaces)?;
        let images = |Frame { rgb, alpha, depth }| Images { colors: rgb.data, alphas: alpha, depths: depth };
        let screens = workspaces.iter().map(|w| w.screen(splats.len())).collect();
        Ok((frames.into_iter().map(images).collect(), screens))
    }

    fn pull_back(
        splats: &Splats,
        colors: &[Channels],
        cameras: &[Camera],
        options: &RasterOptions,
        workspaces: &mut Vec<Workspace>,
        d: Vec<Images<f32>>,
    ) -> Result<Pulls<f32>, ViewsError> {
        let frame = |Images { colors, alphas, depths }| FrameGrad { rgb: colors, alpha: alphas, depth: depths };
        let d: Vec<FrameGrad> = d.into_iter().map(frame).collect();
        let grad = render_views_backward(splats, colors, cameras, options, workspaces, &d)?;
        Ok(Pulls {
            splats: scene_of(grad.splats),
            colors: grad.colors,
            means2d: grad.stats.into_iter().map(|s| s.grad_means2d).collect(),
            cameras: grad.cameras,
        })
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
        colors: &[Groups],
        cameras: &[Camera],
        options: &RasterOptions,
        (): &mut (),
    ) -> Result<(Vec<Images<f64>>, Vec<Screen>), ViewsError> {
        let mut images = Vec::new();
        for (camera, groups) in cameras.iter().zip(colors.iter().cycle()) {
            let (mut all, mut parts) = (Images::default(), Vec::new());
            for scene in groups.scenes(splats) {
                let frame = reference::render(&scene, camera, options, Cutoff::Hard);
                parts.push(frame.rgb.into_flattened());
                (all.alphas, all.depths) = (frame.alpha, frame.depth);
            }
            images.push(Images { colors: join(parts, groups.channels), ..all });
        }
        Ok((images, cameras.iter().map(|camera| screen(splats, camera, options)).collect()))
    }

    fn pull_back(
        splats: &Scene<f64>,
        colors: &[Groups],
        cameras: &[Camera],
        options: &RasterOptions,
        (): &mut (),
        d: Vec<Images<f64>>,
    ) -> Result<Pulls<f64>, ViewsError> {
        let mut total =
            Pulls { splats: splats.zeros_like(), colors: Vec::new(), means2d: Vec::new(), cameras: Vec::new() };
        for (i, (camera, d)) in cameras.iter().zip(&d).enumerate() {
            let groups = &colors[i % colors.len()];
            let mut d_images = split(&d.colors, groups.channels).into_iter();
            let (mut d_colors, mut means2d) = (Vec::new(), vec![[0.0; 2]; splats.means.len()]);
            let mut d_camera = CameraGrad::default();
            for (group, scene) in groups.scenes(splats).enumerate() {
                let d = pixels(camera, &d_images.next().unwrap_or_default(), (group == 0).then_some(d));
                let (mut grad, part, of_camera) = reference::render_backward(&scene, camera, options, Cutoff::Hard, &d);
                d_colors.push(std::mem::take(&mut grad.color));
                add_scene(&mut total.splats, &grad);
                add(means2d.as_flattened_mut(), part.as_flattened());
                d_camera += of_camera;
            }
            let d_colors = join(d_colors, groups.channels);
            match total.colors.get_mut(i % colors.len()) {
                Some(sum) => add(sum, &d_colors),
                None => total.colors.push(d_colors),
            }
            total.means2d.push(means2d);
            total.cameras.push(d_camera);
        }
        Ok(total)
    }
}

/// Cotangents of each pixel: of three channels, and with the first of their groups those of alpha and depth.
fn pixels(camera: &Camera, rgb: &[f64], first: Option<&Images<f64>>) -> Vec<PixelGrad<f64>> {
    let at = |values: &[f64], i: usize| values.get(i).copied().unwrap_or(0.0);
    let once = |part: fn(&Images<f64>) -> &[f64], i: usize| first.map_or(0.0, |d| at(part(d), i));
    let pixel = |i: usize| ([0, 1, 2].map(|c| at(rgb, 3 * i + c)), once(|d| &d.alphas, i), once(|d| &d.depths, i));
    (0..camera.width as usize * camera.height as usize).map(pixel).collect()
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

/// Adds gradients of the same splats, but for the colours.
fn add_scene(to: &mut Scene<f64>, from: &Scene<f64>) {
    add(to.means.as_flattened_mut(), from.means.as_flattened());
    add(to.quats.as_flattened_mut(), from.quats.as_flattened());
    add(to.scales.as_flattened_mut(), from.scales.as_flattened());
    add(&mut to.opacities, &from.opacities);
}

fn add(to: &mut [f64], from: &[f64]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += *from);
}
