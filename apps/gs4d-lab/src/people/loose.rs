//! Loose clothing: a surface that moves by itself, which no pose states.

use super::learning::SINGLE_UNPROJECTION;
use super::region::{self, Region};
use super::subject::Errors;
use super::trained::deformed;
use super::{Cell, Findings, LabError, Log, Setup, Subject, Trained};
use gs_data::Dataset;
use gs_data::avatar::AvatarScene;
use gs_method_texel::Dut;
use gs_texel::texels::TexelTable;
use gs_texel::unproject::UnprojectConfig;
use std::sync::Arc;

/// Vertices that move by more than this beyond the pose, metres, are clothing.
const LEAST: f32 = 0.005;

/// What the method knows of the surface: name, settings, and whether poses state the motion of the clothing.
const GEOMETRIES: [(&str, &[&str], Knows); 4] = [
    ("template, no geometry stage", SINGLE_UNPROJECTION, Knows::Template),
    ("GeoNet, first texture", &["input=\"first\""], Knows::Offsets { retextured: false }),
    ("GeoNet, second texture", &["input=\"double\""], Knows::Offsets { retextured: true }),
    ("true surface, no geometry stage", SINGLE_UNPROJECTION, Knows::Truth),
];

/// Where a row's surface comes from.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Knows {
    Template,
    /// GeoNet's; with the texture unprojected on it again, or not.
    Offsets {
        retextured: bool,
    },
    Truth,
}

/// Scores without offsets, with offsets under either texture, and on the true surface.
pub(super) fn loose(setup: &Setup, log: &mut Log<'_>) -> Result<Findings, LabError> {
    let plain = Subject::new(setup, log)?;
    let stated = Subject::of(stated(&plain.full_film), setup.frames)?;
    let clothing = Region::of(&plain, &moving(&plain));
    if clothing.is_empty() {
        return Err(LabError::Unfit("nothing of this film moves that its poses do not state".into()));
    }
    let table = plain.table(setup.texels)?;
    let films = [clothing.scored(&plain)?, clothing.scored(&stated)?];
    let whole = Trained::of(setup, &plain.full_film, log)?;
    let finds_offsets = whole.as_ref().is_some_and(|t| setup.run.is_none() || t.has_geonet());
    if whole.is_some() && !finds_offsets {
        log("this run has no GeoNet: its rows are left out");
    }
    let heads = [("geometry", 0), ("offset error %", 1), ("along normals %", 1), ("seen %", 1), ("texture dB", 2)];
    let remark = "Offsets: RMS error over RMS length of the true ones, all vertices and evaluated frames. Texture: unprojected on the \
                  posed template, the second one on GeoNet's surface, against the template's own colour, texels of the clothing. Region: pixels of test views that show it. \
                  True surface: the poses state the clothing's motion.";
    let mut out = Findings::new("loose", remark, &[&heads[..], &region::SCORES].concat());
    for (name, settings, knows) in GEOMETRIES {
        let offsets = matches!(knows, Knows::Offsets { .. });
        if offsets && !finds_offsets {
            continue;
        }
        let settings = if whole.as_ref().is_some_and(|t| settings == [t.input()]) { &[][..] } else { settings };
        log(name);
        let (subject, film) = if knows == Knows::Truth { (&stated, &films[1]) } else { (&plain, &films[0]) };
        let varied = Trained::varied(setup, &subject.full_film, settings, log)?;
        let (trained, changes) =
            (varied.as_ref().or(whole.as_ref()), if varied.is_some() { &[][..] } else { settings });
        let report = trained.map(|t| t.scores(film, changes)).transpose()?;
        let dut = trained.filter(|_| offsets).map(|t| t.on(film, changes)).transpose()?;
        let off = match (&dut, knows) {
            (Some(dut), _) => dut.offset_errors()?.ratio,
            (None, Knows::Truth) => [0.0; 2],
            (None, _) => [1.0; 2],
        };
        let on = dut.as_ref().filter(|_| knows == Knows::Offsets { retextured: true });
        let errors = textured(subject, on, &table, &clothing)?;
        let mut row: Vec<Cell> = vec![name.into()];
        row.extend(off.map(|v| Cell::from(100.0 * v)));
        row.extend([Some(100.0 * errors.coverage()), errors.psnr()].map(Cell::from));
        row.extend(region::scores(report.as_ref()).map(Cell::from));
        out.rows.push(row);
    }
    Ok(out)
}

/// A film whose poses state the motion that its images show.
fn stated(film: &Dataset) -> Dataset {
    let state = |scene: &Arc<AvatarScene>| {
        let mut scene = AvatarScene::clone(scene);
        for frame in &mut scene.frames {
            frame.pose.morphs = frame.true_morphs.clone().unwrap_or_else(|| frame.pose.morphs.clone());
        }
        Arc::new(scene)
    };
    Dataset { avatar: film.avatar.as_ref().map(state), ..film.clone() }
}

/// Whether each vertex moves by itself in some frame of the film.
fn moving(subject: &Subject) -> Vec<bool> {
    let mut moves = vec![false; subject.scene.character.template.vertices.len()];
    let frames = subject.full_film.avatar.iter().flat_map(|scene| &scene.frames);
    for offsets in frames.filter_map(|frame| subject.scene.true_offsets(frame)) {
        moves.iter_mut().zip(offsets).for_each(|(moves, d)| *moves |= d.length() > LEAST);
    }
    moves
}

/// The texture of a region on the posed template, or on the surface that the method has found.
fn textured(subject: &Subject, dut: Option<&Dut>, table: &TexelTable, of: &Region) -> Result<Errors, LabError> {
    let (truth, within, mut errors) = (subject.truth(table), of.texels(table), Errors::default());
    for frame in &subject.scene.frames {
        let surface = match dut {
            Some(dut) => deformed(dut, frame)?,
            None => subject.scene.posed(frame),
        };
        let images = subject.images(&frame.inputs)?;
        let (texture, ms) = subject.texture(&surface, &images, table, &UnprojectConfig::default())?;
        errors.add_within(&texture, &truth, &within, ms);
    }
    Ok(errors)
}
