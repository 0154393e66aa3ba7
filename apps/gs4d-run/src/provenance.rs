//! Provenance of a run: what is needed to repeat it, and the machine its seconds were measured on.

use crate::folder::{CONFIG, PROVENANCE, RunFolder};
use crate::{Resolved, RunError};
use gs_data::{Dataset, ImageSource};
use gs_raster::SimdLevel;
use gs_train::device::CPU;
use serde::Serialize;
use serde_json::{Value, json};
use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

/// The machine and the program version.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Machine {
    /// Version of this crate.
    pub(crate) version: &'static str,
    /// Commit that it was built from, where that is known.
    pub(crate) commit: Option<&'static str>,
    /// Model name of the processor.
    pub(crate) cpu: String,
    /// Threads of the rayon pool.
    pub(crate) threads: usize,
    /// Instruction set of the rasteriser.
    pub(crate) simd: String,
    /// Device that frames are rendered on ([`note_device`]).
    pub(crate) device: &'static str,
    /// Operating system and architecture.
    pub(crate) system: String,
}

/// The data set of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct DataOrigin {
    /// Path of the folder; empty for data generated in memory.
    pub(crate) root: String,
    /// Name of the layout.
    pub(crate) layout: &'static str,
    /// Hash of names, cameras, times, image paths and parts of the images of all views.
    pub(crate) digest: String,
    /// Hash of normalised times, lenses and parts of the depth maps of all views.
    pub(crate) details: String,
    /// Source of the times, in words.
    pub(crate) time_source: String,
    /// Numbers of training, validation and test views.
    pub(crate) views: [usize; 3],
    /// Number of views beyond the last training time.
    pub(crate) extrapolate: usize,
    /// Assumptions made while reading.
    pub(crate) notes: Vec<String>,
}

/// Commit that the program was built from: of the git checkout, or of `GS4D_COMMIT` in the environment of the build.
pub const COMMIT: Option<&str> = option_env!("GS4D_COMMIT");

impl Machine {
    /// This machine, with the rayon pool in scope.
    pub(crate) fn here() -> Self {
        let level = gs_raster::simd::level(SimdLevel::Auto);
        Self {
            version: env!("CARGO_PKG_VERSION"),
            commit: COMMIT,
            cpu: cpu_name(),
            threads: rayon::current_num_threads(),
            simd: gs_raster::simd::level_name(level),
            device: CPU,
            system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
        }
    }
}

impl DataOrigin {
    /// Describes a data set.
    pub(crate) fn of(dataset: &Dataset) -> Self {
        Self {
            root: dataset.root.display().to_string(),
            layout: dataset.layout,
            digest: digest(dataset),
            details: details(dataset),
            time_source: dataset.time_source.clone(),
            views: [dataset.train.len(), dataset.val.len(), dataset.test.len()],
            extrapolate: dataset.extrapolate.len(),
            notes: dataset.notes.clone(),
        }
    }
}

/// The provenance of a run of so many steps that begins now; `config` is the text of its settings.
pub(crate) fn begun(resolved: &Resolved, config: &str, dataset: &Dataset, steps: u32) -> Value {
    json!({
        "machine": Machine::here(),
        "started": now_utc(),
        "method": resolved.run.method,
        "preset": resolved.run.preset,
        "seed": resolved.run.seed,
        "steps": steps,
        "settings": settings(config),
        "weight_files": weight_files(config),
        "data": DataOrigin::of(dataset),
    })
}

/// Hash of settings, without what changes no result: where the data are, and how many images are kept in memory. `None` if it is not
/// TOML.
fn settings(config: &str) -> Option<String> {
    let mut table: toml::Table = config.parse().ok()?;
    if let Some(run) = table.get_mut("run").and_then(toml::Value::as_table_mut) {
        run.retain(|key, _| !["data", "image_mib"].contains(&key));
    }
    let mut hash = Fnv::default();
    hash.feed(json!(table).to_string().as_bytes());
    Some(hash.text())
}

/// Hash of lengths and parts of the weight files that settings name, `schedule.mrf_weights` say; `None` if they name none.
fn weight_files(config: &str) -> Option<String> {
    let table: toml::Table = config.parse().ok()?;
    let settings = table.values().filter_map(toml::Value::as_table).flatten();
    let file = |(key, value): (&String, &toml::Value)| {
        Some(sample(Path::new(value.as_str().filter(|file| key.ends_with("_weights") && !file.is_empty())?)))
    };
    let files: Vec<Vec<u8>> = settings.filter_map(file).collect();
    let mut hash = Fnv::default();
    files.iter().for_each(|file| hash.feed(file));
    (!files.is_empty()).then(|| hash.text())
}

