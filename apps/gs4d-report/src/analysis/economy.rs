//! Rendering cost of a scene: splats, tile entries and depth per pixel, to compare kernels at a given PSNR.

use crate::ReportRow;
use gs_core::{Camera, Time};
use gs_raster::measure::bytes_per_splat;
use gs_raster::tiles::TILE;
use gs_raster::{Frame, RasterOptions, Workspace, render_into};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::timestamp::Timestamp;
use serde::Serialize;

/// Rendering cost, averaged over views.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RenderCost {
    /// Number of splats of the scene.
    pub splats: usize,
    /// Mean number of tiles that list a splat, over all splats and views.
    pub tiles_per_splat: f64,
    /// Mean number of splats listed in a tile.
    pub listed_per_tile: f64,
    /// Mean number of splats in a tile's list up to the last one that any pixel blended.
    pub used_per_tile: f64,
    /// Mean number of splats a pixel visits up to its last blended one: at least the number it blends.
    pub walked_per_pixel: f64,
    /// Bytes a splat takes in a frame, and in a step of training: there with gradients, and with the parameters of the method, their
    /// gradients and Adam's moments. The most over views.
    pub bytes_per_splat: [f64; 2],
    /// PSNR of the run, dB, for comparison.
    pub psnr: Option<f64>,
}

impl RenderCost {
    /// Renders a model from these cameras at these times and counts; `None` without views or splats.
    ///
    /// # Errors
    /// If a view cannot be rendered.
    pub fn of(
        method: &Model,
        views: &[(Camera, Time)],
        options: &RasterOptions,
        psnr: Option<f64>,
    ) -> Result<Option<Self>, MethodError> {
        let (mut workspace, mut frame) = (Workspace::new(), Frame::default());
        let (mut listed, mut used, mut walked, mut tiles, mut pixels) = (0usize, 0usize, 0u64, 0usize, 0usize);
        let mut bytes = [0.0f64; 2];
        for (camera, time) in views {
            let splats = method.splats(&Timestamp::new(*time), camera)?;
            render_into(&splats, camera, options, &mut workspace, &mut frame);
            listed += workspace.entries();
            used += workspace.entries_used();
            walked += workspace.entries_walked();
            tiles += frame.rgb.width.div_ceil(TILE) * frame.rgb.height.div_ceil(TILE);
            pixels += frame.alpha.len();
            let [drawn, trained] = bytes_per_splat(splats.view(), camera, options);
            bytes = [bytes[0].max(drawn), bytes[1].max(trained)];
        }
        // A value, its gradient and two moments.
        bytes[1] += 16.0 * method.param_count() as f64 / method.splat_count().max(1) as f64;
        Ok((tiles > 0 && method.splat_count() > 0).then(|| Self {
            splats: method.splat_count(),
            tiles_per_splat: listed as f64 / (views.len() * method.splat_count()) as f64,
            listed_per_tile: listed as f64 / tiles as f64,
            used_per_tile: used as f64 / tiles as f64,
            walked_per_pixel: walked as f64 / pixels as f64,
            bytes_per_splat: bytes,
            psnr,
        }))
    }

    /// Rows for the report.
    pub fn rows(&self) -> Vec<ReportRow> {
        let at = self.psnr.map_or(String::new(), |p| format!(", at {p:.2} dB"));
        let per_tile = format!("{:.1}, {:.1}", self.listed_per_tile, self.used_per_tile);
        vec![
            ReportRow::new("kernels", format!("{}{at}", self.splats), "splats of the scene, and the PSNR they reach"),
            ReportRow::new(
                "tiles per splat",
                format!("{:.2}", self.tiles_per_splat),
                "mean over all splats and the views rendered",
            ),
            ReportRow::new("splats per tile", per_tile, "listed, and listed up to the last one some pixel blended"),
            ReportRow::new(
                "depth of a pixel",
                format!("{:.1}", self.walked_per_pixel),
                "splats of its tile up to its last blended one",
            ),
            ReportRow::new(
                "memory of a splat",
                format!("{:.0}, {:.0} bytes", self.bytes_per_splat[0], self.bytes_per_splat[1]),
                "in a frame; in a step of training, with parameters, gradients and Adam's moments",
            ),
        ]
    }
}
