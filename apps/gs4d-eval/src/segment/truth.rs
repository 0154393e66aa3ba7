//! Ground-truth labels of views.

use std::path::{Path, PathBuf};

use gs_core::io::{Limits, npy, read_file};
use gs_core::{Camera, cast};

use super::SegmentError;
use gs_data::{DataError, View, mask};
use gs_synth::Truth;
use gs_train::renderer::file_stem;

/// The source of ground-truth labels. Ids are any whole numbers; 0 is the background.
#[derive(Clone, Debug)]
pub enum TrueLabels {
    /// The bodies of a generated scene: body `k` of its list is `k + 1`.
    Scene(Box<Truth>),
    /// A folder of label images `NAME.png` or `NAME.npy`, `NAME` being that of the view, in the folder itself or in one named
    /// after the split.
    Folder(PathBuf),
    /// The label images listed in the data set ([`View::labels`]).
    Views,
}

impl TrueLabels {
    /// A description of the source.
    pub fn source(&self) -> String {
        match self {
            Self::Scene(truth) => format!("bodies of the generated scene \"{}\"", truth.scene()),
            Self::Folder(folder) => format!("label images in {}", folder.display()),
            Self::Views => "label images of the data set".to_owned(),
        }
    }

    /// The labels of a view at the pixels of `camera`, row by row; `None` if the source has none for it.
    ///
    /// # Errors
    /// If a file cannot be read, is no label image, or has another shape than the view.
    pub fn of(&self, view: &View, split: &str, camera: &Camera) -> Result<Option<Vec<u32>>, SegmentError> {
        let file = match self {
            Self::Scene(truth) => {
                let ids = truth.segments(camera, view.time.seconds);
                return Ok(Some(ids.into_iter().map(|id| id.map_or(0, |id| id + 1)).collect()));
            }
            Self::Folder(folder) => {
                let stem = file_stem(&view.name);
                let places = [folder.join(split), folder.clone()];
                let files = places.iter().flat_map(|p| ["png", "npy"].map(|e| p.join(format!("{stem}.{e}"))));
                match files.into_iter().find(|f| f.is_file()) {
                    Some(file) => file,
                    None => return Ok(None),
                }
            }
            Self::Views => match &view.labels {
                Some(file) => file.clone(),
                None => return Ok(None),
            },
        };
        let wrong = |why: String| SegmentError::Labels { view: view.name.clone(), why };
        let ([width, height], ids) = if file.extension().is_some_and(|e| e.eq_ignore_ascii_case("npy")) {
            of_npy(&file).map_err(|e| e.unwrap_or_else(|why| wrong(format!("{}: {why}", file.display()))))?
        } else {
            of_png(&file)?
        };
        let got = [width, height].map(|side| u32::try_from(side).unwrap_or(u32::MAX));
        mask::check_shape(&file, got, [view.camera.width, view.camera.height])?;
        let pixels = mask::nearest([width, height], view, camera);
        Ok(Some(pixels.map(|at| at.map_or(0, |[x, y]| ids[y * width + x])).collect()))
    }
}

type LabelImage = ([usize; 2], Vec<u32>);

/// Reads whole numbers `[H, W]` or `[H, W, 1]`; negative ones are the background.
fn of_npy(file: &Path) -> Result<LabelImage, Result<SegmentError, String>> {
    let bytes = read_file(file, &Limits::default()).map_err(|e| Ok(e.into()))?;
    let array = npy::read(&bytes, &file.display().to_string(), &Limits::default()).map_err(|e| Ok(e.into()))?;
    let (height, width) = match array.shape[..] {
        [h, w] | [h, w, 1] => (h, w),
        ref other => return Err(Err(format!("shape {other:?} is not [H, W]"))),
    };
    let id = |v: f64| {
        if v.fract() == 0.0 && v <= f64::from(u32::MAX) { Ok(cast::to_u32(cast::to_usize(v))) } else { Err(v) }
    };
    let ids: Result<Vec<u32>, f64> = array.to_f64().into_iter().map(id).collect();
    Ok(([width, height], ids.map_err(|v| Err(format!("{v} is no label; labels are whole numbers")))?))
}

/// Reads grey pixels as their value (8 or 16 bits); of colour images each colour is a label.
fn of_png(file: &Path) -> Result<LabelImage, SegmentError> {
    use image::{DynamicImage, GenericImageView};
    let bytes = read_file(file, &Limits::default())?;
    let image = image::load_from_memory(&bytes).map_err(|e| DataError::decode(file, e))?;
    let (width, height) = image.dimensions();
    let ids = match &image {
        DynamicImage::ImageLuma8(grey) => grey.pixels().map(|p| p.0[0].into()).collect(),
        DynamicImage::ImageLuma16(grey) => grey.pixels().map(|p| p.0[0].into()).collect(),
        other => other.to_rgb8().pixels().map(|p| u32::from_be_bytes([0, p.0[0], p.0[1], p.0[2]])).collect(),
    };
    Ok(([width as usize, height as usize], ids))
}
