//! Answers questions: renders the layer, adds legends and scores, encodes the image.

use crate::arrows::arrows;
use crate::choice;
use crate::legend::{grey, named, scaled};
use crate::packing::{Packing, pack};
use crate::pick::pick;
use crate::pose::inputs;
use crate::question::{Look, MAX_PIXELS, Question, Target};
use crate::shot::{MIN_OPACITY, SelectionCache, Shot};
use crate::stage::{Show, Stage};
use gs_core::{Camera, Color, Image, Splats, cast};
use gs_metrics::psnr;
use gs_raster::{Frame, RasterOptions, Workspace, blend_counts, render_into};
use gs_train::evaluate::clamped;
use gs_train::palette::color_scale;
use gs_train::timestamp::Timestamp;
use gs4d_eval::segment;
use serde_json::{Value, json};
use std::borrow::Cow;
use std::time::Instant;

/// Quantiles of the depths of covered pixels that bound the colour scale.
const DEPTH_QUANTILES: [f64; 2] = [0.02, 0.98];

/// An image or a file, with a header for the page.
pub struct Answer {
    /// JSON: size, milliseconds, legend, PSNR, reason of a blank image, picked splats, or the name of a file.
    pub header: Value,
    /// A PNG, JPEG or PLY file.
    pub bytes: Vec<u8>,
}

/// Renders layers; buffers are reused between images.
#[derive(Default)]
pub struct Renderer {
    workspace: Workspace,
    frame: Frame,
    selections: SelectionCache,
}

impl Renderer {
    /// Answers a question.
    ///
    /// # Errors
    /// A message for the page: no such show, view or layer, or an image that cannot be read.
    pub fn answer(&mut self, stage: &Stage, q: &Question, packing: Packing) -> Result<Answer, String> {
        let begun = Instant::now();
        let camera = q.look.camera(stage, q.width, q.height)?;
        let shot = Shot::of(stage, q, &q.what, &camera, &mut self.selections)?;
        let mut header = json!({"id": q.id, "layer": q.what.layer});
        if let Some(part) = q.save {
            let (name, bytes) = choice::file(stage, &shot, q.chosen.as_ref(), part, &mut self.selections)?;
            header["file"] = json!(name);
            return Ok(Answer { header, bytes });
        }
        let mut image = self.layer(stage, q, &q.what, &shot, &mut header)?;
        if let Some(other) = &q.against {
            let other_shot = Shot::of(stage, q, other, &camera, &mut self.selections)?;
            let subtracted = self.layer(stage, q, other, &other_shot, &mut json!({}))?;
            header["psnr"] = psnr_value(&image, &subtracted);
            header["legend"] = Value::Null;
            difference(&mut image, &subtracted, q.gain);
        }
        header["width"] = json!(image.width);
        header["height"] = json!(image.height);
        if let Some(at) = q.pick {
            header["picked"] = pick(&shot, at)?;
        }
        if let Some(choice) = &q.chosen {
            header["chosen"] = choice::describe(stage, &shot, choice, &mut self.selections)?;
        }
        if q.arrows && shot.show.moving() {
            header["arrows"] = arrows(&shot)?;
        }
        if let Some(avatar) = shot.scene.avatar() {
            header["inputs"] = inputs(avatar, q.time);
        }
        header["ms"] = json!(begun.elapsed().as_secs_f64() * 1e3);
        Ok(Answer { bytes: pack(&image, packing)?, header })
    }

    fn layer(
        &mut self,
        stage: &Stage,
        q: &Question,
        target: &Target,
        shot: &Shot,
        header: &mut Value,
    ) -> Result<Image, String> {
        // Renders are averaged from twice the resolution; dataset images keep their own.
        let fine = q.fine && target.layer != "truth" && 4 * shot.camera.width * shot.camera.height <= MAX_PIXELS;
        let shot = if fine { &shot.with_camera(shot.camera.scaled(2.0)) } else { shot };
        let image = match target.layer.as_str() {
            "truth" => return truth(stage, q, shot.show, &shot.camera),
            "color" => self.color(shot, header)?,
            "alpha" => {
                self.render(&*shot.splats()?, shot);
                header["legend"] = grey("alpha", &self.frame.alpha);
                self.image(self.frame.alpha.iter().flat_map(|&a| [a; 3]).collect())
            }
            "depth" => {
                self.render(&*shot.splats()?, shot);
                self.depth(header)
            }
            "count" => self.count(shot, header)?,
            "segment" => self.parts(shot, header)?,
            name => self.overlay(shot, name, header)?,
        };
        let image = if fine { halved(&image) } else { image };
        let has_truth = matches!(q.look, Look::View(..)) && shot.show.images().is_some();
        if target.layer == "color" && q.against.is_none() && has_truth {
            let camera = q.look.camera(stage, q.width, q.height)?;
            header["psnr"] = psnr_value(&image, &truth(stage, q, shot.show, &camera)?);
        }
        Ok(image)
    }

