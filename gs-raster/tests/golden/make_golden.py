#!/usr/bin/env python3
"""Golden images and gradients of three small scenes, in float64, with numpy alone.

    python3 make_golden.py           make the scenes from their seeds and write NAME.safetensors
    python3 make_golden.py --check   recompute from the stored inputs and compare with the stored outputs

Every splat is evaluated at every pixel: no tiles, no supports. Gradients take the complex step,
f'(x) = Im f(x + ih) / h with h = 1e-30, through everything in front of the compositing (quaternion, covariance,
projection, opacity, colour); the compositing itself has a five-line backward. Central differences of the whole loss
check both.
Formulas and the layout of the files: README.md.
"""
import json
import struct
import sys
from pathlib import Path

import numpy as np

NEAR, FAR, DILATION, MIN_ALPHA, STOP = 0.01, 1e10, 0.3, 1 / 255, 1e-4
STEP = 1e-30
VARIANTS = {"": (False, 0.99), "_aa": (True, 0.99), "_a999": (False, 0.999)}  # antialias, max_alpha
COLUMNS = [("means", 3), ("quats", 4), ("log_scales", 3), ("logits", 1), ("sh", None)]


# --- one splat: theta = (mean 3, quat 4, log-scale 3, logit 1, sh 3K), real or complex, any leading axes ------------

def clamp(x, lo, hi):
    return np.where(x.real < lo, lo, np.where(x.real > hi, hi, x))


def rotation(q):
    w, x, y, z = np.moveaxis(q / np.sqrt((q * q).sum(-1, keepdims=True)), -1, 0)
    rows = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
    return np.stack([np.stack(r, -1) for r in rows], -2)


def sh_basis(d, k):
    x, y, z = np.moveaxis(d, -1, 0)
    xx, yy, zz = x * x, y * y, z * z
    terms = [
        0.28209479177387814 + 0 * x,
        -0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x,
        1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2 * zz - xx - yy),
        -1.0925484305920792 * x * z, 0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3 * xx - yy), 2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * zz - xx - yy), 0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
        -0.4570457994644658 * x * (4 * zz - xx - yy), 1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3 * yy)]
    return np.stack(terms[:k], -1)


def splat(theta, cam, antialias):
    """Raw alpha [..., H, W] before cap and cutoff, and colour [..., 3]."""
    mean, quat, scale, logit = theta[..., :3], theta[..., 3:7], np.exp(theta[..., 7:10]), theta[..., 10]
    view, (fx, fy, cx, cy), (width, height) = cam["view"], cam["intrinsics"], cam["size"]
    t = mean @ view[:3, :3].T + view[:3, 3]
    z = t[..., 2]
    rows = []
    for axis, f, c, side in ((0, fx, cx, width), (1, fy, cy, height)):
        margin = 0.3 * 0.5 * side / f
        ratio = clamp(t[..., axis] / z, -(c / f + margin), (side - c) / f + margin)
        row = np.zeros(t.shape, t.dtype)
        row[..., axis], row[..., 2] = f / z, -f * ratio / z
        rows.append(row)
    factor = np.stack(rows, -2) @ view[:3, :3] @ rotation(quat) * scale[..., None, :]
    a, b = factor[..., 0, :], factor[..., 1, :]
    xx, xy, yy = (a * a).sum(-1), (a * b).sum(-1), (b * b).sum(-1)
    # |F F^T| = |a x b|^2, free of cancellation for needles; the determinant after dilation is then a sum of positives.
    cross = np.stack([a[..., i] * b[..., j] - a[..., j] * b[..., i] for i, j in ((1, 2), (2, 0), (0, 1))], -1)
    before = (cross * cross).sum(-1)
    after = before + DILATION * (xx + yy) + DILATION**2
    opacity = 1 / (1 + np.exp(-logit))
    if antialias:
        opacity = opacity * np.sqrt(clamp(before / after, 0.005**2, np.inf))
    dx = (fx * t[..., 0] / z + cx)[..., None, None] - (np.arange(width) + 0.5)
    dy = (fy * t[..., 1] / z + cy)[..., None, None] - (np.arange(height) + 0.5)[:, None]
    e = lambda v: v[..., None, None]
    sigma = (0.5 * (e(yy + DILATION) * dx * dx + e(xx + DILATION) * dy * dy) - e(xy) * dx * dy) / e(after)
    raw = e(opacity) * np.exp(-sigma)
    d = mean + view[:3, :3].T @ view[:3, 3]  # from the camera centre -R^T t to the mean
    sh = theta[..., 11:].reshape(theta.shape[:-1] + (-1, 3))
    basis = sh_basis(d / np.sqrt((d * d).sum(-1, keepdims=True)), sh.shape[-2])
    return raw, clamp((basis[..., None] * sh).sum(-2) + 0.5, 0, np.inf)


# --- a frame ----------------------------------------------------------------------------------------------------------

