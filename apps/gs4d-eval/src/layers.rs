//! Layers: colours per splat that are drawn in place of the scene's own. Rigid parts where the scene moves, and the scalars and
//! overlays of the method ([`Inspect`](gs_train::capabilities::Inspect)).

use crate::segment::{self, Labels, Options, SegmentError, segment};
use gs_core::{Camera, Color, Splats};
use gs_raster::{Frame, RasterOptions, Workspace, blend_counts, render_into};
use gs_train::capabilities::{Overlay, Quantity};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::timestamp::Timestamp;

/// Name of the layer of rigid parts.
pub const PARTS: &str = "segment";

/// A layer that cannot be drawn.
#[derive(Debug, thiserror::Error)]
pub enum LayerError {
    /// The model cannot compute its splats or their attributes.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// The layer does not have one colour for each splat.
    #[error("layer `{name}` has {colors} colours for {splats} splats")]
    Rows {
        /// Name of the layer.
        name: String,
        /// Number of its colours.
        colors: usize,
        /// Number of splats.
        splats: usize,
    },
}

/// Names of the layers of a model at a timestamp; `moving`: whether it was trained on more than one timestamp.
pub fn names(method: &Model, moving: bool, at: &Timestamp) -> Vec<&'static str> {
    let overlays = method.overlays(at).unwrap_or_default();
    moving.then_some(PARTS).into_iter().chain(overlays.into_iter().map(|o| o.name)).collect()
}

/// A scalar or overlay of a method: its colours, and its values where it is a scalar.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Name, colours and their meaning.
    pub overlay: Overlay,
    /// The values that the colours stand for; `None` for an overlay that shows none.
    pub quantity: Option<Quantity>,
}

/// All scalars and overlays of a model at a timestamp, each once, in the order of [`names`].
///
/// # Errors
/// As [`Model::overlays`].
pub fn all(method: &Model, at: &Timestamp) -> Result<Vec<Layer>, MethodError> {
    let mut quantities = method.quantities(at)?;
    let layer = |overlay: Overlay| {
        let of = quantities.iter().position(|q| q.name == overlay.name);
        Layer { quantity: of.map(|k| quantities.swap_remove(k)), overlay }
    };
    Ok(method.overlays(at)?.into_iter().map(layer).collect())
}

/// A scalar or overlay by its name; `None` if the model has no such layer.
///
/// # Errors
/// As [`Model::overlays`].
pub fn find(method: &Model, name: &str, at: &Timestamp) -> Result<Option<Layer>, MethodError> {
    Ok(all(method, at)?.into_iter().find(|l| l.overlay.name == name))
}

/// The rigid parts by the motion up to `observed`, the last training time, normalised.
///
/// # Errors
/// As [`segment`](segment::segment).
pub fn parts(method: &Model, observed: f32) -> Result<Labels, SegmentError> {
    segment(method, &Options { observed, ..Options::default() })
}

/// A colour per splat for its part.
pub fn part_colors(parts: &Labels) -> Vec<[f32; 3]> {
    parts.of.iter().map(|part| segment::color(part + 1)).collect()
}

/// Splats in the colours of a layer.
///
/// # Errors
/// [`LayerError::Rows`] if there is not one colour for each splat.
pub fn painted(splats: Splats, name: &str, colors: Vec<[f32; 3]>) -> Result<Splats, LayerError> {
    if colors.len() != splats.len() {
        return Err(LayerError::Rows { name: name.to_owned(), colors: colors.len(), splats: splats.len() });
    }
    Ok(Splats { color: Color::Rgb(colors), ..splats })
}

/// Number of splats that are blended into each pixel, `[height, width]`, counted on the CPU.
pub fn counts(splats: &Splats, camera: &Camera, options: &RasterOptions) -> Vec<f32> {
    let (mut workspace, mut frame) = (Workspace::new(), Frame::default());
    render_into(splats, camera, options, &mut workspace, &mut frame);
    blend_counts(splats, options, &mut workspace).into_iter().map(|c| c as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_synth::{self as synth, SynthOptions};
    use gs_train::registry::section;
    use gs_train::scene::SceneInfo;
    use std::collections::BTreeSet;

    fn model(name: &str) -> Model {
        let options = SynthOptions { size: 32, train_views: 6, test_views: 1, ..SynthOptions::default() };
        let data = synth::generate("sheet", &options).unwrap().dataset;
        let entry = gs_methods::registry().find(name).unwrap();
        let config = entry.config("tiny").unwrap();
        let scene = SceneInfo::of(&data, &section(entry.name, &config, "init").unwrap(), 3).unwrap();
        let mut model = entry.model(&config, &scene).unwrap();
        model.begin_step(100_000);
        model
    }

    #[test]
    fn every_layer_is_there_once_and_has_a_colour_for_each_splat() {
        let at = Timestamp::normalised(0.5);
        let camera = gs4d_report::needs::neutral_camera();
        for (name, of_values, of_words) in
            [("fags", "gate", "motion"), ("trace", "speed", "velocity"), ("modec", "local", "anchor")]
        {
            let model = model(name);
            let listed = names(&model, true, &at);
            assert_eq!(listed.iter().collect::<BTreeSet<_>>().len(), listed.len(), "{name}: {listed:?}");
            assert_eq!((listed[0], names(&model, false, &at).as_slice()), (PARTS, &listed[1..]));
            let splats = model.all_splats(&at, &camera).unwrap();
            for layer in &listed[1..] {
                let found = find(&model, layer, &at).unwrap().unwrap();
                let painted = painted(splats.clone(), layer, found.overlay.colors.clone()).unwrap();
                assert_eq!(painted.color, Color::Rgb(found.overlay.colors), "{name} {layer}");
            }
            assert!(find(&model, of_values, &at).unwrap().unwrap().quantity.is_some_and(|q| q.name == of_values));
            assert!(find(&model, of_words, &at).unwrap().unwrap().quantity.is_none());
            assert_eq!(find(&model, "no such layer", &at).unwrap(), None);
            assert!(painted(splats, "short", vec![[0.0; 3]]).is_err());
        }
        assert!(names(&model("static3d"), false, &at).is_empty());
    }
}
