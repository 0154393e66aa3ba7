"""``rasterization`` on torch tensors in main memory, with gradients by autograd."""

import numpy as np
import torch

from . import _raster
from ._arguments import ARRAYS

__all__ = ["rasterization"]


def rasterization(means, quats, scales, opacities, colors, viewmats, Ks, width, height, near_plane=0.01, far_plane=1e10,
                  radius_clip=0.0, eps2d=0.3, sh_degree=None, packed=True, tile_size=None, backgrounds=None,
                  render_mode="RGB", sparse_grad=False, absgrad=False, rasterize_mode="classic", channel_chunk=32,
                  distributed=False, camera_model="pinhole", segmented=False, covars=None, *, max_alpha=0.99,
                  constants="gsplat", threads=None, **refused):
    """As :func:`gs4d.rasterization`, of tensors. Gradients reach every tensor, ``viewmats``, ``Ks`` and ``backgrounds`` too;
    ``meta["means2d_grad"]`` [C, N, 2] is there after backward. Second derivatives are refused by torch."""
    arguments = _raster.named(locals())
    tensors = [arguments.pop(name) for name in ARRAYS]
    for name, tensor in zip(ARRAYS, tensors):
        if tensor is not None and not isinstance(tensor, torch.Tensor):
            raise TypeError(f"{name} must be a tensor, not {type(tensor).__name__}")
        if tensor is not None and tensor.device.type != "cpu":
            raise ValueError(f"{name} is on {tensor.device}: this rasteriser works in main memory, move it by .cpu()")
    meta = {}
    renders, alphas = _Rasterization.apply(arguments, meta, torch.is_grad_enabled(), *tensors)
    return renders, alphas, meta


class _Rasterization(torch.autograd.Function):
    @staticmethod
    def forward(ctx, arguments, meta, grad_enabled, *tensors):
        arrays = {name: None if t is None else t.detach().numpy() for name, t in zip(ARRAYS, tensors)}
        keep = grad_enabled and any(ctx.needs_input_grad)
        renders, alphas, found, ctx.vjp = _raster.rasterize({**arguments, **arrays}, keep)
        ctx.found, ctx.meta = found, meta
        meta.update((k, torch.from_numpy(v) if isinstance(v, np.ndarray) else v) for k, v in found.items())
        return torch.from_numpy(renders), torch.from_numpy(alphas)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, d_renders, d_alphas):
        grads = ctx.vjp(d_renders.contiguous().numpy(), d_alphas.contiguous().numpy())
        ctx.meta["means2d_grad"] = torch.from_numpy(ctx.found["means2d_grad"])
        wanted = zip(ARRAYS, ctx.needs_input_grad[3:])
        return (None, None, None, *(torch.from_numpy(grads[name]) if want else None for name, want in wanted))
