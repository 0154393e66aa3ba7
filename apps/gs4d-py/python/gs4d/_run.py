"""Runs of gs4d: what was trained, as arrays and images."""

import os
from functools import cached_property

import numpy as np

from . import _gs4d


def load(path, data=None):
    """Opens a run folder, a checkpoint or a compact file (``.gs4d``). ``data`` is the folder of its data, if they moved.

    Raises:
        ValueError: says why it cannot be opened. What needs the data raises it where ``data`` was given and cannot be read.
    """
    return Run(_gs4d.open_run(os.fspath(path), None if data is None else os.fspath(data)))


class Run:
    """A trained scene.

    Times are normalised: 0 is the first training image, 1 the last, or the end of the whole sequence where ``data.time_boundary`` keeps that out
    of training; what is later than the last training image is extrapolated.
    """

    def __init__(self, native):
        self._native = native

    def __repr__(self):
        return f"<gs4d.Run of {self.method}, {self.step} steps>"

    @property
    def method(self):
        """Name of the method, such as "fourdgs"."""
        return self._native.method

    @property
    def step(self):
        """Optimizer steps made."""
        return self._native.step

    @property
    def background(self):
        """[3] the colour behind the scene that the run is evaluated over."""
        return np.array(self._native.background, np.float32)

    @cached_property
    def times(self):
        """[T] training timestamps, ascending, at most 400; empty if neither the data nor their times were kept."""
        return np.array(self._native.times(), np.float32)

    @cached_property
    def cameras(self):
        """Training views: dictionaries of ``name``, ``viewmat`` [4, 4], ``K`` [3, 3], ``width``, ``height`` and ``t``.

        Matrices are float64; beside the float32 columns of ``splats``, ``rasterization`` takes them ``.astype(numpy.float32)``.

        Cameras and times are as they were learnt, where the run corrected them. Without the data there are those that the run kept: at most 16,
        evenly spaced.
        """
        return [{"name": name, "viewmat": np.reshape(viewmat, (4, 4)), "K": np.reshape(k, (3, 3)), "width": width,
                 "height": height, "t": t} for name, (viewmat, k, width, height), t in self._native.cameras()]

    def splats(self, t, camera=None):
        """All splats at a time, in the same order at every time; those absent have opacity 0.

        The dictionary has arguments of :func:`gs4d.rasterization`: ``means`` [N, 3], ``quats`` [N, 4], ``scales``
        [N, 3], ``opacities`` [N], ``colors`` [N, 3] or [N, K, 3] and ``sh_degree``; and how the scene was trained to be drawn,
        ``near_plane``, ``eps2d`` and ``rasterize_mode``. Of a learnt kernel there are also
        ``lambdas`` and ``betas`` or ``acutances`` [N], which only :meth:`render` draws. ``camera``, a dictionary as in
        :attr:`cameras`, matters where a method decodes splats for a view; a training view by default.
        """
        matrices = None if camera is None else _matrices(**{k: camera[k] for k in ("viewmat", "K", "width", "height")})
        return self._native.splats(float(t), matrices)

    def render(self, viewmat, K, width, height, t, background=None, threads=None):
        """The image at a time: ``colors`` [height, width, 3], not clamped, ``alphas`` and ``depths`` (Σ w z) [height, width, 1].
        ``background`` is a colour, that of the evaluation by default."""
        color = None if background is None else tuple(float(v) for v in background)
        if color is not None and len(color) != 3:
            raise ValueError(f"background must have 3 values, not {len(color)}")
        return self._native.render(float(t), _matrices(viewmat, K, width, height), color, threads)


def _matrices(viewmat, K, width, height):
    viewmat, K = np.asarray(viewmat, np.float64), np.asarray(K, np.float64)
    for name, array, side in (("viewmat", viewmat, 4), ("K", K, 3)):
        if array.shape != (side, side):
            raise ValueError(f"{name} must have shape [{side}, {side}], not {list(array.shape)}")
    return viewmat.ravel().tolist(), K.ravel().tolist(), width, height
