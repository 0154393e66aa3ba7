"""The example fits, and the examples in the documentation hold."""

import doctest
import runpy
from pathlib import Path

import numpy as np

import gs4d._raster

PACKAGE = Path(__file__).resolve().parents[1]


def test_the_moving_scene_is_fitted():
    path = PACKAGE / "examples" / "fit_moving_scene.py"
    psnr = runpy.run_path(path)["psnr"]
    assert len(psnr) == 9 and np.mean(psnr) > 35 and min(psnr) > 30, psnr
    code = path.read_text(encoding="utf-8").split('"""\n\n')[1]
    assert code in (PACKAGE / "README.md").read_text(encoding="utf-8")
    assert sum(bool(line.strip()) for line in code.splitlines()) <= 30


def test_documented_examples():
    result = doctest.testmod(gs4d._raster)
    assert result.attempted >= 6 and result.failed == 0
