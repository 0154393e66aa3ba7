//! Characters, skinning, unprojection, visibility, texel Gaussians and networks.

#[cfg(feature = "read")]
mod bad_characters;
mod base_maps;
#[cfg(feature = "read")]
mod character_features;
#[cfg(feature = "read")]
mod characters;
#[cfg(feature = "read")]
mod evaluate;
mod figure;
mod gaussians;
mod inpaint;
mod networks;
mod scenes;
mod skinning;
#[cfg(feature = "read")]
mod small_gltf;
mod square;
mod surface_loss;
mod texels;
mod unproject;
mod visibility;