/// Compares the text of the settings with what sessions of the run have written.
///
/// # Errors
/// [`RunError::SettingsChanged`] if none wrote these. Older runs know of none.
pub(crate) fn check_settings(folder: &RunFolder, config: &str) -> Result<(), RunError> {
    let provenance = read(folder).unwrap_or_default();
    let sessions = provenance["resumed"].as_array().into_iter().flatten();
    let known: Vec<&str> = sessions.chain([&provenance]).filter_map(|s| s["settings"].as_str()).collect();
    match settings(config) {
        Some(now) if !known.is_empty() && !known.contains(&now.as_str()) => {
            Err(RunError::SettingsChanged { path: folder.root().join(CONFIG) })
        }
        _ => Ok(()),
    }
}

/// A session that goes on with a run.
pub(crate) struct Session {
    /// The provenance with an entry for this session, to be written once it has begun; `None` if there was none to be read.
    pub(crate) provenance: Option<String>,
    /// What a user should know.
    pub(crate) warnings: Vec<String>,
}

/// Compares data and machine with those of the last session of a run, which goes on from a step with the second of these settings; the
/// first are those in its folder.
///
/// # Errors
/// [`RunError::DataChanged`] if the data are not those that the run was trained on last, unless that is accepted.
pub(crate) fn resumed(
    folder: &RunFolder,
    dataset: &Dataset,
    step: u32,
    [before, config]: [&str; 2],
    accept_changed_data: bool,
) -> Result<Session, RunError> {
    // A run whose provenance was lost can go on; there is nothing to compare with.
    let Some(mut provenance) = read(folder) else {
        let warnings = vec![format!("{PROVENANCE} cannot be read: whether the data are the same is not known")];
        return Ok(Session { provenance: None, warnings });
    };
    let (machine, DataOrigin { digest, details, .. }) = (Machine::here(), DataOrigin::of(dataset));
    let known_simd = known(&provenance, "/machine/simd", "/machine/simd");
    let mut warnings = Vec::new();
    if is_of(&provenance, &digest, &details) == Some(false) {
        if !accept_changed_data {
            return Err(RunError::DataChanged { path: dataset.root.clone(), run: folder.root().to_owned() });
        }
        warnings.push("the data are not those that the run began with".to_owned());
    }
    if let Some(known) = known_simd.filter(|known| *known != machine.simd) {
        warnings.push(format!(
            "the run was trained with {known}, this machine has {}: from here on its bits are not those of a run that was \
             never interrupted",
            machine.simd
        ));
    }
    let weight_files = weight_files(config);
    if known(&provenance, "/weight_files", "/weight_files").is_some_and(|known| weight_files.as_ref() != Some(&known)) {
        warnings.push("the weight files are not those that the run was trained with".to_owned());
    }
    if let Some(map) = provenance.as_object_mut() {
        // Older runs do not say which they are. A session that ends before it has written its own leaves these in place.
        if map.get("settings").is_none_or(Value::is_null) {
            map.insert("settings".to_owned(), json!(settings(before)));
        }
        let sessions = map.entry("resumed").or_insert_with(|| json!([]));
        let session = json!({
            "step": step, "at": now_utc(), "machine": machine, "settings": settings(config), "weight_files": weight_files,
            "digest": digest, "details": details,
        });
        sessions.as_array_mut().into_iter().for_each(|s| s.push(session.clone()));
    }
    Ok(Session { provenance: Some(format!("{provenance:#}\n")), warnings })
}

/// What the last session of a run wrote down at a place of its entry, or the first at its own.
fn known(provenance: &Value, in_session: &str, at_first: &str) -> Option<String> {
    let last = provenance["resumed"].as_array().and_then(|a| a.last());
    let text = last.and_then(|session| session.pointer(in_session)?.as_str());
    text.or_else(|| provenance.pointer(at_first)?.as_str()).map(str::to_owned)
}

