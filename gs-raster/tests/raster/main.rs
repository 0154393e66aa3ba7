//! The rasteriser against closed forms, the reference and independent renderers.

mod analytic;
mod camera;
mod channels;
mod common;
mod golden;
mod kernels;
mod production;
mod reference;
mod views;
