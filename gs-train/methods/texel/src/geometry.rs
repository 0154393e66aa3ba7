//! GeoNet under training: offsets of the bind pose that bring the posed template to measured points.
//!
//! ```text
//! p_i = T_i (v̄_i + D_i)      L = L_cham(P) + λ_lap L_lap(P) + λ_iso L_iso(v̄ + D) + λ_nc L_nc(v̄ + D)
//! ```
//! (DUT, supplement.) What the pose's known morphs do to the bind pose is left out of the last two.

use super::actor::{Actor, First, FrameError};
use super::cache::Cache;
use super::config::{Config, LaplacianRule, NormalTarget, PointRule, SurfaceConfig};
use super::tape::{covered, last, with_tape};
use super::texture::texture_loss;
use glam::Vec3;
use gs_core::{Image, Param, Params, cast};
use gs_data::avatar::{AvatarFrame, MeasuredPoints};
use gs_texel::skin::{skin, skin_backward};
use gs_texel::surface_loss::{Chamfer, Colors, Isometry, NormalConsistency, SurfaceLoss, laplacian};
use gs_texel::{GeoNet, GeoNetTape};
use std::sync::{Arc, Mutex};

/// Frames whose points are kept with their index.
const FRAMES: usize = 256;

/// GeoNet, and what it learns from.
pub(crate) struct Geometry {
    net: GeoNet,
    tape: Mutex<GeoNetTape>,
    weights: SurfaceConfig,
    isometry: Isometry,
    normals: NormalConsistency,
    points: Cache<(Chamfer, Arc<MeasuredPoints>)>,
}

