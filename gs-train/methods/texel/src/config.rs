//! The settings of the method.

use gs_texel::gaussians::DecodeOptions;
use gs_texel::scale_refine::ScaleRefineOptions;
use gs_texel::surface_loss::{IsometryRule, NormalRule};
use gs_texel::texels::SeamRead;
use gs_texel::unproject::UnprojectConfig;
use gs_texel::{GauNetConfig, GeoNetConfig};
use gs_train::domains::{Domain, STEPS, within};
use gs_train::method::MethodError;
use gs_train::scene::InitConfig;
use gs_train::schedule::Schedule;
use serde::{Deserialize, Serialize};

/// What says of each texel which Gaussian it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The output of GauNet for the texture of the timestamp.
    Networks,
    /// Values of its own, the same at all timestamps.
    Direct,
}

/// How often the images are brought to the surface, and to which.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Input {
    /// Twice: before and after GeoNet has deformed it.
    Double,
    /// Once, before GeoNet has deformed it: Gaussians lie on the deformed surface, with the colours of the first texture.
    First,
    /// Once: the template is believed.
    Single,
}

/// What a texel of a smaller texture is the mean of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ResizeRule {
    /// Texels nearby that some camera sees.
    Masked,
    /// All texels nearby, black where no camera sees them or no chart lies: the published one, which bleeds over borders.
    Plain,
}

/// Sides of the square textures and maps, texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextureSizes {
    /// Side of the textures that images are unprojected to.
    pub unproject: usize,
    /// Side of GeoNet's maps.
    pub geo: usize,
    /// Of GauNet's maps: one Gaussian per valid texel.
    pub gau: usize,
}

/// How texel Gaussians are made of values.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GaussianConfig {
    /// Degree of spherical harmonics there is room for, 0 to 3.
    pub sh_degree: u8,
    /// How the values of a texel become a Gaussian.
    pub decode: DecodeOptions,
    /// Weight of the mean squared offset, per square metre.
    pub reg: f32,
}

/// What colours that are learnt without a network are made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DirectColor {
    /// The same at all timestamps.
    Learnt,
    /// `T a + b` of the timestamp's texture, where a camera sees the texel; of its mean elsewhere.
    Texture,
}

/// Texel values that are learnt directly, without GauNet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DirectConfig {
    /// What colours are made of.
    pub color: DirectColor,
}

/// The Gaussians that learning begins with.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReferenceConfig {
    /// Opacity, between 0 and 1.
    pub opacity: f32,
    /// Standard deviations over the distance of neighbouring texels.
    pub spread: f32,
}

/// What the Laplacian term keeps smooth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LaplacianRule {
    /// The deformed surface, its positions.
    Positions,
    /// What moves it: the template keeps its shape.
    Offsets,
}

/// What measured points are held against.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PointRule {
    /// Vertices of the template, distances in both directions.
    Vertices,
    /// Faces: points to the surface alone.
    Faces,
}

/// Terms that GeoNet learns from, and their weights.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SurfaceConfig {
    /// What measured points are held against.
    pub points: PointRule,
    /// How much distances of vertices along the surface count, 0 to 1.
    pub slide: f32,
    /// Weight of the mean squared Laplacian.
    pub laplacian: f32,
    /// What the Laplacian is taken of.
    pub laplacian_rule: LaplacianRule,
    /// Weight of the lengths of edges.
    pub isometry: f32,
    /// Edges whose lengths are kept.
    pub isometry_rule: IsometryRule,
    /// Weight of the difference of neighbouring normals.
    pub normals: f32,
    /// Which normals count as neighbours.
    pub normal_rule: NormalRule,
    /// How neighbouring normals should differ.
    #[serde(default)]
    pub normal_target: NormalTarget,
    /// Weight of the colours of texels against their mean.
    pub texture: f32,
    /// Weight of the colours of measured points against those the template is painted with, where points are held against
    /// faces; squared metres. Runs from before it have none.
    #[serde(default)]
    pub color: f32,
    /// Share of GeoNet's steps in which the first texture is what one camera alone sees, drawn anew each time: cameras that see
    /// little of a body must do as well.
    #[serde(default)]
    pub one_view: f32,
    /// Steps of GeoNet after which the mean colours are made anew, of second textures; 0: they stay those of first ones.
    pub refresh: u32,
    /// What vertices on seams read of the map of offsets.
    pub seams: SeamRead,
}

