"""A differentiable Gaussian rasteriser for the CPU, with the signature of gsplat's; image metrics; runs of gs4d.

``rasterization`` draws numpy arrays, ``rasterization_vjp`` also returns a function for the gradients.
``gs4d.torch.rasterization`` and ``gs4d.jax.rasterization`` do the same in torch and JAX, which are imported when asked for.
``load`` opens a run, a checkpoint or a compact file.
"""

import importlib

from ._metrics import ms_ssim, perceptual_proxy, psnr, ssim
from ._raster import rasterization, rasterization_vjp
from ._run import Run, load

__all__ = ["Run", "load", "ms_ssim", "perceptual_proxy", "psnr", "rasterization", "rasterization_vjp", "ssim"]


def __getattr__(name):
    if name in ("jax", "torch"):
        return importlib.import_module(f"gs4d.{name}")
    raise AttributeError(f"module 'gs4d' has no attribute {name!r}")
