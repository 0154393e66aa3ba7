//! The registry of all methods of gs4d, for programs that offer every one of them.

use gs_train::registry::Registry;
use std::sync::LazyLock;

/// Every method: static and deformed clouds, anchors, rigid particles, textured people.
///
/// ```
/// assert!(gs_methods::registry().find("fourdgs").is_ok());
/// assert!(gs_methods::registry().find("none").is_err());
/// ```
pub fn registry() -> &'static Registry {
    static ALL: LazyLock<Registry> = LazyLock::new(|| {
        let crates =
            [gs_method_field::METHODS, gs_method_anchor::METHODS, gs_method_physics::METHODS, gs_method_texel::METHODS];
        Registry::new(crates.concat())
    });
    &ALL
}
