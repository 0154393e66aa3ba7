"""JAX arrays in, JAX arrays out, gradients in reverse mode, with and without jit."""

import numpy as np
import pytest

import gs4d
from scenes import NAMES, scene

jax = pytest.importorskip("jax")


@pytest.fixture(autouse=True)
def double_precision():
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", before)


@pytest.mark.parametrize("options", [
    {"dtype": np.float32, "cameras": 2}, {"dtype": np.float64, "sh_degree": 1, "channels": 4, "backgrounds": False},
])
@pytest.mark.parametrize("jit", [False, True])
def test_the_same_as_numpy(options, jit):
    arguments = scene(**options)
    mode = {"render_mode": "RGB+ED"}
    renders, alphas, meta, vjp = gs4d.rasterization_vjp(**arguments, **mode)
    want = vjp(np.cos(renders), np.ones_like(alphas))
    rest = {k: v for k, v in arguments.items() if not isinstance(v, np.ndarray) and k not in NAMES}
    arrays = {k: jax.numpy.asarray(arguments[k]) for k in NAMES if arguments[k] is not None}
    if "backgrounds" not in arrays:
        rest["backgrounds"] = None

    def loss(arrays):
        r, a, m = gs4d.jax.rasterization(**arrays, **rest, **mode)
        return jax.numpy.sin(r).sum() + a.sum(), (r, a, m["radii"])

    grad = jax.value_and_grad(loss, has_aux=True)
    (_, (r, a, radii)), grads = (jax.jit(grad) if jit else grad)(arrays)
    assert np.array_equal(r, renders) and np.array_equal(a, alphas) and np.array_equal(radii, meta["radii"])
    for key, array in grads.items():
        assert array.dtype == want[key].dtype
        assert np.allclose(array, want[key], rtol=1e-6, atol=1e-6 * np.abs(want[key]).max()), key


def test_check_grads():
    from jax.test_util import check_grads

    arguments = scene(n=3, size=(6, 5))
    arguments["scales"] = arguments["scales"] + 1.5
    free = ("means", "quats", "scales", "opacities", "colors")
    rest = {k: v for k, v in arguments.items() if k not in free}
    check_grads(lambda *v: gs4d.jax.rasterization(**dict(zip(free, v)), **rest)[:2], [arguments[k] for k in free], order=1,
                modes=["rev"], eps=1e-6, atol=1e-5, rtol=1e-4)


def test_what_does_not_fit_is_refused_by_name():
    with pytest.raises(ValueError, match=r"means must have shape \[N, 3\], not \[6, 2\]"):
        gs4d.jax.rasterization(**{**scene(), "means": jax.numpy.zeros((6, 2))})
