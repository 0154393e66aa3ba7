//! Two parts of the surface that touch and part again, while the template's faces stay as they are.

use super::learning::SINGLE_UNPROJECTION;
use super::pose::joint;
use super::region::{self, Region};
use super::trained::deformed;
use super::visibility::{Bench, cases};
use super::{Cell, Findings, LabError, Log, Setup, Subject, Trained};
use glam::Vec3;
use gs_data::avatar::AvatarFrame;
use gs_texel::unproject::UnprojectConfig;
use gs_texel::visibility::Rule;

/// What comes this near to the other part in some frame is the region of contact, metres.
const REACH: f32 = 0.05;

const HEADS: [(&str, usize); 13] = [
    ("of", 0),
    ("apart seen %", 1),
    ("apart dB", 2),
    ("apart false visible %", 3),
    ("apart false hidden %", 3),
    ("contact seen %", 1),
    ("contact dB", 2),
    ("contact false visible %", 3),
    ("contact false hidden %", 3),
    ("apart PSNR", 2),
    ("apart SSIM", 4),
    ("contact PSNR", 2),
    ("contact SSIM", 4),
];

/// Both unprojections under the rules of visibility, and the method, while a fore arm is away from the body and on it.
pub(super) fn topo(setup: &Setup, log: &mut Log<'_>) -> Result<Findings, LabError> {
    let mut setup = setup.clone();
    setup.film.clip.get_or_insert_with(|| "touch".into());
    let all = Subject::new(&Setup { frames: usize::MAX, ..setup.clone() }, log)?;
    let (region, gaps) = Parts::of(&all, joint(&all, setup.joint.as_deref())?).meet(&all);
    if region.is_empty() {
        return Err(LabError::Unfit("the fore arm does not come near the body in this motion".into()));
    }
    let both = Trained::of(&setup, &all.full_film, log)?;
    let one = Trained::varied(&setup, &all.full_film, SINGLE_UNPROJECTION, log)?;
    let evaluated = evaluated(&all, setup.frames);
    let touches = |k: usize| gaps[k] <= UnprojectConfig::default().depth_tolerance;
    let state = |touching| {
        let kept: Vec<bool> = evaluated.iter().enumerate().map(|(k, e)| *e && touches(k) == touching).collect();
        all.only(&kept)
    };
    let states = States { subjects: [state(false)?, state(true)?], region, texels: setup.texels };
    let gap: Vec<String> = (0..gaps.len()).filter(|&k| evaluated[k]).map(|k| format!("{:.0}", 1e3 * gaps[k])).collect();
    let remark = format!(
        "Fore arm and body, where they come within {:.0} mm of one another in the film; contact: frames with a gap up to the \
         tolerance of the depth map. Gaps of the evaluated frames, mm, negative inside, inf beyond that distance: {}. First \
         unprojection on the posed template. PSNR and SSIM: pixels of test views that show the region.",
        1e3 * REACH,
        gap.join(", ")
    );
    let mut out = Findings::new("topo", remark, &HEADS);
    let mut add = |of: String, textures: [Cell; 8], scores: [Cell; 4]| {
        out.rows.push([&[of.into()][..], &textures, &scores].concat());
    };
    log("first unprojection");
    for (name, config) in cases() {
        let cells = states.textures(&config, |_, subject, frame| Ok(subject.scene.posed(frame)))?;
        add(format!("1st, {name}"), cells, empty());
    }
    log("second unprojection");
    for rule in [Rule::Neighbours, Rule::FourTap] {
        let config = UnprojectConfig { rule, ..UnprojectConfig::default() };
        let cells = states.textures(&config, |_, subject, frame| Ok(subject.scene.true_surface(frame)))?;
        add(format!("2nd on the true surface, {}", rule.name()), cells, empty());
    }
    if let Some(both) = &both {
        let (trained, changes) = one.as_ref().map_or((both, SINGLE_UNPROJECTION), |one| (one, &[]));
        add("method, one texture".into(), empty(), states.scores(trained, changes)?);
    }
    if let Some(both) = both.as_ref().filter(|both| both.has_geonet()) {
        let on = |subject: &Option<Subject>| subject.as_ref().map(|s| both.on(&s.film, &[])).transpose();
        let duts = [on(&states.subjects[0])?, on(&states.subjects[1])?];
        let surface = |k: usize, subject: &Subject, frame: &AvatarFrame| {
            duts[k].as_ref().map_or_else(|| Ok(subject.scene.posed(frame)), |dut| deformed(dut, frame))
        };
        let cells = states.textures(&UnprojectConfig::default(), surface)?;
        add("method, 2nd on GeoNet's surface".into(), cells, states.scores(both, &[])?);
    }
    Ok(out)
}

