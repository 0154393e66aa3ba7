"""``rasterization`` on numpy arrays, and its gradients."""

import numpy as np

from . import _gs4d
from ._arguments import ARRAYS, Plan, refuse

#: Least alpha that expected depth is divided by, as in gsplat.
_LEAST_ALPHA = 1e-10


def rasterization(means, quats, scales, opacities, colors, viewmats, Ks, width, height, near_plane=0.01, far_plane=1e10,
                  radius_clip=0.0, eps2d=0.3, sh_degree=None, packed=True, tile_size=None, backgrounds=None,
                  render_mode="RGB", sparse_grad=False, absgrad=False, rasterize_mode="classic", channel_chunk=32,
                  distributed=False, camera_model="pinhole", segmented=False, covars=None, *, max_alpha=0.99,
                  constants="gsplat", threads=None, **refused):
    """Renders N splats from C cameras. Arrays of float32 take the fast path, of float64 the reference, splats × pixels.

    Args:
        means: [N, 3] centres, world units.
        quats: [N, 4] rotations (w, x, y, z) of any length.
        scales: [N, 3] standard deviations, world units.
        opacities: [N], 0 to 1.
        colors: [N, D] or [C, N, D] values of D channels; with ``sh_degree`` coefficients, [N, K, D] or [C, N, K, D], of which
            the first (sh_degree + 1)² count: max(0, 0.5 + their sum). None for the render modes "D" and "ED".
        viewmats: [C, 4, 4] world to camera, OpenCV axes (+x right, +y down, +z forward); rotations up to 1e-3.
        Ks: [C, 3, 3] intrinsics in pixels, without skew. Pixel centres lie at +0.5.
        width, height: pixels, 1 to 32768.
        near_plane, far_plane: splats whose centre has another camera depth are culled.
        eps2d: added to the diagonal of the projected covariance, pixels².
        backgrounds: [C, D] colours behind the splats; black if None.
        render_mode: "RGB"; "D" depth Σ w z; "ED" depth over alpha; "RGB+D" and "RGB+ED" have the depth as last channel.
        rasterize_mode: "classic", or "antialiased" (Mip-Splatting's factor on the opacities).
        max_alpha: cap of a sample's alpha. 0.99 is that of INRIA and of gsplat since 1.6; older ones had 0.999.
        constants: "gsplat", or "inria" for what INRIA's rasteriser does otherwise: splats nearer than 0.2 are culled whatever
            ``near_plane`` is, and a sample above ``max_alpha`` gets the gradient that it has without the cap.
        threads: 1 to 1024; None for one per core. The result is the same bits for any number.
        packed, tile_size, channel_chunk, segmented, macro_tile: concern GPUs; no effect.

    Other arguments of gsplat are refused by name, unless they have their default.

    Returns:
        renders [C, height, width, D (+ 1)], alphas [C, height, width, 1], and a dictionary: ``width``, ``height``,
        ``n_cameras``, and in float32 of each splat on the screen ``means2d`` [C, N, 2], ``depths`` [C, N] and ``radii``
        [C, N], three standard deviations in pixels; zeros where a splat touches no tile, and for some that lie behind what
        is opaque.

    Raises:
        TypeError, ValueError: name the argument and say what is wrong with it.
    """
    renders, alphas, meta, _ = rasterize(named(locals()), keep=False)
    return renders, alphas, meta


def rasterization_vjp(means, quats, scales, opacities, colors, viewmats, Ks, width, height, near_plane=0.01,
                      far_plane=1e10, radius_clip=0.0, eps2d=0.3, sh_degree=None, packed=True, tile_size=None,
                      backgrounds=None, render_mode="RGB", sparse_grad=False, absgrad=False, rasterize_mode="classic",
                      channel_chunk=32, distributed=False, camera_model="pinhole", segmented=False, covars=None, *,
                      max_alpha=0.99, constants="gsplat", threads=None, **refused):
    """As :func:`rasterization`, and as fourth result a function for the gradients.

    ``vjp(d_renders, d_alphas=None)`` takes the gradient of a loss with respect to ``renders`` and ``alphas`` and returns a
    dictionary: its gradient with respect to every array given, by the name of the argument, in the same shape. It also
    sets ``meta["means2d_grad"]`` [C, N, 2], the gradient of the projected centres per pixel, for densification.

    Entries of ``viewmats`` count as independent numbers (the camera centre is −R⁻¹ T); those that a camera does not have,
    the last row and the skew, get zeros. What culls or orders splats has no gradient, nor has a sample above ``max_alpha``
    with gsplat's constants.

    >>> import numpy as np
    >>> import gs4d
    >>> one = lambda *shape: np.ones(shape, np.float32)
    >>> view = np.eye(4, dtype=np.float32)[None]
    >>> K = np.array([[[10, 0, 8], [0, 10, 8], [0, 0, 1]]], np.float32)
    >>> renders, alphas, meta, vjp = gs4d.rasterization_vjp(
    ...     np.array([[0, 0, 2]], np.float32), one(1, 4), 0.1 * one(1, 3), 0.5 * one(1), one(1, 3), view, K, 16, 16)
    >>> renders.shape, vjp(np.ones_like(renders))["means"].shape
    ((1, 16, 16, 3), (1, 3))
    """
    return rasterize(named(locals()), keep=True)


