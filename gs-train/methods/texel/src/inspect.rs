//! What can be said of a trained person: errors of the offsets, values of the texels.

use super::Dut;
use super::actor::{First, FrameError};
use gs_data::avatar::AvatarFrame;
use gs_texel::gaussians::{OFFSET, OPACITY};
use gs_train::capabilities::{Inspect, Quantity};
use gs_train::method::MethodError;
use gs_train::report::{ReportRow, Section};
use gs_train::timestamp::Timestamp;

/// Offsets against the true ones: in all, and along the normals of the bind pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OffsetErrors {
    /// RMS error over RMS length; NaN where no truth is known.
    pub ratio: [f64; 2],
    /// RMS length of the true ones, metres.
    pub length: [f64; 2],
}

impl Dut {
    /// How well GeoNet knows the surface, over all frames whose true offsets are known: RMS error over RMS length.
    ///
    /// # Errors
    /// As [`Actor::first`](super::Actor::first).
    pub fn offset_errors(&self) -> Result<OffsetErrors, FrameError> {
        self.errors_of(|_, first| self.offsets(first))
    }

    /// The same of any offsets.
    pub(super) fn errors_of(
        &self,
        offsets: impl Fn(&AvatarFrame, &First) -> Result<Option<Vec<glam::Vec3>>, FrameError>,
    ) -> Result<OffsetErrors, FrameError> {
        let (scene, mut sums) = (&self.actor.scene, OffsetErrors::default());
        let template = &scene.character.template;
        let normals = self.actor.topology.normals(&template.vertices, &template.faces);
        let (mut error, mut count) = ([0.0f64; 2], 0usize);
        for frame in &scene.frames {
            let Some(wanted) = scene.true_offsets(frame) else { continue };
            let first = self.first(frame)?;
            let Some(found) = offsets(frame, &first)? else { continue };
            for ((found, wanted), normal) in found.iter().zip(&wanted).zip(&normals) {
                let squares = |v: glam::Vec3| [v.length_squared(), v.dot(*normal).powi(2)].map(f64::from);
                error.iter_mut().zip(squares(*found - *wanted)).for_each(|(sum, v)| *sum += v);
                sums.length.iter_mut().zip(squares(*wanted)).for_each(|(sum, v)| *sum += v);
            }
            count += found.len();
        }
        sums.ratio = [0, 1].map(|k| (error[k] / sums.length[k]).sqrt());
        sums.length = sums.length.map(|v| (v / count.max(1) as f64).sqrt());
        Ok(sums)
    }
}

impl Inspect for Dut {
    /// How well GeoNet knows the surface, where the film carries the truth.
    fn report_section(&self, _events: &[serde_json::Value]) -> Result<Option<Section>, MethodError> {
        if self.geometry.is_none() {
            return Ok(None);
        }
        let wrong = |e| Self::at_frame(self.actor.frame_at(Default::default()), &e);
        let OffsetErrors { ratio, length } = self.offset_errors().map_err(wrong)?;
        if !ratio[0].is_finite() {
            return Ok(None);
        }
        let along = |k: usize, what: &str| {
            let value = format!("{:.1} % of {:.1} mm", 100.0 * ratio[k], 1e3 * length[k]);
            ReportRow::new(
                what,
                value,
                "RMS over all frames, of that of the true offsets; 100 %: the template without offsets",
            )
        };
        Ok(Some(Section {
            title: "Offsets of the template".into(),
            rows: vec![along(0, "error of offsets"), along(1, "error along normals")],
            json: serde_json::json!({"offsets": {"error": ratio, "length_m": length}}),
            ..Section::default()
        }))
    }

    fn quantities(&self, at: &Timestamp) -> Result<Vec<Quantity>, MethodError> {
        let texels = self.texels_at(at);
        let (second, rows) = texels.map_err(|e| Self::at_frame(self.actor.frame_at(at.t), &e))?;
        let width = self.channels.width();
        let each = |value: &dyn Fn(&[f32]) -> f32| rows.chunks_exact(width).map(value).collect();
        let offset = |row: &[f32]| row[OFFSET].iter().map(|d| d * d).sum::<f32>().sqrt();
        let number = |name, unit, values| Quantity { name, unit, range: None, values };
        Ok(vec![
            number("visibility", "views", second.seen.views.clone()),
            number("offset", "m", each(&offset)),
            number("kappa", "", second.base.kappas.clone()),
            Quantity::share("opacity", each(&|row| 1.0 / (1.0 + (-row[OPACITY]).exp()))),
        ])
    }
}