    fn render(&mut self, splats: &Splats, shot: &Shot) -> &Frame {
        let options: &RasterOptions = shot.show.options();
        render_into(splats, &shot.camera, options, &mut self.workspace, &mut self.frame);
        &self.frame
    }

    fn image(&self, data: Vec<f32>) -> Image {
        Image { width: self.frame.rgb.width, height: self.frame.rgb.height, channels: 3, data }
    }

    fn color(&mut self, shot: &Shot, header: &mut Value) -> Result<Image, String> {
        let (splats, error) = match shot.splats() {
            Ok(splats) => (splats, None),
            Err(why) if shot.pose.is_some() => return Err(why),
            Err(why) => (Cow::Owned(Splats::default()), Some(why)),
        };
        let image = clamped(self.render(&splats, shot));
        header["splats"] = json!(splats.len());
        if let Some(why) = error.or_else(|| self.blank(&splats, &shot.camera)) {
            header["blank"] = json!(why);
        }
        Ok(image)
    }

    /// Mean depth of pixels covered by more than half: dark near, bright far.
    fn depth(&self, header: &mut Value) -> Image {
        let frame = &self.frame;
        let mean = |(&d, &a): (&f32, &f32)| if a > 0.5 { d / a } else { f32::NAN };
        let depths: Vec<f32> = frame.depth.iter().zip(&frame.alpha).map(mean).collect();
        let mut known: Vec<f32> = depths.iter().copied().filter(|d| d.is_finite()).collect();
        known.sort_by(f32::total_cmp);
        let at = |share: f64| known.get(cast::to_usize(known.len().saturating_sub(1) as f64 * share)).copied();
        let span = [at(DEPTH_QUANTILES[0]).unwrap_or(0.0), at(DEPTH_QUANTILES[1]).unwrap_or(1.0)];
        header["legend"] = scaled("depth", "world units", span, &known);
        let share = |d: &f32| (d - span[0]) / (span[1] - span[0]).max(1e-9);
        let color = |d: &f32| if d.is_finite() { color_scale(share(d)) } else { [0.0; 3] };
        self.image(depths.iter().flat_map(color).collect())
    }

    /// Number of splats blended into each pixel.
    fn count(&mut self, shot: &Shot, header: &mut Value) -> Result<Image, String> {
        let splats = shot.splats()?;
        self.render(&splats, shot);
        let counts = blend_counts(splats.as_ref(), shot.show.options(), &mut self.workspace);
        let counts: Vec<f32> = counts.into_iter().map(|c| c as f32).collect();
        let max_count = counts.iter().copied().fold(1.0, f32::max);
        // The histogram leaves out empty pixels.
        let covered: Vec<f32> = counts.iter().copied().filter(|c| *c > 0.0).collect();
        header["legend"] = scaled("count", "splats per pixel", [0.0, max_count], &covered);
        Ok(self.image(counts.iter().flat_map(|c| color_scale(c / max_count)).collect()))
    }

    /// Rigid parts, one colour each.
    fn parts(&mut self, shot: &Shot, header: &mut Value) -> Result<Image, String> {
        let parts = shot.scene.parts(shot.show.observed())?;
        let mut splats = shot.all_splats()?.into_owned();
        let color = |part: u32| segment::color(part + 1);
        let words = format!("rigid parts: {}, bars are their splats", parts.k);
        header["legend"] = named("segment", &words, &parts.of, parts.k, color);
        splats.color = Color::Rgb(parts.of.iter().map(|part| color(*part)).collect());
        Ok(clamped(self.render(&splats, shot)))
    }

