//! The captured avatar and the true colours of its texels.

use super::{LabError, Log, Setup, registry};
use glam::Vec3;
use gs_core::{Camera, Image};
use gs_data::avatar::{AvatarFrame, AvatarScene};
use gs_data::{Dataset, ImageCache, ImageU8, View};
use gs_synth::avatar::generate;
use gs_texel::surface::{Mesh, Topology};
use gs_texel::texels::{TexelOptions, TexelTable};
use gs_texel::unproject::{self, Texture, UnprojectConfig, unproject};
use gs4d_run::OpenRun;
use std::sync::Arc;
use std::time::Instant;

/// Size of the cache of decoded images, bytes.
const IMAGE_BYTES: usize = 256 << 20;

/// Dataset and template of an avatar.
pub(super) struct Subject {
    /// The dataset with all frames, for training.
    pub(super) full_film: Dataset,
    /// The dataset restricted to the evaluated frames.
    pub(super) film: Dataset,
    /// Template, poses and input views of the evaluated frames.
    pub(super) scene: Arc<AvatarScene>,
    topology: Topology,
    cache: ImageCache,
}

/// Input images of one frame with their cameras.
pub(super) type InputImages = Vec<(Camera, Image)>;

impl Subject {
    /// Opens the data of the run, or generates the film of the setup; keeps `setup.frames` frames for evaluation.
    ///
    /// # Errors
    /// If the data cannot be opened or generated, or hold no avatar.
    pub(super) fn new(setup: &Setup, log: &mut Log<'_>) -> Result<Self, LabError> {
        let film = match &setup.run {
            Some(run) => OpenRun::open(&registry(), run)?.resolved.open_data()?,
            None => {
                log(&format!("filming {}", setup.film.template));
                let film = generate(&setup.film)?;
                film.notes.iter().filter(|n| n.starts_with("template:")).for_each(|note| log(note));
                film
            }
        };
        Self::of(film, setup.frames)
    }

    /// Keeps at most `frames` frames for evaluation, evenly spread over those with test views.
    ///
    /// # Errors
    /// If the data hold no avatar, or the faces of its template are invalid.
    pub(super) fn of(full_film: Dataset, frames: usize) -> Result<Self, LabError> {
        let scene =
            full_film.avatar.as_ref().ok_or_else(|| LabError::Unfit("there is no filmed person in the data".into()))?;
        let tested = |f: &&AvatarFrame| full_film.test.iter().any(|v| v.time == f.time);
        let mut all: Vec<&AvatarFrame> = scene.frames.iter().filter(tested).collect();
        if all.is_empty() {
            all = scene.frames.iter().collect();
        }
        let kept: Vec<AvatarFrame> = gs_data::evenly(all.len(), frames.max(1)).map(|k| all[k].clone()).collect();
        let mut film = full_film.clone();
        film.test.retain(|v| kept.iter().any(|f| f.time == v.time));
        let t = &scene.character.template;
        let topology = Topology::new(&t.faces, t.vertices.len())?;
        let scene = Arc::new(AvatarScene { frames: kept, ..AvatarScene::clone(scene) });
        film.avatar = Some(scene.clone());
        let cache = ImageCache::new(IMAGE_BYTES, 1.0).with_max_image_mib(full_film.max_image_mib);
        Ok(Self { full_film, film, scene, topology, cache })
    }

    /// The evaluated frames with poses or inputs modified by `change(frame index, frame)`.
    pub(super) fn changed(&self, mut change: impl FnMut(usize, &mut AvatarFrame)) -> Dataset {
        let mut scene = AvatarScene::clone(&self.scene);
        scene.frames.iter_mut().enumerate().for_each(|(k, f)| change(k, f));
        Dataset { avatar: Some(Arc::new(scene)), ..self.film.clone() }
    }

    /// The subject with those of the evaluated frames for which `kept` holds; `None` if there are none.
    ///
    /// # Errors
    /// As [`Self::of`].
    pub(super) fn only(&self, kept: &[bool]) -> Result<Option<Self>, LabError> {
        let mut scene = AvatarScene::clone(&self.scene);
        let mut kept = kept.iter();
        scene.frames.retain(|_| *kept.next().unwrap_or(&false));
        let count = scene.frames.len();
        let film = Dataset { avatar: Some(Arc::new(scene)), ..self.film.clone() };
        (count > 0).then(|| Self::of(film, count)).transpose()
    }

