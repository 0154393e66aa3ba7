"""Gradients: float64 against central finite differences of every argument, float32 against float64."""

import numpy as np
import pytest

import gs4d
from scenes import NAMES, scene

#: Whatever the arguments of a call can be that change the gradients.
CASES = {
    "plain colours": {},
    "one channel, no background": {"channels": 1, "backgrounds": False},
    "seven channels, two cameras": {"channels": 7, "cameras": 2},
    "colours of each camera": {"channels": 2, "cameras": 2, "per_camera": True},
    "harmonics": {"sh_degree": 2},
    "harmonics of each camera": {"sh_degree": 1, "cameras": 2, "per_camera": True, "channels": 4},
    "depth": {"render_mode": "D", "backgrounds": False},
    "expected depth": {"render_mode": "ED", "backgrounds": False},
    "colours and depth": {"render_mode": "RGB+D"},
    "colours and expected depth, anti-aliased": {"render_mode": "RGB+ED", "rasterize_mode": "antialiased", "cameras": 2},
}
OPTIONS = ("render_mode", "rasterize_mode")


def case(name, dtype=np.float64):
    arguments = dict(CASES[name])
    options = {key: arguments.pop(key) for key in OPTIONS if key in arguments}
    # Splats are larger than the image, so that no sample comes near the least alpha that is drawn.
    full = scene(**arguments)
    full["scales"] = full["scales"] + 1.5
    if full["sh_degree"] is not None:
        full["colors"] = full["colors"] * 0.3 + 0.1
    return {**{k: v.astype(dtype) if isinstance(v, np.ndarray) else v for k, v in full.items()}, **options}


def weights(of, seed):
    return np.random.default_rng(seed).normal(size=of.shape)


def pulled(arguments):
    renders, alphas, meta, vjp = gs4d.rasterization_vjp(**arguments)
    d = weights(renders, 1).astype(renders.dtype), weights(alphas, 2).astype(alphas.dtype)
    return vjp(*d), meta


def loss(arguments):
    renders, alphas, _ = gs4d.rasterization(**arguments)
    return (renders * weights(renders, 1)).sum() + (alphas * weights(alphas, 2)).sum()


@pytest.mark.parametrize("name", CASES)
def test_float64_against_finite_differences(name):
    arguments = case(name)
    grads, _ = pulled(arguments)
    rng = np.random.default_rng(3)
    for key in NAMES:
        if arguments[key] is None:
            continue
        grad = grads[key]
        assert grad.shape == arguments[key].shape and grad.dtype == np.float64
        flat = [index for index in np.ndindex(grad.shape) if _varies(key, index)]
        for index in rng.permutation(flat)[:8]:
            index, values = tuple(index), []
            for step in (1e-6, -1e-6):
                array = arguments[key].copy()
                array[index] += step
                values.append(loss({**arguments, key: array}))
            slope = (values[0] - values[1]) / 2e-6
            scale = max(np.abs(grad).max(), 1e-3)
            assert abs(slope - grad[index]) <= 2e-6 * scale, (key, index, slope, grad[index])


def _varies(key, index):
    """Whether an entry is free: the last row of a viewmat and five entries of K are not."""
    if key == "viewmats":
        return index[1] < 3
    return key != "Ks" or tuple(index[1:]) in [(0, 0), (1, 1), (0, 2), (1, 2)]


@pytest.mark.parametrize("name", CASES)
def test_float32_against_float64(name):
    exact, _ = pulled(case(name))
    rounded, meta = pulled(case(name, np.float32))
    assert meta["means2d_grad"].dtype == np.float32 and np.abs(meta["means2d_grad"]).max() > 0
    for key, want in exact.items():
        got = rounded[key]
        assert got.dtype == np.float32 and got.shape == want.shape
        scale = np.linalg.norm(want)
        assert np.linalg.norm(got - want) <= 2e-4 * scale + 1e-6, (key, np.linalg.norm(got - want) / scale)


def test_a_kept_rendering_is_its_own():
    """Changing the arrays or the results after the call changes nothing, and gradients can be taken twice."""
    arguments = case("colours and expected depth, anti-aliased", np.float32)
    renders, alphas, _, vjp = gs4d.rasterization_vjp(**arguments)
    first = vjp(np.ones_like(renders))
    for array in (arguments["means"], arguments["backgrounds"], renders, alphas):
        array[:] = 0
    second = vjp(np.ones_like(renders))
    assert all(np.array_equal(first[key], second[key]) for key in first)
    assert np.abs(first["means"]).max() > 0


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_constants_of_inria(dtype):
    """A splat above the cap everywhere gets gradients, and one nearer than 0.2 is culled; with gsplat's constants neither."""
    one = {"means": [[0, 0, 2]], "quats": [[1, 0, 0, 0]], "scales": [[50, 50, 50]], "opacities": [1], "colors": [[1, 1, 1]],
           "viewmats": np.eye(4)[None], "Ks": [[[8, 0, 4], [0, 8, 4], [0, 0, 1]]]}
    one = {key: np.array(value, dtype) for key, value in one.items()}

    def drawn(z, **options):
        arguments = {**one, "means": np.array([[0, 0, z]], dtype), "width": 8, "height": 8, **options}
        renders, _, _, vjp = gs4d.rasterization_vjp(**arguments)
        return renders, vjp(np.ones_like(renders))["opacities"][0]

    (capped, none), (passed, some) = drawn(2), drawn(2, constants="inria")
    assert np.array_equal(capped, passed) and none == 0 and some > 100
    near, far = drawn(0.15, constants="gsplat")[0], drawn(0.15, constants="inria")[0]
    assert near.max() > 0.9 and not far.any()
    assert not drawn(0.25, constants="inria", near_plane=0.3)[0].any() and drawn(0.25, constants="inria")[0].any()


def test_the_gradient_of_a_background_is_a_sum_without_drift():
    side = 1200
    few = {**scene(dtype=np.float32), "width": side, "height": side, "threads": 1}
    few["opacities"] = np.zeros_like(few["opacities"])
    renders, _, _, vjp = gs4d.rasterization_vjp(**few)
    d = np.full_like(renders, 0.1)
    got = vjp(d)["backgrounds"]
    assert got.dtype == np.float32
    assert np.abs(got / (np.float64(d[0, 0, 0, 0]) * side * side) - 1).max() < 1e-6
