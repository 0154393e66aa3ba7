//! `gs4d import`: with stand-ins for ffmpeg and COLMAP, and with the real programs on a film.

use crate::support::{Call, command, gs4d, text};
use gs4d_import::testkit::{FPS, arc, has, picture, write_video};
use std::fs;
use std::path::{Path, PathBuf};

/// Answers as ffprobe does, about every video.
const FFPROBE: &str = r#"[ "$1" = -version ] && exit 0
echo '{"streams": [{"width": 64, "height": 48, "avg_frame_rate": "10/1", "duration": "2.0"}]}'"#;

/// Grey frames of a rig at rest on the standard output, or numbered files: copies of a mask, the frames of a film, else copies of a
/// picture.
const FFMPEG: &str = r#"[ "$1" = -version ] && exit 0
for last; do :; done
echo "$*" >> "$HERE/calls"
case "$last" in
pipe:1) i=0; while [ $i -lt 20 ]; do cat "$HERE/grey"; i=$((i+1)); done;;
*.png) i=0; while [ $i -lt 20 ]; do cp "$HERE/mask.png" "$(printf %05d $i).png"; i=$((i+1)); done;;
*) [ -e "$HERE/broken" ] && { echo "moov atom not found" >&2; exit 1; }
   i=0; while [ $i -lt 20 ]; do to=$(printf %05d $i).jpg; from="$HERE/film/$to"; [ -e "$from" ] || from="$HERE/picture.jpg"
     cp "$from" "$to"; i=$((i+1)); done;;
esac"#;