    /// Normals of a surface, one per template vertex.
    pub(super) fn normals(&self, surface: &[Vec3]) -> Vec<Vec3> {
        self.topology.normals(surface, &self.scene.character.template.faces)
    }

    /// Texel table of the template's atlas, `size` texels per side.
    ///
    /// # Errors
    /// If the template has no atlas, or texels overlap.
    pub(super) fn table(&self, size: usize) -> Result<TexelTable, LabError> {
        let t = &self.scene.character.template;
        Ok(TexelTable::build(&t.faces, &t.uvs, &t.face_uvs, size, &TexelOptions::default())?)
    }

    /// The template's colour at every texel, `[K, 3]`.
    pub(super) fn truth(&self, table: &TexelTable) -> Vec<[f32; 3]> {
        let template = &self.scene.character.template;
        let color = |k| template.colour(table.tri[k] as usize, table.weights(k)).truncate().to_array();
        (0..table.len()).map(color).collect()
    }

    /// The image of a view as its pinhole camera has it.
    ///
    /// # Errors
    /// If it cannot be read.
    pub(super) fn image(&self, view: &View) -> Result<Arc<ImageU8>, LabError> {
        Ok(self.cache.get(view)?)
    }

    /// Images of some views with their cameras.
    ///
    /// # Errors
    /// If one cannot be read.
    pub(super) fn images(&self, views: &[View]) -> Result<InputImages, LabError> {
        Ok(AvatarScene::input_images(views, &self.cache)?)
    }

    /// Unprojects images onto a surface (one vertex per template vertex); also returns the time in milliseconds.
    ///
    /// # Errors
    /// If surface, images or settings do not fit.
    pub(super) fn texture(
        &self,
        surface: &[Vec3],
        images: &InputImages,
        table: &TexelTable,
        config: &UnprojectConfig,
    ) -> Result<(Texture, f64), LabError> {
        let faces = &self.scene.character.template.faces;
        let begun = Instant::now();
        let normals = self.normals(surface);
        let mesh = Mesh { vertices: surface, normals: &normals, faces };
        let views: Vec<_> =
            images.iter().map(|(camera, image)| unproject::View { camera, image, mask: None }).collect();
        let texture = unproject(&mesh, table, &views, config)?;
        Ok((texture, begun.elapsed().as_secs_f64() * 1e3))
    }
}

/// Sums of squared colour errors over visible texels and frames.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Errors {
    squares: f64,
    seen: f64,
    texels: f64,
    frames: f64,
    ms: f64,
}

impl Errors {
    /// [`Self::add`] of the texels for which `within` holds alone.
    pub(super) fn add_within(&mut self, texture: &Texture, truth: &[[f32; 3]], within: &[bool], ms: f64) {
        let rows: Vec<usize> = (0..truth.len()).filter(|&k| within[k]).collect();
        let of = |colors: &[[f32; 3]]| rows.iter().map(|&k| colors[k]).collect::<Vec<_>>();
        self.add(&of(&texture.colors), rows.iter().map(|&k| texture.seen[k] > 0), &of(truth), ms);
    }

    /// Adds a texture `[K, 3]` against the true colours; `seen` masks its texels, `ms` is its unprojection time.
    pub(super) fn add(&mut self, colors: &[[f32; 3]], seen: impl Iterator<Item = bool>, truth: &[[f32; 3]], ms: f64) {
        let square = |(a, b): (&[f32; 3], &[f32; 3])| (0..3).map(|i| f64::from(a[i] - b[i]).powi(2)).sum::<f64>();
        for (pair, _) in colors.iter().zip(truth).zip(seen).filter(|(_, seen)| *seen) {
            self.squares += square(pair) / 3.0;
            self.seen += 1.0;
        }
        self.texels += truth.len() as f64;
        self.frames += 1.0;
        self.ms += ms;
    }

    /// PSNR over visible texels, dB; `None` without visible texels or without error.
    pub(super) fn psnr(&self) -> Option<f64> {
        Some(-10.0 * (self.squares / self.seen).log10()).filter(|v| v.is_finite())
    }

    /// Share of texels visible to some camera, 0 to 1.
    pub(super) fn coverage(&self) -> f64 {
        self.seen / self.texels
    }

    /// Mean milliseconds per frame.
    pub(super) fn ms(&self) -> f64 {
        self.ms / self.frames
    }
}
