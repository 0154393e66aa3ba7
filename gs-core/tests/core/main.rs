//! Files, maps and small networks.

#[cfg(feature = "nn")]
mod maps;
#[cfg(feature = "io")]
mod real_files;
#[cfg(feature = "images")]
mod sog;
mod writing;
