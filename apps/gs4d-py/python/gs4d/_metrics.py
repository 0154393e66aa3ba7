"""Scores of images: arrays [height, width] or [height, width, channels], display-encoded values in 0 to 1."""

import numpy as np

from . import _gs4d


def psnr(image, truth):
    """Peak signal-to-noise ratio in dB, for values in 0 to 1; infinite for equal images."""
    return _gs4d.psnr(_pixels("image", image), _pixels("truth", truth))


def ssim(image, truth, padding="valid"):
    """Structural similarity (Wang et al. 2004), Gaussian window of 11 pixels. ``padding`` is "valid", as in publications, or
    "zero", as in training losses."""
    if padding not in ("valid", "zero"):
        raise ValueError(f"padding = {padding!r} is not supported: use 'valid' or 'zero'")
    return _gs4d.ssim(_pixels("image", image), _pixels("truth", truth), padding == "valid")


def ms_ssim(image, truth):
    """Structural similarity on five scales (Wang et al. 2003)."""
    return _gs4d.ms_ssim(_pixels("image", image), _pixels("truth", truth))


def perceptual_proxy(image, truth):
    """A perceptual distance without learnt weights; it is not LPIPS."""
    return _gs4d.perceptual_proxy(_pixels("image", image), _pixels("truth", truth))


def _pixels(name, value):
    array = np.asarray(value)
    if array.dtype.kind != "f" or array.ndim not in (2, 3):
        raise ValueError(f"{name} must be floats of shape [height, width] or [height, width, channels], not {array.dtype} "
                         f"of {list(array.shape)}")
    return np.require(array.reshape(*array.shape[:2], -1), np.float32, "CA")
