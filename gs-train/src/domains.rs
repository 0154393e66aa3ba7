//! Domains of settings: the lowest and the highest value that a configuration may give them.
//!
//! They are checked before a method is built, so that no number of a file or of a command line is believed further than a
//! scene can need it. What a setting must satisfy beyond its range, or together with others, its own crate checks.

use crate::method::MethodError;
use toml::{Table, Value};

/// Most entries of a list.
const MAX_ENTRIES: usize = 4096;
/// Most steps of anything.
pub const STEPS: f64 = (1u64 << 31) as f64;

/// The domain of every number that stands under a key.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Domain {
    /// The end of a dotted key: `hexplane.channels` stands for `field.hexplane.channels`, too.
    pub key: &'static str,
    /// Lowest value.
    pub low: f64,
    /// Highest value.
    pub high: f64,
    /// How the setting follows the length of the run.
    pub scaling: Scaling,
}

/// How a setting of a preset follows the length of the run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scaling {
    /// Not at all.
    Fixed,
    /// A number of steps that is a share of the run: a run of half the length has half of it, and never less than so many.
    Length(u32),
    /// A learning rate that takes a parameter as far in any run: a run of half the length has twice of it, and never more than so much.
    Rate(f64),
}

/// A domain from the lowest to the highest value, both included.
pub const fn within(key: &'static str, low: f64, high: f64) -> Domain {
    Domain { key, low, high, scaling: Scaling::Fixed }
}

/// A number of steps, at least `low`, that is a share of the run.
pub const fn length(key: &'static str, low: f64) -> Domain {
    Domain { key, low, high: STEPS, scaling: Scaling::Length(0) }
}

/// Steps between two passes over statistics of steps: a share of the run. Fewer than ten steps say little.
pub const fn interval(key: &'static str) -> Domain {
    Domain { key, low: 1.0, high: STEPS, scaling: Scaling::Length(10) }
}

/// A learning rate that is higher in shorter runs. With Adam a logit crosses a sigmoid's range within a hundred steps of `5e-2`, so rates
/// are not raised above.
pub const fn rate(key: &'static str) -> Domain {
    Domain { key, low: 0.0, high: 1e30, scaling: Scaling::Rate(5e-2) }
}

/// Domains of the settings that several methods have: those of [`layers`](crate::layers).
pub const SHARED: &[Domain] = &[
    length("steps", 0.0),
    length("from", 0.0),
    length("ramp", 0.0),
    within("leak", 0.0, 1.0),
    within("order", 0.0, 1e3),
    within("image_scale", 0.0, 1.0),
    within("window_until", 0.0, 0.7),
    within("window_newest", 0.0, 0.5),
    within("window_parts", 0.0, 1e6),
    within("start", 0.0, 1e30),
    within("end", 0.0, 1e30),
    rate("lambda.start"),
    rate("lambda.end"),
    rate("beta.start"),
    rate("beta.end"),
    rate("acutance.start"),
    rate("acutance.end"),
    within("eps", 0.0, 1.0),
    within("weight_decay", 0.0, 1.0),
    within("adam_eps", 0.0, 1.0),
    within("batch", 1.0, 256.0),
    within("lr_batch", 1.0, 256.0),
    within("dilation", 0.0, 100.0),
    within("lambda_dssim", 0.0, 1.0),
    within("exposure.after", 0.0, 1.0),
    within("exposure.ridge", 1e-9, 1e9),
    within("lambda_depth", 0.0, 1e4),
    within("lambda_fre", 0.0, 1e4),
    within("lambda_l1", 0.0, 1e4),
    within("max_quarantine", 0.0, 1.0),
    within("near", 1e-6, 1e6),
    within("cameras.turn_rate", 0.0, 1.0),
    within("cameras.shift_rate", 0.0, 1.0),
    within("cameras.focal_rate", 0.0, 1.0),
    within("cameras.time_rate", 0.0, 1.0),
    within("cameras.rate_end", 1e-6, 1.0),
    within("cameras.until", 0.0, 1e9),
    within("cameras.after", 0.0, 1.0),
    length("sh_every", 0.0),
    within("density.dense_share", 0.0, 1e3),
    interval("density.every"),
    length("density.from", 0.0),
    within("density.grad", 0.0, 1e6),
    within("density.max_screen", 0.0, 1e6),
    within("density.max_splats", 1.0, (1u64 << 26) as f64),
    within("density.max_world", 0.0, 1e6),
    within("density.min_opacity", 0.0, 1.0),
    length("density.reset_every", 0.0),
    within("density.min_splats", 0.0, (1u64 << 26) as f64),
    within("density.prune_above", 0.0, (1u64 << 26) as f64),
    length("density.prune_every", 0.0),
    within("density.reset_opacity", 0.0, 1.0),
    within("density.split_factor", 1.0, 1e3),
    length("density.until", 0.0),
    within("init.bound", 1e-6, 1e6),
    within("init.points", 1.0, (1u64 << 26) as f64),
    within("cloud.opacity", 0.0, 1.0),
    within("cloud.sh_degree", 0.0, 3.0),
    within("cloud.spread", 1e-3, 1e3),
    within("kernel.beta_hi", 0.0, 1.0),
    length("kernel.from_step", 0.0),
    interval("still.every"),
    within("still.from", 0.0, 1.0),
    within("still.pixels", 0.0, 1e3),
    within("still.probes", 2.0, 1024.0),
    within("still.pull", 0.0, 1e6),
    within("still.shape", 0.0, 1e3),
    within("still.turn", 1.0, 1e6),
    within("still.until", 0.0, 1.0),
    within("anneal.strength", 0.0, 1e3),
    within("margin", 0.0, 1e3),
    // Networks of place and time.
    within("width", 1.0, 4096.0),
    within("depth", 0.0, 64.0),
    within("skip", 0.0, 64.0),
    within("bands", 0.0, 4096.0),
    within("bands_position", 0.0, 24.0),
    within("bands_time", 0.0, 24.0),
    within("hidden", 1.0, 4096.0),
    within("time_hidden", 0.0, 4096.0),
    within("time_features", 1.0, 4096.0),
    within("coordinate_scale", -1e6, 1e6),
    // Feature planes.
    within("rows_per_moment", 0.0, 1e3),
    within("hexplane.channels", 16.0, 1024.0),
    within("hexplane.levels", 1.0, 64.0),
    within("hexplane.resolution", 2.0, 8192.0),
    within("hexplane.plane_tv", 0.0, 1e4),
    within("hexplane.time_smoothness", 0.0, 1e4),
    within("hexplane.time_l1", 0.0, 1e4),
    within("canonical.base", 2.0, 131_072.0),
    within("canonical.end", 2.0, 131_072.0),
    within("canonical.levels", 1.0, 64.0),
    within("canonical.log2_table", 1.0, 28.0),
    within("temporal.base", 2.0, 131_072.0),
    within("temporal.end", 2.0, 131_072.0),
    within("temporal.levels", 1.0, 64.0),
    within("temporal.log2_table", 1.0, 28.0),
];

