"""Fits splats that move in straight lines to images of a moving scene: numpy alone, two seconds."""

import numpy as np
import gs4d

rng = np.random.default_rng(0)
views = np.tile(np.eye(4, dtype=np.float32), (3, 1, 1))  # three cameras in a row, which look along +z
views[:, :3, 3] = [[-0.8, 0, 3], [0, 0, 3], [0.8, 0, 3]]
Ks = np.tile(np.array([[60, 0, 24], [0, 60, 24], [0, 0, 1]], np.float32), (3, 1, 1))
opacities = np.full(12, 0.8, np.float32)


def render(scene, t):
    splats = {name: array for name, array in scene.items() if name != "velocities"}
    splats["means"] = scene["means"] + t * scene["velocities"]
    return gs4d.rasterization_vjp(**splats, opacities=opacities, viewmats=views, Ks=Ks, width=48, height=48)


def uniform(low, high, width):
    return rng.uniform(low, high, (12, width)).astype(np.float32)


truth = {"means": uniform(-0.6, 0.6, 3), "velocities": uniform(-0.5, 0.5, 3), "quats": uniform(-1, 1, 4),
         "scales": uniform(0.1, 0.25, 3), "colors": uniform(0, 1, 3)}
images = {t: render(truth, t)[0] for t in np.linspace(0, 1, 5, dtype=np.float32)}
scene = {"means": truth["means"] + uniform(-0.1, 0.1, 3), "velocities": np.zeros((12, 3), np.float32), "quats": uniform(-1, 1, 4),
         "scales": np.full((12, 3), 0.15, np.float32), "colors": np.full((12, 3), 0.5, np.float32)}
moments = {name: np.zeros((2, *array.shape), np.float32) for name, array in scene.items()}
for step in range(1000):
    t = rng.choice(list(images))
    drawn, _, _, vjp = render(scene, t)
    grads = vjp(drawn - images[t])
    grads["velocities"] = t * grads["means"]
    for name, (mean, square) in moments.items():  # Adam, with a rate that falls to 0
        mean += 0.1 * (grads[name] - mean)
        square += 0.01 * (grads[name] ** 2 - square)
        scene[name] -= 0.02 * (1 - step / 1000) * mean / (np.sqrt(square) + 1e-8)

psnr = [gs4d.psnr(*pair) for t in (0.125, 0.625, 0.875) for pair in zip(render(scene, t)[0], render(truth, t)[0])]
print(f"{np.mean(psnr):.1f} dB at times that were not fitted")
