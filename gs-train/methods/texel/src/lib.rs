//! DUT: people from few cameras by textures that are unprojected twice, and one Gaussian per texel (Sun et al. 2025,
//! "Real-time Free-view Human Rendering from Sparse-view RGB Videos using Double Unprojected Textures").
//!
//! ```text
//! pose → template → first texture → GeoNet → offsets → deformed template → second texture → texel Gaussians → image
//! ```
//! A frame is a function of its images and its pose alone. The texel Gaussians come from GauNet, or from values of the
//! texels' own ([`Mode::Direct`]), which need no network and say how well any network could do.
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::cast_possible_truncation))]

mod actor;
mod cache;
mod config;
mod direct;
mod geometry;
mod inspect;
mod learn;
mod light;
mod mean;
mod network;
mod oracle;
mod tape;
mod texels;
mod texture;

pub use actor::{Actor, ActorError, First, FrameError, Posed, Second, Seen};
pub use config::{
    Config, DirectColor, DirectConfig, GauConfig, GaussianConfig, Input, LaplacianRule, Mode, Phase, Plan, PointRule,
    ReferenceConfig, ResizeRule, SurfaceConfig, TextureLoss, TextureSizes, UnseenColor,
};
pub use inspect::OffsetErrors;
pub use mean::MeanTextures;
pub use oracle::OracleOptions;

use cache::Cache;
use direct::Direct;
use geometry::Geometry;
use gs_core::{Camera, Image, Param, Params, Splats, SplatsGrad};
use gs_data::avatar::{AvatarFrame, AvatarScene};
use gs_texel::Pose;
use gs_texel::gaussians::{Channels, DecodeOptions, decode};
use gs_train::capabilities::Capabilities;
use gs_train::layers::BASE;
use gs_train::loss::TextureTerm;
use gs_train::method::{
    Buffer, BufferMut, Buffers, LossValue, Merge, Method, MethodError, RenderView, StepEvents, ViewCtx,
};
use gs_train::model::Model;
use gs_train::registry::{MethodEntry, parse_config};
use gs_train::scene::SceneInfo;
use gs_train::step::StepCtx;
use gs_train::timestamp::Timestamp;
use learn::StepError;
use network::Network;
use std::path::PathBuf;
use std::sync::Arc;

/// What the presets `direct`, `tiny`, `fast` and `small` share.
const QUICK: &str = include_str!("dut.quick.toml");
/// What the presets `tiny`, `fast` and `small` share.
const TINY: &str = include_str!("dut.tiny.toml");

/// The line in the list of methods.
pub const ENTRY: MethodEntry = MethodEntry {
    name: "dut",
    about: "DUT: a filmed person from few cameras, by twice unprojected textures and a Gaussian per texel (Sun et al. 2025)",
    defaults: &[BASE, include_str!("dut.toml")],
    presets: &[
        ("paper", &[]),
        ("large", &[include_str!("dut.large.toml")]),
        ("small", &[QUICK, TINY, include_str!("dut.small.toml")]),
        ("fast", &[QUICK, TINY, include_str!("dut.fast.toml")]),
        ("tiny", &[QUICK, TINY]),
        ("direct", &[QUICK, include_str!("dut.direct.toml")]),
    ],
    domains: config::DOMAINS,
    needs_avatar: true,
    grows: None,
    effective: None,
    build,
};

/// The methods of this crate.
pub const METHODS: &[MethodEntry] = &[ENTRY];

/// Where a frame's rows come from.
enum Source {
    Network(Box<Network>),
    Direct(Box<Direct>),
}

/// The method DUT: a skinned template, its networks and their training.
pub struct Dut {
    config: Config,
    channels: Channels,
    actor: Actor,
    geometry: Option<Geometry>,
    source: Source,
    firsts: Cache<First>,
    seconds: Cache<Second>,
    seed: u64,
    at: StepCtx,
    /// Regularisers of the present step.
    penalties: Vec<LossValue>,
    /// Scratch: texels' values and their cotangents.
    rows: Vec<f32>,
    d_rows: Vec<f32>,
    d_splats: SplatsGrad,
}

fn build(table: &toml::Table, scene: &SceneInfo) -> Result<Model, MethodError> {
    let config: Config = parse_config(ENTRY.name, table)?;
    let Plan { trainer, texture } = config.schedule.clone();
    let model = Model::new(ENTRY.name, Dut::new(config, scene)?, trainer)?;
    let weights = (!texture.mrf_weights.is_empty()).then(|| texture.mrf_weights.into());
    Ok(model.with_loss(texture.lambda_mrf, TextureTerm::new(texture.mrf_side, weights)))
}

