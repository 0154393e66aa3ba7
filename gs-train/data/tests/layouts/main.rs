//! Data sets: readers layout by layout, real captures, and scenes that are generated.

mod blender;
mod cameras;
mod colmap;
mod hypernerf;
mod layouts;
mod llff;
mod maps;
mod nerfies;
mod nerfstudio;
mod nvfi;
mod nvidia;
mod panoptic;
mod real;
