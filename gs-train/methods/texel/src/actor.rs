//! What of a filmed person never changes, and what a frame gives: the posed template, what the cameras say about its
//! texels, and the same once GeoNet's offsets have moved it.

mod error;
mod frame;

pub use error::{ActorError, FrameError};
pub use frame::{First, Posed, Second, Seen};

use super::config::{Config, Input, Mode, ResizeRule, TextureSizes, UnseenColor};
use super::mean::{Mean, MeanTexture, MeanTextures};
use glam::{Affine3A, Vec3};
use gs_core::{Camera, Image, Time};
use gs_data::avatar::{AvatarFrame, AvatarScene};
use gs_data::{DataError, ImageCache};
use gs_texel::Pose;
use gs_texel::gaussians::TexelBase;
use gs_texel::scale_refine::ScaleRefine;
use gs_texel::skin::{rotations, skin};
use gs_texel::surface::{Mesh, Topology};
use gs_texel::texels::{MapReader, TexelOptions, TexelTable, resize};
use gs_texel::unproject::{self, UnprojectConfig, unproject};
use std::sync::Arc;

/// Bytes of decoded input images kept.
const IMAGE_BYTES: usize = 256 << 20;

/// The mean texture is that of so many frames, spread over the recording.
const MEAN_FRAMES: usize = 8;

/// Everything of a person that does not depend on the timestamp.
pub struct Actor {
    /// Template, motions and the images of every frame.
    pub scene: Arc<AvatarScene>,
    /// Edges and rings of the template.
    pub topology: Topology,
    /// Normals of the bind pose, per vertex.
    rest_normals: Vec<Vec3>,
    /// Texels of the textures that are unprojected.
    pub fine: TexelTable,
    /// Texels of the maps of GeoNet.
    pub geo: TexelTable,
    /// Texels of GauNet: the Gaussians.
    pub gau: TexelTable,
    /// GeoNet's map at the vertices.
    pub reader: MapReader,
    refine: ScaleRefine,
    pub(super) unproject: UnprojectConfig,
    images: ImageCache,
    resize: ResizeRule,
    /// Mean textures: state of the method, saved with it.
    pub(super) mean: MeanTextures,
    rgb: bool,
    normals: bool,
    kappa: bool,
    follows_light: bool,
    /// Whether images are looked at again on the deformed surface.
    twice: bool,
}

/// Colours of the mean texture up to this say nothing of the light.
const DARK: f32 = 0.1;
/// Least and most light of a frame over that of the mean textures.
const LIGHTS: [f32; 2] = [0.1, 10.0];

impl Actor {
    /// Lays texels on the template.
    ///
    /// # Errors
    /// If that is not possible.
    pub fn new(scene: Arc<AvatarScene>, config: &Config) -> Result<Self, ActorError> {
        config.unproject.check()?;
        let t = &scene.character.template;
        let topology = Topology::new(&t.faces, t.vertices.len())?;
        let table = |size| TexelTable::build(&t.faces, &t.uvs, &t.face_uvs, size, &TexelOptions::default());
        let TextureSizes { unproject, geo, gau } = config.textures;
        let (fine, geo, gau) = (table(unproject)?, table(geo)?, table(gau)?);
        let (vertices, seams) = (t.vertices.len(), config.surface.seams);
        let mut actor = Self {
            rest_normals: topology.normals(&t.vertices, &t.faces),
            reader: MapReader::at_vertices(&geo, vertices, &t.faces, &t.uvs, &t.face_uvs, seams),
            refine: ScaleRefine::new(&t.vertices, &t.faces, config.refine),
            unproject: config.unproject,
            images: ImageCache::new(IMAGE_BYTES, 1.0).with_max_image_mib(scene.max_image_mib),
            resize: config.resize,
            mean: MeanTextures::default(),
            rgb: config.rgb,
            normals: config.normals,
            kappa: config.kappa,
            follows_light: config.follow_light,
            twice: config.input == Input::Double,
            topology,
            fine,
            geo,
            gau,
            scene,
        };
        let deformed = config.input != Input::Single;
        let of_gau = match config.mode {
            Mode::Direct => true,
            Mode::Networks => config.gaunet.unseen == UnseenColor::Mean,
        };
        let wanted = [
            (deformed && config.centred && config.rgb).then_some(&actor.geo),
            (of_gau || config.follow_light || deformed && config.surface.texture > 0.0).then_some(&actor.gau),
        ];
        let [geo, gau] = actor.mean_textures(wanted, |_| Ok(None)).map_err(Box::new)?;
        actor.mean = MeanTextures { geo: geo.colors, gau: gau.colors, known: gau.known };
        Ok(actor)
    }

