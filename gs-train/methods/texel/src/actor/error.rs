//! Why a frame, or a person at all, cannot be made of what the data give.

use gs_data::DataError;
use gs_texel::gaussians::warm_up::WarmUpError;
use gs_texel::gaussians::{BaseError, ChannelsError};
use gs_texel::inpaint::InpaintError;
use gs_texel::net::NetError;
use gs_texel::surface::MeshError;
use gs_texel::surface_loss::ChamferError;
use gs_texel::texels::TexelError;
use gs_texel::unproject::UnprojectError;

/// What a frame cannot be made of.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// An image of a conditioning camera.
    #[error(transparent)]
    Image(#[from] DataError),
    /// Mesh, cameras and images do not fit.
    #[error(transparent)]
    Unproject(#[from] UnprojectError),
    /// A network refuses its input.
    #[error(transparent)]
    Net(#[from] NetError),
    /// Pose or offsets do not fit the template.
    #[error(transparent)]
    Base(#[from] BaseError),
    /// Texel values do not fit the map.
    #[error(transparent)]
    Channels(#[from] ChannelsError),
    /// Reference Gaussians cannot be made.
    #[error(transparent)]
    WarmUp(#[from] WarmUpError),
    /// Colours of texels that are not seen.
    #[error(transparent)]
    Inpaint(#[from] InpaintError),
    /// Measured points cannot be compared with the surface.
    #[error(transparent)]
    Chamfer(#[from] ChamferError),
    /// A frame from which mean colours are taken.
    #[error("frame {frame}, of which mean colours are taken: {source}")]
    Mean {
        /// Number of the frame.
        frame: u32,
        /// What is wrong with it.
        source: Box<FrameError>,
    },
    /// There are no measured points.
    #[error(
        "it has no points of the surface to learn geometry from; make the data with points, or set input = \"single\""
    )]
    NoPoints,
    /// No camera sees anything of it.
    #[error(
        "no conditioning camera sees any texel of it; check that cameras and masks are those of its images, and scale a template that is not in metres, together with its cameras"
    )]
    Unseen,
    /// Its points have no colours.
    #[error(
        "its points have no colours; make the data with coloured points (PLY with red, green, blue), or set surface.color = 0"
    )]
    NoColors,
}

/// A template that no texels can be laid on.
#[derive(Debug, thiserror::Error)]
pub enum ActorError {
    /// Faces of the template are invalid.
    #[error("template: {0}")]
    Mesh(#[from] MeshError),
    /// Texture coordinates of the template are invalid.
    #[error("template: {0}")]
    Texels(#[from] TexelError),
    /// A setting of the unprojection is out of its domain.
    #[error(transparent)]
    Unproject(#[from] UnprojectError),
    /// A frame of the mean texture.
    #[error("mean texture: {0}")]
    Frame(#[from] Box<FrameError>),
}
