//! The metrics against independent `f64` references, central differences, published and golden scores, and human order.

mod covisible;
mod data;
mod distort;
mod flow;
mod fourier;
mod frames;
mod golden;
mod images;
mod lpips;
mod mrf;
mod ms_ssim;
mod perceptual;
mod published;
mod reference;
mod spectrum;
mod ssim;
mod stored;
