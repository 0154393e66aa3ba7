//! A table of a paper: what is trained on what, and the published figures.

use crate::column::{Column, PsnrMean};
use crate::network::Network;
use crate::nightly::Nightly;
use gs_metrics::LpipsRange;
use gs4d_lab::contest::Entry;
use serde::Deserialize;
use std::collections::BTreeMap;

/// The files, each with the name `PAPER-TABLE`.
const FILES: &[(&str, &str)] = &[
    ("fags-dnerf", include_str!("../tables/fags-dnerf.toml")),
    ("fags-neu3d", include_str!("../tables/fags-neu3d.toml")),
    ("fags-hypernerf-interp", include_str!("../tables/fags-hypernerf-interp.toml")),
    ("fags-hypernerf-vrig", include_str!("../tables/fags-hypernerf-vrig.toml")),
    ("fags-ablation", include_str!("../tables/fags-ablation.toml")),
    ("modec-iphone", include_str!("../tables/modec-iphone.toml")),
    ("modec-hypernerf-interp", include_str!("../tables/modec-hypernerf-interp.toml")),
    ("modec-hypernerf-misc", include_str!("../tables/modec-hypernerf-misc.toml")),
    ("modec-hypernerf-vrig", include_str!("../tables/modec-hypernerf-vrig.toml")),
    ("modec-hypernerf-nerfs", include_str!("../tables/modec-hypernerf-nerfs.toml")),
    ("modec-stages", include_str!("../tables/modec-stages.toml")),
    ("modec-motion", include_str!("../tables/modec-motion.toml")),
    ("modec-nvidia", include_str!("../tables/modec-nvidia.toml")),
    ("modec-dnerf", include_str!("../tables/modec-dnerf.toml")),
    ("modec-panoptic", include_str!("../tables/modec-panoptic.toml")),
    ("modec-settings", include_str!("../tables/modec-settings.toml")),
    ("modec-ablation", include_str!("../tables/modec-ablation.toml")),
    ("trace-object", include_str!("../tables/trace-object.toml")),
    ("trace-indoor", include_str!("../tables/trace-indoor.toml")),
    ("trace-real", include_str!("../tables/trace-real.toml")),
    ("trace-multipart", include_str!("../tables/trace-multipart.toml")),
    ("trace-ablation-object", include_str!("../tables/trace-ablation-object.toml")),
    ("trace-ablation-indoor", include_str!("../tables/trace-ablation-indoor.toml")),
    ("trace-ablation-multipart", include_str!("../tables/trace-ablation-multipart.toml")),
    ("trace-segments-indoor", include_str!("../tables/trace-segments-indoor.toml")),
    ("trace-segments-basketball", include_str!("../tables/trace-segments-basketball.toml")),
    ("trace-continual", include_str!("../tables/trace-continual.toml")),
    ("trace-continual-panoptic", include_str!("../tables/trace-continual-panoptic.toml")),
    ("dut-stages", include_str!("../tables/dut-stages.toml")),
    ("dut-parts", include_str!("../tables/dut-parts.toml")),
    ("dut-runtime", include_str!("../tables/dut-runtime.toml")),
    ("dut-mocap", include_str!("../tables/dut-mocap.toml")),
];

/// A table of a paper.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Table {
    /// `fags`, `modec`, `trace` or `dut`; from the name of the file.
    #[serde(skip)]
    pub paper: String,
    /// Name within the paper; from the name of the file.
    #[serde(skip)]
    pub name: String,
    /// What it shows.
    pub title: String,
    /// Where it is printed.
    pub source: String,
    /// Name of the [`DataSet`](crate::DataSet) of its scenes; absent where `command` needs none of the paper's.
    #[serde(default)]
    pub data: Option<String>,
    /// Under which conditions the published figures were measured.
    pub protocol: String,
    /// Settings of all entries, `KEY=VALUE`; those of `data` on the paper's data alone.
    #[serde(default)]
    pub sets: Vec<String>,
    /// Names of the columns; the first decides the order of methods.
    pub columns: Vec<String>,
    /// Network and range of each column of LPIPS.
    #[serde(default)]
    pub networks: BTreeMap<String, Network>,
    /// Which mean over images the paper's PSNR is.
    #[serde(default)]
    pub psnr: PsnrMean,
    /// What a reader must know of the published figures.
    #[serde(default)]
    pub remark: Option<String>,
    /// The command that makes our side of a table that no contest makes.
    #[serde(default)]
    pub command: Option<String>,
    /// How the nightly job runs it; absent where it does not.
    #[serde(default)]
    pub nightly: Option<Nightly>,
    /// The rows. The others are compared with the first.
    pub entries: Vec<TableEntry>,
    /// Published means over scenes by entry, in the order of the columns; figures that are not printed are absent or NaN.
    #[serde(default)]
    pub average: BTreeMap<String, Vec<f64>>,
    /// The scenes.
    #[serde(default)]
    pub scenes: Vec<Scene>,
}

