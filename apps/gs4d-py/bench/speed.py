"""Milliseconds of a frame and of its gradients, from numpy: ``python bench/speed.py``.

The least of 31 calls of ``rasterization`` and of ``vjp``, copies included: plain colours, float32, one camera. The scene is that of
gs-raster's benchmark: centres in the unit box, log-normal sizes, 1.5 units from the camera.
"""

import time

import numpy as np

import gs4d

ROUNDS = 31


def scene(n, side, seed=1):
    rng = np.random.default_rng(seed)
    median = 0.02 * (1e4 / n) ** np.log10(2)
    size = median * np.exp(0.5 * rng.normal(size=(n, 1)))
    view = np.eye(4)
    view[2, 3] = 1.5
    K = np.array([[1.2 * side, 0, side / 2], [0, 1.2 * side, side / 2], [0, 0, 1]])
    arrays = (rng.uniform(-0.5, 0.5, (n, 3)), rng.normal(size=(n, 4)), size * np.exp(0.6 * rng.normal(size=(n, 3))),
              1 / (1 + np.exp(-1.8 * rng.normal(size=n))), rng.uniform(size=(n, 3)), view[None], K[None])
    return [array.astype(np.float32) for array in arrays]


def least_ms(function):
    times = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return 1e3 * min(times)


if __name__ == "__main__":
    side = 256
    for n in (10_000, 100_000):
        arrays = scene(n, side)
        for threads in (1, 2):
            forward = least_ms(lambda: gs4d.rasterization(*arrays, side, side, threads=threads))
            renders, _, _, vjp = gs4d.rasterization_vjp(*arrays, side, side, threads=threads)
            d = np.ones_like(renders)
            backward = least_ms(lambda: vjp(d))
            print(f"{n} splats, {side}x{side}, {threads} threads: forward {forward:.1f} ms, backward {backward:.1f} ms")
