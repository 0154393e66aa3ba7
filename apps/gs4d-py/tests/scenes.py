"""Scenes for the tests, and the arrays of golden files."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

GOLDEN = Path(__file__).resolve().parents[3] / "gs-raster" / "tests" / "golden"
NAMES = ("means", "quats", "scales", "opacities", "colors", "viewmats", "Ks", "backgrounds")


def read_safetensors(path):
    """The arrays of a file of float32 and float64."""
    raw = Path(path).read_bytes()
    size = int.from_bytes(raw[:8], "little")
    header = json.loads(raw[8:8 + size])
    arrays = {}
    for name, entry in header.items():
        if name != "__metadata__":
            start, end = entry["data_offsets"]
            data = np.frombuffer(raw[8 + size + start:8 + size + end], {"F32": "<f4", "F64": "<f8"}[entry["dtype"]])
            arrays[name] = data.reshape(entry["shape"])
    return arrays


def shared(*parts):
    """A file of the captures that are not part of the repository; without it the test is skipped by name."""
    root = os.environ.get("GS4D_SHARED", Path(__file__).resolve().parents[4] / "shared")
    path = Path(root).joinpath(*parts)
    if not path.exists():
        assert os.environ.get("GS4D_REQUIRE_SHARED") != "1", f"{path} is not there, but GS4D_REQUIRE_SHARED is 1"
        print(f"SKIPPED {'/'.join(parts)}: not found under {root}")
        pytest.skip(f"{path} is not there (GS4D_SHARED names its folder)")
    return path


def rotation(axis, angle):
    """Rodrigues' formula."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def scene(n=6, cameras=1, channels=3, sh_degree=None, per_camera=False, backgrounds=True, dtype=np.float64, size=(12, 10),
          seed=0):
    """Random splats before cameras that look along +z: all arguments that are arrays, and the sizes."""
    rng = np.random.default_rng(seed)
    width, height = size
    coefficients = () if sh_degree is None else ((sh_degree + 1) ** 2,)
    own = (cameras,) if per_camera else ()
    viewmats = np.tile(np.eye(4), (cameras, 1, 1))
    for view in viewmats:
        view[:3, :3] = rotation(rng.normal(size=3), 0.2 * rng.uniform())
        view[:3, 3] = 0.2 * rng.normal(size=3) + [0, 0, 3]
    Ks = np.tile(np.array([[1.1 * width, 0, 0.5 * width], [0, 1.2 * width, 0.5 * height], [0, 0, 1.0]]), (cameras, 1, 1))
    arrays = {
        "means": rng.uniform(-0.7, 0.7, (n, 3)),
        "quats": rng.normal(size=(n, 4)),
        "scales": np.exp(rng.normal(-1.4, 0.4, (n, 3))),
        "opacities": rng.uniform(0.2, 0.8, n),
        "colors": rng.uniform(0.1, 1.0, (*own, n, *coefficients, channels)),
        "viewmats": viewmats,
        "Ks": Ks,
        "backgrounds": rng.uniform(0, 1, (cameras, channels)) if backgrounds else None,
    }
    arrays = {name: a if a is None else a.astype(dtype) for name, a in arrays.items()}
    return {**arrays, "width": width, "height": height, "sh_degree": sh_degree}