/// Fails for the first number of a configuration outside its domain; a method's own domains come before the shared ones.
///
/// # Errors
/// [`MethodError::Domain`] with key, value and domain.
pub fn check(method: &'static str, config: &Table, own: &[Domain]) -> Result<(), MethodError> {
    let mut open: Vec<(String, &Value)> = config.iter().map(|(key, value)| (key.clone(), value)).collect();
    while let Some((key, value)) = open.pop() {
        match value {
            Value::Table(table) => open.extend(table.iter().map(|(k, v)| (format!("{key}.{k}"), v))),
            Value::Array(list) if list.len() > MAX_ENTRIES => {
                let value = format!("a list of {} entries", list.len());
                return Err(MethodError::Domain { method, key, value, low: 0.0, high: MAX_ENTRIES as f64 });
            }
            Value::Array(list) => open.extend(list.iter().map(|v| (key.clone(), v))),
            value => check_number(method, &key, value, own)?,
        }
    }
    Ok(())
}

fn check_number(method: &'static str, key: &str, value: &Value, own: &[Domain]) -> Result<(), MethodError> {
    let number = match value {
        Value::Integer(n) => *n as f64,
        Value::Float(x) => *x,
        _ => return Ok(()),
    };
    match domain(key, own) {
        Some(d) if !(d.low..=d.high).contains(&number) => {
            let (key, value) = (key.to_owned(), value.to_string());
            Err(MethodError::Domain { method, key, value, low: d.low, high: d.high })
        }
        _ => Ok(()),
    }
}

/// The domain of a setting, if it has one.
pub fn domain(key: &str, own: &[Domain]) -> Option<Domain> {
    let ends = |d: &&Domain| key.strip_suffix(d.key).is_some_and(|rest| rest.is_empty() || rest.ends_with('.'));
    let longest = |domains: &[Domain]| domains.iter().filter(ends).max_by_key(|d| d.key.len()).copied();
    longest(own).or_else(|| longest(SHARED))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(config: &str, own: &[Domain]) -> Option<String> {
        check("m", &config.parse().unwrap(), own).err().map(|e| e.to_string())
    }

    #[test]
    fn a_number_outside_its_domain_is_refused_by_key_value_and_range() {
        let message = error("[a.hexplane]\nchannels = 9223372036854775807", &[]).unwrap();
        assert!(message.contains("`a.hexplane.channels` = 9223372036854775807") && message.contains("from 16 to 1024"));
        assert!(error("[a.hexplane]\nresolution = [8, 8, 1]", &[]).unwrap().contains("`a.hexplane.resolution` = 1"));
        assert!(error("near = nan", &[]).unwrap().contains("near"));
        assert!(error("depth = -1", &[]).unwrap().contains("from 0 to 64"));
        assert_eq!(error("depth = 64\nunknown = 1e300\nnear = 0.2\nname = \"x\"", &[]), None);
        assert_eq!(error("my_depth = 1000", &[]), None, "another name that ends alike");
        let long = format!("levels = {:?}", vec![1; MAX_ENTRIES + 1]);
        assert!(error(&long, &[]).unwrap().contains("a list of 4097 entries"));
    }

    #[test]
    fn the_longest_key_and_the_methods_own_domain_count() {
        let own = [within("depth", 1.0, 2.0), within("net.depth", 1.0, 3.0)];
        assert_eq!(error("[net]\ndepth = 3", &own), None);
        assert!(error("[law]\ndepth = 3", &own).unwrap().contains("from 1 to 2"));
        assert!(error("[density]\nevery = 0", &[]).is_some());
    }
}
