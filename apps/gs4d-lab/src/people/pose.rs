//! Wrong poses with correct images.

use super::subject::Errors;
use super::trained::{SCORES, scores, scores_at};
use super::{Cell, Chart, Findings, LabError, Log, Setup, Subject, Trained};
use glam::{DVec3, Vec3};
use gs_core::Rng;
use gs_data::Dataset;
use gs_data::avatar::AvatarFrame;
use gs_texel::retarget::part;
use gs_texel::texels::TexelTable;
use gs_texel::unproject::UnprojectConfig;
use gs_train::evaluate::EvalReport;

/// Errors of the elbow angle, degrees; the third and the last are the 7°46′ and 60°13′ of the publication.
const ANGLES: [f64; 7] = [0.0, 3.717, 7.767, 15.0, 30.0, 45.0, 60.217];
/// Standard deviations of the rotation noise on every joint, degrees.
const NOISE: [f64; 6] = [0.0, 0.5, 1.0, 2.0, 5.0, 10.0];

const REMARK: &str = "First texture: on the posed template, against the template's own colour at seen texels. With a method: the \
                      root mean square of its offsets, the second texture on the deformed template, and scores of test views.";

const HEADS: [(&str, usize); 5] =
    [("seen %", 1), ("1st texture dB", 2), ("offsets mm", 2), ("2nd seen %", 1), ("2nd texture dB", 2)];

/// Rotates one joint by the same angle in all frames, then by an angle that grows from frame to frame.
pub(super) fn motion(setup: &Setup, log: &mut Log<'_>) -> Result<Findings, LabError> {
    let probe = Probe::new(setup, log)?;
    let joint = joint(&probe.subject, setup.joint.as_deref())?;
    let name = &probe.subject.scene.character.skeleton.nodes[joint as usize].name;
    let mut out =
        probe.findings("motion", &[("mode", 0), ("angle deg", 2)], &format!("The joint is `{name}`. {REMARK}"));
    for angle in ANGLES {
        log(&format!("{name}: {angle:.1} degrees off"));
        let film = probe.subject.changed(|_, frame| probe.bend(frame, joint, angle));
        let report = probe.report(&film)?;
        let mut row: Vec<Cell> = vec!["static".into(), angle.into()];
        row.extend(probe.texture_cells(&film, None)?);
        row.extend(scores(report.as_ref()).map(Cell::from));
        out.rows.push(row);
    }
    let frames = probe.subject.scene.frames.len();
    let at = |k: usize| ANGLES[ANGLES.len() - 1] * k as f64 / (frames - 1).max(1) as f64;
    log(&format!("{name}: growing over {frames} frames"));
    let film = probe.subject.changed(|k, frame| probe.bend(frame, joint, at(k)));
    let report = probe.report(&film)?;
    for (k, frame) in probe.subject.scene.frames.iter().enumerate() {
        let mut row: Vec<Cell> = vec!["ramp".into(), at(k).into()];
        row.extend(probe.texture_cells(&film, Some(k))?);
        row.extend(scores_at(report.as_ref(), frame.time.normalised).map(Cell::from));
        out.rows.push(row);
    }
    out.charts = charts("angle deg", Some("mode"));
    Ok(out)
}

/// Rotates every joint by a random angle, independently in each frame.
pub(super) fn mocap(setup: &Setup, log: &mut Log<'_>) -> Result<Findings, LabError> {
    let probe = Probe::new(setup, log)?;
    let remark = format!("Every joint turned about a random axis by a normal angle, anew in each frame. {REMARK}");
    let mut out = probe.findings("mocap", &[("noise deg", 2)], &remark);
    let joints: Vec<u32> = probe.subject.scene.character.skeleton.joints.iter().map(|j| j.node).collect();
    for noise in NOISE {
        log(&format!("{noise} degrees of noise"));
        let film = probe.subject.changed(|k, frame| {
            for &joint in &joints {
                let mut rng = Rng::new(setup.film.seed, "mocap noise", k as u32, u64::from(joint));
                let axis = DVec3::from_array(std::array::from_fn(|_| f64::from(rng.normal())));
                frame.pose.turn(joint, axis, (noise * f64::from(rng.normal())).to_radians());
            }
        });
        let report = probe.report(&film)?;
        let mut row: Vec<Cell> = vec![noise.into()];
        row.extend(probe.texture_cells(&film, None)?);
        row.extend(scores(report.as_ref()).map(Cell::from));
        out.rows.push(row);
    }
    out.charts = charts("noise deg", None);
    Ok(out)
}

