//! The splats behind a pixel. Their blending weights are the derivatives of the pixel by their colours, computed by the
//! backward pass of the rasteriser.

use crate::shot::Shot;
use gs_core::{Color, cast};
use gs_raster::{FrameGrad, Workspace, render, render_backward};
use serde_json::{Value, json};

/// Most splats listed.
const MAX_SPLATS: usize = 8;
/// Points of a path over normalised time 0..1.
const PATH_POINTS: usize = 33;

/// The splats behind the pixel at `at` (shares of width and height), by descending weight, with their properties and paths.
///
/// # Errors
/// As [`Shot::all_splats`].
pub(crate) fn pick(shot: &Shot, at: [f32; 2]) -> Result<Value, String> {
    let camera = &shot.camera;
    let place = |share: f32, side: u32| cast::to_usize(f64::from(share) * f64::from(side)).min(side as usize - 1);
    let pixel = [place(at[0], camera.width), place(at[1], camera.height)];
    let index = pixel[1] * camera.width as usize + pixel[0];
    let splats = shot.all_splats()?;
    let mut grey = shot.style.of(splats.clone().into_owned(), camera);
    grey.color = Color::Rgb(vec![[0.5; 3]; splats.len()]);
    let mut workspace = Workspace::new();
    // The whole image: a camera of one pixel would have another frustum, and splats at its rim another shape.
    let frame = render(&grey, camera, &shot.options(), &mut workspace);
    let mut d = FrameGrad { rgb: vec![0.0; frame.rgb.data.len()], ..FrameGrad::default() };
    d.rgb[3 * index] = 1.0;
    let (grad, _) = render_backward(&grey, camera, &shot.options(), &mut workspace, &d);
    let weights: Vec<f32> = grad.color.chunks_exact(3).map(|c| c[0]).collect();
    let mut order: Vec<usize> = (0..splats.len()).filter(|&i| weights[i] > 0.0).collect();
    order.sort_by(|&a, &b| weights[b].total_cmp(&weights[a]).then(a.cmp(&b)));
    order.truncate(MAX_SPLATS);
    let paths = paths(shot, &order)?;
    let quantities = shot.scene.quantities(shot.time)?;
    let about = |(k, &i): (usize, &usize)| {
        let of: serde_json::Map<String, Value> = quantities
            .iter()
            .filter_map(|q| Some((format!("{} {}", q.name, q.unit).trim().to_owned(), json!(q.values.get(i)?))))
            .collect();
        json!({
            "splat": i, "weight": weights[i], "mean": splats.means[i].to_array(), "scale": splats.scales[i].to_array(),
            "opacity": splats.opacities[i], "quantities": of, "path": paths[k],
        })
    };
    let found: Vec<Value> = order.iter().enumerate().map(about).collect();
    Ok(json!({"alpha": frame.alpha.get(index), "splats": found, "pixel": pixel}))
}

/// Means of some splats at times from 0 to 1, `[splats, PATH_POINTS, 3]`; one point each for a static scene.
fn paths(shot: &Shot, of: &[usize]) -> Result<Vec<Vec<[f32; 3]>>, String> {
    let n = if shot.show.moving() && !of.is_empty() { PATH_POINTS } else { 1 };
    let mut paths = vec![Vec::with_capacity(n); of.len()];
    for k in 0..n {
        let splats = shot.all_splats_at(k as f32 / (n.max(2) - 1) as f32)?;
        for (path, &i) in paths.iter_mut().zip(of) {
            path.extend(splats.means.get(i).map(|m| m.to_array()));
        }
    }
    Ok(paths)
}