/// How neighbouring normals of the deformed bind pose should differ.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NormalTarget {
    /// Not at all: folds of the template pull, too, and the template is not at rest (published).
    #[default]
    Flat,
    /// As those of the template.
    Rest,
}

/// The reference colour of texels that no camera sees at a timestamp.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum UnseenColor {
    /// Black, as an empty texture has.
    Black,
    /// The mean over timestamps that see them, in-painted where none does.
    Mean,
}

/// Settings of GauNet beside the shape of the network.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GauConfig {
    /// The network; its number of inputs and its degree follow from elsewhere.
    pub net: GauNetConfig,
    /// Whether its values are added to the reference Gaussians, which leaves a warm-up nothing to learn.
    pub residual: bool,
    /// Colours of reference Gaussians that no camera sees.
    pub unseen: UnseenColor,
    /// Whether every texel adds values of its own, the same at all timestamps.
    pub own: bool,
    /// Metres of an offset of one that the network gives.
    pub offset_unit: f32,
    /// Longest gradient of all its weights in a step; 0: any.
    pub clip: f32,
    /// Share of the frames, the first ones, that the warm-up learns from.
    #[serde(default = "all_frames")]
    pub warm_up_frames: f32,
}

fn all_frames() -> f32 {
    1.0
}

/// Settings of `dut`, the sections of its TOML file.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Where texel Gaussians come from.
    pub mode: Mode,
    /// How often images are unprojected.
    pub input: Input,
    /// Whether the networks see colours.
    pub rgb: bool,
    /// Whether the networks see normals.
    pub normals: bool,
    /// Whether GeoNet sees colours less their mean over the recording.
    pub centred: bool,
    /// Whether Gaussians grow where the surface is stretched.
    pub kappa: bool,
    /// How textures are brought to the networks' sizes.
    pub resize: ResizeRule,
    /// Most that a step scales each colour of the Gaussians' textures by, as a logarithm; 0: not at all.
    pub jitter: f32,
    /// Whether images are taken as scaled alike: colours follow the light. If not, Gaussians keep the recorded light whatever
    /// the textures show.
    pub jitter_image: bool,
    /// Whether a frame's light is estimated from its colours against their mean, taken off its textures and put on its Gaussians.
    pub follow_light: bool,
    /// Memory for frames once prepared, MiB.
    pub cache_mib: u32,
    /// Points, which only the extent of the scene is read from.
    pub init: InitConfig,
    /// Sides of the textures and maps, texels.
    pub textures: TextureSizes,
    /// Visibility rule of the unprojection.
    pub unproject: UnprojectConfig,
    /// Bounds of the scale refinement `κ`.
    pub refine: ScaleRefineOptions,
    /// How texel Gaussians are made of values.
    pub gaussians: GaussianConfig,
    /// The Gaussians that learning begins with.
    pub reference: ReferenceConfig,
    /// Values that texels learn directly, in mode `direct`.
    pub direct: DirectConfig,
    /// Shape of GeoNet, the network of vertex offsets.
    pub geonet: GeoNetConfig,
    /// Terms that GeoNet learns from, and their weights.
    pub surface: SurfaceConfig,
    /// GauNet, the network of Gaussians, and its training.
    pub gaunet: GauConfig,
    /// The plan of the run.
    pub schedule: Plan,
}

/// The likeness of textures over the box of what images show.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextureLoss {
    /// Weight μ (the paper's code: 0.01, with VGG-19).
    #[serde(default)]
    pub lambda_mrf: f32,
    /// Side that box is resized to, pixels; time grows with its fourth power.
    #[serde(default = "mrf_side")]
    pub mrf_side: u32,
    /// A safetensors file with the weights of VGG-19, whose features are compared then; empty: a fixed filter
    /// bank without learnt weights.
    #[serde(default)]
    pub mrf_weights: String,
}

fn mrf_side() -> u32 {
    256
}

