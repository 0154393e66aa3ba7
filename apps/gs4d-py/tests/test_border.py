"""What the package accepts and refuses, threads, and the interpreter's lock."""

import importlib.metadata
import multiprocessing
import os
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import gs4d
from gs4d._arguments import IGNORED, REFUSED, refuse
from scenes import scene


def test_the_package_is_the_one_that_pip_installed():
    files = {Path(file.locate()).resolve() for file in importlib.metadata.files("gs4d")}
    assert {Path(module.__file__).resolve() for module in (gs4d, gs4d._gs4d)} <= files
    assert any("numpy" in requirement for requirement in importlib.metadata.requires("gs4d"))


def drawn(**changes):
    return gs4d.rasterization(**{**scene(dtype=np.float32), **changes})


@pytest.mark.parametrize("change, kind, text", [
    ({"means": [[0, 0, 1]]}, TypeError, "means must be an array of float32 (fast) or float64 (the reference), not list"),
    ({"means": np.zeros((6, 3), np.int64)}, TypeError, "not int64"),
    ({"means": np.zeros((6, 2), np.float32)}, ValueError, "means must have shape [N, 3], not [6, 2]"),
    ({"means": np.zeros((2, 6, 3), np.float32)}, ValueError, "not [2, 6, 3]: leading batch dimensions are not supported"),
    ({"quats": np.ones((5, 4), np.float32)}, ValueError, "quats must have shape [N = 6, 4], not [5, 4]"),
    ({"quats": np.ones((6, 4))}, TypeError, "quats must be float32 as means are, not float64"),
    ({"scales": np.full((6, 3), np.nan, np.float32)}, ValueError, "scales, row 0: NaN is not finite"),
    ({"opacities": np.full(6, 1.5, np.float32)}, ValueError, "opacities, row 0: 1.5 is out of range (0 to 1)"),
    ({"opacities": np.ones((6, 1), np.float32)}, ValueError, "opacities must have shape [N = 6], not [6, 1]"),
    ({"colors": np.ones((2, 6, 3), np.float32)}, ValueError, "colors must have shape [C = 1, N = 6, D], not [2, 6, 3]"),
    ({"colors": np.ones((6, 0), np.float32), "backgrounds": None}, ValueError, "colors of shape (6, 0) have no channel"),
    ({"colors": np.full((6, 3), np.inf, np.float32)}, ValueError, "colors: the colour of splat 0 has a channel of inf"),
    ({"colors": None}, ValueError, "colors is None"),
    ({"sh_degree": 4, "colors": np.ones((6, 25, 3), np.float32)}, ValueError, "sh_degree = 4 is out of range (0 to 3)"),
    ({"sh_degree": 2, "colors": np.ones((6, 4, 3), np.float32)}, ValueError, "have 4 coefficients, sh_degree = 2 needs 9"),
    ({"viewmats": np.zeros((0, 4, 4), np.float32), "Ks": np.zeros((0, 3, 3), np.float32)}, ValueError, "holds no camera"),
    ({"viewmats": 2 * np.eye(4, dtype=np.float32)[None]}, ValueError, "viewmats[0]: the last row"),
    ({"viewmats": np.diag([2, 1, 1, 1]).astype(np.float32)[None]}, ValueError, "camera rotation is not orthonormal"),
    ({"Ks": np.ones((1, 3, 3), np.float32)}, ValueError, "skew is not supported"),
    ({"Ks": np.diag([-1, 1, 1]).astype(np.float32)[None]}, ValueError, "fx = -1"),
    ({"backgrounds": np.ones((1, 4), np.float32)}, ValueError, "backgrounds must have shape [C = 1, D = 3], not [1, 4]"),
    ({"backgrounds": np.full((1, 3), np.nan, np.float32)}, ValueError, "backgrounds: all values must be finite"),
    ({"render_mode": "D"}, ValueError, "backgrounds have no meaning"),
    ({"render_mode": "rgb"}, ValueError, "render_mode = 'rgb' is not supported"),
    ({"rasterize_mode": "fast"}, ValueError, "rasterize_mode = 'fast' is not supported"),
    ({"width": 0}, ValueError, "width = 0 is out of range"),
    ({"height": 1.5}, TypeError, "height must be a whole number, not float"),
    ({"near_plane": -1.0}, ValueError, "near_plane = -1"),
    ({"eps2d": float("nan")}, ValueError, "eps2d = NaN"),
    ({"max_alpha": 1.0}, ValueError, "max_alpha = 1"),
    ({"constants": "INRIA"}, ValueError, "constants = 'INRIA' is not supported: use one of gsplat, inria"),
    ({"threads": 0}, ValueError, "threads = 0"),
    ({"camera_model": "fisheye"}, ValueError, "camera_model = 'fisheye' is not supported: only pinhole cameras are drawn"),
    ({"covars": np.zeros((6, 3, 3))}, ValueError, "is not supported: give quats and scales"),
    ({"sparse_grad": True}, ValueError, "sparse_grad = True is not supported"),
    ({"distributed": True}, ValueError, "distributed = True is not supported"),
    ({"absgrad": True}, ValueError, "absgrad = True is not supported"),
    ({"radius_clip": 3.0}, ValueError, "radius_clip = 3.0 is not supported"),
    ({"with_ut": True}, ValueError, "with_ut = True is not supported"),
    ({"radial_coeffs": np.zeros((1, 6))}, ValueError, "is not supported: undistort the images first"),
    ({"no_such_argument": 1}, TypeError, "unexpected keyword argument 'no_such_argument'"),
])
def test_what_does_not_fit_is_refused_by_name(change, kind, text):
    with pytest.raises(kind) as error:
        drawn(**change)
    assert text in str(error.value)


