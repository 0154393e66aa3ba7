//! The trainer on small scenes: cameras, clocks, exposure, devices and checkpoints.

mod cameras;
mod checkpoint_files;
mod checkpoint_kill;
mod clocks;
mod device;
mod exposure;
mod trainer;
