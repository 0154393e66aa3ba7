//! Answers questions: renders the layer, adds legends and scores, encodes the image.

use crate::arrows::arrows;
use crate::choice;
use crate::legend::{grey, named, scaled};
use crate::packing::{Packing, pack};
use crate::pick::pick;
use crate::pose::inputs;
use crate::question::{Look, MAX_PIXELS, Question, Save, Target};
use crate::shot::{MIN_OPACITY, SelectionCache, Shot};
use crate::stage::Stage;
use crate::style::Style;
use gs_core::{Camera, Image, Splats};
use gs_metrics::{half_size, psnr};
use gs_raster::{DeviceError, Frame, RasterOptions, Rasterizer};
use gs_train::device::Device;
use gs_train::evaluate::clamped;
use gs_train::palette::color_scale;
use gs_train::renderer::{depth_colors, depth_span, file_stem, mean_depth};
use gs_train::timestamp::Timestamp;
use gs4d_eval::{layers, segment};
use serde_json::{Value, json};
use std::borrow::Cow;
use std::time::Instant;

/// An image, a file or splats, with a header for the page.
pub struct Answer {
    /// JSON: size, milliseconds, legend, PSNR, reason of a blank image, picked splats, or the name of a file.
    pub header: Value,
    /// A PNG, JPEG or PLY file, or the words of splats.
    pub bytes: Vec<u8>,
}

/// Renders layers; buffers are reused between images.
pub struct Renderer {
    rasterizer: Box<dyn Rasterizer>,
    frame: Frame,
    selections: SelectionCache,
}

impl Renderer {
    /// Renders on a device.
    ///
    /// # Errors
    /// If the device fails.
    pub fn on(device: &Device) -> Result<Self, DeviceError> {
        let (frame, selections) = Default::default();
        Ok(Self { rasterizer: device.open()?, frame, selections })
    }