/// The section `[schedule]`: what the trainer follows, and the term that this method adds to the image loss.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(try_from = "toml::Table")]
pub struct Plan {
    /// The plan of the run.
    pub trainer: Schedule,
    /// The likeness of textures.
    pub texture: TextureLoss,
}

impl TryFrom<toml::Table> for Plan {
    type Error = toml::de::Error;

    fn try_from(mut section: toml::Table) -> Result<Self, Self::Error> {
        let own = ["lambda_mrf", "mrf_side", "mrf_weights"]
            .into_iter()
            .filter_map(|key| Some((key.to_owned(), section.remove(key)?)));
        let own: toml::Table = own.collect();
        Ok(Self { texture: own.try_into()?, trainer: section.try_into()? })
    }
}

/// What a step of a stage trains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// GeoNet, from measured points.
    Geometry,
    /// GauNet, from reference Gaussians, without images.
    WarmUp,
    /// GauNet or the texels' own values, from images.
    Main,
}

/// Domains of the method's settings.
pub(crate) const DOMAINS: &[Domain] = &[
    within("cache_mib", 0.0, 1_048_576.0),
    within("gaunet.clip", 0.0, 1e6),
    within("gaunet.net.levels", 1.0, 8.0),
    within("gaunet.net.width", 8.0, 512.0),
    within("gaunet.offset_unit", 1e-6, 100.0),
    within("gaunet.warm_up_frames", 0.0, 1.0),
    within("gaussians.decode.scale_range", 1e-9, 1e3),
    within("gaussians.decode.sh_active", 0.0, 3.0),
    within("gaussians.reg", 0.0, 1e4),
    within("gaussians.sh_degree", 0.0, 3.0),
    within("geonet.offset_unit", 1e-6, 100.0),
    within("geonet.width", 16.0, 512.0),
    within("jitter", 0.0, 1e3),
    within("reference.opacity", 0.0, 1.0),
    within("reference.spread", 0.0, 100.0),
    within("refine.gain", 0.0, 1e3),
    within("refine.most", 0.0, 1e3),
    within("lambda_mrf", 0.0, 1e4),
    within("mrf_side", 8.0, 512.0),
    within("surface.color", 0.0, 1e6),
    within("surface.isometry", 0.0, 1e6),
    within("surface.laplacian", 0.0, 1e6),
    within("surface.normals", 0.0, 1e6),
    within("surface.one_view", 0.0, 1.0),
    within("surface.refresh", 0.0, STEPS),
    within("surface.slide", 0.0, 1e6),
    within("surface.texture", 0.0, 1e6),
    within("textures.gau", 8.0, 2048.0),
    within("textures.geo", 8.0, 2048.0),
    within("textures.unproject", 8.0, 2048.0),
    within("unproject.depth_tolerance", 0.0, 1e6),
    within("unproject.min_cos", -1.0, 1.0),
    within("unproject.min_weight", 0.0, 1.0),
    within("unproject.near", 1e-6, 1e6),
    within("unproject.ray_offset", 0.0, 1e6),
];

const PHASES: [(&str, Phase); 3] = [("geometry", Phase::Geometry), ("warm_up", Phase::WarmUp), ("main", Phase::Main)];

impl Phase {
    /// What the stage of that name learns.
    pub fn of(stage: &str) -> Self {
        PHASES.iter().find(|p| p.0 == stage).map_or(Self::Main, |p| p.1)
    }
}

impl Config {
    /// Shape of GeoNet: its inputs are texture and normals.
    pub(crate) fn geonet_shape(&self) -> GeoNetConfig {
        GeoNetConfig { inputs: 6, ..self.geonet }
    }

    /// Shape of GauNet: its inputs are texture and normals, its outputs follow from the SH degree.
    pub(crate) fn gaunet_shape(&self) -> GauNetConfig {
        GauNetConfig { inputs: 6, sh_degree: self.gaussians.sh_degree.into(), ..self.gaunet.net }
    }

    /// Parameters of the networks that are built.
    pub(crate) fn param_counts(&self) -> [u64; 2] {
        let geonet = if self.input != Input::Single { self.geonet_shape().param_count() } else { 0 };
        [geonet, if self.mode == Mode::Networks { self.gaunet_shape().param_count() } else { 0 }]
    }

