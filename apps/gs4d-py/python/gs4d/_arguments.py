"""The arguments of ``rasterization``: names and defaults are gsplat's. Types and shapes are checked here, values natively."""

import operator

import numpy as np

#: Arguments of gsplat, and columns of kernels, that are refused unless they have this value, and what to do instead.
REFUSED = {
    "radius_clip": (0.0, "remove small splats from the arrays"),
    "sparse_grad": (False, "gradients are dense"),
    "absgrad": (False, 'meta["means2d_grad"] has the signed gradients after backward'),
    "distributed": (False, "call it once per process, with all splats"),
    "camera_model": ("pinhole", "only pinhole cameras are drawn; undistort images of other lenses first"),
    "covars": (None, "give quats and scales"),
    "with_ut": (False, "leave it out"),
    "with_eval3d": (False, "leave it out"),
    "return_normals": (False, "render normals as channels of colors"),
    "global_z_order": (True, "splats are ordered by camera depth"),
    "rays": (None, "give viewmats and Ks"),
    "radial_coeffs": (None, "undistort the images first"),
    "tangential_coeffs": (None, "undistort the images first"),
    "thin_prism_coeffs": (None, "undistort the images first"),
    "ftheta_coeffs": (None, "undistort the images first"),
    "lidar_coeffs": (None, "give viewmats and Ks"),
    "external_distortion_coeffs": (None, "undistort the images first"),
    "rolling_shutter": (None, "every camera has a global shutter"),
    "viewmats_rs": (None, "every camera has a global shutter"),
    "ut_params": (None, "leave it out"),
    "extra_signals": (None, "append them to the channels of colors"),
    "extra_signals_sh_degree": (None, "append them to the channels of colors"),
    "renderer_config": (None, "leave it out"),
    "lambdas": (None, "learnt kernels are drawn by Run.render alone"),
    "betas": (None, "learnt kernels are drawn by Run.render alone"),
    "acutances": (None, "learnt kernels are drawn by Run.render alone"),
}

#: Arguments that concern the speed of GPUs.
IGNORED = ("packed", "tile_size", "channel_chunk", "segmented", "macro_tile")

#: Names of the arrays, in the order of the arguments.
ARRAYS = ("means", "quats", "scales", "opacities", "colors", "viewmats", "Ks", "backgrounds")

#: Constants of the two published rasterisers where they differ: the least near plane, and whether samples above ``max_alpha``
#: get gradients. INRIA's kernels cull at 0.2 whatever near plane is asked for, and their backward ignores the cap
#: (diff-gaussian-rasterization: ``in_frustum``, ``renderCUDA``).
CONSTANTS = {"gsplat": (float("-inf"), False), "inria": (0.2, True)}

_MODES = {"RGB": (True, None), "D": (False, "D"), "ED": (False, "ED"), "RGB+D": (True, "D"), "RGB+ED": (True, "ED")}
_MOST_PIXELS = 32768