@pytest.mark.parametrize("name, default", [(name, default) for name, (default, _) in REFUSED.items()])
def test_every_argument_that_is_not_supported_is_refused_by_name(name, default):
    refuse({name: default})
    refuse({name: None})
    with pytest.raises(ValueError, match=f"^{name} = "):
        refuse({name: not default if isinstance(default, bool) else "something else"})


def test_arguments_of_gpus_have_no_effect():
    images = [drawn(**changes)[0] for changes in ({}, dict.fromkeys(IGNORED[-1:], True), {"packed": False, "tile_size": 32})]
    assert all((image == images[0]).all() for image in images)


@pytest.mark.parametrize("bad, kind", [
    (np.zeros((1, 10, 12, 4), np.float32), ValueError),
    (np.zeros((1, 10, 12, 3)), ValueError),
    (np.full((1, 10, 12, 3), np.nan, np.float32), ValueError),
    ("ones", TypeError),
])
def test_cotangents_that_do_not_fit_are_refused(bad, kind):
    *_, vjp = gs4d.rasterization_vjp(**scene(dtype=np.float32))
    with pytest.raises(kind, match="d_renders|cotangent of colors"):
        vjp(bad)


def _one_byte_on(array):
    """A view of the same values that begins one byte into its memory."""
    return np.frombuffer(b"0" + array.tobytes(), array.dtype, offset=1).reshape(array.shape)


def test_what_concerns_gpus_has_no_effect():
    plain = drawn()[0]
    assert np.array_equal(plain, drawn(packed=False, tile_size=8, channel_chunk=1, segmented=True)[0])
    assert np.array_equal(plain, drawn(camera_model="pinhole", covars=None, rolling_shutter=None, absgrad=False)[0])
    assert np.array_equal(plain, drawn(sparse_grad=np.False_, radius_clip=np.float32(0))[0])


def test_arrays_may_have_any_strides_and_byte_views():
    arguments = scene(dtype=np.float32)
    plain = gs4d.rasterization(**arguments)[0]
    strided = {k: np.asfortranarray(np.repeat(v, 2, axis=0))[::2] if isinstance(v, np.ndarray) else v
               for k, v in arguments.items()}
    assert not strided["means"].flags.c_contiguous
    assert np.array_equal(plain, gs4d.rasterization(**strided)[0])
    moved = {k: _one_byte_on(v) if isinstance(v, np.ndarray) else v for k, v in arguments.items()}
    assert not moved["means"].flags.aligned
    assert np.array_equal(plain, gs4d.rasterization(**moved)[0])
    image = _one_byte_on(plain[0])
    assert gs4d.psnr(image, plain[0]) == np.inf


def test_no_splats_show_the_background():
    empty = {"means": (0, 3), "quats": (0, 4), "scales": (0, 3), "opacities": (0,), "colors": (0, 3)}
    arguments = {**scene(dtype=np.float32), **{k: np.zeros(s, np.float32) for k, s in empty.items()}}
    renders, alphas, _, vjp = gs4d.rasterization_vjp(**arguments)
    assert np.array_equal(renders[0, 3, 4], arguments["backgrounds"][0]) and not alphas.any()
    grads = vjp(np.ones_like(renders))
    assert grads["means"].shape == (0, 3) and (grads["backgrounds"] == 120).all()