    /// A quantity or overlay of the method.
    fn overlay(&mut self, shot: &Shot, name: &str, header: &mut Value) -> Result<Image, String> {
        let quantities = shot.scene.quantities(shot.time)?;
        let overlay = match quantities.iter().find(|q| q.name == name) {
            Some(quantity) => {
                header["legend"] = scaled(name, quantity.unit, quantity.span(), &quantity.values);
                quantity.overlay()
            }
            None => {
                let method = shot.scene.as_method().ok_or("a splat file has no such layer")?;
                let overlays = method.overlays(&Timestamp::normalised(shot.time)).map_err(|e| e.to_string())?;
                let found = overlays.into_iter().find(|o| o.name == name);
                let found = found.ok_or("there is no such layer")?;
                header["note"] = json!(found.meaning);
                found
            }
        };
        let mut splats = shot.all_splats()?.into_owned();
        if overlay.colors.len() != splats.len() {
            return Err(format!("`{name}` has {} values for {} splats", overlay.colors.len(), splats.len()));
        }
        splats.color = Color::Rgb(overlay.colors);
        Ok(clamped(self.render(&splats, shot)))
    }

    /// Why the render is blank; `None` if it is not.
    fn blank(&self, splats: &Splats, camera: &Camera) -> Option<String> {
        if self.frame.alpha.iter().any(|&a| a > 0.0) {
            return None;
        }
        let count = |test: &dyn Fn(usize) -> bool| (0..splats.len()).filter(|&i| test(i)).count();
        let faint = count(&|i| splats.opacities[i] < MIN_OPACITY);
        let behind = count(&|i| camera.to_camera(splats.means[i].as_dvec3()).z <= 0.0);
        Some(format!(
            "nothing in sight: of {} splats {faint} are invisible at this time, {behind} lie behind the camera, the others \
             outside its image",
            splats.len()
        ))
    }
}

/// The ground-truth image of a view over the background of a show, at the size of `camera`.
fn truth(stage: &Stage, q: &Question, show: &Show, camera: &Camera) -> Result<Image, String> {
    let Look::View(owner, number) = q.look else {
        return Err("a ground-truth image has its own camera: choose a view".into());
    };
    let view = stage.view(owner, number)?;
    let images = stage.show(owner)?.images().ok_or("there are no images")?;
    let image = images.get(view).map_err(|e| e.to_string())?;
    Ok(image.box_downscaled(camera.width as usize, camera.height as usize).over(show.background()))
}

/// PSNR in dB; null for identical images or different sizes.
fn psnr_value(a: &Image, b: &Image) -> Value {
    json!(psnr(a, b).ok().filter(|v| v.is_finite()))
}

/// Replaces `image` by its difference to `other`, times `gain`, around grey.
fn difference(image: &mut Image, other: &Image, gain: f32) {
    image.data.iter_mut().zip(&other.data).for_each(|(a, b)| *a = (0.5 + 0.5 * gain * (*a - b)).clamp(0.0, 1.0));
}

/// Means of 2 × 2 pixels; the sides are even.
fn halved(image: &Image) -> Image {
    let (width, height, channels) = (image.width / 2, image.height / 2, image.channels);
    let mut half = Image::zeros(width, height, channels);
    for y in 0..height {
        for x in 0..width {
            for c in 0..channels {
                let at = |dx, dy| image.pixel(2 * x + dx, 2 * y + dy)[c];
                half.pixel_mut(x, y)[c] = 0.25 * (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1));
            }
        }
    }
    half
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_signed_and_means_are_of_four() {
        let grey = |v: f32| Image { width: 2, height: 2, channels: 1, data: vec![v, 0.5, 0.5, 0.5] };
        let mut image = grey(0.6);
        difference(&mut image, &grey(0.5), 4.0);
        assert!((image.data[0] - 0.7).abs() < 1e-6 && image.data[1..] == [0.5; 3], "{:?}", image.data);
        let mut image = grey(0.0);
        difference(&mut image, &grey(0.5), 4.0);
        assert_eq!(image.data[0], 0.0);
        assert_eq!(halved(&grey(0.9)).data, [0.6]);
    }
}
