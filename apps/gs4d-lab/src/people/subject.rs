//! A filmed person, and what its texels truly look like.

use super::{LabError, Setup, Tell, registry};
use glam::Vec3;
use gs_core::{Camera, Image};
use gs_data::avatar::{AvatarFrame, AvatarScene};
use gs_data::{Dataset, ImageCache, View};
use gs_synth::avatar::generate;
use gs_texel::surface::{Mesh, Topology};
use gs_texel::texels::{TexelOptions, TexelTable};
use gs_texel::unproject::{self, Texture, UnprojectConfig, unproject};
use gs4d_run::OpenRun;
use std::sync::Arc;
use std::time::Instant;

/// Bytes of decoded pictures kept.
const IMAGE_BYTES: usize = 256 << 20;

/// A filmed person.
pub struct Subject {
    /// The film with all its frames: to learn from.
    pub full_film: Dataset,
    /// The film of the frames that are looked at.
    pub film: Dataset,
    /// The person in it.
    pub scene: Arc<AvatarScene>,
    topology: Topology,
    images: ImageCache,
}

/// The pictures of a moment with their cameras.
pub type Photographs = Vec<(Camera, Image)>;

impl Subject {
    /// The film of the run, or a new one; of either some frames.
    ///
    /// # Errors
    /// If run or film cannot be had, or there is no person in it.
    pub fn new(setup: &Setup, tell: &mut Tell<'_>) -> Result<Self, LabError> {
        let film = match &setup.run {
            Some(run) => OpenRun::open(&registry(), run)?.resolved.open_data()?,
            None => {
                tell(&format!("filming {}", setup.film.template));
                let film = generate(&setup.film)?;
                film.notes.iter().filter(|n| n.starts_with("template:")).for_each(|note| tell(note));
                film
            }
        };
        Self::of(film, setup.frames)
    }

    /// At most so many frames of a film, evenly spread over those that have test views.
    ///
    /// # Errors
    /// If there is no person in it, or its template's faces do not fit.
    pub fn of(full_film: Dataset, frames: usize) -> Result<Self, LabError> {
        let scene =
            full_film.avatar.as_ref().ok_or_else(|| LabError::Unfit("there is no filmed person in the data".into()))?;
        let tested = |f: &&AvatarFrame| full_film.test.iter().any(|v| v.time == f.time);
        let mut all: Vec<&AvatarFrame> = scene.frames.iter().filter(tested).collect();
        if all.is_empty() {
            all = scene.frames.iter().collect();
        }
        let count = frames.clamp(1, all.len());
        let kept: Vec<AvatarFrame> = (0..count).map(|k| all[k * all.len() / count].clone()).collect();
        let mut film = full_film.clone();
        film.test.retain(|v| kept.iter().any(|f| f.time == v.time));
        let t = &scene.character.template;
        let topology = Topology::new(&t.faces, t.vertices.len())?;
        let scene = Arc::new(AvatarScene { frames: kept, ..AvatarScene::clone(scene) });
        film.avatar = Some(scene.clone());
        Ok(Self { full_film, film, scene, topology, images: ImageCache::new(IMAGE_BYTES, 1.0) })
    }

    /// The same pictures with other poses or inputs: `change` is given the number of the frame among those looked at.
    pub fn changed(&self, mut change: impl FnMut(usize, &mut AvatarFrame)) -> Dataset {
        let mut scene = AvatarScene::clone(&self.scene);
        scene.frames.iter_mut().enumerate().for_each(|(k, f)| change(k, f));
        Dataset { avatar: Some(Arc::new(scene)), ..self.film.clone() }
    }

    /// The texels of the template's atlas.
    ///
    /// # Errors
    /// If the template has no atlas, or texels overlap.
    pub fn table(&self, size: usize) -> Result<TexelTable, LabError> {
        let t = &self.scene.character.template;
        Ok(TexelTable::build(&t.faces, &t.uvs, &t.face_uvs, size, &TexelOptions::default())?)
    }

    /// The template's own colour at every texel, `K` rows.
    pub fn truth(&self, table: &TexelTable) -> Vec<[f32; 3]> {
        let template = &self.scene.character.template;
        let color = |k| template.colour(table.tri[k] as usize, table.weights(k)).truncate().to_array();
        (0..table.len()).map(color).collect()
    }

    /// Decoded pictures.
    ///
    /// # Errors
    /// If one cannot be read.
    pub fn photographs(&self, views: &[View]) -> Result<Photographs, LabError> {
        Ok(AvatarScene::photographs(views, &self.images)?)
    }

    /// What pictures say about the texels of a surface, and the milliseconds that took.
    ///
    /// # Errors
    /// If surface, pictures or settings do not fit.
    pub fn texture(
        &self,
        surface: &[Vec3],
        photographs: &Photographs,
        table: &TexelTable,
        config: &UnprojectConfig,
    ) -> Result<(Texture, f64), LabError> {
        let faces = &self.scene.character.template.faces;
        let begun = Instant::now();
        let normals = self.topology.normals(surface, faces);
        let mesh = Mesh { vertices: surface, normals: &normals, faces };
        let views: Vec<_> =
            photographs.iter().map(|(camera, image)| unproject::View { camera, image, mask: None }).collect();
        let texture = unproject(&mesh, table, &views, config)?;
        Ok((texture, begun.elapsed().as_secs_f64() * 1e3))
    }
}

/// Squared errors of colours where something is seen, to be summed over frames.
#[derive(Clone, Copy, Debug, Default)]
pub struct Errors {
    squares: f64,
    seen: f64,
    texels: f64,
    frames: f64,
    ms: f64,
}

impl Errors {
    /// Adds a texture of `K` texels against their true colours.
    pub fn add(&mut self, colors: &[[f32; 3]], seen: impl Iterator<Item = bool>, truth: &[[f32; 3]], ms: f64) {
        let square = |(a, b): (&[f32; 3], &[f32; 3])| (0..3).map(|i| f64::from(a[i] - b[i]).powi(2)).sum::<f64>();
        for (pair, _) in colors.iter().zip(truth).zip(seen).filter(|(_, seen)| *seen) {
            self.squares += square(pair) / 3.0;
            self.seen += 1.0;
        }
        self.texels += truth.len() as f64;
        self.frames += 1.0;
        self.ms += ms;
    }

    /// PSNR over seen texels, dB; none where nothing is seen or nothing is wrong.
    pub fn psnr(&self) -> Option<f64> {
        Some(-10.0 * (self.squares / self.seen).log10()).filter(|v| v.is_finite())
    }

    /// Share of texels that some camera sees.
    pub fn coverage(&self) -> f64 {
        self.seen / self.texels
    }

    /// Milliseconds a frame.
    pub fn ms(&self) -> f64 {
        self.ms / self.frames
    }
}
