//! A question to pixels.

use crate::question::{Look, Question};
use crate::stage::{Show, Stage};
use gs_core::io::images::write_png8;
use gs_core::{Camera, Color, Image, Splats};
use gs_metrics::psnr;
use gs_raster::{Frame, RasterOptions, Workspace, render_into};
use gs_train::evaluate::clamped;
use serde_json::{Value, json};
use std::time::Instant;

/// Bars of a legend's histogram.
const BARS: usize = 24;
/// Depths are shown between these shares of the covered pixels.
const DEPTH_SHARES: [f64; 2] = [0.02, 0.98];

/// How pictures are packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packing {
    /// Lossless: for this machine.
    Png,
    /// A tenth of the bytes: for a far one.
    Jpeg,
}

/// A picture with what is to be said about it.
pub struct Answer {
    /// Size, milliseconds, legend, PSNR, why it is blank, what was picked.
    pub header: Value,
    /// A PNG or JPEG file.
    pub image: Vec<u8>,
}

/// Draws, with memory kept from picture to picture.
#[derive(Default)]
pub struct Painter {
    workspace: Workspace,
    frame: Frame,
}

impl Painter {
    /// Answers a question.
    ///
    /// # Errors
    /// In words for the page: a show, view or layer there is not, a photograph that cannot be read.
    pub fn answer(&mut self, stage: &Stage, question: &Question, packing: Packing) -> Result<Answer, String> {
        let begun = Instant::now();
        let show = stage.shows.get(question.show).ok_or("there is no such show")?;
        let camera = camera(show, question)?;
        let mut header = json!({"id": question.id, "layer": question.layer});
        let image = self.layer(show, question, &camera, &mut header)?;
        header["width"] = json!(image.width);
        header["height"] = json!(image.height);
        if let Some(at) = question.pick {
            header["picked"] = crate::pick::pick(show, question.time, &camera, at);
        }
        header["ms"] = json!(begun.elapsed().as_secs_f64() * 1e3);
        Ok(Answer { image: pack(&image, packing)?, header })
    }

    fn layer(&mut self, show: &Show, q: &Question, camera: &Camera, header: &mut Value) -> Result<Image, String> {
        match q.layer.as_str() {
            "truth" => truth(show, q, camera),
            "color" => {
                let splats = show.at(q.time, camera);
                let image = clamped(self.draw(&splats, camera, show.options()));
                header["splats"] = json!(splats.len());
                if let Some(why) = self.blank(&splats, camera) {
                    header["blank"] = json!(why);
                }
                if let (Look::View(_), true) = (&q.look, show.photographs().is_some()) {
                    let photo = truth(show, q, camera)?;
                    header["psnr"] = json!(psnr(&image, &photo).ok().filter(|v| v.is_finite()));
                }
                Ok(image)
            }
            "alpha" => {
                self.draw(&show.at(q.time, camera), camera, show.options());
                header["legend"] = legend("alpha", "", [0.0, 1.0], &self.frame.alpha);
                let grey = self.frame.alpha.iter().flat_map(|&a| [a; 3]).collect();
                Ok(self.image(grey))
            }
            "depth" => {
                self.draw(&show.at(q.time, camera), camera, show.options());
                Ok(self.depth(header))
            }
            name => self.quantity(show, q, camera, name, header),
        }
    }

    fn draw(&mut self, splats: &Splats, camera: &Camera, options: &RasterOptions) -> &Frame {
        render_into(splats, camera, options, &mut self.workspace, &mut self.frame);
        &self.frame
    }

    fn image(&self, data: Vec<f32>) -> Image {
        Image { width: self.frame.width, height: self.frame.height, channels: 3, data }
    }

    /// Mean depth of what covers a pixel, in turning hues that stay apart for all eyes: dark near, bright far.
    fn depth(&self, header: &mut Value) -> Image {
        let frame = &self.frame;
        let mean = |(&d, &a): (&f32, &f32)| if a > 0.5 { d / a } else { f32::NAN };
        let depths: Vec<f32> = frame.depth.iter().zip(&frame.alpha).map(mean).collect();
        let mut known: Vec<f32> = depths.iter().copied().filter(|d| d.is_finite()).collect();
        known.sort_by(f32::total_cmp);
        let at = |share: f64| known.get((known.len().saturating_sub(1) as f64 * share) as usize).copied();
        let span = [at(DEPTH_SHARES[0]).unwrap_or(0.0), at(DEPTH_SHARES[1]).unwrap_or(1.0)];
        header["legend"] = legend("depth", "world units", span, &known);
        let color =
            |d: &f32| if d.is_finite() { scale((d - span[0]) / (span[1] - span[0]).max(1e-9)) } else { [0.0; 3] };
        self.image(depths.iter().flat_map(color).collect())
    }