impl Dut {
    /// Lays texels on the person of a scene.
    ///
    /// # Errors
    /// If there is none, or configuration and template do not fit.
    pub fn new(config: Config, scene: &SceneInfo) -> Result<Self, MethodError> {
        config.check(ENTRY.name)?;
        let no_avatar = || MethodError::NoAvatar { method: ENTRY.name, folder: PathBuf::new() };
        let avatar = scene.avatar.clone().ok_or_else(no_avatar)?;
        let wrong = |why: String| MethodError::Config { method: ENTRY.name, why };
        scene.admit(ENTRY.name, &config.param_counts())?;
        let actor = Actor::new(avatar, &config).map_err(|e| MethodError::Scene(e.to_string()))?;
        let channels = Channels::new(config.gaussians.sh_degree).map_err(|e| wrong(e.to_string()))?;
        let geometry = (config.input != Input::Single).then(|| Geometry::new(&config, &actor, scene.seed));
        let frame = |e: FrameError| MethodError::Scene(e.to_string());
        let source = match config.mode {
            Mode::Networks => Network::new(&config, &actor, channels, scene.seed)
                .map(|n| Source::Network(Box::new(n)))
                .map_err(|e| wrong(e.to_string()))?,
            Mode::Direct => Source::Direct(Box::new(Direct::new(&config, &actor, channels).map_err(frame)?)),
        };
        let frames = ((config.cache_mib as usize) << 20) / actor.frame_bytes().max(1);
        Ok(Self {
            channels,
            geometry: geometry.transpose().map_err(|e| wrong(e.to_string()))?,
            source,
            firsts: Cache::new(frames),
            seconds: Cache::new(frames),
            seed: scene.seed,
            at: StepCtx::default(),
            penalties: Vec::new(),
            rows: Vec::new(),
            d_rows: Vec::new(),
            d_splats: SplatsGrad::default(),
            actor,
            config,
        })
    }

    /// What never changes of the person.
    pub fn actor(&self) -> &Actor {
        &self.actor
    }

    /// A frame before GeoNet.
    ///
    /// # Errors
    /// As [`Actor::first`].
    pub fn first(&self, frame: &AvatarFrame) -> Result<Arc<First>, FrameError> {
        self.firsts.get(frame.number, || self.actor.first(frame))
    }

    /// `D` of a frame, `N` rows; absent if the template is believed.
    ///
    /// # Errors
    /// As [`Actor::first`].
    pub fn offsets(&self, first: &First) -> Result<Option<Vec<glam::Vec3>>, FrameError> {
        self.geometry.as_ref().map(|g| g.offsets(&self.actor, first)).transpose()
    }

    /// A frame behind GeoNet.
    ///
    /// # Errors
    /// As [`Actor::second`].
    pub fn second(&self, frame: &AvatarFrame) -> Result<Arc<Second>, FrameError> {
        let make = || {
            let first = self.first(frame)?;
            self.actor.second(frame, &first, self.offsets(&first)?)
        };
        // GeoNet still changes.
        if self.phase() == Phase::Geometry { make().map(Arc::new) } else { self.seconds.get(frame.number, make) }
    }

    /// Texels' values `[K, width]` of a frame.
    ///
    /// # Errors
    /// As the network goes.
    pub fn rows(&self, second: &Second, rows: &mut Vec<f32>) -> Result<(), FrameError> {
        match &self.source {
            Source::Network(net) => net.rows(&self.actor, second, rows),
            Source::Direct(direct) => {
                direct.rows(&self.actor, second, rows);
                Ok(())
            }
        }
    }

    /// Texels' values as Gaussians.
    ///
    /// # Errors
    /// If they are not as many as the texels.
    pub fn decode(&self, rows: &[f32], second: &Second) -> Result<Splats, FrameError> {
        let mut splats = decode(rows, self.channels, &second.base, &self.decoding())?;
        light::put_on(&mut splats, second.light);
        Ok(splats)
    }

    fn decoding(&self) -> DecodeOptions {
        let options = self.config.gaussians.decode;
        DecodeOptions { sh_active: self.at.sh_degree.min(options.sh_active), ..options }
    }

    fn phase(&self) -> Phase {
        Phase::of(&self.at.stage)
    }

    /// The second unprojection of a timestamp's frame and its texel values.
    fn texels_at(&self, at: &Timestamp) -> Result<(Arc<Second>, Vec<f32>), FrameError> {
        let second = self.second(self.actor.frame_at(at.t))?;
        let mut rows = Vec::new();
        self.rows(&second, &mut rows)?;
        Ok((second, rows))
    }

    /// An error with the frame it concerns.
    fn at_frame(frame: &AvatarFrame, error: &FrameError) -> MethodError {
        MethodError::Render(format!("frame {} of the filmed person: {error}", frame.number))
    }
}

impl Params for Dut {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.geometry.iter().for_each(|g| g.visit(f));
        match &self.source {
            Source::Network(net) => net.visit(f),
            Source::Direct(direct) => direct.visit(f),
        }
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.geometry.iter_mut().for_each(|g| g.visit_mut(f));
        match &mut self.source {
            Source::Network(net) => net.visit_mut(f),
            Source::Direct(direct) => direct.visit_mut(f),
        }
    }
}

