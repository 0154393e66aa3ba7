//! Anchors: decoding and deformation.

mod decode;
mod gad;
mod lgd;
mod support;