/// A method of a table.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TableEntry {
    /// Name in the paper.
    pub name: String,
    /// `METHOD [KEY=VALUE …]`; absent for a method that is not in gs4d.
    #[serde(default)]
    pub run: Option<String>,
    /// Preset of the published recipe.
    #[serde(default = "paper_preset")]
    pub preset: String,
    /// The entry whose [`Scene::recipe`] this one has, too.
    #[serde(default)]
    pub recipe_of: Option<String>,
}

/// A scene of a table.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Name, and that of its folder.
    pub name: String,
    /// Other names of its folder.
    #[serde(default)]
    pub also: Vec<String>,
    /// Settings of all entries on this scene, `KEY=VALUE`.
    #[serde(default)]
    pub sets: Vec<String>,
    /// Settings of single entries on this scene, `KEY=VALUE` by name of the entry.
    #[serde(default)]
    pub own: BTreeMap<String, Vec<String>>,
    /// What the published recipe of an entry is on this scene where its preset differs, `KEY=VALUE` by name of the entry. Lengths in steps are among it,
    /// so it counts only where the recipe is run at its published length.
    #[serde(default)]
    pub recipe: BTreeMap<String, Vec<String>>,
    /// Published figures by entry, as those of [`Table::average`].
    #[serde(default)]
    pub published: BTreeMap<String, Vec<f64>>,
}

fn paper_preset() -> String {
    "paper".to_owned()
}

/// Why there is no such table.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// A file of this crate is wrong.
    #[error("table {name}: {why}")]
    Wrong {
        /// Name of the file.
        name: String,
        /// What is wrong.
        why: String,
    },
    /// No table of that name.
    #[error("there is no table `{name}`; there are {known}")]
    Unknown {
        /// The name asked for.
        name: String,
        /// The names there are.
        known: String,
    },
}

impl Table {
    /// Every table, in the order of the papers.
    ///
    /// # Errors
    /// [`TableError::Wrong`].
    pub fn all() -> Result<Vec<Self>, TableError> {
        FILES.iter().map(|(name, text)| Self::parse(name, text)).collect()
    }

    /// The table `name` of `paper`.
    ///
    /// # Errors
    /// [`TableError::Unknown`] names those there are.
    pub fn find(paper: &str, name: &str) -> Result<Self, TableError> {
        let all = Self::all()?;
        let full = format!("{paper}-{name}");
        let known = || all.iter().map(|t| format!("{} {}", t.paper, t.name)).collect::<Vec<_>>().join(", ");
        let unknown = || TableError::Unknown { name: format!("{paper} {name}"), known: known() };
        all.iter().find(|t| t.full_name() == full).cloned().ok_or_else(unknown)
    }

    /// `PAPER-TABLE`.
    pub fn full_name(&self) -> String {
        format!("{}-{}", self.paper, self.name)
    }

    fn parse(full: &str, text: &str) -> Result<Self, TableError> {
        let wrong = |why: String| TableError::Wrong { name: full.to_owned(), why };
        let (paper, name) = full.split_once('-').ok_or_else(|| wrong("no PAPER-TABLE".into()))?;
        let table: Self = toml::from_str(text).map_err(|e| wrong(e.to_string()))?;
        let table = Self { paper: paper.to_owned(), name: name.to_owned(), ..table };
        table.check().map_err(wrong)?;
        Ok(table)
    }