/// Knows the options of two versions, and gives each image a pose.
const COLMAP: &str = r#"case "$2" in --help) echo "  --FeatureExtraction.use_gpu arg (=1)"; echo "  --SiftMatching.use_gpu arg (=1)"; exit 0;; esac
echo "$*" >> "$HERE/calls"
case "$1" in
feature_extractor) cat import/list.txt >> import/database.db; echo "Processed file [1/1]";;
exhaustive_matcher) if [ -e "$HERE/slow" ]; then touch "$HERE/begun"; exec sleep 60; fi;;
mapper|image_registrator) to=import/registered
  if [ $1 = mapper ]; then
    echo "  => No good initial image pair found."
    [ -e "$HERE/crash" ] && kill -SEGV $$
    [ -e "$HERE/alone" ] && { cat "$HERE/alone" >&2; exit 1; }
    to=import/sparse/0; mkdir $to
  fi; cd $to
  echo "1 SIMPLE_RADIAL 64 48 60 32 24 0.01" > cameras.txt
  i=0; while read -r name; do i=$((i+1))
    case "$name" in cam00/*) x=-1;; cam01/*) [ -e "$HERE/lost" ] && continue; x=0;; *) x=1;; esac
    printf '%s 1 0 0 0 %s 0 4 1 %s\n\n' $i $x "$name"; done < "$HERE/data/import/database.db" > images.txt
  printf '1 0 0 0 200 10 10 0.5 1 0\n2 0.3 0.2 0.1 10 200 10 0.5 1 0\n' > points3D.txt;;
model_analyzer) echo "Mean reprojection error: 0.5px";;
esac"#;

const VIDEOS: [&str; 3] = ["-a.mp4", "b c.mp4", "d%d$x.mp4"];

/// Writes a grey picture of 64×48 pixels.
fn save(file: &Path, grey: impl Fn(u32) -> f32) {
    let data = (0..64 * 48).flat_map(|at| [grey(at); 3]).collect();
    let picture = gs_core::Image { width: 64, height: 48, channels: 3, data };
    gs_core::io::images::save_png(file, &picture, false).unwrap();
}

/// A folder with three videos and the stand-ins.
struct Desk {
    dir: tempfile::TempDir,
}

impl Desk {
    fn new() -> Self {
        let desk = Self { dir: tempfile::tempdir().unwrap() };
        fs::create_dir(desk.at("bin")).unwrap();
        let noise = |x: u32, y: u32| (((x * 7919 + y * 104_729).wrapping_mul(2_654_435_761)) >> 24) as u8;
        let grey: Vec<u8> = (0..240 * 180).map(|k: u32| noise(k % 240 / 3, k / 240 / 3)).collect();
        fs::write(desk.at("grey"), grey).unwrap();
        save(&desk.at("picture.jpg"), |at| f32::from(noise(at % 64, at / 64)) / 255.0);
        VIDEOS.iter().for_each(|name| fs::write(desk.at(name), "a video").unwrap());
        desk
    }

    fn at(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn stand_in(&self, program: &str, script: &str) {
        use std::os::unix::fs::PermissionsExt;
        let file = self.at("bin").join(program);
        let head = format!("#!/bin/sh\nPATH=/usr/bin:/bin\nHERE='{}'\n", self.dir.path().display());
        fs::write(&file, head + script).unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(0o755)).unwrap();
    }

    fn all(self) -> Self {
        [("ffprobe", FFPROBE), ("ffmpeg", FFMPEG), ("colmap", COLMAP)].iter().for_each(|(p, s)| self.stand_in(p, s));
        self
    }

    fn command(&self, more: &[&str]) -> std::process::Command {
        let mut all = vec!["import", "-o", "data"];
        all.extend_from_slice(more);
        all.push("--");
        all.extend(VIDEOS);
        self.beside(&all)
    }

    /// A call in the folder, with the stand-ins.
    fn beside(&self, all: &[&str]) -> std::process::Command {
        let mut command = command(all);
        command.current_dir(self.dir.path()).env("PATH", self.at("bin"));
        command
    }

    /// What a call prints.
    fn said(&self, all: &[&str]) -> String {
        let call = Call::of(&self.beside(all).output().unwrap());
        call.out + &call.err
    }

    fn import(&self, more: &[&str]) -> Call {
        Call::of(&self.command(more).output().unwrap())
    }

    /// Every video shows what a camera that moves sees: frame 7 is blurred, frame 12 shows what frame 11 shows.
    fn film(&self) {
        fs::create_dir(self.at("film")).unwrap();
        let noise = |x: u32, y: u32| gs_core::Rng::new(7, "film", y, x.into()).uniform();
        for k in 0..20u32 {
            let from = 2 * if k == 12 { 11 } else { k };
            // A shutter that is open while the camera turns by five pixels.
            let open = if k == 7 { 5u16 } else { 1 };
            save(&self.at(&format!("film/{k:05}.jpg")), |at| {
                let seen = |turned: u16| noise(at % 64 + from + u32::from(turned), at / 64);
                (0..open).map(seen).sum::<f32>() / f32::from(open)
            });
        }
    }

    /// The frames of the data set.
    fn frames(&self) -> Vec<serde_json::Value> {
        let text = fs::read_to_string(self.at("data/transforms.json")).unwrap();
        let read: serde_json::Value = serde_json::from_str(&text).unwrap();
        read["frames"].as_array().unwrap().clone()
    }

    /// How often the stand-ins were asked for something.
    fn calls(&self, word: &str) -> usize {
        fs::read_to_string(self.at("calls")).unwrap_or_default().lines().filter(|l| l.contains(word)).count()
    }
}

#[cfg(unix)]
#[test]
fn programs_that_are_not_there_are_named_with_their_package() {
    let desk = Desk::new();
    desk.import(&[]).fails(2, &["colmap is not on the PATH", "apt install colmap", "goes on"]);
    desk.stand_in("colmap", COLMAP);
    desk.import(&[]).fails(2, &["ffmpeg is not on the PATH", "apt install ffmpeg"]);
    gs4d(&["import", "-o", "x"]).fails(2, &["VIDEO"]);
    gs4d(&["import", "a.mp4"]).fails(2, &["--out"]);
    gs4d(&["import", "a.mp4", "-o", "x", "--images", "y"]).fails(2, &["cannot be used with"]);
    gs4d(&["import", "/no/such.mp4", "-o", text(&desk.at("x"))]).fails(6, &["/no/such.mp4"]);
    assert!(!desk.at("x").exists());
}

#[cfg(unix)]
#[test]
fn a_camera_that_is_not_there_is_named_before_any_program_runs() {
    let desk = Desk::new().all();
    desk.import(&["--held-out", "3"]).fails(3, &["no camera 3 to hold out", "from 0 to 2"]);
    assert_eq!(desk.calls(""), 0);
    assert!(desk.import(&["--held-out", "2"]).out.contains("held out"), "the same folder goes on");
}

#[cfg(unix)]
#[test]
fn a_program_that_fails_is_quoted_and_what_was_done_is_kept() {
    let desk = Desk::new().all();
    fs::write(desk.at("broken"), "").unwrap();
    let words =
        ["3 cameras that stand still", "ffmpeg failed", "take frames of", "| moov atom not found", "import/log.txt"];
    desk.import(&[]).fails(6, &words);
    assert_eq!(desk.calls("rawvideo"), 3);
    fs::remove_file(desk.at("broken")).unwrap();
    fs::write(desk.at("lost"), "").unwrap();
    desk.import(&[]).fails(3, &["could not place cam01 (b c.mp4)", "30 degrees"]);
    assert_eq!((desk.calls("rawvideo"), desk.calls("exhaustive_matcher")), (3, 2), "two attempts, and no second look");
    // Other settings are another import.
    desk.import(&["--moments", "2"]).fails(6, &["moments was null", "-f"]);
    fs::remove_file(desk.at("lost")).unwrap();
    let done = desk.import(&[]);
    let said = format!("{}{}", done.out, done.err);
    assert!(said.contains("cam01  20 frames  b c.mp4"), "{said}");
    assert!(said.contains("reprojection error 0.50") && said.contains("gs4d train data"), "{said}");
    assert!(desk.calls("--FeatureExtraction.use_gpu 0") > 0 && desk.calls("--SiftMatching.use_gpu 0") > 0);
    for file in ["transforms.json", "points.ply", "start.ply", "scene.toml", "doctor.html", "images/cam02/00019.jpg"] {
        assert!(desk.at("data").join(file).is_file(), "{file}");
    }
    let calls = desk.calls("");
    let again = desk.import(&["--json", "-q"]);
    assert!(again.out.contains("\"fps\": 10"), "{}{}", again.out, again.err);
    assert_eq!(desk.calls(""), calls, "a finished import is not done again");
    // A folder of somebody's own is nobody's to clear.
    fs::create_dir(desk.at("own")).unwrap();
    fs::write(desk.at("own/notes.txt"), "mine").unwrap();
    let call = command(&["import", "b c.mp4", "-o", "own", "-f"]).current_dir(desk.dir.path()).output().unwrap();
    Call::of(&call).fails(6, &["not empty", "-o"]);
    assert_eq!(fs::read_dir(desk.at("own")).unwrap().count(), 1);
}

#[cfg(unix)]
#[test]
fn a_program_that_crashes_is_named_and_is_no_lack_of_overlap() {
    let desk = Desk::new().all();
    fs::write(desk.at("crash"), "").unwrap();
    let words = ["colmap failed", "reconstruct the cameras", "signal: 11", "import/log.txt", "apt install colmap"];
    desk.import(&[]).fails(6, &words);
    assert_eq!((desk.calls("exhaustive_matcher"), desk.calls("mapper")), (1, 1), "no second attempt");
    fs::remove_file(desk.at("crash")).unwrap();
    fs::write(desk.at("alone"), "ERROR: failed to create sparse model\n").unwrap();
    desk.import(&[]).fails(3, &["no two images that fit together", "30 degrees"]);
    assert_eq!((desk.calls("exhaustive_matcher"), desk.calls("mapper")), (2, 3), "two attempts");
    let desk = Desk::new().all();
    fs::write(desk.at("alone"), "E1129 sfm.cc:288] Failed to create any sparse model\n").unwrap();
    desk.import(&[]).fails(3, &["no two images that fit together", "30 degrees"]);
    assert_eq!(desk.calls("mapper"), 2, "two attempts with COLMAP 4");
}

#[cfg(unix)]
#[test]
fn several_moving_cameras_are_numbered_and_keep_their_clocks() {
    let numbers = |desk: &Desk| -> Vec<Option<u64>> {
        let mut all: Vec<_> = desk.frames().iter().map(|f| f["camera_index"].as_u64()).collect();
        all.dedup();
        all
    };
    let desk = Desk::new().all();
    let done = desk.import(&["--rig", "moving"]);
    let said = format!("{}{}", done.out, done.err);
    assert!(said.contains("clocks of moving cameras") && said.contains("cameras.time=true"), "{said}");
    assert_eq!(numbers(&desk), [Some(0), Some(1), Some(2)]);
    let desk = Desk::new().all();
    let said = desk.said(&["import", "-o", "data", "--rig", "moving", "b c.mp4"]);
    assert!(!said.contains("clocks of moving cameras"), "{said}");
    assert_eq!(numbers(&desk), [None]);
}

#[cfg(unix)]
#[test]
fn blurred_and_repeated_frames_are_named_and_left_out() {
    let filmed = || {
        let desk = Desk::new().all();
        desk.film();
        desk
    };
    let one = ["import", "-o", "data", "--rig", "moving", "b c.mp4"];
    let desk = filmed();
    let said = desk.said(&one);
    assert!(said.contains("1 blurred frames are left out: cam00/00007"), "{said}");
    assert!(said.contains("1 duplicate frames are left out: cam00/00012"), "{said}");
    let files: Vec<String> = desk.frames().iter().map(|f| f["file_path"].as_str().unwrap().to_owned()).collect();
    let kept = (0..20).filter(|k| ![7, 12].contains(k)).map(|k| format!("images/cam00/{k:05}.jpg"));
    assert!(kept.eq(files.iter().cloned()), "{files:?}");
    assert!(desk.at("data/images/cam00/00007.jpg").is_file(), "its image stays");
    let desk = filmed();
    let said = desk.said(&[&one[..], &["--keep-all"]].concat());
    assert!(!said.contains("frames are left out"), "{said}");
    assert_eq!(desk.frames().len(), 20);
    // Of cameras at rest a moment counts that all of them saw twice.
    let desk = filmed();
    let done = desk.import(&[]);
    let said = done.out + &done.err;
    assert!(said.contains("3 duplicate frames are left out: cam00/00012, cam01/00012, cam02/00012"), "{said}");
    assert!(!said.contains("blurred frames"), "{said}");
    assert_eq!(desk.frames().len(), 57);
}

#[cfg(unix)]
#[test]
fn videos_of_masks_are_taken_along() {
    let desk = Desk::new().all();
    fs::create_dir(desk.at("white")).unwrap();
    VIDEOS.iter().for_each(|name| fs::write(desk.at("white").join(name), "a video of masks").unwrap());
    save(&desk.at("mask.png"), |at| if at % 64 < 48 { 1.0 } else { 0.0 });
    let done = desk.import(&["--masks", "white"]);
    assert!(done.out.contains("now: gs4d train data"), "{}{}", done.out, done.err);
    assert_eq!((desk.calls("white/"), desk.calls("%05d.png")), (3, 3));
    let (mask, frames) = (fs::read(desk.at("mask.png")).unwrap(), desk.frames());
    assert_eq!(frames.len(), 60);
    for frame in &frames {
        let image = frame["file_path"].as_str().unwrap();
        let path = image.replace("images/", "masks/").replace(".jpg", ".png");
        assert_eq!(frame["mask_path"].as_str(), Some(path.as_str()));
        assert!(fs::read(desk.at("data").join(&path)).unwrap() == mask, "{path}");
    }
    assert!(["start.ply", "doctor.html"].iter().all(|file| desk.at("data").join(file).is_file()));
}

#[cfg(unix)]
#[test]
fn pictures_without_order_are_matched_with_every_key_picture() {
    let desk = Desk::new().all();
    fs::create_dir(desk.at("pictures")).unwrap();
    for k in 0..5 {
        fs::copy(desk.at("picture.jpg"), desk.at(&format!("pictures/{k}.jpg"))).unwrap();
    }
    let said = desk.said(&["import", "-o", "data", "--images", "pictures", "--unordered", "--keyframes", "3"]);
    assert!(said.contains("5 frames of 1 camera"), "{said}");
    assert_eq!((desk.calls("exhaustive_matcher"), desk.calls("sequential_matcher")), (1, 0));
    assert_eq!(desk.calls("matches_importer"), 1);
    let list = fs::read_to_string(desk.at("data/import/list.txt")).unwrap();
    let pairs = [0, 2, 4].map(|key| format!("cam00/{key:05}.jpg cam00/00001.jpg\n"));
    assert!(list.lines().count() == 6 && pairs.iter().all(|pair| list.contains(pair)), "{list}");
}

#[cfg(unix)]
#[test]
fn files_of_others_stay_and_frames_that_are_missing_are_named() {
    let desk = Desk::new().all();
    fs::write(desk.at("lost"), "").unwrap();
    let lost = |more: &[&str]| desk.import(more).fails(3, &["could not place cam01"]);
    lost(&[]);
    let [frame, mine, mask] = ["images/cam01/00005.jpg", "images/cam01/mine.jpg", "masks/cam01/00005.png"]
        .map(|name| desk.at("data").join(name));
    fs::rename(&frame, &mine).unwrap();
    desk.import(&[]).fails(3, &["of 20 frames the image 00005 is missing", "cam01", "put it back"]);
    desk.import(&["-f"]).fails(3, &["mine.jpg", "the import did not make it", "move them away"]);
    desk.import(&["-f", "--masks", "data/images"]).fails(3, &["inside the data set"]);
    assert!(mine.exists() && desk.at("data/images/cam00/00000.jpg").exists());
    fs::remove_file(&mine).unwrap();
    let scene = desk.at("data/scene.toml");
    fs::write(&scene, "[time]\nfps = 5\n").unwrap();
    desk.import(&["-f"]).fails(3, &["scene.toml", "settings of yours", "move it away"]);
    fs::write(&scene, "[start]\npoints = \"start.ply\"\n").unwrap();
    // Masks that somebody painted are nothing to an import without masks.
    fs::create_dir_all(mask.parent().unwrap()).unwrap();
    fs::write(&mask, "painted").unwrap();
    lost(&["-f"]);
    assert!(frame.exists() && mask.exists());
    desk.import(&["-f", "--masks", "."]).fails(3, &["masks/cam01/00005.png", "move them away"]);
    assert!(frame.exists() && mask.exists());
}

#[cfg(unix)]
#[test]
fn an_import_that_is_stopped_ends_its_programs_and_goes_on() {
    let desk = Desk::new().all();
    fs::write(desk.at("slow"), "").unwrap();
    let mut child = desk.command(&["-q"]).stderr(std::process::Stdio::piped()).spawn().unwrap();
    let begun = std::time::Instant::now();
    while !desk.at("begun").exists() && begun.elapsed().as_secs() < 60 {
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    let id = child.id().to_string();
    assert!(std::process::Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    let status = child.wait().unwrap();
    assert_eq!(status.code(), Some(130));
    assert!(begun.elapsed().as_secs() < 50, "the program is not waited for");
    fs::remove_file(desk.at("slow")).unwrap();
    let extracted = desk.calls("feature_extractor");
    let done = desk.import(&[]);
    assert!(done.out.contains("now: gs4d train data"), "{}{}", done.out, done.err);
    assert_eq!(desk.calls("feature_extractor"), extracted, "features are not found again");
}

/// Films by `n` cameras, `degrees` from the first to the last, of a moving scene, imported by the real programs and trained on: the mean
/// PSNR of the held-out views.
fn of_films(n: usize, degrees: f64, steps: &str, more: &[&str]) -> Option<f64> {
    if !(has("ffmpeg", "-version") && has("colmap", "help")) {
        println!("SKIPPED import::films_of_{n}: ffmpeg and colmap are not both installed");
        return None;
    }
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let film = |k: usize| {
        let camera = arc(k as f64, n as f64, degrees, [320, 240]);
        let frames: Vec<_> = (0..40).map(|i| picture(&camera, f64::from(i) / f64::from(FPS))).collect();
        let file = at(&format!("{k}.mp4"));
        write_video(&file, &frames).unwrap();
        text(&file).to_owned()
    };
    let videos: Vec<String> = (0..n).map(film).collect();
    let (data, run) = (at("data"), at("run"));
    let mut all = vec!["import", "-o", text(&data), "--moments", "2"];
    all.extend(more.iter().copied().chain(videos.iter().map(String::as_str)));
    let call = gs4d(&all);
    println!("{}{}", call.err, call.out);
    assert_eq!(call.code, 0);
    let psnr = trained(&data, &run, &["-m", "fourdgs", "--steps", steps]);
    println!("{n} films: {psnr:.2} dB at held-out views");
    Some(psnr)
}

/// One of the six cameras is held out.
#[test]
#[ignore = "COLMAP and training take minutes: cargo test -p gs4d --test cli import::films -- --ignored --nocapture"]
fn films_of_six_cameras_become_a_scene() {
    of_films(6, 75.0, "6000", &[]).into_iter().for_each(|psnr| assert!(psnr >= 25.0, "{psnr}"));
}

/// Every eighth frame is held out.
#[test]
#[ignore = "COLMAP and training take minutes: cargo test -p gs4d --test cli import::films -- --ignored --nocapture"]
fn films_of_two_cameras_become_a_scene() {
    let fov = 0.9f64.to_degrees().to_string();
    of_films(2, 15.0, "2400", &["--fov", &fov]).into_iter().for_each(|psnr| assert!(psnr >= 25.0, "{psnr}"));
}

/// Pictures of a scene at rest in no order, with masks, imported by the real program and trained on.
#[test]
#[ignore = "COLMAP and training take minutes: cargo test -p gs4d --test cli import::pictures -- --ignored --nocapture"]
fn pictures_without_order_become_a_scene() {
    if !has("colmap", "help") {
        println!("SKIPPED pictures_without_order_become_a_scene: colmap is not installed");
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let (pictures, masks) = (at("pictures"), at("masks"));
    [&pictures, &masks].iter().for_each(|folder| fs::create_dir(folder).unwrap());
    let half = |k: usize| if k % 320 < 300 { 1.0 } else { 0.0 };
    let mask: Vec<f32> = (0..320 * 240).flat_map(|k| [half(k); 3]).collect();
    let mask = gs_core::Image { width: 320, height: 240, channels: 3, data: mask };
    for k in 0..24 {
        // Names that say nothing about where a picture was taken.
        let name = format!("{}.png", (k * 7919) % 1009);
        let camera = arc(f64::from(k), 24.0, 80.0, [320, 240]);
        gs_core::io::images::save_png(&pictures.join(&name), &picture(&camera, 0.0), false).unwrap();
        gs_core::io::images::save_png(&masks.join(&name), &mask, false).unwrap();
    }
    let (data, run) = (at("data"), at("run"));
    let what = ["--images", text(&pictures), "--unordered", "--masks", text(&masks)];
    let call = gs4d(&[&["import", "-o", text(&data)], &what[..]].concat());
    println!("{}{}", call.err, call.out);
    assert_eq!(call.code, 0);
    let read: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(data.join("transforms.json")).unwrap()).unwrap();
    let frames = read["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 24, "every picture has a place");
    assert!(frames.iter().all(|f| f.get("time").is_none() && data.join(f["mask_path"].as_str().unwrap()).is_file()));
    let masked = ["-m", "static3d", "--steps", "3000", "--set", "data.mask_loss=true"];
    let psnr = trained(&data, &run, &masked);
    assert!(psnr >= 25.0, "{psnr}");
}

/// Trains, and gives the mean PSNR of the held-out views, where masks count.
fn trained(data: &Path, run: &Path, more: &[&str]) -> f64 {
    let call = gs4d(&[&["train", text(data), "--preset", "fast", "-o", text(run), "--quiet"], more].concat());
    assert_eq!(call.code, 0, "{}", call.err);
    println!("{}", call.out);
    let scores = gs4d(&["eval", text(run), "--json"]).json();
    let mean = &scores["mean"];
    mean.pointer("/masked/psnr").unwrap_or(&mean["psnr"]).as_f64().unwrap()
}
