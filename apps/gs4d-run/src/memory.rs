//! How much memory the program may take, and what pictures and splats need.

use crate::RunError;
use std::fmt::Display;

/// Bytes a pixel takes while it is rendered and written.
const BYTES_PER_PIXEL: u64 = 56;
/// Bytes a splat takes while it is rendered, beside its own columns.
const BYTES_PER_SPLAT: u64 = 160;
const MIB: u64 = 1 << 20;

/// A limit of memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryLimit {
    /// Bytes that may still be taken.
    bytes: u64,
}

impl MemoryLimit {
    /// So many MiB; `None`: three quarters of what is free ([`free`]), and no limit where the system does not tell.
    pub fn new(mib: Option<u64>) -> Self {
        let share = |bytes: u64| bytes / 4 * 3;
        Self { bytes: mib.map(|m| m.saturating_mul(MIB)).or_else(|| free().map(share)).unwrap_or(u64::MAX) }
    }

    /// Bytes that may still be taken.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Fails if `what` needs more than the limit.
    ///
    /// # Errors
    /// [`RunError::Memory`] with both numbers.
    pub fn admit(&self, what: impl Display, bytes: u64) -> Result<(), RunError> {
        if bytes <= self.bytes {
            return Ok(());
        }
        let [need_mib, limit_mib] = [bytes.div_ceil(MIB), self.bytes / MIB];
        Err(RunError::Memory { what: what.to_string(), need_mib, limit_mib })
    }

    /// Fails if a picture of so many pixels and splats needs more than the limit.
    ///
    /// # Errors
    /// As [`Self::admit`].
    pub fn admit_picture(&self, [width, height]: [u32; 2], splats: usize) -> Result<(), RunError> {
        let pixels = u64::from(width) * u64::from(height);
        let bytes = pixels * BYTES_PER_PIXEL + splats as u64 * BYTES_PER_SPLAT;
        self.admit(format_args!("a picture of {width}x{height} pixels and {splats} splats"), bytes)
    }
}

/// Bytes that are free: the least of what the machine has, what the control group of the process may still take, and what
/// is left of its address space. `None` where the system tells none of them.
pub fn free() -> Option<u64> {
    [machine(), control_group(), address_space()].into_iter().flatten().min()
}

/// Memory available on this machine, bytes.
pub fn machine() -> Option<u64> {
    kib(&std::fs::read_to_string("/proc/meminfo").ok()?, "MemAvailable:")
}

/// What a control group (version 2) of the process may still take, as a container or a batch system sets it.
fn control_group() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/cgroup").ok()?;
    let path = text.lines().find_map(|l| l.strip_prefix("0::/"))?;
    let number = |file: &str| {
        let text = std::fs::read_to_string(std::path::Path::new("/sys/fs/cgroup").join(path).join(file)).ok()?;
        text.trim().parse::<u64>().ok()
    };
    // Pages of files are given back when memory is short.
    let stat = std::fs::read_to_string(std::path::Path::new("/sys/fs/cgroup").join(path).join("memory.stat"));
    let pages = |kind: &str| -> Option<u64> {
        stat.as_ref().ok()?.lines().find_map(|line| line.strip_prefix(kind)?.trim().parse().ok())
    };
    let files: u64 = ["inactive_file ", "active_file "].into_iter().filter_map(pages).sum();
    Some(number("memory.max")?.saturating_sub(number("memory.current")?.saturating_sub(files)))
}

/// What is left below the limit of the address space (`ulimit -v`).
fn address_space() -> Option<u64> {
    let limits = std::fs::read_to_string("/proc/self/limits").ok()?;
    let line = limits.lines().find_map(|l| l.strip_prefix("Max address space"))?;
    let limit: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(limit.saturating_sub(kib(&std::fs::read_to_string("/proc/self/status").ok()?, "VmSize:")?))
}

fn kib(text: &str, key: &str) -> Option<u64> {
    let line = text.lines().find_map(|l| l.strip_prefix(key))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_beyond_the_limit_is_refused_with_both_numbers() {
        let limit = MemoryLimit::new(Some(100));
        assert!(limit.admit_picture([1000, 1000], 10_000).is_ok());
        let text = limit.admit_picture([32_768, 32_768], 3).unwrap_err().to_string();
        assert!(text.contains("32768x32768") && text.contains("57345 MiB") && text.contains("100 MiB"), "{text}");
        assert!(limit.admit_picture([10, 10], 5_000_000).is_err());
        assert!(MemoryLimit::new(Some(u64::MAX)).admit("all", u64::MAX).is_ok());
    }

    #[test]
    fn the_system_tells_what_is_free() {
        if cfg!(target_os = "linux") {
            assert!(free().is_some_and(|bytes| bytes > 1 << 20));
            assert!(MemoryLimit::new(None).bytes() < free().unwrap_or(0));
        }
    }
}