    /// Whether entries can be read, figures belong to entries and columns, and what is run has data and known columns.
    fn check(&self) -> Result<(), String> {
        if self.data.is_none() && self.command.is_none() {
            return Err("a table has data or a command".into());
        }
        if self.command.is_some() && self.runnable().next().is_some() {
            return Err("a table of a command has entries to run".into());
        }
        let known = |name: &String| self.entries.iter().any(|e| e.name == *name);
        let figures = self.scenes.iter().flat_map(|s| &s.published).chain(&self.average);
        for (entry, values) in figures {
            if !known(entry) || values.len() > self.columns.len() {
                return Err(format!("figures of {entry} belong to no entry or column"));
            }
        }
        for entry in self.runnable() {
            entry.contest_entry("fast", &[])?;
        }
        if let Some(entry) = self.runnable().find(|e| e.name.contains(',')) {
            return Err(format!("the name {} cannot stand in a list with commas", entry.name));
        }
        let of_scenes = self.scenes.iter().flat_map(|s| s.own.keys().chain(s.recipe.keys()));
        if let Some(entry) = of_scenes.chain(self.entries.iter().flat_map(|e| &e.recipe_of)).find(|e| !known(e)) {
            return Err(format!("settings of {entry} belong to no entry"));
        }
        self.check_columns()
    }

    /// Whether columns are known, those of LPIPS and no others have a network, and PSNR has a mean that is measured.
    fn check_columns(&self) -> Result<(), String> {
        if let Some(column) = self.networks.keys().find(|c| !self.columns.contains(c)) {
            return Err(format!("the network of {column} belongs to no column"));
        }
        for name in self.columns.iter().filter(|_| self.command.is_none()) {
            let column = Column::named(name).ok_or_else(|| format!("no contest has the column {name}"))?;
            match self.networks.get(name) {
                None if column.is_lpips() => return Err(format!("the column {name} names no network")),
                Some(_) if !column.is_lpips() => return Err(format!("the column {name} takes no network")),
                Some(network) if column.is_masked() && network.range != LpipsRange::Signed => {
                    return Err(format!("{name} is measured in -1..1 alone, not with {network}"));
                }
                _ => {}
            }
            if column.is_masked() && self.psnr == PsnrMean::MeanError {
                return Err(format!("{name} has no PSNR of the mean error"));
            }
        }
        Ok(())
    }

    /// The columns that contests measure, on the table's own scenes or on generated ones.
    pub(crate) fn measured_columns(&self, generated: bool) -> Vec<Column> {
        let columns = self.columns.iter().filter_map(|c| Column::named(c)).map(|c| c.with_mean(self.psnr));
        columns.map(|c| if generated { c.on_generated() } else { c }).collect()
    }

    /// The published figure of an entry on a scene in a column.
    pub fn published(&self, scene: &Scene, entry: &str, column: usize) -> Option<f64> {
        figure(&scene.published, entry, column)
    }

    /// The published mean over scenes of an entry in a column.
    pub fn published_average(&self, entry: &str, column: usize) -> Option<f64> {
        figure(&self.average, entry, column)
    }

    /// The entries that gs4d can train.
    pub fn runnable(&self) -> impl Iterator<Item = &TableEntry> {
        self.entries.iter().filter(|e| e.run.is_some())
    }
}

fn figure(figures: &BTreeMap<String, Vec<f64>>, entry: &str, column: usize) -> Option<f64> {
    figures.get(entry)?.get(column).copied().filter(|v| v.is_finite())
}

