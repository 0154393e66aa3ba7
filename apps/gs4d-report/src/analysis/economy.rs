//! How many splats a picture takes: the price of a kernel at a given PSNR.

use super::row;
use crate::Need;
use gs_core::{Camera, Time};
use gs_raster::tiles::TILE;
use gs_raster::{Frame, RasterOptions, Workspace, render_into};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::timestamp::Timestamp;
use serde::Serialize;

/// What views of a scene take to draw, on average over them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Economy {
    /// Splats of the scene.
    pub splats: usize,
    /// Tiles a splat is listed in, over all splats.
    pub tiles_per_splat: f64,
    /// Splats listed in a tile.
    pub listed_per_tile: f64,
    /// Of those, up to the last one that some pixel blended.
    pub used_per_tile: f64,
    /// Splats a pixel goes through until its last blended one: at least the number it blends.
    pub walked_per_pixel: f64,
    /// PSNR of the same run, dB, to compare at.
    pub psnr: Option<f64>,
}

impl Economy {
    /// Of a method seen by these cameras at these times; `None` without a view or splats.
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
        for (camera, time) in views {
            let splats = method.splats(&Timestamp::new(*time), camera)?;
            render_into(&splats, camera, options, &mut workspace, &mut frame);
            listed += workspace.entries();
            used += workspace.entries_used();
            walked += workspace.entries_walked();
            tiles += frame.width.div_ceil(TILE) * frame.height.div_ceil(TILE);
            pixels += frame.width * frame.height;
        }
        Ok((tiles > 0 && method.splat_count() > 0).then(|| Self {
            splats: method.splat_count(),
            tiles_per_splat: listed as f64 / (views.len() * method.splat_count()) as f64,
            listed_per_tile: listed as f64 / tiles as f64,
            used_per_tile: used as f64 / tiles as f64,
            walked_per_pixel: walked as f64 / pixels as f64,
            psnr,
        }))
    }

    /// As rows of a table.
    pub fn rows(&self) -> Vec<Need> {
        let at = self.psnr.map_or(String::new(), |p| format!(", at {p:.2} dB"));
        let per_tile = format!("{:.1}, {:.1}", self.listed_per_tile, self.used_per_tile);
        vec![
            row("kernels", format!("{}{at}", self.splats), "splats of the scene, and the PSNR they reach"),
            row(
                "tiles per splat",
                format!("{:.2}", self.tiles_per_splat),
                "mean over all splats and the views looked at",
            ),
            row("splats per tile", per_tile, "listed, and listed up to the last one some pixel blended"),
            row(
                "depth of a pixel",
                format!("{:.1}", self.walked_per_pixel),
                "splats of its tile up to its last blended one",
            ),
        ]
    }
}
