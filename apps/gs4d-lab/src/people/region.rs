//! A part of the template's surface: its texels, and the pixels of test views that show it.

use super::LabError;
use super::Subject;
use gs_data::{Dataset, ImageSource, ImageU8, View};
use gs_texel::surface::NONE;
use gs_texel::texels::TexelTable;
use gs_texel::zbuffer::face_map;
use gs_train::evaluate::EvalReport;
use std::sync::Arc;

/// Near plane, metres.
const NEAR: f64 = 0.05;

/// Heading and digits of the columns of [`scores`].
pub(super) const SCORES: [(&str, usize); 3] = [("PSNR", 2), ("region PSNR", 2), ("region SSIM", 4)];

/// Scores of the test views of [`Region::scored`]: of the whole images, then of the pixels that show the region.
pub(super) fn scores(report: Option<&EvalReport>) -> [Option<f64>; 3] {
    let mean = report.map(|r| r.mean);
    let region = mean.and_then(|m| m.masked);
    [mean.and_then(|m| m.psnr), region.and_then(|m| m.psnr), region.and_then(|m| m.ssim_seen)]
}

/// Some faces of the template.
pub(super) struct Region {
    faces: Vec<bool>,
}

impl Region {
    /// The faces of which a vertex is among `vertices`, one value per template vertex.
    pub(super) fn of(subject: &Subject, vertices: &[bool]) -> Self {
        let faces = &subject.scene.character.template.faces;
        Self { faces: faces.iter().map(|f| f.iter().any(|&v| vertices[v as usize])).collect() }
    }

    /// Whether there is no face.
    pub(super) fn is_empty(&self) -> bool {
        !self.faces.contains(&true)
    }

    /// Whether each texel of a table lies in the region.
    pub(super) fn texels(&self, table: &TexelTable) -> Vec<bool> {
        table.tri.iter().map(|&f| self.faces[f as usize]).collect()
    }

    /// The evaluated data, in whose test views those pixels count that show the region of the true surface. Images are as the pinhole
    /// camera has them, since the region is drawn in it.
    ///
    /// # Errors
    /// If an image cannot be read.
    pub(super) fn scored(&self, subject: &Subject) -> Result<Dataset, LabError> {
        let mut film = subject.film.clone();
        let faces = &subject.scene.character.template.faces;
        for view in &mut film.test {
            let surface = subject.scene.true_surface(subject.scene.frame_at(view.time));
            let nearest = face_map(&surface, faces, &view.camera, NEAR);
            let counts = |f: u32| f != NONE && self.faces[f as usize];
            let data = nearest.iter().flat_map(|&f| [if counts(f) { 255 } else { 0 }; 4]).collect();
            let [width, height] = [view.camera.width, view.camera.height].map(|side| side as usize);
            let mask = Some(ImageSource::Memory(Arc::new(ImageU8 { width, height, data })));
            let image = ImageSource::Memory(subject.image(view)?);
            *view =
                View { mask, ..View::new(view.name.clone(), view.camera.clone(), view.time, image, view.camera_id) };
        }
        Ok(film)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::people::Setup;
    use gs_data::{ImageCache, Lens};
    use gs_synth::avatar::AvatarOptions;

    #[test]
    fn a_region_is_that_of_the_pinhole_image_whatever_the_lens() {
        let film = AvatarOptions { per_ring: 4, frames: 4, size: 64, points: 200, ..Setup::default().film };
        let plain = Subject::new(&Setup { film, ..Setup::default() }, &mut |_| ()).unwrap();
        let mut bent = plain.full_film.clone();
        bent.test.iter_mut().for_each(|view| view.lens = Some(Lens { k1: 0.2, ..Lens::default() }));
        let bent = Subject::of(bent, Setup::default().frames).unwrap();
        let vertices = plain.scene.character.template.vertices.iter().map(|v| v.y > 1.0).collect::<Vec<_>>();
        let region = Region::of(&plain, &vertices);
        let masks = [&plain, &bent].map(|subject| {
            let film = region.scored(subject).unwrap();
            let cache = ImageCache::new(0, 1.0);
            film.test.iter().map(|view| cache.mask(view).unwrap().unwrap().data.clone()).collect::<Vec<_>>()
        });
        assert!(masks[0].iter().flatten().any(|w| *w == 1.0) && masks[0].iter().flatten().any(|w| *w == 0.0));
        assert_eq!(masks[0], masks[1]);
    }
}
