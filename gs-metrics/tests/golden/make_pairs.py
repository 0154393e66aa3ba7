"""Makes the image pairs of this folder and computes their scores, apart from gs-metrics.

    python3 -m venv venv && venv/bin/pip install numpy scipy scikit-image
    venv/bin/python make_pairs.py          # images and scores.tsv
    venv/bin/python make_pairs.py --keep   # scores.tsv of the images that are there

All scores are in float64, of 8-bit values divided by 255. PSNR and SSIM of the valid area are those of scikit-image. SSIM
with zero padding and MS-SSIM are written out below with scipy's filters; where TensorFlow is installed, its
`tf.image.ssim_multiscale` (float32) is compared with MS-SSIM for sides that are multiples of 16.
"""

import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
from PIL import Image
from scipy import fft, ndimage
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

HERE = Path(__file__).parent
LEVEL_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
C1, C2 = 0.01**2, 0.03**2
WINDOW = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))
WINDOW /= WINDOW.sum()


def scene(width, height, phase):
    """Shading, discs, bars and a grating whose frequency rises to the right, [height, width, 3] in [0.05, 0.95]."""
    y, x = np.mgrid[0:height, 0:width].astype(float)
    image = np.empty((height, width, 3))
    for c in range(3):
        value = 0.5 + 0.2 * np.sin(0.021 * x + phase + c) * np.cos(0.017 * y - 0.5 * c)
        value += 0.15 * np.sin((0.05 + 0.003 * x) * x + 0.4 * c) * np.clip((y - 0.6 * height) / 20, 0, 1)
        for k, (u, v, radius) in enumerate([(0.25, 0.3, 30), (0.7, 0.25, 22), (0.55, 0.55, 14)]):
            inside = np.hypot(x - u * width, y - v * height) < radius
            value[inside] += 0.2 * (-1) ** (k + c)
        bars = (np.floor((x + 0.5 * y + 7 * phase) / 6) % 2 == 0) & (x > 0.8 * width)
        value[bars] -= 0.15
        image[..., c] = value
    return np.clip(image, 0.05, 0.95)


def blur(image):
    """Gaussian blur of 1.6 pixels."""
    return ndimage.gaussian_filter(image, sigma=(1.6, 1.6, 0))


def blocks(image):
    """8 x 8 cosine transform of each channel, coefficient (u, v) rounded to a multiple of 0.04 (1 + u + v)."""
    u, v = np.mgrid[0:8, 0:8]
    quantum = 0.04 * (1 + u + v)
    out = image.copy()
    for y in range(0, image.shape[0], 8):
        for x in range(0, image.shape[1], 8):
            for c in range(3):
                block = fft.dctn(image[y : y + 8, x : x + 8, c], norm="ortho")
                block = np.round(block / quantum) * quantum
                out[y : y + 8, x : x + 8, c] = fft.idctn(block, norm="ortho")
    return out


def noise(image):
    """Contrast lowered to 0.8, and noise of standard deviation 0.04."""
    rng = np.random.Generator(np.random.PCG64(7))
    return 0.5 + 0.8 * (image - 0.5) + rng.normal(0, 0.04, image.shape)


PAIRS = {"blur": (blur, 208, 176, 0.0), "blocks": (blocks, 192, 176, 1.0), "noise": (noise, 187, 171, 2.0)}


def save(name, image):
    rounded = np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
    Image.fromarray(rounded).save(HERE / name, optimize=True)


def load(name):
    return np.asarray(Image.open(HERE / name).convert("RGB")).astype(float) / 255


def filtered(plane):
    """The 11-tap window along both axes, zeros outside."""
    rows = ndimage.correlate1d(plane, WINDOW, axis=0, mode="constant")
    return ndimage.correlate1d(rows, WINDOW, axis=1, mode="constant")


def maps(a, b):
    """SSIM of every pixel of one channel, and its contrast-structure factor."""
    mean_a, mean_b = filtered(a), filtered(b)
    var_a, var_b = filtered(a * a) - mean_a**2, filtered(b * b) - mean_b**2
    cov = filtered(a * b) - mean_a * mean_b
    contrast = (2 * cov + C2) / (var_a + var_b + C2)
    return contrast * (2 * mean_a * mean_b + C1) / (mean_a**2 + mean_b**2 + C1), contrast


def ssim_zero_padded(a, b):
    return np.mean([maps(a[..., c], b[..., c])[0].mean() for c in range(3)])


def halved(plane):
    """2 x 2 means; a side of odd length gets a line of zeros on both ends (avg_pool2d with padding side % 2)."""
    height, width = plane.shape
    plane = np.pad(plane, [(height % 2, height % 2), (width % 2, width % 2)])
    height, width = plane.shape[0] // 2 * 2, plane.shape[1] // 2 * 2
    return plane[:height, :width].reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3))


def ms_ssim(a, b):
    """Five levels, valid area, factors clamped at 0, product per channel (pytorch-msssim 1.0)."""
    products = []
    for c in range(3):
        x, y, product = a[..., c], b[..., c], 1.0
        for level, weight in enumerate(LEVEL_WEIGHTS):
            full, contrast = (m[5:-5, 5:-5].mean() for m in maps(x, y))
            product *= max(full if level == 4 else contrast, 0) ** weight
            x, y = halved(x), halved(y)
        products.append(product)
    return np.mean(products)


def scores(truth, image):
    published = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "channel_axis": 2}
    return {
        "mse": np.mean((truth - image) ** 2),
        "psnr": peak_signal_noise_ratio(truth, image, data_range=1),
        "ssim_valid": structural_similarity(truth, image, data_range=1, **published),
        "ssim_zero": ssim_zero_padded(truth, image),
        "ms_ssim": ms_ssim(truth, image),
    }


def compare_with_tensorflow(name, truth, image, ours):
    try:
        import tensorflow as tf
    except ImportError:
        return
    if any(side % 16 for side in truth.shape[:2]):
        return
    theirs = float(tf.image.ssim_multiscale(tf.constant(image), tf.constant(truth), max_val=1.0))
    print(f"{name}: MS-SSIM {ours:.7f}, TensorFlow {tf.__version__} {theirs:.7f}, off by {theirs - ours:.1e}")


def main():
    packages = ("numpy", "scipy", "scikit-image", "pillow")
    lines = ["# " + ", ".join(f"{p} {version(p)}" for p in packages) + f", Python {sys.version.split()[0]}"]
    for name, (distort, width, height, phase) in PAIRS.items():
        if "--keep" not in sys.argv:
            truth = scene(width, height, phase)
            save(f"{name}_truth.png", truth)
            save(f"{name}.png", distort(truth))
        truth, image = load(f"{name}_truth.png"), load(f"{name}.png")
        found = scores(truth, image)
        lines += [f"{name}\t{metric}\t{float(value)!r}" for metric, value in found.items()]
        compare_with_tensorflow(name, truth, image, found["ms_ssim"])
    (HERE / "scores.tsv").write_text("\n".join(lines) + "\n")


main()