    /// Verifies what the parts cannot see by themselves.
    ///
    /// # Errors
    /// The first setting that does not fit.
    pub fn check(&self, method: &'static str) -> Result<(), MethodError> {
        self.schedule.trainer.check()?;
        let checked = self.check_stages().and_then(|()| self.check_numbers()).and_then(|()| self.check_together());
        checked.map_err(|why| MethodError::Config { method, why })
    }

    /// What is wrong with the stages, in words.
    fn check_stages(&self) -> Result<(), String> {
        let schedule = &self.schedule.trainer;
        let steps = |name: &str| schedule.stages.get(name).map_or(0, |s| s.steps);
        if let Some(name) = schedule.stages.keys().find(|n| PHASES.iter().all(|p| p.0 != n.as_str())) {
            return Err(format!("schedule.stages.{name}: the stages are geometry, warm_up and main"));
        }
        let ordered: Vec<&str> = schedule.ordered().into_iter().map(|s| s.0).collect();
        let mut expected: Vec<&str> = PHASES.map(|p| p.0).into();
        expected.retain(|n| steps(n) > 0);
        if ordered != expected {
            let [must, is] = [expected, ordered].map(|names| names.join(", "));
            return Err(format!("schedule.stages: the order must be {must}, not {is}"));
        }
        if let Some((name, _)) = schedule.ordered().into_iter().skip(1).find(|(_, s)| !s.own_clock) {
            return Err(format!(
                "schedule.stages.{name}.own_clock: must be true, or what was learnt before goes on moving"
            ));
        }
        if steps("geometry") > 0 && self.input == Input::Single {
            return Err("input = \"single\" has no GeoNet: set schedule.stages.geometry.steps = 0".into());
        }
        if steps("warm_up") > 0 && self.mode == Mode::Direct {
            return Err("mode = \"direct\" has no GauNet: set schedule.stages.warm_up.steps = 0".into());
        }
        if steps("warm_up") > 0 && self.gaunet.residual {
            let why = "gaunet.residual = true begins where a warm-up ends: set schedule.stages.warm_up.steps = 0";
            return Err(why.into());
        }
        Ok(())
    }

    /// The first number that is outside its range, in words.
    fn check_numbers(&self) -> Result<(), String> {
        let positive = |name: &str, v: f32, most: f32| match v > 0.0 && v < most {
            true => Ok(()),
            false => Err(format!("{name} = {v}: above 0, below {most}")),
        };
        positive("reference.opacity", self.reference.opacity, 1.0)?;
        positive("reference.spread", self.reference.spread, 100.0)?;
        positive("geonet.offset_unit", self.geonet.offset_unit, 100.0)?;
        positive("gaunet.offset_unit", self.gaunet.offset_unit, 100.0)?;
        let surface = &self.surface;
        let weights = [
            ("jitter", self.jitter),
            ("gaussians.reg", self.gaussians.reg),
            ("gaunet.clip", self.gaunet.clip),
            ("surface.slide", surface.slide),
            ("surface.laplacian", surface.laplacian),
            ("surface.isometry", surface.isometry),
            ("surface.normals", surface.normals),
            ("surface.texture", surface.texture),
            ("surface.color", surface.color),
            ("schedule.lambda_mrf", self.schedule.texture.lambda_mrf),
        ];
        match weights.into_iter().find(|(_, w)| !(*w >= 0.0 && w.is_finite())) {
            Some((name, w)) => Err(format!("{name} = {w}: finite, not negative")),
            None => Ok(()),
        }
    }

    /// What does not fit together, in words.
    fn check_together(&self) -> Result<(), String> {
        let [low, high] = self.gaussians.decode.scale_range;
        if low > high {
            return Err(format!("gaussians.decode.scale_range = [{low}, {high}]: lowest first"));
        }
        let side = self.schedule.texture.mrf_side;
        if !(8..=512).contains(&side) {
            return Err(format!("schedule.mrf_side = {side}: 8 to 512"));
        }
        if self.surface.color > 0.0 && self.surface.points == PointRule::Vertices {
            return Err("surface.color holds points against faces: set surface.points = \"faces\"".into());
        }
        Ok(())
    }
}