    /// Answers a question.
    ///
    /// # Errors
    /// A message for the page: no such show, view or layer, or an image that cannot be read.
    pub fn answer(&mut self, stage: &Stage, q: &Question, packing: Packing) -> Result<Answer, String> {
        let begun = Instant::now();
        let camera = q.look.camera(stage, q.width, q.height, q.enlarges())?;
        let shot = Shot::of(stage, q, &q.what, &camera, &mut self.selections)?;
        let mut header = json!({"id": q.id, "layer": q.what.layer});
        let chosen = q.chosen.as_ref();
        match q.save {
            None | Some(Save::Image) => {}
            Some(Save::Splats) => return self.splats(q, &shot, header),
            Some(part @ (Save::Chosen | Save::Rest)) => {
                let inside = part == Save::Chosen;
                let (name, bytes) = choice::file(stage, &shot, chosen, inside, &mut self.selections)?;
                header["file"] = json!(name);
                return Ok(Answer { header, bytes });
            }
        }
        let mut image = self.layer(stage, q, &q.what, &shot, &mut header)?;
        if let Some(other) = &q.against {
            let other_shot = Shot::of(stage, q, other, &camera, &mut self.selections)?;
            let subtracted = self.layer(stage, q, other, &other_shot, &mut json!({}))?;
            header["legend"] = Value::Null;
            if q.score && matches!(q.look, Look::Free(..)) {
                scored(&mut header, psnr_value(&image, &subtracted), &image);
            }
            difference(&mut image, &subtracted, q.gain);
        }
        if q.save == Some(Save::Image) {
            header["file"] = json!(format!("{}_{}_t{:.3}.png", file_stem(&shot.show.name), q.what.layer, q.time));
            return Ok(Answer { bytes: pack(&image, Packing::Png)?, header });
        }
        if q.score && matches!(q.look, Look::View(..)) {
            self.score(stage, q, &shot, &mut header)?;
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
        header["ms"] = json!(ms_since(begun));
        let bytes = pack(&image, packing)?;
        if let Some(frame) = shot.scene.frame {
            header["frame"] = json!({"number": frame.number, "latency_ms": ms_since(frame.written)});
        }
        Ok(Answer { bytes, header })
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
        let shot = if fine { &shot.doubled() } else { shot };
        let image = match target.layer.as_str() {
            "truth" => {
                let (image, time) = truth(stage, q, shot)?;
                if time != q.time {
                    header["note"] = json!(format!("the ground truth is of time {time:.3}"));
                }
                return Ok(image);
            }
            "color" => self.color(shot, header)?,
            "alpha" => {
                self.render(shot.splats()?, shot)?;
                header["legend"] = grey("alpha", &self.frame.alpha);
                self.image(self.frame.alpha.iter().flat_map(|&a| [a; 3]).collect())
            }
            "depth" => {
                self.render(shot.splats()?, shot)?;
                self.depth(header)
            }
            "count" => count(shot, header)?,
            name => {
                let splats = painted_splats(shot, name, header)?;
                clamped(self.render(Cow::Owned(splats), shot)?)
            }
        };
        Ok(if fine { half_size(&image) } else { image })
    }

    /// The splats of a layer, for the renderer in the browser: all, in the same order at every time.
    fn splats(&self, q: &Question, shot: &Shot, mut header: Value) -> Result<Answer, String> {
        let splats = match q.what.layer.as_str() {
            "color" => shot.all_splats()?.into_owned(),
            "truth" | "depth" | "alpha" | "count" => return Err(format!("`{}` has no splats", q.what.layer)),
            name => painted_splats(shot, name, &mut header)?,
        };
        header["splats"] = json!(splats.len());
        header["background"] = json!(shot.background());
        let RasterOptions { near, dilation, antialias, .. } = shot.options();
        header["raster"] = json!({"near": near, "dilation": dilation, "antialias": antialias});
        Ok(Answer { bytes: gs4d_player::words::bytes(&shot.style.of(splats, &shot.camera), &shot.camera), header })
    }

    /// PSNR at the size of the dataset's image: of the colours against the ground truth at its time, or between the two sides of
    /// a difference. Absent where there is nothing to compare with, or the two are equal.
    fn score(&mut self, stage: &Stage, q: &Question, shot: &Shot, header: &mut Value) -> Result<(), String> {
        let Look::View(owner, number) = q.look else { return Ok(()) };
        let view = stage.view(owner, number)?;
        let plain = Question { fine: false, ..q.clone() };
        let full = shot.with_camera(view.camera.clone());
        let own = q.what.layer == "color" && q.time == view.time.normalised && shot.is_plain();
        let other = match &q.against {
            _ if u64::from(full.camera.width) * u64::from(full.camera.height) > u64::from(MAX_PIXELS) => return Ok(()),
            Some(other) => {
                let side = Shot::of(stage, q, other, &view.camera, &mut self.selections)?;
                self.layer(stage, &plain, other, &side, &mut json!({}))?
            }
            None if own && stage.show(owner)?.images().is_some() => truth(stage, q, &full)?.0,
            None => return Ok(()),
        };
        let image = self.layer(stage, &plain, &q.what, &full, &mut json!({}))?;
        scored(header, psnr_value(&image, &other), &image);
        Ok(())
    }

    fn render(&mut self, splats: Cow<'_, Splats>, shot: &Shot) -> Result<&Frame, String> {
        let drawn = match shot.style {
            Style::Splats => splats,
            style => Cow::Owned(style.of(splats.into_owned(), &shot.camera)),
        };
        let rendered = self.rasterizer.render_into(drawn.view(), &shot.camera, &shot.options(), &mut self.frame);
        rendered.map_err(|e| e.to_string())?;
        Ok(&self.frame)
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
        header["splats"] = json!(splats.len());
        let image = clamped(self.render(Cow::Borrowed(&*splats), shot)?);
        if let Some(why) = error.or_else(|| self.blank(&splats, &shot.camera)) {
            header["blank"] = json!(why);
        }
        Ok(image)
    }

    /// Mean depth of pixels covered by more than half: dark near, bright far.
    fn depth(&self, header: &mut Value) -> Image {
        let depths = mean_depth(&self.frame);
        let span = depth_span(&depths);
        let known: Vec<f32> = depths.iter().copied().filter(|d| *d > 0.0).collect();
        header["legend"] = scaled("depth", "world units", span, &known);
        self.image(depth_colors(&depths, span))
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
            "no splat is visible: of {} splats {faint} are invisible at this time, {behind} lie behind the camera, the others \
             outside its image",
            splats.len()
        ))
    }
}