def render(thetas, cam, antialias, max_alpha):
    """Image [H, W, 4], T behind all, samples front to back (index, T, alpha, colour, below cap), smallest margin."""
    width, height = cam["size"]
    depth = thetas[:, :3] @ cam["view"][2, :3] + cam["view"][2, 3]
    order = [i for i in np.argsort(depth, kind="stable") if NEAR < depth[i] < FAR]
    image, light = np.zeros((height, width, 4)), np.ones((height, width))
    is_open, samples, margin = np.ones((height, width), bool), [], np.inf
    for i in order:
        raw, color = splat(thetas[i], cam, antialias)
        alpha = np.minimum(raw, max_alpha)
        reached = is_open & (alpha >= MIN_ALPHA)
        after = light * (1 - alpha)
        margin = min([margin, *abs(raw[is_open] / MIN_ALPHA - 1), *abs(after[reached] / STOP - 1)])
        is_open &= ~(reached & (after <= STOP))
        alpha = np.where(reached & is_open, alpha, 0)
        image[..., :3] += (light * alpha)[..., None] * color
        samples.append((i, light, alpha, color, raw <= max_alpha))
        light = light * (1 - alpha)
    image[..., 3] = 1 - light
    return image, light, samples, margin


def gradients(thetas, cam, weights, antialias, max_alpha):
    """d sum(weights * image) / d theta for every splat."""
    _, light_end, samples, _ = render(thetas, cam, antialias, max_alpha)
    grad = np.zeros_like(thetas)
    behind = -light_end * weights[..., 3]
    for i, light, alpha, color, below_cap in reversed(samples):
        own = weights[..., :3] @ color
        d_alpha = np.where((alpha > 0) & below_cap, light * own - behind / (1 - alpha), 0)
        d_color = ((light * alpha)[..., None] * weights[..., :3]).sum((0, 1))
        behind = behind + light * alpha * own
        raw_step, color_step = splat(thetas[i] + 1j * STEP * np.eye(thetas.shape[1]), cam, antialias)
        grad[i] = ((raw_step.imag * d_alpha).sum((1, 2)) + color_step.imag @ d_color) / STEP
    return grad


def check_by_differences(thetas, cam, weights, antialias, max_alpha, grad, rng):
    loss = lambda p: (render(p, cam, antialias, max_alpha)[0] * weights).sum()
    errors = []
    for flat in rng.choice(grad.size, min(30, grad.size), replace=False):
        at = np.unravel_index(flat, grad.shape)
        estimates = []
        for h in (1e-4, 1e-5, 1e-6, 1e-7):  # one that crosses no threshold suffices
            hi, lo = thetas.copy(), thetas.copy()
            hi[at] += h
            lo[at] -= h
            estimates.append((loss(hi) - loss(lo)) / (2 * h))
        scale = max(abs(grad[at]), 1e-3 * abs(grad).max())
        errors.append(min(abs(np.array(estimates) - grad[at])) / scale)
    return np.median(errors), max(errors)


# --- scenes -----------------------------------------------------------------------------------------------------------

def look_at(width, height, focal, center, eye, target):
    forward = np.array(target) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross([0.0, 1, 0], forward)  # +y down
    right /= np.linalg.norm(right)
    view = np.eye(4)
    view[:3, :3] = [right, np.cross(forward, right), forward]
    view[:3, 3] = -view[:3, :3] @ eye
    return {"view": view, "intrinsics": np.array([*focal, *center]), "size": (width, height)}


def columns(rng, n, degree, scales):
    return [rng.uniform(-0.7, 0.7, (n, 3)), rng.normal(size=(n, 4)), np.log(rng.uniform(*scales, (n, 3))),
            rng.normal(0, 1.5, (n, 1)), rng.normal(0, 0.4, (n, 3 * (degree + 1) ** 2))]


def single(rng):
    """One anisotropic splat above both caps of alpha at its centre, SH 3, fx != fy, off-centre principal point."""
    cam = look_at(32, 24, (40.0, 31.0), (13.3, 14.1), np.array([0.3, -0.4, -2.5]), [0.05, 0.1, 0])
    c = columns(rng, 1, 3, (0.1, 0.4))
    c[0][:] *= 0.1
    c[3][:] = 8.0
    return cam, c


def needles(rng):
    """Scales log-uniform in 1e-4 .. 1: aspect ratios up to 1e4."""
    cam = look_at(64, 48, (60.0, 55.0), (30.2, 25.9), np.array([0.2, 0.5, -3.0]), [0, 0, 0])
    c = columns(rng, 100, 2, (1, 2))
    c[2][:] = rng.uniform(np.log(1e-4), 0, c[2].shape)
    return cam, c