/// Whether a run was trained last on the data with these hashes; `None` if its provenance has no digest.
fn is_of(provenance: &Value, digest: &str, details: &str) -> Option<bool> {
    let known_digest = known(provenance, "/digest", "/data/digest")?;
    // Older runs have no details.
    let known_details = known(provenance, "/details", "/data/details");
    Some(known_digest == digest && known_details.is_none_or(|known| known == details))
}

/// Whether a run was trained last on these data; `None` if that is not known: its provenance is lost, or is that of the first of
/// several rounds.
pub(crate) fn trained_on(folder: &RunFolder, dataset: &Dataset) -> Option<bool> {
    let provenance = read(folder).filter(|p| p["rounds"].is_null())?;
    is_of(&provenance, &digest(dataset), &details(dataset))
}

/// Hashes of a data set: of views and images, and of normalised times, lenses and depth maps.
pub fn origin(dataset: &Dataset) -> [String; 2] {
    [digest(dataset), details(dataset)]
}

/// Processor, number of threads and device of every session of a run; empty where that is not known.
pub fn machines(folder: &RunFolder) -> Vec<String> {
    let provenance = read(folder).unwrap_or_default();
    let sessions = provenance["resumed"].as_array().into_iter().flatten().map(|session| &session["machine"]);
    let text = |m: &Value| {
        let device = m["device"].as_str().filter(|d| *d != CPU).map_or(String::new(), |d| format!(", {d}"));
        Some(format!("{}, {} threads{device}", m["cpu"].as_str()?, m["threads"]))
    };
    std::iter::once(&provenance["machine"]).chain(sessions).filter_map(text).collect()
}

/// Digest of the data that a run was trained on last.
pub(crate) fn known_digest(folder: &RunFolder) -> Option<String> {
    known(&read(folder)?, "/digest", "/data/digest")
}

fn read(folder: &RunFolder) -> Option<Value> {
    serde_json::from_str(&folder.read(PROVENANCE).ok()?).ok()
}

/// Writes the device of the present session into the provenance of a run; a warning if the session before had another. Files
/// without a device are of the CPU.
///
/// # Errors
/// If the file cannot be written.
pub(crate) fn note_device(folder: &RunFolder, device: &str) -> Result<Option<String>, RunError> {
    let Some(mut provenance) = read(folder) else { return Ok(None) };
    let present = provenance["resumed"].as_array().map_or(0, Vec::len);
    let machine = |session: usize| match session {
        0 => "/machine".to_owned(),
        n => format!("/resumed/{}/machine", n - 1),
    };
    let device_of = |session: usize| {
        let machine = provenance.pointer(&machine(session)).and_then(|m| m["device"].as_str());
        machine.unwrap_or(CPU).to_owned()
    };
    let before = present.checked_sub(1).map(device_of).filter(|before| before != device);
    if device_of(present) != device
        && let Some(machine) = provenance.pointer_mut(&machine(present)).and_then(Value::as_object_mut)
    {
        machine.insert("device".to_owned(), json!(device));
        folder.write(PROVENANCE, &format!("{provenance:#}\n"))?;
    }
    let warning = |before| {
        format!(
            "the run was rendered on {before} and goes on on {device}: from here on its bits are not those of one device"
        )
    };
    Ok(before.map(warning))
}

/// Bytes of a file that are hashed at its beginning, its middle and its end.
const SAMPLE: usize = 4096;

/// Length of a file, and parts of it; nothing of a file that cannot be read.
fn sample(path: &Path) -> Vec<u8> {
    let read = || {
        let (mut file, mut out) = (File::open(path)?, Vec::new());
        let length = file.metadata()?.len();
        out.extend(length.to_le_bytes());
        for start in [0, length / 2, length.saturating_sub(SAMPLE as u64)] {
            file.seek(SeekFrom::Start(start))?;
            (&mut file).take(SAMPLE as u64).read_to_end(&mut out)?;
        }
        Ok::<_, std::io::Error>(out)
    };
    if path.is_file() { read().unwrap_or_default() } else { Vec::new() }
}