def test_coefficients_above_the_degree_do_not_count():
    arguments = scene(sh_degree=2, dtype=np.float32)
    renders, _, _, vjp = gs4d.rasterization_vjp(**{**arguments, "sh_degree": 1})
    cut = gs4d.rasterization(**{**arguments, "sh_degree": 1, "colors": arguments["colors"][:, :4]})[0]
    assert np.array_equal(renders, cut)
    d_colors = vjp(np.ones_like(renders))["colors"]
    assert d_colors.shape == (6, 9, 3) and not d_colors[:, 4:].any() and d_colors[:, :4].any()


def big(n=20_000, side=160, channels=5):
    arguments = scene(n, channels=channels, cameras=2, dtype=np.float32, size=(side, side))
    arguments["scales"] = arguments["scales"] * 0.1
    return arguments


def test_any_number_of_threads_gives_the_same_bits():
    def all_of(threads):
        renders, alphas, meta, vjp = gs4d.rasterization_vjp(**big(), threads=threads, render_mode="RGB+ED")
        grads = vjp(np.cos(renders), np.sin(alphas))
        return [renders, alphas, *(grads[key] for key in sorted(grads)), meta["means2d_grad"], meta["radii"]]

    first = all_of(1)
    for threads in (2, 5, None):
        assert all(np.array_equal(a, b) for a, b in zip(first, all_of(threads)))


def test_the_interpreter_goes_on_while_splats_are_drawn():
    """Rendering on one thread of the pool leaves the interpreter to others: they count meanwhile."""
    arguments, counts, done = big(150_000, 512, 3), [0], threading.Event()

    def count():
        while not done.is_set():
            counts[0] += 1
            time.sleep(0.001)

    counter = threading.Thread(target=count)
    counter.start()
    try:
        most = 0
        for _ in range(3):
            before = counts[0]
            gs4d.rasterization(**arguments, threads=1)
            most = max(most, counts[0] - before)
    finally:
        done.set()
        counter.join()
    # Held all the time, the lock would let one or two pass, between this line and the call.
    assert most >= 5, f"{most} counts in a call"


def test_calls_from_several_threads_agree():
    arguments = big(2000, 64)
    want = gs4d.rasterization(**arguments)[0]
    results = [None] * 4

    def work(i):
        results[i] = gs4d.rasterization(**arguments, threads=1 + i % 2)[0]

    workers = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert all(np.array_equal(want, result) for result in results)


def _drawn_in_a_fork(_):
    return drawn()[0]


def _scored():
    noise = np.random.default_rng(0).uniform(size=(200, 180, 3))
    return [gs4d.ssim(noise, noise[::-1]), gs4d.ms_ssim(noise, noise[::-1]), gs4d.perceptual_proxy(noise, noise[::-1])]


def _scored_in_a_fork(_):
    return _scored()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
@pytest.mark.filterwarnings("ignore")
def test_a_forked_process_draws_and_scores():
    """As data loaders do; the threads of the parent are not there."""
    want, scores = drawn()[0], _scored()
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert np.array_equal(want, pool.apply_async(_drawn_in_a_fork, (0,)).get(timeout=60))
        assert scores == pool.apply_async(_scored_in_a_fork, (0,)).get(timeout=60)


def test_metrics():
    image = np.full((24, 32, 3), 0.5, np.float32)
    assert gs4d.psnr(image, image) == float("inf")
    assert abs(gs4d.psnr(image, image - 0.1) - 20) < 1e-4
    assert gs4d.ssim(image, image) == 1 and gs4d.ssim(image, image, padding="zero") == 1
    noise = np.random.default_rng(0).uniform(size=(200, 180, 3))
    assert gs4d.ms_ssim(noise, noise) == pytest.approx(1) and gs4d.ms_ssim(noise, noise[::-1]) < 0.5
    assert gs4d.perceptual_proxy(image, image) == 0
    with pytest.raises(ValueError, match="24|32|30"):
        gs4d.psnr(image, image[:, :30])
    with pytest.raises(ValueError, match="image must be floats"):
        gs4d.psnr((image * 255).astype(np.uint8), image)
