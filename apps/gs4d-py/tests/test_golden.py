"""Images and gradients of independent renderers (gs-raster/tests/golden) and the image of gsplat's CUDA kernels."""

import numpy as np
import pytest

import gs4d
from scenes import GOLDEN, read_safetensors, shared


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def relative(got, want):
    return np.linalg.norm(got - want) / np.linalg.norm(want)


def gsplat_case(path):
    file = read_safetensors(path)
    view, k = np.eye(4), np.array([[61.5, 0, 61.5], [0, 61.5, 41.0], [0, 0, 1]])
    view[:3, 3] = [-0.123, -0.456, 8]
    arrays = [file["means"], file["quats"], np.exp(file["scales"].astype(float)), sigmoid(file["opacities"].astype(float)),
              file["coeffs"].reshape(-1, 16, 3), view[None], k[None]]
    return arrays, file["out_img"]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_image_of_gsplat(dtype):
    arrays, want = gsplat_case(GOLDEN / "gsplat_basic_case.safetensors")
    arrays = [a.astype(dtype) for a in arrays]
    renders, alphas, meta = gs4d.rasterization(*arrays, 123, 82, sh_degree=3, max_alpha=0.999)
    assert renders.dtype == dtype and renders.shape == (1, 82, 123, 3) and alphas.shape == (1, 82, 123, 1)
    got = np.concatenate([renders, alphas], -1)[0]
    assert np.abs(got - want.reshape(got.shape)).max() <= 1e-5
    assert (meta["radii"] > 0).any()


def test_the_image_of_gsplat_among_the_captures():
    arrays, want = gsplat_case(shared("data", "gsplat_reference_render_basic", "basic_case.safetensors"))
    renders, alphas, _ = gs4d.rasterization(*[a.astype(np.float32) for a in arrays], 123, 82, sh_degree=3, max_alpha=0.999)
    got = np.concatenate([renders, alphas], -1)[0]
    assert np.abs(got - want.reshape(got.shape)).max() <= 1e-5


@pytest.mark.parametrize("mode, suffix", [("classic", ""), ("antialiased", "_aa")])
@pytest.mark.parametrize("name", ["single", "needles", "near_plane"])
def test_golden_images_and_gradients(name, mode, suffix):
    file = read_safetensors(GOLDEN / f"{name}.safetensors")
    fx, fy, cx, cy = file["intrinsics"]
    weights = file["weights"].astype(float)
    height, width = weights.shape[:2]
    sh = file["sh"].reshape(len(file["means"]), -1, 3)
    exact = [file["means"], file["quats"], np.exp(file["log_scales"].astype(float)), sigmoid(file["logits"].astype(float)),
             sh, file["world_to_camera"][None], np.array([[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]])]
    degree = round(sh.shape[1] ** 0.5) - 1
    tolerances = {np.float64: (1e-10, 1e-9), np.float32: (2e-5, 1e-3 if suffix else 1e-4)}
    for dtype, (image_tolerance, grad_tolerance) in tolerances.items():
        arrays = [a.astype(dtype) for a in exact]
        renders, alphas, _, vjp = gs4d.rasterization_vjp(*arrays, width, height, sh_degree=degree, rasterize_mode=mode)
        got = np.concatenate([renders, alphas], -1)[0]
        assert np.abs(got - file[f"image{suffix}"]).max() <= image_tolerance
        d = weights[None].astype(dtype)
        grads = vjp(np.ascontiguousarray(d[..., :3]), np.ascontiguousarray(d[..., 3:]))
        raw = {"means": grads["means"], "quats": grads["quats"], "log_scales": grads["scales"] * exact[2], "sh": grads["colors"],
               "logits": grads["opacities"] * exact[3] * (1 - exact[3])}
        for key, grad in raw.items():
            want = file[f"grad{suffix}_{key}"]
            assert relative(grad.reshape(want.shape), want) <= grad_tolerance, (name, key, dtype)