    /// A quantity of the method as the splats' colour.
    fn quantity(
        &mut self,
        show: &Show,
        q: &Question,
        camera: &Camera,
        name: &str,
        header: &mut Value,
    ) -> Result<Image, String> {
        let method = show.method().ok_or("a splat file has no such layer")?;
        let all = method.quantities(&gs_train::run::picture::moment(q.time));
        let quantity = all.iter().find(|quantity| quantity.name == name).ok_or("there is no such layer")?;
        let mut splats = show.tracked(q.time, camera);
        let span = quantity.span();
        if quantity.values.len() != splats.len() {
            return Err(format!("`{name}` has {} values for {} splats", quantity.values.len(), splats.len()));
        }
        let color = |v: &f32| scale((v - span[0]) / (span[1] - span[0]));
        splats.color = Color::Rgb(quantity.values.iter().map(color).collect());
        header["legend"] = legend(name, quantity.unit, span, &quantity.values);
        Ok(clamped(self.draw(&splats, camera, show.options())))
    }

    /// Why nothing is to be seen, if nothing is.
    fn blank(&self, splats: &Splats, camera: &Camera) -> Option<String> {
        if self.frame.alpha.iter().any(|&a| a > 0.0) {
            return None;
        }
        let count = |test: &dyn Fn(usize) -> bool| (0..splats.len()).filter(|&i| test(i)).count();
        let faint = count(&|i| splats.opacities[i] < 1.0 / 255.0);
        let behind = count(&|i| camera.to_camera(splats.means[i].as_dvec3()).z <= 0.0);
        Some(format!(
            "nothing in sight: of {} splats {faint} are invisible at this time, {behind} lie behind the camera, the others \
             outside its picture",
            splats.len()
        ))
    }
}

/// The camera of a question, of the size it asks for; a view of the data keeps its ratio.
fn camera(show: &Show, question: &Question) -> Result<Camera, String> {
    if let Some(camera) = question.free_camera()? {
        return Ok(camera);
    }
    let Look::View(number) = question.look else { return Err("no look".into()) };
    let view = show.views.get(number).ok_or("there is no such view")?;
    let c = &view.camera;
    let factor = (f64::from(question.width) / f64::from(c.width)).min(f64::from(question.height) / f64::from(c.height));
    Ok(if factor < 1.0 { c.scaled(factor) } else { c.clone() })
}

/// The photograph of a view over the show's background, of the camera's size.
fn truth(show: &Show, question: &Question, camera: &Camera) -> Result<Image, String> {
    let Look::View(number) = question.look else {
        return Err("a photograph is seen from its own camera: choose a view".into());
    };
    let view = show.views.get(number).ok_or("there is no such view")?;
    let photographs = show.photographs().ok_or("there are no photographs")?;
    let image = photographs.get(view).map_err(|e| e.to_string())?;
    Ok(image.box_downscaled(camera.width as usize, camera.height as usize).over(show.background()))
}

/// A scale from dark blue over teal to pale yellow whose lightness grows evenly, for all eyes.
fn scale(x: f32) -> [f32; 3] {
    const STOPS: [[f32; 3]; 5] =
        [[0.05, 0.03, 0.30], [0.10, 0.25, 0.55], [0.10, 0.50, 0.53], [0.45, 0.74, 0.35], [0.99, 0.93, 0.55]];
    let at = if x.is_finite() { x.clamp(0.0, 1.0) * 4.0 } else { 0.0 };
    let k = (at as usize).min(3);
    std::array::from_fn(|c| STOPS[k][c] + (STOPS[k + 1][c] - STOPS[k][c]) * (at - k as f32))
}

/// Name, unit, range and histogram of what colours mean.
fn legend(name: &str, unit: &str, span: [f32; 2], values: &[f32]) -> Value {
    let mut bars = [0u32; BARS];
    for v in values.iter().filter(|v| v.is_finite()) {
        let at = (v - span[0]) / (span[1] - span[0]).max(1e-12) * BARS as f32;
        bars[(at.max(0.0) as usize).min(BARS - 1)] += 1;
    }
    let colors: Vec<String> = (0..BARS)
        .map(|k| {
            let rgb =
                if name == "alpha" { [k as f32 / (BARS - 1) as f32; 3] } else { scale(k as f32 / (BARS - 1) as f32) };
            let [r, g, b] = rgb.map(|v| (v * 255.0).round() as u8);
            format!("#{r:02x}{g:02x}{b:02x}")
        })
        .collect();
    json!({"name": name, "unit": unit, "low": span[0], "high": span[1], "bars": bars, "colors": colors})
}

fn pack(image: &Image, packing: Packing) -> Result<Vec<u8>, String> {
    let bytes: Vec<u8> = image.data.iter().map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8).collect();
    let mut out = Vec::new();
    let (width, height) = (image.width, image.height);
    match packing {
        Packing::Png => {
            write_png8(width, height, 3, &bytes, &mut out).map_err(|e| e.to_string())?;
            Ok(out)
        }
        Packing::Jpeg => {
            let side = |n: usize| u16::try_from(n).map_err(|_| "a picture is too wide".to_owned());
            let encoder = jpeg_encoder::Encoder::new(&mut out, 80);
            let written = encoder.encode(&bytes, side(width)?, side(height)?, jpeg_encoder::ColorType::Rgb);
            written.map_err(|e| e.to_string()).map(|()| out)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_grows_lighter() {
        let light = |x: f32| scale(x).iter().zip([0.2126, 0.7152, 0.0722]).map(|(c, w)| c * w).sum::<f32>();
        assert!((0..20).all(|k| light((k + 1) as f32 / 20.0) > light(k as f32 / 20.0)));
        assert_eq!(scale(f32::NAN), scale(0.0));
    }
}
