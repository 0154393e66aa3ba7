"""Fits splats that move in straight lines to images of a moving scene: numpy alone, a few seconds.

    python examples/fit_moving_scene.py
"""

import numpy as np

import gs4d

SIDE, TIMES = 48, np.linspace(0, 1, 5, dtype=np.float32)


def cameras(count=4):
    """Cameras on an arc in front of the scene, and their intrinsics."""
    views = np.tile(np.eye(4, dtype=np.float32), (count, 1, 1))
    for view, angle in zip(views, np.linspace(-0.5, 0.5, count)):
        view[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
        view[2, 3] = 3
    K = np.array([[60, 0, SIDE / 2], [0, 60, SIDE / 2], [0, 0, 1]], np.float32)
    return views, np.tile(K, (count, 1, 1))


def truth(rng, n=12):
    """Parameters of the scene: centres at time 0, velocities, log-scales, quaternions, logits of opacity and of colour."""
    draw = lambda width, low, high: rng.uniform(low, high, (n, width)).astype(np.float32)
    return {"start": draw(3, -0.6, 0.6), "velocity": draw(3, -0.5, 0.5), "log_scales": draw(3, -2.2, -1.4),
            "quats": draw(4, -1, 1), "opacity": draw(1, 0, 2), "color": draw(3, -2, 2)}


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def render(p, t, views, Ks):
    """Images of all cameras at a time, and the gradients of the parameters for a gradient of the images."""
    scales, opacities, colors = np.exp(p["log_scales"]), sigmoid(p["opacity"][:, 0]), sigmoid(p["color"])
    images, _, _, vjp = gs4d.rasterization_vjp(
        p["start"] + t * p["velocity"], p["quats"], scales, opacities, colors, views, Ks, SIDE, SIDE)

    def pull_back(d_images):
        g = vjp(d_images)
        return {"start": g["means"], "velocity": t * g["means"], "log_scales": g["scales"] * scales, "quats": g["quats"],
                "opacity": (g["opacities"] * opacities * (1 - opacities))[:, None],
                "color": g["colors"] * colors * (1 - colors)}

    return images, pull_back


def fit(steps=400, rate=0.02, seed=0):
    """PSNR in dB over all cameras and times before and after the fit."""
    rng = np.random.default_rng(seed)
    views, Ks = cameras()
    scene = truth(rng)
    images = {t: render(scene, t, views, Ks)[0] for t in TIMES}
    p = {key: value + rng.normal(0, 0.25, value.shape).astype(np.float32) for key, value in scene.items()}
    p["velocity"][:] = 0
    score = lambda: np.mean([gs4d.psnr(a, b) for t in TIMES for a, b in zip(render(p, t, views, Ks)[0], images[t])])
    before, moments = score(), {key: (np.zeros_like(v), np.zeros_like(v)) for key, v in p.items()}
    for step in range(1, steps + 1):
        t = rng.choice(TIMES)
        drawn, pull_back = render(p, t, views, Ks)
        for key, g in pull_back(2 * (drawn - images[t]) / drawn.size).items():
            m, v = moments[key]
            m += 0.1 * (g - m)
            v += 0.01 * (g * g - v)
            p[key] -= rate * (1 - step / steps) * (m / (1 - 0.9**step)) / (np.sqrt(v / (1 - 0.99**step)) + 1e-12)
    return before, score()


if __name__ == "__main__":
    print("PSNR %.1f dB before, %.1f dB after" % fit())
