//! Twists: the velocity fields of rigid bodies, and how they change.

/// The velocity field `u(x) = v + w × (x − o)` of a rigid body, about an origin `o` that is said beside it.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Twist<T> {
    /// Velocity of the body-fixed frame at the origin (`v̄`), world units per unit of time.
    pub v: [T; 3],
    /// Rotation vector (right-hand rule), radians per unit of time.
    pub w: [T; 3],
}

/// A twist as a polynomial of the time `τ` since it was read: `u(τ) = twist + rate τ + ½ jerk τ²`.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Motion<T> {
    /// At `τ = 0`.
    pub twist: Twist<T>,
    /// First derivative (`ā`, `ε`).
    pub rate: Twist<T>,
    /// Second derivative; zero below the third order.
    pub jerk: Twist<T>,
}
