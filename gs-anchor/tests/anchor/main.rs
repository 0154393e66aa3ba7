//! Anchors: decoding and deformation.

mod decode;
mod gad;
mod support;