def named(arguments):
    """All arguments by name, those refused among them."""
    refused = arguments.pop("refused")
    return {**arguments, **refused}


def plan(arguments):
    """The arrays, and the plan of everything else. Takes the arguments out of the dictionary."""
    arrays = {name: arguments.pop(name) for name in ARRAYS}
    names = ("width", "height", "near_plane", "far_plane", "eps2d", "sh_degree", "render_mode", "rasterize_mode",
             "max_alpha", "constants", "threads")
    options = {name: arguments.pop(name) for name in names}
    refuse(arguments)
    return arrays, Plan(arrays, **options)


def rasterize(arguments, keep):
    """Renders, alphas, the dictionary, and the function for the gradients if it is to be kept."""
    arrays, p = plan(arguments)
    for name, array in arrays.items():
        if array is not None and not isinstance(array, np.ndarray):
            raise TypeError(f"{name} must be a numpy array, not {type(array).__name__}")
    given = {name: np.require(array, requirements="CA") for name, array in arrays.items() if array is not None}
    backgrounds = given.pop("backgrounds", None)
    if backgrounds is not None and not np.isfinite(backgrounds).all():
        raise ValueError("backgrounds: all values must be finite")
    if p.degree is not None:
        given["colors"] = np.require(given["colors"][..., :p.coefficients, :], requirements="CA")
    out = _gs4d.draw(given, p.settings, keep)
    alphas, images = out["alphas"], []
    if p.has_color:
        images.append(out["colors"])
        if backgrounds is not None:
            images[0] = images[0] + (1 - alphas) * backgrounds[:, None, None, :]
    if p.depth is not None:
        images.append(out["depths"] / np.maximum(alphas, _LEAST_ALPHA) if p.depth == "ED" else out["depths"])
    renders = images[0] if len(images) == 1 else np.concatenate(images, axis=-1)
    meta = {"width": p.width, "height": p.height, "n_cameras": p.cameras, "means2d": out["means2d"],
            "depths": out["splat_depths"], "radii": out["radii"]}
    if not keep:
        return renders, alphas, meta, None
    # Copies: what the caller does to arrays and results must not reach the gradients.
    alpha, depth = alphas.copy(), images[-1].copy() if p.depth == "ED" else None
    behind = None if backgrounds is None else backgrounds[:, None, None, :].copy()
    shapes = {name: array.shape for name, array in arrays.items() if array is not None}

    def vjp(d_renders, d_alphas=None):
        d_renders = _cotangent("d_renders", d_renders, renders)
        d_alphas = None if d_alphas is None else _cotangent("d_alphas", d_alphas, alphas)
        d = {"colors": d_renders[..., :p.channels]} if p.has_color else {}
        grads, more = {}, []
        if p.depth == "D":
            d["depths"] = d_renders[..., p.channels:]
        elif p.depth == "ED":
            inverse = 1 / np.maximum(alpha, _LEAST_ALPHA)
            d["depths"] = d_renders[..., p.channels:] * inverse
            more.append(np.where(alpha > _LEAST_ALPHA, -d["depths"] * depth, 0))
        if behind is not None:
            more.append(-(d["colors"] * behind).sum(-1, keepdims=True))
            # In f64: numpy adds up one by one along these axes.
            grads["backgrounds"] = (d["colors"] * (1 - alpha)).sum((1, 2), dtype=np.float64).astype(p.dtype)
        if d_alphas is not None or more:
            d["alphas"] = sum(more, np.zeros_like(alpha) if d_alphas is None else d_alphas)
        pulled = out["rendering"].pull_back({name: np.require(array, requirements="CA") for name, array in d.items()})
        meta["means2d_grad"] = pulled.pop("means2d")
        for name, shape in shapes.items():
            if name == "colors":
                grads[name] = _colors_grad(p, pulled["colors"], shape)
            elif name != "backgrounds":
                grads[name] = pulled[name]
        return grads

    return renders, alphas, meta, vjp


def _colors_grad(p, flat, shape):
    """The gradient of the colours in their shape: zeros for coefficients above the degree and for colours not drawn."""
    if not p.has_color:
        return np.zeros(shape, p.dtype)
    if p.degree is None:
        return flat.reshape(shape)
    grad = np.zeros(shape, p.dtype)
    grad[..., :p.coefficients, :] = flat.reshape(*shape[:-2], p.coefficients, p.channels)
    return grad


def _cotangent(name, value, of):
    if not isinstance(value, np.ndarray):
        raise TypeError(f"{name} must be a numpy array, not {type(value).__name__}")
    if value.shape != of.shape or value.dtype != of.dtype:
        raise ValueError(f"{name} must be {of.dtype} of shape {list(of.shape)}, not {value.dtype} of {list(value.shape)}")
    return value