fn charts(across: &'static str, split: Option<&'static str>) -> Vec<Chart> {
    let chart = |part, title: &str, columns| Chart { part, title: title.into(), across, drawn: columns, split };
    vec![
        chart("", "Textures, dB over seen texels", vec!["1st texture dB", "2nd texture dB"]),
        chart("scores", "In-mask PSNR of test views, dB", vec!["in-mask PSNR"]),
    ]
}

/// Node of the named joint, or of the left forearm.
pub(super) fn joint(subject: &Subject, name: Option<&str>) -> Result<u32, LabError> {
    let skeleton = &subject.scene.character.skeleton;
    let joints = || skeleton.joints.iter().map(|j| (j.node, skeleton.nodes[j.node as usize].name.as_str()));
    let is_fore_arm = |name: &str| part(name).as_deref() == Some("left forearm");
    let found = joints().find(|(_, n)| name.map_or_else(|| is_fore_arm(n), |asked| asked == *n));
    found.map(|(node, _)| node).ok_or_else(|| LabError::Unknown {
        what: "the joint",
        asked: name.unwrap_or("left fore arm").to_owned(),
        known: joints().map(|(_, n)| n).collect::<Vec<_>>().join(", "),
    })
}

/// Measures textures and scores under changed poses.
struct Probe {
    subject: Subject,
    trained: Option<Trained>,
    table: TexelTable,
    truth: Vec<[f32; 3]>,
}

impl Probe {
    fn new(setup: &Setup, log: &mut Log<'_>) -> Result<Self, LabError> {
        let subject = Subject::new(setup, log)?;
        let trained = Trained::of(setup, &subject.full_film, log)?;
        let table = subject.table(setup.texels)?;
        Ok(Self { truth: subject.truth(&table), trained, table, subject })
    }

    fn findings(&self, name: &'static str, first: &[(&'static str, usize)], remark: &str) -> Findings {
        Findings::new(name, remark, &[first, &HEADS, &SCORES].concat())
    }

    /// Rotates a joint about its hinge axis.
    fn bend(&self, frame: &mut AvatarFrame, joint: u32, degrees: f64) {
        let axis = self.subject.scene.character.skeleton.hinge_axis(&frame.pose, joint);
        frame.pose.turn(joint, axis, degrees.to_radians());
    }

    fn report(&self, film: &Dataset) -> Result<Option<EvalReport>, LabError> {
        self.trained.as_ref().map(|t| t.scores(film, &[])).transpose()
    }

    /// The cells under [`HEADS`] for the poses of `film`, over one frame or all.
    fn texture_cells(&self, film: &Dataset, only: Option<usize>) -> Result<Vec<Cell>, LabError> {
        let Some(scene) = &film.avatar else { return Ok(vec![None.into(); HEADS.len()]) };
        let dut = self.trained.as_ref().map(|t| t.on(film, &[])).transpose()?;
        let (mut first, mut second) = (Errors::default(), Errors::default());
        let (mut squares, mut rows) = (0.0f64, 0usize);
        for (_, frame) in scene.frames.iter().enumerate().filter(|(k, _)| only.is_none_or(|o| o == *k)) {
            let images = self.subject.images(&frame.inputs)?;
            let add = |errors: &mut Errors, surface: &[Vec3]| -> Result<(), LabError> {
                let (texture, ms) = self.subject.texture(surface, &images, &self.table, &UnprojectConfig::default())?;
                errors.add(&texture.colors, texture.seen.iter().map(|&n| n > 0), &self.truth, ms);
                Ok(())
            };
            add(&mut first, &scene.posed(frame))?;
            let Some(dut) = &dut else { continue };
            let first_pass = dut.first(frame)?;
            if let Some(offsets) = dut.offsets(&first_pass)? {
                squares += offsets.iter().map(|d| f64::from(d.length_squared())).sum::<f64>();
                rows += offsets.len();
                add(&mut second, &dut.actor().surface(&first_pass.posed, &offsets))?;
            }
        }
        let rms_offset = (rows > 0).then(|| 1e3 * (squares / rows as f64).sqrt());
        let seen = |e: &Errors| Some(100.0 * e.coverage());
        Ok([seen(&first), first.psnr(), rms_offset, seen(&second), second.psnr()].map(Cell::from).into())
    }
}
