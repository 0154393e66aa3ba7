//! Deformation fields, hash grids, planes and networks.

mod fields;
mod grid4d;
mod hash;
mod hexplane;
mod plane_net;
mod support;