def near_plane(rng):
    """Quarters: behind the camera, depth about `near`, outside the frustum (clamped Jacobian), ordinary and huge."""
    cam = look_at(48, 48, (40.0, 44.0), (25.1, 22.7), np.array([0.1, -0.2, -2.0]), [0.1, 0.1, 0])
    n = 20
    c = columns(rng, 4 * n, 1, (0.05, 0.3))
    local = rng.uniform(-0.4, 0.4, (4 * n, 3))
    local[:n, 2] = rng.uniform(-3, 0, n)
    local[n:2 * n, 2] = np.exp(rng.uniform(np.log(0.003), np.log(0.3), n))
    local[n:2 * n, :2] *= 2 * local[n:2 * n, 2:]
    local[2 * n:, 2] = rng.uniform(0.5, 4, 2 * n)
    local[2 * n:3 * n, :2] = np.sign(local[2 * n:3 * n, :2]) * local[2 * n:3 * n, 2:] * rng.uniform(0.4, 1.2, (n, 2))
    c[0][:] = (local - cam["view"][:3, 3]) @ cam["view"][:3, :3]
    c[2][n:2 * n] -= 4
    c[2][-4:] += 3
    c[3][n:2 * n] -= 2
    return cam, c


SCENES = {"single": single, "needles": needles, "near_plane": near_plane}


def make_inputs(name):
    """The first seed whose frames have no decision within 2e-5 of a threshold: no single sample hangs on rounding."""
    for seed in range(100):
        rng = np.random.default_rng(seed)
        cam, cols = SCENES[name](rng)
        cols = [c.astype(np.float32) for c in cols]
        weights = rng.uniform(-1, 1, cam["size"][::-1] + (4,)).astype(np.float32)
        margins = [render(np.hstack(cols).astype(float), cam, *v)[3] for v in VARIANTS.values()]
        if min(margins) > 2e-5:
            print(f"{name}: seed {seed}, margin {min(margins):.1e}")
            arrays = {key: c.squeeze(1) if key == "logits" else c for (key, _), c in zip(COLUMNS, cols)}
            return {**arrays, "weights": weights, "world_to_camera": cam["view"], "intrinsics": cam["intrinsics"]}
    raise SystemExit(f"{name}: no seed will do")


def outputs(arrays):
    """Every golden array, from the inputs alone."""
    weights = arrays["weights"].astype(float)
    cam = {"view": arrays["world_to_camera"], "intrinsics": arrays["intrinsics"], "size": weights.shape[1::-1]}
    n = len(arrays["means"])
    thetas = np.hstack([arrays[key].reshape(n, -1).astype(float) for key, _ in COLUMNS])
    out, rng = {}, np.random.default_rng(0)
    for suffix, variant in VARIANTS.items():
        if suffix == "_a999" and n > 1:
            continue  # one scene shows what the cap does
        out["image" + suffix] = render(thetas, cam, *variant)[0]
        grad = gradients(thetas, cam, weights, *variant)
        median, worst = check_by_differences(thetas, cam, weights, *variant, grad, rng)
        print(f"  {suffix or 'classic'}: against central differences, median {median:.1e}, worst {worst:.1e}")
        ends = np.cumsum([width or 0 for _, width in COLUMNS])[:-1]
        for (key, _), part in zip(COLUMNS, np.split(grad, ends, axis=1)):
            out[f"grad{suffix}_{key}"] = part.squeeze(1) if key == "logits" else part
    return out


# --- files ------------------------------------------------------------------------------------------------------------

def save(path, arrays):
    header, data = {}, b""
    for key in sorted(arrays, key=lambda k: (-arrays[k].itemsize, k)):  # doubles first: everything stays aligned
        v = np.ascontiguousarray(arrays[key])
        span = [len(data), len(data) + v.nbytes]
        header[key] = {"dtype": f"F{8 * v.itemsize}", "shape": list(v.shape), "data_offsets": span}
        data += v.tobytes()
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    path.write_bytes(struct.pack("<Q", len(text)) + text + data)


def load(path):
    raw = path.read_bytes()
    start = 8 + struct.unpack("<Q", raw[:8])[0]
    arrays = {}
    for key, h in json.loads(raw[8:start]).items():
        first, last = h["data_offsets"]
        dtype = f"<f{int(h['dtype'][1:]) // 8}"
        arrays[key] = np.frombuffer(raw[start + first:start + last], dtype).reshape(h["shape"])
    return arrays


def main():
    here = Path(__file__).parent
    for name in SCENES:
        path = here / f"{name}.safetensors"
        if "--check" not in sys.argv:
            inputs = make_inputs(name)
            save(path, {**inputs, **outputs(inputs)})
            continue
        print(name)
        stored = load(path)
        computed = outputs(stored)
        inputs = {key for key, _ in COLUMNS} | {"weights", "world_to_camera", "intrinsics"}
        assert set(stored) == inputs | set(computed), f"{name}: arrays differ"
        for key, value in computed.items():
            error = abs(value - stored[key]).max() / max(abs(value).max(), 1e-300)
            print(f"  {key}: {error:.1e}")
            assert error < 1e-11, f"{name}: {key} differs from what is stored"


if __name__ == "__main__":
    main()