/// Values of the terms, weights applied.
pub(crate) type Terms = [(&'static str, f32); 5];

impl Geometry {
    /// A network that leaves the template as it is.
    ///
    /// # Errors
    /// If its shape does not fit.
    pub(crate) fn new(config: &Config, actor: &Actor, seed: u64) -> Result<Self, FrameError> {
        let net = GeoNet::new("geo", config.geonet_shape(), seed)?;
        let mask = covered(&actor.geo);
        let t = &actor.scene.character.template;
        let weights = config.surface;
        let normals = NormalConsistency::new(&t.faces, &actor.topology, weights.normal_rule);
        Ok(Self {
            tape: Mutex::new(net.tape(actor.geo.size, Some(&mask))?),
            net,
            isometry: Isometry::new(&t.vertices, &t.faces, &actor.topology, weights.isometry_rule),
            normals: match weights.normal_target {
                NormalTarget::Flat => normals,
                NormalTarget::Rest => normals.from_rest(&t.vertices),
            },
            weights,
            points: Cache::new(FRAMES),
        })
    }

    /// `D`, `N` rows.
    ///
    /// # Errors
    /// If the input is not finite.
    pub(crate) fn offsets(&self, actor: &Actor, first: &First) -> Result<Vec<Vec3>, FrameError> {
        let fresh = || self.net.tape(actor.geo.size, Some(&covered(&actor.geo)));
        Ok(with_tape(&self.tape, fresh, |tape| Ok(read(actor, self.net.forward(&first.input, tape)?)))?)
    }

    /// Adds the gradient of a frame's loss, times `share`, to the weights.
    ///
    /// # Errors
    /// If the frame has no points or values are not finite.
    pub(crate) fn learn(
        &mut self,
        actor: &Actor,
        frame: &AvatarFrame,
        first: &First,
        share: f32,
    ) -> Result<Terms, FrameError> {
        let tape = last(&mut self.tape);
        let offsets = read(actor, self.net.forward(&first.input, tape)?);
        let (terms, d_offsets) = self.loss(actor, frame, first, &offsets)?;
        let d_read: Vec<f32> = d_offsets.iter().flat_map(|d| (*d * share).to_array()).collect();
        let tape = last(&mut self.tape);
        self.net.backward(tape, &actor.reader.adjoint(&d_read, 3).data)?;
        Ok(terms.map(|(name, v)| (name, v * share)))
    }

    /// The loss of a frame's offsets, term by term, and its gradient.
    ///
    /// # Errors
    /// If the frame has no points or values are not finite.
    pub(crate) fn loss(
        &self,
        actor: &Actor,
        frame: &AvatarFrame,
        first: &First,
        offsets: &[Vec3],
    ) -> Result<(Terms, Vec<Vec3>), FrameError> {
        let points = self.points.get(frame.number, || {
            let points = frame.points.as_ref().ok_or(FrameError::NoPoints)?.read()?;
            Ok::<_, FrameError>((Chamfer::new(&points.positions)?, points))
        })?;
        let (points, measured) = &*points;
        let t = &actor.scene.character.template;
        let posed = actor.surface(&first.posed, offsets);
        let deformed: Vec<Vec3> = t.vertices.iter().zip(offsets).map(|(&v, &d)| v + d).collect();
        let SurfaceConfig { laplacian: lap, isometry, normals, .. } = self.weights;
        let mut world = match self.weights.points {
            PointRule::Vertices => {
                points.evaluate_anisotropic(&posed, &first.posed.normals, self.weights.slide.into())?
            }
            PointRule::Faces => {
                let weight = f64::from(self.weights.color);
                let colors = match measured.colors.as_deref() {
                    _ if weight == 0.0 => None,
                    Some(points) => Some(Colors { paint: t, points, weight }),
                    None => return Err(FrameError::NoColors),
                };
                points.evaluate_faces(&posed, &t.faces, &actor.topology, colors.as_ref())?
            }
        };
        let chamfer = world.value;
        let smooth = term(lap, || self.smooth(actor, first, &posed), posed.len());
        world.add(lap.into(), &smooth);
        let mut drift = 0.0;
        if self.weights.texture > 0.0 {
            let lit = |c: [f32; 3]| std::array::from_fn(|i| c[i] * first.light[i]);
            let mean: Vec<Option<[f32; 3]>> = actor.mean.seen().map(|c| c.map(lit)).collect();
            let texture = texture_loss(actor, &posed, &actor.images(frame)?, &mean)?;
            drift = f64::from(self.weights.texture) * texture.value;
            world.add(self.weights.texture.into(), &texture);
        }
        let lengths = term(isometry, || self.isometry.evaluate(&deformed), posed.len());
        let creases = term(normals, || self.normals.evaluate(&deformed), posed.len());
        let d_world: Vec<Vec3> = world.grad.iter().map(|g| g.as_vec3()).collect();
        let mut d_offsets = skin_backward(&first.posed.transforms, &d_world);
        for (weight, loss) in [(isometry, &lengths), (normals, &creases)] {
            d_offsets.iter_mut().zip(&loss.grad).for_each(|(d, g)| *d += (f64::from(weight) * *g).as_vec3());
        }
        let weighted = |weight: f32, loss: &SurfaceLoss| cast::to_f32(f64::from(weight) * loss.value);
        let terms = [
            ("chamfer", cast::to_f32(chamfer)),
            ("laplacian", weighted(lap, &smooth)),
            ("isometry", weighted(isometry, &lengths)),
            ("normals", weighted(normals, &creases)),
            ("texture", cast::to_f32(drift)),
        ];
        Ok((terms, d_offsets))
    }

    fn smooth(&self, actor: &Actor, first: &First, posed: &[Vec3]) -> SurfaceLoss {
        match self.weights.laplacian_rule {
            LaplacianRule::Positions => laplacian(posed, &actor.topology),
            LaplacianRule::Offsets => {
                let still = skin(&first.posed.canonical, &first.posed.transforms);
                let moved: Vec<Vec3> = posed.iter().zip(&still).map(|(p, s)| *p - *s).collect();
                laplacian(&moved, &actor.topology)
            }
        }
    }
}

/// A loss, not looked at without weight.
fn term(weight: f32, loss: impl FnOnce() -> SurfaceLoss, vertices: usize) -> SurfaceLoss {
    if weight > 0.0 { loss() } else { SurfaceLoss { value: 0.0, grad: vec![Default::default(); vertices] } }
}

/// The offsets of the vertices from a map `[S, S, 3]`.
fn read(actor: &Actor, map: &[f32]) -> Vec<Vec3> {
    let size = actor.geo.size;
    let map = Image { width: size, height: size, channels: 3, data: map.to_vec() };
    actor.reader.read(&map).chunks_exact(3).map(Vec3::from_slice).collect()
}

impl Params for Geometry {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.net.visit(f);
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.net.visit_mut(f);
    }
}

#[cfg(test)]
mod tests {
    use super::super::config::TextureSizes;
    use super::*;
    use gs_synth::avatar::{AvatarOptions, generate};
    use gs_train::registry::own_settings;

    #[test]
    fn colours_that_no_frame_shows_pull_at_nothing() {
        let template = "builtin:cylinder".into();
        let film = AvatarOptions { template, size: 64, frames: 1, rings: 1, points: 400, ..AvatarOptions::default() };
        let scene = generate(&film).unwrap().avatar.unwrap();
        let config = gs_methods::registry().find("dut").unwrap().config("tiny").unwrap();
        let config: Config = own_settings(config).try_into().unwrap();
        let mut actor = Actor::new(scene.clone(), &config).unwrap();
        let geometry = Geometry::new(&config, &actor, 1).unwrap();
        let (frame, still) = (&scene.frames[0], vec![Vec3::ZERO; scene.character.template.vertices.len()]);
        let first = actor.first(frame).unwrap();
        let texture = |actor: &Actor| geometry.loss(actor, frame, &first, &still).unwrap().0[4].1;
        let all = texture(&actor);
        // Every second texel is one that no frame shows, and then its colour is another.
        actor.mean.known.chunks_mut(2).for_each(|pair| pair[0] = 0.0);
        let half = texture(&actor);
        actor.mean.gau.chunks_exact_mut(6).for_each(|pair| pair[..3].fill(0.0));
        assert_eq!(texture(&actor), half);
        actor.mean.known.fill(1.0);
        assert!(half > 0.0 && texture(&actor) > 2.0 * all, "{all} {half}");
    }

    /// Where the template is the truth, nothing but the points may pull at it. With the published target of normals folds of the
    /// template do, in every preset; not with normals held against those at rest, nor without that term.
    #[test]
    fn regularisers_leave_the_template_as_it_is_if_normals_do() {
        let film = AvatarOptions { template: "builtin:person".into(), size: 32, frames: 1, ..AvatarOptions::default() };
        let scene = generate(&film).unwrap().avatar.unwrap();
        let pull = |preset: &str, normals: fn(&mut SurfaceConfig)| {
            let config = gs_methods::registry().find("dut").unwrap().config(preset).unwrap();
            let mut config: Config = own_settings(config).try_into().unwrap();
            config.textures = TextureSizes { unproject: 64, geo: 64, gau: 64 };
            normals(&mut config.surface);
            let actor = Actor::new(scene.clone(), &config).unwrap();
            let geometry = Geometry::new(&config, &actor, 1).unwrap();
            let first = actor.first(&scene.frames[0]).unwrap();
            let template = &scene.character.template.vertices;
            let posed = actor.surface(&first.posed, &vec![Vec3::ZERO; template.len()]);
            let weights = geometry.weights;
            let terms = [
                (weights.laplacian, geometry.smooth(&actor, &first, &posed)),
                (weights.isometry, geometry.isometry.evaluate(template)),
                (weights.normals, geometry.normals.evaluate(template)),
            ];
            let longest = |(weight, loss): &(f32, SurfaceLoss)| {
                f64::from(*weight) * loss.grad.iter().map(|g| g.length()).fold(0.0, f64::max)
            };
            terms.iter().map(longest).fold(0.0, f64::max)
        };
        let [rest, none]: [fn(&mut SurfaceConfig); 2] = [|s| s.normal_target = NormalTarget::Rest, |s| s.normals = 0.0];
        let ours = ["tiny", "fast", "direct", "small"];
        for (preset, normals) in ours.into_iter().flat_map(|preset| [(preset, rest), (preset, none)]) {
            assert!(pull(preset, normals) < 1e-12, "{preset}: {:e}", pull(preset, normals));
        }
        for preset in ours.into_iter().chain(["paper", "large"]) {
            assert!(pull(preset, |_| ()) > 1e-6, "{preset}: {:e}", pull(preset, |_| ()));
        }
        assert!(pull("paper", rest) > 1e-6, "the Laplacian of positions pulls as well");
    }

    /// With coloured points held against faces, and normals against those at rest, the loss of a morph that is half too small or
    /// half too large is more than twice that of the true one.
    #[test]
    fn true_offsets_cost_least() {
        let config = gs_methods::registry().find("dut").unwrap().config("tiny").unwrap();
        let mut config: Config = own_settings(config).try_into().unwrap();
        config.textures = TextureSizes { unproject: 64, geo: 32, gau: 32 };
        config.surface = SurfaceConfig {
            points: PointRule::Faces,
            color: 0.05,
            texture: 0.0,
            normal_target: NormalTarget::Rest,
            laplacian: 1.0,
            ..config.surface
        };
        for morph in ["breathe", "swing"] {
            let only_morphs = vec![morph.into()];
            let film =
                AvatarOptions { only_morphs, size: 32, frames: 3, rings: 1, points: 2000, ..AvatarOptions::default() };
            let scene = generate(&film).unwrap().avatar.unwrap();
            let actor = Actor::new(scene.clone(), &config).unwrap();
            let geometry = Geometry::new(&config, &actor, 1).unwrap();
            let frame = &scene.frames[1];
            let (first, truth) = (actor.first(frame).unwrap(), scene.true_offsets(frame).unwrap());
            let cost = |share: f32| -> f32 {
                let offsets: Vec<Vec3> = truth.iter().map(|d| share * *d).collect();
                geometry.loss(&actor, frame, &first, &offsets).unwrap().0.iter().map(|term| term.1).sum()
            };
            for share in [0.0, 0.5, 1.5] {
                assert!(2.0 * cost(1.0) < cost(share), "{morph}, {share}: {:e} {:e}", cost(1.0), cost(share));
            }
        }
    }
}
