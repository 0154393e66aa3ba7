//! The section `[cloud.kernel]`: the fall-off of the splats of any cloud, moving or at rest.

use crate::capabilities::Quantity;
use crate::schedule::LearningRate;
use gs_core::Kernel;
use gs_core::cloud::KernelInit;
use gs_core::kernel::BetaMode;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Which fall-off the splats of a cloud have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum KernelKind {
    /// The Gaussian of 3DGS, without parameters.
    #[default]
    Gaussian,
    /// FAGS: λ and β per splat.
    Frequency,
    /// One sharpness per splat: the acutance of Deformable Radial Kernels.
    Acutance,
}

/// The fall-off and how it learns. Everything but `kind` and `from_step` concerns the frequency kernel only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KernelConfig {
    /// Which fall-off the splats have.
    pub kind: KernelKind,
    /// What is done where β would open the foot: `capped`, `literal` (as printed) or `relative`.
    pub beta_mode: BetaMode,
    /// Upper end of β, above 0.5, at most 1 (FAGS: 1).
    pub beta_hi: f32,
    /// One λ for all splats (the ablation "without λ": λ = ½ would be "without the kernel").
    pub shared_lambda: bool,
    /// Whether λ learns; it stays at ½ otherwise, where the kernel is the Gaussian.
    pub learn_lambda: bool,
    /// Whether β learns; it stays at ½ otherwise.
    pub learn_beta: bool,
    /// The kernel does not learn before this step of the schedule's clock.
    pub from_step: u32,
}

impl Default for KernelConfig {
    fn default() -> Self {
        Self {
            kind: KernelKind::Gaussian,
            beta_mode: BetaMode::Capped,
            beta_hi: 0.98,
            shared_lambda: false,
            learn_lambda: true,
            learn_beta: true,
            from_step: 0,
        }
    }
}

impl KernelConfig {
    /// The raw columns a cloud needs, if any.
    pub fn init(&self) -> Option<KernelInit> {
        let Self { beta_mode: mode, beta_hi, shared_lambda, .. } = *self;
        match self.kind {
            KernelKind::Gaussian => None,
            KernelKind::Frequency => Some(KernelInit::Frequency { mode, beta_hi, shared_lambda }),
            KernelKind::Acutance => Some(KernelInit::Acutance),
        }
    }

    /// Holds back among the learning rates of a schedule those of parameters that the splats do not have, or that do not learn, or not
    /// yet.
    pub(crate) fn hold_back(&self, rates: &mut BTreeMap<String, BTreeMap<String, LearningRate>>) {
        let of = |kind: KernelKind, learns: bool| self.kind == kind && learns;
        let cloud = rates.entry("cloud".to_owned()).or_default();
        for (name, learns) in [
            ("lambda", of(KernelKind::Frequency, self.learn_lambda)),
            ("beta", of(KernelKind::Frequency, self.learn_beta)),
            ("acutance", of(KernelKind::Acutance, true)),
        ] {
            if !learns {
                cloud.insert(name.to_owned(), LearningRate::constant(0.0));
            } else if let Some(rate) = cloud.get_mut(name) {
                rate.from = rate.from.max(self.from_step);
            }
        }
    }
}

/// The parameters of a kernel as quantities.
pub fn kernel_quantities(kernel: &Kernel) -> Vec<Quantity> {
    match kernel {
        Kernel::Frequency { lambdas, betas } => {
            vec![Quantity::share("lambda", lambdas.clone()), Quantity::share("beta", betas.clone())]
        }
        Kernel::Acutance { acutances } => {
            let range = Some([-1.0, 1.0]);
            vec![Quantity { name: "acutance", unit: "", range, values: acutances.clone() }]
        }
        _ => Vec::new(),
    }
}
