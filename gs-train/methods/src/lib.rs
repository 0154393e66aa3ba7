//! The registry of all methods of gs4d, for programs that offer every one of them.
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::cast_possible_truncation))]

use gs_train::registry::Registry;
use std::sync::LazyLock;

/// Every method: static scenes, deformed clouds, anchors, rigid particles, textured people, in this order.
///
/// ```
/// assert!(gs_methods::registry().find("fourdgs").is_ok());
/// assert!(gs_methods::registry().find("none").is_err());
/// ```
pub fn registry() -> &'static Registry {
    static ALL: LazyLock<Registry> = LazyLock::new(|| {
        // Static scenes first; an entry keeps the place of its first mention.
        let at_rest: &[_] = &[gs_method_field::static3d::ENTRY, gs_method_anchor::scaffold::ENTRY];
        let (fields, anchors) = (gs_method_field::METHODS, gs_method_anchor::METHODS);
        let (particles, people) = (gs_method_physics::METHODS, gs_method_texel::METHODS);
        Registry::new([at_rest, fields, anchors, particles, people].concat())
    });
    &ALL
}
