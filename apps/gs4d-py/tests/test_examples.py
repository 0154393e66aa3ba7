"""The example fits, and the examples in the documentation hold."""

import doctest
import importlib.util
from pathlib import Path

import gs4d._raster


def test_the_moving_scene_is_fitted():
    path = Path(__file__).resolve().parents[1] / "examples" / "fit_moving_scene.py"
    spec = importlib.util.spec_from_file_location("fit_moving_scene", path)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    before, after = example.fit()
    assert before < 18 and after > 32, f"PSNR {before:.1f} dB before, {after:.1f} dB after"


def test_documented_examples():
    result = doctest.testmod(gs4d._raster)
    assert result.attempted >= 6 and result.failed == 0
