//! Splat files, one for each time, as one page: `play_files OUT.html A.ply [B.ply …]`.

use gs_core::io::{Limits, load_splats, write_file};
use gs4d_player::{Clip, Frames, Page, RenderSettings, Start, Tolerance};
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(out), files) = (arguments.next(), arguments.collect::<Vec<_>>()) else {
        return Err("give OUT.html and at least one splat file".into());
    };
    let last = files.len().saturating_sub(1).max(1) as f32;
    let times = (0..files.len()).map(|k| k as f32 / last).collect();
    let (mut splats, mut settings) = (Vec::new(), RenderSettings::default());
    for file in &files {
        let raw = load_splats(Path::new(file), &Limits::default())?;
        settings.antialias |= raw.antialiased;
        splats.push(raw.to_splats()?);
    }
    let clip = Clip::fit(&Frames::new(times, splats)?, &[], Tolerance::default()).with_render_settings(settings);
    let page = Page { title: out.clone(), start: Start::default(), background: [0.0; 3], clock: None };
    let html = page.html(&clip)?;
    write_file(Path::new(&out), false, |file| file.write_all(html.as_bytes()))?;
    println!("{} splats, {} of them move, {:.2} MB", clip.len(), clip.moving(), html.len() as f64 / 1e6);
    Ok(())
}
