"""``rasterization`` on JAX arrays, with gradients in reverse mode. The work is done on the host by a callback."""

import jax
import jax.numpy as jnp
import numpy as np

from . import _raster
from ._arguments import ARRAYS

__all__ = ["rasterization"]

# Earlier ones have no callback that vmap can repeat, or wait for themselves on one core.
if tuple(int(part) for part in jax.__version__.split(".")[:2]) < (0, 5):
    raise ImportError(f"gs4d.jax needs JAX 0.5 or later, and this is {jax.__version__}: pip install -U 'jax>=0.5'")


def rasterization(means, quats, scales, opacities, colors, viewmats, Ks, width, height, near_plane=0.01, far_plane=1e10,
                  radius_clip=0.0, eps2d=0.3, sh_degree=None, packed=True, tile_size=None, backgrounds=None,
                  render_mode="RGB", sparse_grad=False, absgrad=False, rasterize_mode="classic", channel_chunk=32,
                  distributed=False, camera_model="pinhole", segmented=False, covars=None, *, max_alpha=0.99,
                  constants="gsplat", threads=None, **refused):
    """As :func:`gs4d.rasterization`, of JAX arrays, also under ``jax.jit`` with sizes and options static. float64 needs
    ``jax_enable_x64``. Backward draws again: nothing is kept between the passes. Of the dictionary, splats on the screen have
    no gradients, and ``means2d_grad`` is not there."""
    arguments = _raster.named(locals())
    arrays, plan = _raster.plan(dict(arguments))
    for name in ARRAYS:
        del arguments[name]
    names = tuple(name for name in ARRAYS if arrays[name] is not None)
    rest = {name: None for name in ARRAYS if arrays[name] is None}
    given = tuple(jnp.asarray(arrays[name]) for name in names)
    dtype, screen = jnp.dtype(plan.dtype), jnp.float32
    c, n = plan.cameras, plan.splats
    image = (c, plan.height, plan.width)
    shapes = tuple(jax.ShapeDtypeStruct(shape, kind) for shape, kind in [
        ((*image, plan.out_channels), dtype), ((*image, 1), dtype), ((c, n, 2), screen), ((c, n), screen), ((c, n), screen)])

    def on_host(keep, values):
        hosted = {name: np.asarray(value) for name, value in zip(names, values)}
        return _raster.rasterize({**arguments, **rest, **hosted}, keep)

    def forward(*values):
        renders, alphas, meta, _ = on_host(False, values)
        return renders, alphas, meta["means2d"], meta["depths"], meta["radii"]

    def backward(values, d_renders, d_alphas):
        grads = on_host(True, values)[3](np.asarray(d_renders), np.asarray(d_alphas))
        return tuple(grads[name] for name in names)

    @jax.custom_vjp
    def draw(*values):
        return jax.pure_callback(forward, shapes, *values, vmap_method="sequential")

    def draw_forward(*values):
        return draw(*values), values

    def draw_backward(values, d):
        like = tuple(jax.ShapeDtypeStruct(value.shape, value.dtype) for value in values)
        return jax.pure_callback(backward, like, values, d[0], d[1], vmap_method="sequential")

    draw.defvjp(draw_forward, draw_backward)
    renders, alphas, means2d, depths, radii = draw(*given)
    meta = {"width": plan.width, "height": plan.height, "n_cameras": c, "means2d": means2d, "depths": depths, "radii": radii}
    return renders, alphas, meta
