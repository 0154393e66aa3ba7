//! Functionals for methods that leave a path out of their gradient on purpose: they leave it out as well.

use gs_core::{Splats, rot};
use gs_raster::reference::Scene;
use gs_train::conformance::gradients::View;
use gs_train::model::Model;

/// Which path has no gradient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StopGradient {
    /// None.
    None,
    /// The field is read at the centres.
    Centres,
    /// The field is read at the centres, and dynamics at the splats of the field.
    Dynamics,
}

/// The state that paths without gradient are frozen at.
pub struct Frozen {
    stop: StopGradient,
    rendered: Splats,
    field: Splats,
    centres: Vec<f32>,
}

impl Frozen {
    pub fn new(stop: StopGradient, view: &View, model: &mut Model) -> Self {
        let rendered = view.splats(model).expect("step");
        Self { stop, rendered, field: field(view, model), centres: centres(model) }
    }

    /// The functional of a block.
    pub fn value(&self, view: &View, model: &mut Model, block: &str) -> f64 {
        let before_dynamics = block.starts_with("cloud.") || block.starts_with("field.");
        match self.stop {
            StopGradient::Centres | StopGradient::Dynamics if block == "cloud.means" => {
                view.value(&self.shifted(model))
            }
            StopGradient::Dynamics if before_dynamics => view.value(&self.carried(view, model)),
            _ => view.functional(model),
        }
    }

    /// The rendered splats, shifted by the displacement of the centres.
    fn shifted(&self, model: &Model) -> Scene<f64> {
        let mut scene = Scene::new(&self.rendered);
        let shifts = centres(model).into_iter().zip(&self.centres).map(|(a, b)| f64::from(a) - f64::from(*b));
        scene.means.as_flattened_mut().iter_mut().zip(shifts).for_each(|(x, shift)| *x += shift);
        scene
    }

    /// The splats of the field, with the displacement and the turn of the dynamics as they were.
    fn carried(&self, view: &View, model: &Model) -> Scene<f64> {
        let [mut scene, rendered, frozen] = [&field(view, model), &self.rendered, &self.field].map(Scene::<f64>::new);
        for i in 0..scene.means.len() {
            for c in 0..3 {
                scene.means[i][c] += rendered.means[i][c] - frozen.means[i][c];
            }
            let [w, x, y, z] = frozen.quats[i];
            let square: f64 = frozen.quats[i].iter().map(|v| v * v).sum();
            let turn = rot::hamilton(rendered.quats[i], [w, -x, -y, -z].map(|v| v / square));
            scene.quats[i] = rot::hamilton(turn, scene.quats[i]);
        }
        scene
    }
}

/// The splats before dynamics, where there are any.
fn field(view: &View, model: &Model) -> Splats {
    let stages = model.stages(view.at(), view.camera()).expect("stages");
    stages.into_iter().find(|s| s.name == "field").map_or(Splats::default(), |s| s.splats)
}

fn centres(model: &Model) -> Vec<f32> {
    let mut centres = Vec::new();
    model.visit(&mut |p| {
        if p.name == "cloud.means" {
            centres.clone_from(&p.value);
        }
    });
    centres
}