impl TableEntry {
    /// Settings of the published recipe on a scene.
    pub(crate) fn recipe<'a>(&self, scene: &'a Scene) -> &'a [String] {
        scene.recipe.get(self.recipe_of.as_ref().unwrap_or(&self.name)).map_or(&[], Vec::as_slice)
    }

    /// The entry of a contest with a preset and further settings.
    ///
    /// # Errors
    /// If it is no `METHOD [KEY=VALUE …]`.
    pub fn contest_entry(&self, preset: &str, sets: &[String]) -> Result<Entry, String> {
        let run = self.run.as_deref().unwrap_or_default();
        let (method, own) = run.split_once(' ').unwrap_or((run, ""));
        Entry::parse(&format!("{method}:{preset} {own} {}", sets.join(" ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_tables_can_be_read_and_each_file_is_listed() {
        let all = Table::all().unwrap();
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tables");
        let files = std::fs::read_dir(folder).unwrap().map(|f| f.unwrap().file_name().into_string().unwrap());
        let mut files: Vec<String> = files.filter(|f| f != "data.toml").collect();
        files.sort();
        let mut listed: Vec<String> = all.iter().map(|t| format!("{}.toml", t.full_name())).collect();
        listed.sort();
        assert_eq!(files, listed);
    }

    /// What gs4d is asked to train must be settings of the method, with both presets.
    #[test]
    fn every_entry_resolves() {
        let registry = gs_methods::registry();
        for table in Table::all().unwrap() {
            for entry in table.runnable() {
                let of_scenes = table.scenes.iter().flat_map(|s| s.own.get(&entry.name).into_iter().chain([&s.sets]));
                let of_scenes: Vec<String> = of_scenes.flatten().cloned().collect();
                for preset in ["fast", &entry.preset] {
                    let method = entry.run.as_deref().unwrap().split(' ').next().unwrap();
                    let sets = entry.run.as_deref().unwrap().split(' ').skip(1).map(str::to_owned);
                    let request = gs4d_run::settings::Request {
                        method: method.into(),
                        preset: preset.into(),
                        sets: table.sets.iter().cloned().chain(sets).chain(of_scenes.clone()).collect(),
                        ..Default::default()
                    };
                    let resolved = |request: &gs4d_run::settings::Request| {
                        gs4d_run::settings::resolve(registry, request)
                            .unwrap_or_else(|e| panic!("{}: {}: {e}", table.full_name(), entry.name))
                    };
                    let plain = resolved(&request);
                    for scene in table.scenes.iter().filter(|_| preset == entry.preset) {
                        let recipe = entry.recipe(scene).to_vec();
                        let own = resolved(&gs4d_run::settings::Request { sets: recipe.clone(), ..request.clone() });
                        let same = |set: &&String| {
                            let key = set.split('=').next().unwrap_or_default();
                            plain.config.get(key).map(|s| &s.value) == own.config.get(key).map(|s| &s.value)
                        };
                        assert_eq!(
                            recipe.iter().find(same),
                            None,
                            "{} {}: no difference",
                            table.full_name(),
                            scene.name
                        );
                    }
                }
            }
        }
    }

    /// The settings of the entries of a table with their own presets, or `fast`, by name.
    fn recipes(table: &Table, fast: bool) -> Vec<(String, gs4d_run::Resolved)> {
        let recipe = |entry: &TableEntry| {
            let mut words = entry.run.as_deref().unwrap().split(' ').map(str::to_owned);
            let request = gs4d_run::settings::Request {
                method: words.next().unwrap(),
                preset: if fast { "fast".into() } else { entry.preset.clone() },
                sets: table.sets.iter().cloned().chain(words).collect(),
                ..Default::default()
            };
            (entry.name.clone(), gs4d_run::settings::resolve(gs_methods::registry(), &request).unwrap())
        };
        table.runnable().map(recipe).collect()
    }

    /// Entries with one recipe would be one training, counted twice; over several backgrounds they would not be scored on the same images.
    #[test]
    fn entries_of_a_table_differ_and_have_one_background() {
        for table in Table::all().unwrap() {
            for fast in [true, false] {
                let recipes = recipes(&table, fast);
                for (k, (name, recipe)) in recipes.iter().enumerate() {
                    let background =
                        |r: &gs4d_run::Resolved| r.config.get("schedule.background").unwrap().value.clone();
                    let twin = recipes[..k].iter().find(|(_, other)| other.trains_as(recipe));
                    assert!(twin.is_none(), "{}: {name} is {}", table.full_name(), twin.unwrap().0);
                    assert_eq!(background(recipe), background(&recipes[0].1), "{}: {name}", table.full_name());
                }
            }
        }
    }

    /// The printed averages are means of the printed rows, where all rows are printed; cells that are known to be wrong are named.
    #[test]
    fn averages_are_means_of_their_rows() {
        // Printed averages that do not follow from their rows.
        const KNOWN: [(&str, &str, &str); 2] =
            [("fags-dnerf", "SC-GS", "psnr"), ("modec-hypernerf-interp", "MoDec-GS", "lpips")];
        let mut checked = 0;
        for table in Table::all().unwrap() {
            for (entry, column) in table.entries.iter().flat_map(|e| (0..table.columns.len()).map(move |c| (e, c))) {
                let rows: Option<Vec<f64>> =
                    table.scenes.iter().map(|s| table.published(s, &entry.name, column)).collect();
                let Some((rows, average)) = rows.zip(table.published_average(&entry.name, column)) else { continue };
                if rows.is_empty() || KNOWN.contains(&(table.full_name().as_str(), &entry.name, &table.columns[column]))
                {
                    continue;
                }
                let mean = rows.iter().sum::<f64>() / rows.len() as f64;
                let unit = 10f64.powi(-i32::try_from(Column::named(&table.columns[column]).unwrap().digits).unwrap());
                let within = (0.6 * unit).max(4e-3 * average.abs());
                assert!((mean - average).abs() <= within, "{} {}: {mean} {average}", table.full_name(), entry.name);
                checked += 1;
            }
        }
        assert!(checked > 40, "{checked}");
    }

    /// TRACE's published row on Dynamic Object is of another step than its other rows (supplement, table 9).
    #[test]
    fn rows_of_trace_have_the_step_that_is_run() {
        let step = |table: &Table, entry: &str| {
            let run = table.entries.iter().find(|e| e.name == entry).and_then(|e| e.run.clone()).unwrap_or_default();
            run.split_once("physics.step_frames=").map_or(2.0, |(_, frames)| frames.parse().unwrap())
        };
        let ablation = |set: &str| Table::find("trace", &format!("ablation-{set}")).unwrap();
        let rows = [("object", "TRACE"), ("object", "TRACE 2 frames"), ("indoor", "TRACE"), ("multipart", "TRACE")];
        for (set, entry) in rows {
            let table = Table::find("trace", set).unwrap();
            let by_step = if step(&table, entry) == 1.0 { "1 frame" } else { "2 frames and order 2" };
            for (column, of) in [("future_psnr", 0), ("psnr", 1)] {
                let k = table.columns.iter().position(|c| c == column).unwrap();
                let printed = table.published_average(entry, k);
                assert!(printed.is_some(), "{set} {entry}");
                assert_eq!(printed, ablation(set).published_average(by_step, of), "{set} {entry} {column}");
            }
        }
    }

    /// The table of these lines, with a data set, an entry and a scene.
    fn parsed(lines: &str) -> Result<Table, TableError> {
        let rest = "title = \"t\"\nsource = \"s\"\ndata = \"iphone\"\nprotocol = \"p\"\n";
        Table::parse("p-t", &format!("{rest}{lines}\n[[entries]]\nname = \"a\"\nrun = \"modec\"\n"))
    }

    #[test]
    fn every_column_of_lpips_names_its_network() {
        let refused = |lines: &str, words: &str| {
            let error = parsed(lines).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        };
        let two = "columns = [\"lpips\", \"masked_lpips\"]";
        let table = parsed(&format!("{two}\nnetworks = {{ lpips = \"vgg 0..1\", masked_lpips = \"alex -1..1\" }}"));
        assert_eq!(table.unwrap().networks["masked_lpips"].to_string(), "alex -1..1");
        refused(&format!("{two}\nnetworks = {{ lpips = \"vgg 0..1\" }}"), "masked_lpips names no network");
        refused("columns = [\"psnr\"]\nnetworks = { psnr = \"vgg 0..1\" }", "psnr takes no network");
        refused("columns = [\"psnr\"]\nnetworks = { lpips = \"vgg 0..1\" }", "belongs to no column");
        refused("columns = [\"lpips\"]\nnetworks = { lpips = \"squeeze 0..1\" }", "`squeeze 0..1`");
        refused("columns = [\"masked_lpips\"]\nnetworks = { masked_lpips = \"alex 0..1\" }", "-1..1 alone");
    }

    #[test]
    fn entries_can_be_named_in_a_list() {
        let error =
            parsed("columns = [\"psnr\"]\n[[entries]]\nname = \"b, c\"\nrun = \"modec\"").unwrap_err().to_string();
        assert!(error.contains("b, c cannot stand in a list"), "{error}");
    }

    #[test]
    fn a_table_of_a_command_has_nothing_to_run() {
        let error = parsed("columns = [\"rounds\"]\ncommand = \"gs4d continual\"").unwrap_err().to_string();
        assert!(error.contains("has entries to run"), "{error}");
        let continual = Table::find("trace", "continual").unwrap();
        assert_eq!((continual.data.as_deref(), continual.scenes.len()), (Some("particlenerf"), 6));
    }

    #[test]
    fn a_table_may_name_the_other_mean_of_psnr() {
        assert_eq!(parsed("columns = [\"psnr\"]").unwrap().psnr, PsnrMean::Images);
        assert_eq!(parsed("columns = [\"psnr\"]\npsnr = \"mean_error\"").unwrap().psnr, PsnrMean::MeanError);
        let error = parsed("columns = [\"masked_psnr\"]\npsnr = \"mean_error\"").unwrap_err().to_string();
        assert!(error.contains("masked_psnr has no PSNR of the mean error"), "{error}");
    }

    #[test]
    fn an_unknown_table_is_named_with_those_there_are() {
        let error = Table::find("fags", "dnref").unwrap_err().to_string();
        assert!(error.contains("fags dnref") && error.contains("trace multipart"), "{error}");
    }
}
