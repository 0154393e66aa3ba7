//! Renders two textured spheres from four sides, unprojects the images to a texture, and prints the accuracy and time of every
//! visibility rule.
//!
//! `cargo run --release -p gs-texel --example unproject [texture size]`

#[path = "../tests/texel/scenes.rs"]
mod scenes;

use gs_core::speed::median_seconds;
use gs_texel::unproject::{Compat, UnprojectConfig, unproject};
use gs_texel::visibility::{Rates, Rule};
use scenes::{psnr, render, ring, two_spheres, views, waves};

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let size = std::env::args().nth(1).map_or(Ok(512), |a| a.parse())?;
    let figure = two_spheres();
    let table = figure.table(size);
    println!("{} triangles, {} texels in {} charts, 4 views", figure.faces.len(), table.len(), table.report.charts);
    println!("dB: the texture against the truth where seen; false: pairs of texel and view against exact rays\n");
    println!("| image | k (1/m) | rule | dB | coverage | false visible | false hidden | ms |");
    println!("|---|---|---|---|---|---|---|---|");
    for (side, k) in [(512, 12.0), (1024, 4.0), (1024, 12.0), (1024, 24.0), (1024, 48.0), (2048, 12.0)] {
        let (cameras, color) = (ring(4, side), waves(k));
        let images: Vec<_> = cameras.iter().map(|c| render(&figure, c, &color)).collect();
        let views = views(&cameras, &images);
        let oracle = UnprojectConfig { rule: Rule::Ray, keep_views: true, ..Default::default() };
        let truth = unproject(&figure.mesh(), &table, &views, &oracle)?;
        for (name, config) in settings() {
            let kept = UnprojectConfig { keep_views: true, ..config };
            let texture = unproject(&figure.mesh(), &table, &views, &kept)?;
            let rates = Rates::of(&texture.by_view, &truth.by_view);
            let ms = 1e3 * median_seconds(3, || drop(unproject(&figure.mesh(), &table, &views, &config)));
            println!(
                "| {side}² | {k} | {name} | {:.1} | {:.3} | {:.2} % | {:.2} % | {ms:.1} |",
                psnr(&texture, &figure, &table, &color),
                texture.coverage(),
                100.0 * rates.false_visible,
                100.0 * rates.false_hidden,
            );
        }
    }
    Ok(())
}

/// Every rule, DUT's published code, and other methods.
fn settings() -> Vec<(&'static str, UnprojectConfig)> {
    let align = Compat { align_corners: true, ..Compat::default() };
    let rule = |rule| UnprojectConfig { rule, ..Default::default() };
    vec![
        ("bilinear, align corners", UnprojectConfig { compat: align, ..rule(Rule::Bilinear) }),
        ("bilinear", rule(Rule::Bilinear)),
        ("four_tap", rule(Rule::FourTap)),
        ("neighbours", rule(Rule::Neighbours)),
        ("ray", rule(Rule::Ray)),
        ("ray_footprint", rule(Rule::RayFootprint)),
        ("face_tag", rule(Rule::FaceTag)),
        ("DUT's code", UnprojectConfig::dut_code()),
        ("HoloChar", UnprojectConfig::holochar()),
        ("DVA", UnprojectConfig::dva()),
        ("GHG", UnprojectConfig::ghg()),
    ]
}