/// Number of splats blended into each pixel.
fn count(shot: &Shot, header: &mut Value) -> Result<Image, String> {
    let splats = shot.style.of(shot.splats()?.into_owned(), &shot.camera);
    let counts = layers::counts(&splats, &shot.camera, &shot.options());
    let max_count = counts.iter().copied().fold(1.0, f32::max);
    // The histogram leaves out empty pixels.
    let covered: Vec<f32> = counts.iter().copied().filter(|c| *c > 0.0).collect();
    header["legend"] = scaled("count", "splats per pixel", [0.0, max_count], &covered);
    let [width, height] = [shot.camera.width as usize, shot.camera.height as usize];
    let data = counts.iter().flat_map(|c| color_scale(c / max_count)).collect();
    Ok(Image { width, height, channels: 3, data })
}

/// All splats in the colours of a layer: `segment`, a scalar or an overlay of the method. Legend and note go to `header`.
fn painted_splats(shot: &Shot, name: &str, header: &mut Value) -> Result<Splats, String> {
    let colors = if name == layers::PARTS { parts(shot, header)? } else { overlay(shot, name, header)? };
    layers::painted(shot.all_splats()?.into_owned(), name, colors).map_err(|e| e.to_string())
}

/// Rigid parts, one colour each.
fn parts(shot: &Shot, header: &mut Value) -> Result<Vec<[f32; 3]>, String> {
    let parts = shot.scene.parts(shot.show.observed())?;
    let words = format!("rigid parts: {}, bars are their splats", parts.k);
    header["legend"] = named(layers::PARTS, &words, &parts.of, parts.k, |part| segment::color(part + 1));
    Ok(layers::part_colors(parts))
}

/// A scalar or overlay of the method.
fn overlay(shot: &Shot, name: &str, header: &mut Value) -> Result<Vec<[f32; 3]>, String> {
    let method = shot.scene.as_method().ok_or("a splat file has no such layer")?;
    let found = layers::find(method, name, &Timestamp::normalised(shot.time)).map_err(|e| e.to_string())?;
    let layers::Layer { overlay, quantity } = found.ok_or("there is no such layer")?;
    match quantity {
        Some(q) => header["legend"] = scaled(name, q.unit, q.span(), &q.values),
        None => header["note"] = json!(overlay.meaning),
    }
    Ok(overlay.colors)
}

/// The ground-truth image of a view over the background of a shot, at the size of its camera, and its normalised time.
fn truth(stage: &Stage, q: &Question, shot: &Shot) -> Result<(Image, f32), String> {
    let Look::View(owner, number) = q.look else {
        return Err("a ground-truth image has its own camera: choose a view".into());
    };
    let (view, image) = (stage.view(owner, number)?, stage.show(owner)?.truth(number)?);
    let [width, height] = [shot.camera.width as usize, shot.camera.height as usize];
    Ok((image.box_downscaled(width, height).over(shot.background()), view.time.normalised))
}

fn ms_since(begun: Instant) -> f64 {
    begun.elapsed().as_secs_f64() * 1e3
}

/// PSNR in dB; `None` for identical images or different sizes.
fn psnr_value(a: &Image, b: &Image) -> Option<f64> {
    psnr(a, b).ok().filter(|v| v.is_finite())
}

/// Notes a PSNR and the size of the images it is of.
fn scored(header: &mut Value, psnr: Option<f64>, image: &Image) {
    header["psnr"] = json!(psnr);
    header["scored"] = json!([image.width, image.height]);
}

/// Replaces `image` by its difference to `other`, times `gain`, around grey.
fn difference(image: &mut Image, other: &Image, gain: f32) {
    image.data.iter_mut().zip(&other.data).for_each(|(a, b)| *a = (0.5 + 0.5 * gain * (*a - b)).clamp(0.0, 1.0));
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
        assert_eq!(half_size(&grey(0.9)).data, [0.6]);
    }
}
