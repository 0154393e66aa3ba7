//! A [`Law`] in `f64`, one particle at a time.

use super::net::{NetRef, encode};
use super::{Pose, adjoint, advance};
use crate::law::arc::{self, Span};
use crate::law::{Form, Law, LawConfig, LawInput};
use crate::rollout::Rollout;
use crate::twist::Motion;

/// Reference of a [`Law`]: the same network and forms in `f64`.
#[derive(Clone, Debug)]
pub struct LawRef {
    /// The network, whose weights may be changed.
    pub net: NetRef,
    /// Centroid of the moving particles, world units; initially the law's origin.
    pub centroid: [f64; 3],
    config: LawConfig,
    form: Form,
    rollout: Rollout,
}

impl LawRef {
    /// The reference of `law`, with a copy of its weights.
    pub fn new(law: &Law) -> Self {
        let (config, rollout) = (law.config().clone(), law.rollout());
        let centroid = rollout.origin.as_dvec3().to_array();
        Self { net: NetRef::new(law.net()), centroid, form: Form::new(&config), config, rollout }
    }

    fn input(&self, x: [f64; 3], t: f64) -> Vec<Vec<f64>> {
        let [mut row, ..] = encode(&x, self.config.coordinate_scale.into(), self.config.bands);
        if self.config.input == LawInput::Xt {
            let [time, ..] = encode(&[t], 1.0, self.config.bands);
            row.extend(time);
        }
        vec![row]
    }

    fn relative(&self, x: [f64; 3]) -> [f64; 3] {
        crate::vec3::sub(x, self.rollout.origin.as_dvec3().to_array())
    }

    fn span(&self, [from, to]: [f64; 2]) -> Span<f64> {
        let steps = self.form.literal().then(|| self.rollout.steps([0.0, to - from]));
        Span::new(to - from, steps.as_deref())
    }

    /// One row of [`motions`](crate::Dynamics::motions), in `f64`.
    pub fn motion(&self, x: [f64; 3], t: f64) -> Motion<f64> {
        self.form.motion(&self.net.forward(&self.input(x, t))[0], self.relative(x), self.relative(self.centroid))
    }

    /// As [`transport`](crate::Dynamics::integrate) over `[from, to]`.
    pub fn integrate(&self, x: [f64; 3], span: [f64; 2]) -> Pose {
        let start = [1.0, 0.0, 0.0, 0.0];
        if span[0] == span[1] {
            return (x, start);
        }
        if !self.form.is_closed() {
            return advance(&self.rollout, &self.motion(x, span[0]), [0.0, span[1] - span[0]], (x, start));
        }
        let y = self.net.forward(&self.input(x, span[0]));
        let (end, q) = arc::advance(&self.form, &y[0], self.relative(x), self.span(span));
        (crate::vec3::add(end, self.rollout.origin.as_dvec3().to_array()), q)
    }

    /// Adds the gradient of the weights for cotangents `d` of [`LawRef::integrate`], without the clamp of
    /// [`LawConfig::accel_clamp`].
    pub fn gradient(&self, x: [f64; 3], span: [f64; 2], d: Pose, grad: &mut [Vec<f64>]) {
        let input = self.input(x, span[0]);
        let y = self.net.forward(&input).swap_remove(0);
        let mut d_y = vec![0.0; y.len()];
        if self.form.is_closed() {
            arc::advance_backward(&self.form, &y, self.relative(x), self.span(span), d, &mut d_y);
        } else {
            let motion = self.form.motion(&y, self.relative(x), self.relative(self.centroid));
            let start = (x, [1.0, 0.0, 0.0, 0.0]);
            let (d_motion, _) = adjoint(&self.rollout, &motion, [0.0, span[1] - span[0]], start, d);
            self.form.motion_backward(&y, self.relative(self.centroid), &d_motion, &mut d_y);
        }
        self.net.backward(&input, &vec![d_y], grad);
    }
}