/// Cells without a value.
fn empty<const N: usize>() -> [Cell; N] {
    std::array::from_fn(|_| Cell::Number(None))
}

/// The frames to evaluate: at most `most` of those that no training view shows, evenly spread; of all, if there are none.
fn evaluated(subject: &Subject, most: usize) -> Vec<bool> {
    let frames = &subject.scene.frames;
    let mut of: Vec<usize> = (0..frames.len()).filter(|&k| !frames[k].learnt).collect();
    if of.is_empty() {
        of = (0..frames.len()).collect();
    }
    let mut evaluated = vec![false; frames.len()];
    gs_data::evenly(of.len(), most.max(1)).for_each(|k| evaluated[of[k]] = true);
    evaluated
}

/// The frames with the parts apart and in contact, none where there is no such frame.
struct States {
    subjects: [Option<Subject>; 2],
    region: Region,
    texels: usize,
}

impl States {
    /// The cells of both states for the textures on a surface, given by state, subject and frame.
    fn textures(
        &self,
        config: &UnprojectConfig,
        surface: impl Fn(usize, &Subject, &AvatarFrame) -> Result<Vec<Vec3>, LabError>,
    ) -> Result<[Cell; 8], LabError> {
        let mut cells = [None; 8];
        for (k, subject) in self.subjects.iter().enumerate() {
            let Some(subject) = subject else { continue };
            let on = |frame: &AvatarFrame| surface(k, subject, frame);
            let measured = Bench::new(subject, self.texels, Some(&self.region), on)?.measure(config)?;
            cells[4 * k..4 * k + 4].copy_from_slice(&measured[..4]);
        }
        Ok(cells.map(Cell::from))
    }

    /// Scores of the region in both states.
    fn scores(&self, trained: &Trained, changes: &[&str]) -> Result<[Cell; 4], LabError> {
        let mut cells = [None; 4];
        for (k, subject) in self.subjects.iter().enumerate() {
            let Some(subject) = subject else { continue };
            let report = trained.scores(&self.region.scored(subject)?, changes)?;
            cells[2 * k..2 * k + 2].copy_from_slice(&region::scores(Some(&report))[1..]);
        }
        Ok(cells.map(Cell::from))
    }
}

/// Vertices of a fore arm with its hand, and those of all but that arm.
struct Parts {
    fore_arm: Vec<usize>,
    body: Vec<usize>,
}

impl Parts {
    /// By the joint of most weight; `joint` is the node of the fore arm, its parent carries the upper arm.
    fn of(subject: &Subject, joint: u32) -> Self {
        let character = &subject.scene.character;
        let (nodes, weights) = (&character.skeleton.nodes, &character.template.weights);
        let upper = nodes[joint as usize].parent.unwrap_or(joint);
        let below = |v: usize, root: u32| {
            let most = weights.row(v).max_by(|a, b| a.1.total_cmp(&b.1)).map(|(joint, _)| joint);
            let node = most.map(|joint| character.skeleton.joints[joint as usize].node);
            std::iter::successors(node, |&n| nodes[n as usize].parent).any(|n| n == root)
        };
        let vertices = 0..weights.len();
        Self {
            fore_arm: vertices.clone().filter(|&v| below(v, joint)).collect(),
            body: vertices.filter(|&v| !below(v, upper)).collect(),
        }
    }

    /// The region of contact, and the gap in every frame, metres: the least distance of a vertex of the fore arm from the plane
    /// of the nearest vertex of the body, negative inside; infinite beyond [`REACH`].
    fn meet(&self, subject: &Subject) -> (Region, Vec<f32>) {
        let mut near = vec![false; subject.scene.character.template.vertices.len()];
        let mut gap = |frame: &AvatarFrame| {
            let surface = subject.scene.true_surface(frame);
            let normals = subject.normals(&surface);
            let mut least = f32::INFINITY;
            for &a in &self.fore_arm {
                let mut nearest = (REACH, None);
                for &b in &self.body {
                    let distance = surface[a].distance(surface[b]);
                    if distance < REACH {
                        (near[a], near[b]) = (true, true);
                    }
                    if distance < nearest.0 {
                        nearest = (distance, Some(b));
                    }
                }
                let height = nearest.1.map(|b| (surface[a] - surface[b]).dot(normals[b]));
                least = height.map_or(least, |h| h.min(least));
            }
            least
        };
        let gaps = subject.scene.frames.iter().map(&mut gap).collect();
        (Region::of(subject, &near), gaps)
    }
}