    /// The frame of a timestamp.
    pub fn frame_at(&self, t: Time) -> &AvatarFrame {
        self.scene.frame_at(t)
    }

    /// Bytes a prepared frame takes, roughly.
    pub(crate) fn frame_bytes(&self) -> usize {
        let vertices = self.rest_normals.len() * 160;
        vertices + 16 * self.fine.len() + 24 * (self.geo.row.len() + self.gau.row.len()) + 160 * self.gau.len()
    }

    /// Joints to vertices: what skinning needs of a pose.
    pub fn pose(&self, pose: &Pose) -> Posed {
        let character = &self.scene.character;
        let (t, skeleton) = (&character.template, &character.skeleton);
        let joints = skeleton.skinning(pose);
        let transforms = self.scene.skinning.blend(&t.weights, &joints);
        let turns = rotations(&t.weights, &joints, &transforms);
        let canonical = t.morphed(&pose.morphs);
        let kappas = match self.kappa {
            true => self.refine.kappas(&skin(&t.vertices, &transforms)),
            false => vec![1.0; canonical.len()],
        };
        let back = skeleton.root_rotation(pose).transpose().as_mat3();
        let turned = |(n, m): (&Vec3, &Affine3A)| (m.matrix3 * *n).normalize_or_zero();
        let normals: Vec<Vec3> = self.rest_normals.iter().zip(&transforms).map(turned).collect();
        let root_free = normals.iter().map(|n| back * *n).collect();
        Posed { canonical, transforms, turns, kappas, normals, root_free }
    }

    /// The images of a frame's conditioning cameras, decoded; colours are straight, the fourth channel is coverage.
    ///
    /// # Errors
    /// If one cannot be read.
    pub fn images(&self, frame: &AvatarFrame) -> Result<Vec<(Camera, Image)>, DataError> {
        AvatarScene::input_images(&frame.inputs, &self.images)
    }

    /// What images say about the texels of a surface, `N` world positions.
    ///
    /// # Errors
    /// If positions are not finite or images do not fit.
    pub fn look(&self, surface: &[Vec3], images: &[(Camera, Image)]) -> Result<Seen, FrameError> {
        let faces = &self.scene.character.template.faces;
        let normals = self.topology.normals(surface, faces);
        let mesh = Mesh { vertices: surface, normals: &normals, faces };
        let views: Vec<_> =
            images.iter().map(|(camera, image)| unproject::View { camera, image, mask: None }).collect();
        let texture = unproject(&mesh, &self.fine, &views, &self.unproject)?;
        Ok(Seen { colors: texture.colors, views: texture.seen.iter().map(|&n| f32::from(n)).collect() })
    }

    /// The posed surface with offsets.
    pub fn surface(&self, posed: &Posed, offsets: &[Vec3]) -> Vec<Vec3> {
        let moved: Vec<Vec3> = posed.canonical.iter().zip(offsets).map(|(&p, &d)| p + d).collect();
        skin(&moved, &posed.transforms)
    }

    /// The frame before GeoNet.
    ///
    /// # Errors
    /// As reading images and unprojecting them goes.
    pub fn first(&self, frame: &AvatarFrame) -> Result<First, FrameError> {
        self.first_of(self.pose(&frame.pose), &self.images(frame)?)
    }

    /// The same of a posed template and its images.
    ///
    /// # Errors
    /// As [`Self::look`].
    pub fn first_of(&self, posed: Posed, images: &[(Camera, Image)]) -> Result<First, FrameError> {
        let mut seen = self.look(&skin(&posed.canonical, &posed.transforms), images)?;
        let light = self.light_of(&seen);
        seen.divide(light);
        let middle = (!self.mean.geo.is_empty()).then(|| MeanTextures::rows(&self.mean.geo));
        let input = self.input(&self.geo, &self.resized(&seen, &self.geo), &posed, middle);
        Ok(First { posed, seen, light, input })
    }

    /// The frame behind GeoNet, whose offsets are absent if the template is believed.
    ///
    /// # Errors
    /// As reading images and unprojecting them goes; if offsets are not finite.
    pub fn second(&self, frame: &AvatarFrame, first: &First, offsets: Option<Vec<Vec3>>) -> Result<Second, FrameError> {
        let images = if self.twice && offsets.is_some() { self.images(frame)? } else { Vec::new() };
        self.second_of(first, offsets, &images)
    }