class Plan:
    """Arguments that have passed: the sizes, and the settings of the native module. Arrays need a shape and a dtype only."""

    def __init__(self, arrays, *, width, height, near_plane, far_plane, eps2d, sh_degree, render_mode, rasterize_mode,
                 max_alpha, constants, threads):
        if render_mode not in _MODES:
            raise ValueError(f"render_mode = {render_mode!r} is not supported: use one of {', '.join(_MODES)}")
        if rasterize_mode not in ("classic", "antialiased"):
            raise ValueError(f"rasterize_mode = {rasterize_mode!r} is not supported: use 'classic' or 'antialiased'")
        if constants not in CONSTANTS:
            raise ValueError(f"constants = {constants!r} is not supported: use one of {', '.join(CONSTANTS)}")
        least_near, pass_through = CONSTANTS[constants]
        self.has_color, self.depth = _MODES[render_mode]
        self.width, self.height = _side("width", width), _side("height", height)
        self.dtype = _dtype(arrays["means"])
        self.splats = _shape("means", arrays["means"], self.dtype, [("N", None), 3])[0]
        _shape("quats", arrays["quats"], self.dtype, [("N", self.splats), 4])
        _shape("scales", arrays["scales"], self.dtype, [("N", self.splats), 3])
        _shape("opacities", arrays["opacities"], self.dtype, [("N", self.splats)])
        self.cameras = _shape("viewmats", arrays["viewmats"], self.dtype, [("C", None), 4, 4])[0]
        _shape("Ks", arrays["Ks"], self.dtype, [("C", self.cameras), 3, 3])
        if self.cameras == 0:
            raise ValueError("viewmats holds no camera")
        self.degree, self.coefficients, self.channels, self.colors_per_camera = None, 1, 0, False
        if self.has_color:
            self._colors(arrays["colors"], sh_degree)
        if arrays["backgrounds"] is not None:
            want = [("C", self.cameras), ("D", self.channels)]
            if not self.has_color:
                raise ValueError(f"backgrounds have no meaning for render_mode = {render_mode!r}: leave them out")
            _shape("backgrounds", arrays["backgrounds"], self.dtype, want)
        self.out_channels = self.channels + (self.depth is not None)
        self.settings = {
            "width": self.width,
            "height": self.height,
            "near": max(float(near_plane), least_near),
            "far": float(far_plane),
            "dilation": float(eps2d),
            "max_alpha": float(max_alpha),
            "pass_through": pass_through,
            "antialias": rasterize_mode == "antialiased",
            "degree": self.degree,
            "channels": self.channels,
            "colors_per_camera": self.colors_per_camera,
            "threads": None if threads is None else _whole("threads", threads, 1, 1024),
        }

    def _colors(self, colors, sh_degree):
        if colors is None:
            raise ValueError("colors is None: only the render modes 'D' and 'ED' do without")
        n, c, shape = ("N", self.splats), ("C", self.cameras), []
        if sh_degree is None:
            shape = [n, ("D", None)]
        else:
            self.degree = _whole("sh_degree", sh_degree, 0, 3)
            self.coefficients = (self.degree + 1) ** 2
            shape = [n, ("K", None), ("D", None)]
        self.colors_per_camera = getattr(colors, "ndim", 0) == len(shape) + 1
        found = _shape("colors", colors, self.dtype, [c] * self.colors_per_camera + shape)
        self.channels = found[-1]
        if self.channels == 0:
            raise ValueError(f"colors of shape {found} have no channel")
        if self.degree is not None and found[-2] < self.coefficients:
            raise ValueError(f"colors of shape {found} have {found[-2]} coefficients, sh_degree = {self.degree} needs "
                             f"{self.coefficients}")


def refuse(arguments):
    """An error for the first argument that is not supported."""
    for name, value in arguments.items():
        if name in IGNORED:
            continue
        if name not in REFUSED:
            raise TypeError(f"rasterization() got an unexpected keyword argument {name!r}")
        default, advice = REFUSED[name]
        if value is not None and not _is_default(value, default):
            raise ValueError(f"{name} = {value!r} is not supported: {advice}")


def _is_default(value, default):
    """Whether a value, plain or of numpy, is the default. gsplat's own name of a camera without a rolling shutter is GLOBAL."""
    if getattr(value, "name", None) == "GLOBAL":
        return True
    plain = value.item() if isinstance(value, np.generic) else value
    return type(plain) in (bool, int, float, str) and plain == default


def _whole(name, value, least, most):
    try:
        number = operator.index(value)
    except TypeError:
        raise TypeError(f"{name} must be a whole number, not {type(value).__name__}") from None
    if not least <= number <= most:
        raise ValueError(f"{name} = {number} is out of range ({least} to {most})")
    return number


def _side(name, value):
    return _whole(name, value, 1, _MOST_PIXELS)


def _dtype(means):
    dtype = str(getattr(means, "dtype", type(means).__name__)).removeprefix("torch.")
    if dtype not in ("float32", "float64"):
        raise TypeError(f"means must be an array of float32 (fast) or float64 (the reference), not {dtype}")
    return dtype


def _shape(name, value, dtype, want):
    """The array's shape, if it is as wanted: numbers, or pairs of a letter and a number or None."""
    if not hasattr(value, "shape") or not hasattr(value, "dtype"):
        raise TypeError(f"{name} must be an array, not {type(value).__name__}")
    got = str(value.dtype).removeprefix("torch.")
    if got != dtype:
        raise TypeError(f"{name} must be {dtype} as means are, not {got}")
    shape = tuple(value.shape)
    sizes = [side if isinstance(side, int) else side[1] for side in want]
    if len(shape) != len(want) or any(size is not None and size != side for size, side in zip(sizes, shape)):
        text = [str(side) if isinstance(side, int) else side[0] if side[1] is None else f"{side[0]} = {side[1]}"
                for side in want]
        batches = name in ("means", "viewmats") and len(shape) > len(want)
        advice = ": leading batch dimensions are not supported, call it once for each" if batches else ""
        raise ValueError(f"{name} must have shape [{', '.join(text)}], not {list(shape)}{advice}")
    return shape