/// 64-bit FNV-1a over names, cameras, times, image paths (relative to the folder) and parts of the images of all views: the
/// same for the same data wherever the folder stands.
pub(crate) fn digest(dataset: &Dataset) -> String {
    let mut hash = Fnv::default();
    let mut feed = |bytes: &[u8]| hash.feed(bytes);
    feed(dataset.layout.as_bytes());
    for (split, views) in [(0u8, &dataset.train), (1, &dataset.val), (2, &dataset.test), (3, &dataset.extrapolate)] {
        for view in views {
            feed(&[split]);
            feed(view.name.as_bytes());
            for image in [Some(&view.image), view.mask.as_ref()].into_iter().flatten() {
                match image {
                    ImageSource::File(path) => {
                        feed(path.strip_prefix(&dataset.root).unwrap_or(path).as_os_str().as_encoded_bytes());
                        feed(&sample(path));
                    }
                    ImageSource::Memory(image) => feed(&image.data),
                }
            }
            // Which pixels count; nothing is fed where all do.
            for (on, name) in [(view.cut_out, "cut_out"), (view.mask_loss, "mask_loss")] {
                feed(if on { name.as_bytes() } else { &[] });
            }
            let c = &view.camera;
            feed(&[c.width, c.height].map(u32::to_le_bytes).concat());
            let pose = c.rotation.to_cols_array().into_iter().chain(c.translation.to_array());
            for v in pose.chain([c.fx, c.fy, c.cx, c.cy, view.time.seconds]) {
                feed(&v.to_bits().to_le_bytes());
            }
        }
    }
    hash.text()
}

/// The same over normalised times, lenses and parts of the depth maps of all views.
fn details(dataset: &Dataset) -> String {
    let mut hash = Fnv::default();
    for view in [&dataset.train, &dataset.val, &dataset.test, &dataset.extrapolate].into_iter().flatten() {
        hash.feed(&view.time.normalised.to_bits().to_le_bytes());
        view.lens.unwrap_or_default().to_array().iter().for_each(|k| hash.feed(&k.to_bits().to_le_bytes()));
        view.depth.iter().for_each(|map| hash.feed(&sample(&map.file)));
    }
    hash.text()
}

/// 64-bit FNV-1a.
struct Fnv(u64);

impl Default for Fnv {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Fnv {
    fn feed(&mut self, bytes: &[u8]) {
        for &b in bytes {
            self.0 = (self.0 ^ u64::from(b)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }

    fn text(&self) -> String {
        format!("{:016x}", self.0)
    }
}

fn cpu_name() -> String {
    let info = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = info.lines().find_map(|l| l.strip_prefix("model name")?.split_once(':').map(|(_, n)| n.trim()));
    name.unwrap_or(std::env::consts::ARCH).to_owned()
}

/// Peak resident memory of this process, MiB; `None` where `/proc` does not exist.
pub(crate) fn peak_memory_mib() -> Option<f64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    let kib: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib / 1024.0)
}

/// The current time in UTC, for example `2026-11-20T21:18:00Z`.
pub(crate) fn now_utc() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    utc(seconds)
}

/// Seconds since 1970 as date and time; the calendar is that of Howard Hinnant's `civil_from_days`.
fn utc(seconds: u64) -> String {
    let (days, rest) = (seconds / 86_400 + 719_468, seconds % 86_400);
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 { shifted + 3 } else { shifted - 9 };
    let year = year_of_era + era * 400 + u64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}T{:02}:{:02}:{:02}Z", rest / 3600, rest / 60 % 60, rest % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates() {
        let cases = [
            (0, "1970-01-01T00:00:00Z"),
            (951_782_399, "2000-02-28T23:59:59Z"),
            (951_782_400, "2000-02-29T00:00:00Z"),
            (1_000_000_000, "2001-09-09T01:46:40Z"),
            (4_102_444_800, "2100-01-01T00:00:00Z"),
        ];
        for (seconds, want) in cases {
            assert_eq!(utc(seconds), want);
        }
    }

    #[test]
    fn weight_files_are_known_by_what_they_hold() {
        let dir = tempfile::tempdir().unwrap();
        let of = |name: &str, held: &str| {
            let file = dir.path().join(name);
            fs::write(&file, held).unwrap();
            weight_files(&format!("[schedule]\nmrf_weights = '{}'\n", file.display()))
        };
        let first = of("a", "one");
        assert!(first.is_some() && first == of("b", "one") && first != of("a", "two"));
        assert_eq!(weight_files("[schedule]\nmrf_weights = \"\"\nsteps = 3\n"), None);
    }

    #[test]
    fn this_machine_has_a_name() {
        let here = Machine::here();
        assert!(!here.cpu.is_empty() && here.threads > 0 && !here.simd.is_empty());
        #[cfg(target_os = "linux")]
        assert!(peak_memory_mib().unwrap() > 1.0);
    }
}