    /// The same of images, which are not looked at without offsets, nor with [`Input::First`].
    ///
    /// # Errors
    /// As [`Self::look`]; if offsets are not finite.
    pub fn second_of(
        &self,
        first: &First,
        offsets: Option<Vec<Vec3>>,
        images: &[(Camera, Image)],
    ) -> Result<Second, FrameError> {
        let posed = &first.posed;
        let look = |d: &Vec<Vec3>| {
            let mut seen = self.look(&self.surface(posed, d), images)?;
            seen.divide(first.light);
            Ok::<_, FrameError>(seen)
        };
        let again = offsets.as_ref().filter(|_| self.twice).map(look).transpose()?;
        let seen = self.resized(again.as_ref().unwrap_or(&first.seen), &self.gau);
        let offsets = offsets.unwrap_or_else(|| vec![Vec3::ZERO; posed.canonical.len()]);
        let input = self.input(&self.gau, &seen, posed, None);
        let (light, relit, own) = (first.light, [1.0; 3], [1.0; 3]);
        Ok(Second { base: self.base(posed, &offsets)?, offsets, seen, light, relit, own, input })
    }

    /// Where the Gaussians' texels lie.
    ///
    /// # Errors
    /// If pose or offsets are not finite.
    pub fn base(&self, posed: &Posed, offsets: &[Vec3]) -> Result<TexelBase, FrameError> {
        let points: Vec<Vec3> = posed.canonical.iter().zip(offsets).map(|(&p, &d)| p + d).collect();
        let faces = &self.scene.character.template.faces;
        Ok(TexelBase::new(&self.gau, faces, &points, &posed.transforms, &posed.turns, &posed.kappas)?)
    }

    /// The means of textures at the texels of tables where they are seen, in-painted elsewhere, over frames that training
    /// views show (over any, if none is); empty for an absent table. `offsets` gives those of a frame, none for its first
    /// texture.
    ///
    /// # Errors
    /// As reading images and unprojecting them goes; as `offsets`.
    pub(crate) fn mean_textures<const N: usize>(
        &self,
        tables: [Option<&TexelTable>; N],
        offsets: impl Fn(&AvatarFrame) -> Result<Option<Vec<Vec3>>, FrameError>,
    ) -> Result<[MeanTexture; N], FrameError> {
        let mut means = tables.map(|t| Mean::new(t.map_or(0, TexelTable::len)));
        if tables.iter().any(Option::is_some) {
            for frame in self.mean_frames() {
                let look = || {
                    let posed = self.pose(&frame.pose);
                    let surface = match offsets(frame)? {
                        Some(offsets) => self.surface(&posed, &offsets),
                        None => skin(&posed.canonical, &posed.transforms),
                    };
                    self.look(&surface, &self.images(frame)?)
                };
                let of = |source: FrameError| FrameError::Mean { frame: frame.number, source: Box::new(source) };
                let seen = look().map_err(of)?;
                for (mean, table) in means.iter_mut().zip(tables) {
                    table.iter().for_each(|t| mean.add(&self.resized(&seen, t)));
                }
            }
        }
        let mut textures = std::array::from_fn(|_| MeanTexture::default());
        for ((out, mean), table) in textures.iter_mut().zip(means).zip(tables) {
            *out = table.map(|t| mean.texture(t)).transpose()?.unwrap_or_default();
        }
        Ok(textures)
    }

    /// The frames a mean texture is of.
    fn mean_frames(&self) -> impl Iterator<Item = &AvatarFrame> {
        let mut frames: Vec<&AvatarFrame> = self.scene.frames.iter().filter(|f| f.learnt).collect();
        if frames.is_empty() {
            frames = self.scene.frames.iter().collect();
        }
        let step = frames.len().div_ceil(MEAN_FRAMES).max(1);
        frames.into_iter().step_by(step)
    }

    /// What is seen at the texels of another table: the mean over texels nearby, by the rule of the settings; unseen where none
    /// of them is seen.
    pub fn resized(&self, seen: &Seen, table: &TexelTable) -> Seen {
        if table.size == self.fine.size {
            return seen.clone();
        }
        let row = |(c, &n): (&[f32; 3], &f32)| [c[0], c[1], c[2], n];
        let rows: Vec<[f32; 4]> = seen.colors.iter().zip(&seen.views).map(row).collect();
        let map = self.fine.to_map(&rows, 0.0);
        let seen = |p: &[f32]| if p[3] > 0.0 { 1.0 } else { 0.0 };
        let known: Option<Vec<f32>> =
            (self.resize == ResizeRule::Masked).then(|| map.data.chunks_exact(4).map(seen).collect());
        let (map, _) = resize(&map, known.as_deref(), table.size);
        let (colors, views) = table.from_map::<4>(&map).iter().map(|p| ([p[0], p[1], p[2]], p[3])).unzip();
        Seen { colors, views }
    }

