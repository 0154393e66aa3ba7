//! The metrics against independent `f64` references, central differences, published scores and human order.

mod data;
mod distort;
mod flow;
mod fourier;
mod frames;
mod ms_ssim;
mod perceptual;
mod pictures;
mod published;
mod reference;
mod spectrum;
mod ssim;
mod stored;