impl Dut {
    /// Rendering over black, as in training.
    pub fn raster_options(&self) -> gs_raster::RasterOptions {
        self.config.schedule.trainer.raster_options([0.0; 3])
    }

    /// The character and what was filmed of it.
    pub fn scene(&self) -> &AvatarScene {
        &self.actor.scene
    }

    /// The splats that the images of a timestamp's frame give in the pose of that frame, carried by the skinning of another
    /// pose: appearance stays that of the images.
    ///
    /// # Errors
    /// If the images cannot be read or the pose does not fit.
    pub fn posed(&self, at: &Timestamp, pose: &Pose) -> Result<Splats, FrameError> {
        let (second, rows) = self.texels_at(at)?;
        let base = self.actor.base(&self.actor.pose(pose), &second.offsets)?;
        let mut splats = decode(&rows, self.channels, &base, &self.decoding())?;
        light::put_on(&mut splats, second.light);
        Ok(splats)
    }

    /// The splats of a frame that is not of the film: from its pose and the images of the conditioning cameras, straight colours
    /// and coverage. Nothing is kept.
    ///
    /// # Errors
    /// If pose and images do not fit the person.
    pub fn splats_of(&self, pose: &Pose, images: &[(Camera, Image)]) -> Result<Splats, FrameError> {
        let first = self.actor.first_of(self.actor.pose(pose), images)?;
        let second = self.actor.second_of(&first, self.offsets(&first)?, images)?;
        let mut rows = Vec::new();
        self.rows(&second, &mut rows)?;
        self.decode(&rows, &second)
    }
}

impl Buffers for Dut {
    /// The mean textures, which another film would give other values of.
    fn buffers(&self, f: &mut dyn FnMut(Buffer<'_>)) {
        let MeanTextures { geo, gau, known } = &self.actor.mean;
        for (name, values) in [("mean.geo", geo), ("mean.gau", gau), ("mean.known", known)] {
            if !values.is_empty() {
                f(Buffer { name, row_width: None, merge: Merge::Keep, values });
            }
        }
    }

    fn buffers_mut(&mut self, f: &mut dyn FnMut(BufferMut<'_>)) {
        let MeanTextures { geo, gau, known } = &mut self.actor.mean;
        for (name, values) in [("mean.geo", geo), ("mean.gau", gau), ("mean.known", known)] {
            if !values.is_empty() {
                f(BufferMut { name, row_width: None, merge: Merge::Keep, values });
            }
        }
    }
}

impl Method for Dut {
    fn begin_step(&mut self, at: &StepCtx) {
        // A restored state brings other mean textures, which cached inputs of GeoNet hold.
        let continues = at.step == self.at.step + 1;
        self.at = at.clone();
        if !continues {
            self.firsts.clear();
        }
        if !continues || self.phase() == Phase::Geometry {
            self.seconds.clear();
        }
    }

    fn splats(&self, at: &Timestamp, _camera: &Camera) -> Result<Splats, MethodError> {
        let made = self.texels_at(at).and_then(|(second, rows)| self.decode(&rows, &second));
        made.map_err(|e| Self::at_frame(self.actor.frame_at(at.t), &e))
    }

    fn step(&mut self, view: &ViewCtx<'_>, render: &mut dyn RenderView) -> Result<Vec<LossValue>, MethodError> {
        let scene = self.actor.scene.clone();
        let frame = self.frame_of_step(&scene.frames, scene.frame_at(view.at.t));
        self.learn(frame, render).map_err(|e| match e {
            StepError::Frame(e) => Self::at_frame(frame, &e),
            StepError::Render(e) => e,
        })?;
        Ok(std::mem::take(&mut self.penalties))
    }

    fn regularise(&mut self, _last: &Timestamp) -> Vec<LossValue> {
        if let Source::Network(net) = &mut self.source {
            net.clip();
        }
        Vec::new()
    }

    fn takes_part(&self, parameter: &str) -> bool {
        parameter.starts_with("geo.") == (self.phase() == Phase::Geometry)
    }

    fn needs_whole_gradient(&self) -> bool {
        matches!(&self.source, Source::Network(net) if net.clips())
    }

    fn needs_whole_rows(&self) -> bool {
        false
    }

    fn end_step(&mut self) -> Result<StepEvents, MethodError> {
        self.refresh_mean_textures().map_err(|e| MethodError::Render(format!("the filmed person: {e}")))?;
        Ok(StepEvents::default())
    }

    fn splat_count(&self) -> usize {
        self.actor.gau.len()
    }

    fn capabilities(&self) -> Capabilities<'_> {
        Capabilities { inspect: Some(self), concrete: Some(self), ..Capabilities::default() }
    }
}