    /// Light of a first texture over that of the mean texture, per channel: the median ratio of their colours.
    fn light_of(&self, seen: &Seen) -> [f32; 3] {
        if !self.follows_light || self.mean.gau.is_empty() {
            return [1.0; 3];
        }
        let (seen, mean) = (self.resized(seen, &self.gau), MeanTextures::rows(&self.mean.gau));
        std::array::from_fn(|i| {
            let rows = seen.colors.iter().zip(&seen.views).zip(mean.iter().zip(&self.mean.known));
            let bright = rows.filter(|((_, views), (mean, known))| **views > 0.0 && **known > 0.0 && mean[i] > DARK);
            let mut ratios: Vec<f32> = bright.map(|((color, _), (mean, _))| color[i] / mean[i]).collect();
            if ratios.is_empty() {
                return 1.0;
            }
            let middle = ratios.len() / 2;
            let (_, median, _) = ratios.select_nth_unstable_by(middle, f32::total_cmp);
            median.clamp(LIGHTS[0], LIGHTS[1])
        })
    }

    /// A frame behind GeoNet under another light: its colours times `gain`, at most 1. The Gaussians are those of the recorded
    /// light if `with_image`, which means that images are lit alike; else they are held against images as recorded.
    pub fn relit(&self, second: &Second, gain: [f32; 3], with_image: bool) -> Second {
        let mut relit = second.clone();
        relit.relit = gain;
        if with_image {
            relit.own = gain;
            relit.light.iter_mut().zip(gain).for_each(|(light, gain)| *light /= gain);
        }
        let of_texels = self.gau.valid.iter().zip(&mut relit.seen.colors).zip(&second.seen.views);
        for ((&t, color), _) in of_texels.filter(|(_, views)| **views > 0.0) {
            for (i, (c, gain)) in color.iter_mut().zip(gain).enumerate() {
                *c = (*c * gain).min(1.0);
                if self.rgb {
                    relit.input[t as usize * 6 + i] = 2.0 * *c - 1.0;
                }
            }
        }
        relit
    }

    /// A network's input `[S, S, 6]`: colours as `2 T − 1`, black where nothing is seen, and the root-free normals. Colours
    /// less a `middle` are `2 (T − middle)`, 0 where nothing is seen.
    fn input(&self, table: &TexelTable, seen: &Seen, posed: &Posed, middle: Option<&[[f32; 3]]>) -> Vec<f32> {
        let faces = &self.scene.character.template.faces;
        let empty = if self.rgb && middle.is_none() { -1.0 } else { 0.0 };
        let mut map = vec![0.0; table.row.len() * 6];
        map.chunks_exact_mut(6).for_each(|p| p[..3].fill(empty));
        for (k, (&t, color)) in table.valid.iter().zip(&seen.colors).enumerate() {
            let at = &mut map[t as usize * 6..][..6];
            match middle {
                _ if !self.rgb => {}
                Some(middle) if seen.views[k] > 0.0 => (0..3).for_each(|i| at[i] = 2.0 * (color[i] - middle[k][i])),
                Some(_) => {}
                None => (0..3).for_each(|i| at[i] = 2.0 * color[i] - 1.0),
            }
            if self.normals {
                at[3..].copy_from_slice(&table.at(faces, &posed.root_free, k).to_array());
            }
        }
        map
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_data::{DataOptions, Dataset};
    use gs_synth::avatar::{AvatarOptions, write};
    use gs_train::registry::own_settings;

    #[test]
    fn inputs_are_decoded_within_the_limit_of_the_data() {
        let dir = tempfile::tempdir().unwrap();
        // An image takes a little more than 1 MiB.
        let (template, size) = ("builtin:cylinder".into(), 520);
        let film = AvatarOptions { template, size, rings: 1, frames: 1, points: 400, ..AvatarOptions::default() };
        write(dir.path(), &film, false, false).unwrap();
        let config = gs_methods::registry().find("dut").unwrap().config("tiny").unwrap();
        let config: Config = own_settings(config).try_into().unwrap();
        let fault = |max_image_mib| {
            let options = DataOptions { max_image_mib, ..DataOptions::default() };
            let scene = Dataset::open(dir.path(), &options).unwrap().avatar.unwrap();
            Actor::new(scene, &config).err().map(|e| e.to_string())
        };
        assert_eq!([fault(None), fault(Some(8))], [None, None]);
        assert!(fault(Some(1)).is_some_and(|e| e.contains("the limit is 1048576")));
    }
}
