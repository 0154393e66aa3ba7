"""A run of the program, opened: GS4D_PROGRAM names the program, which makes a scene and trains on it."""

import os
import subprocess

import numpy as np
import pytest

import gs4d


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    program = os.environ.get("GS4D_PROGRAM")
    if not program:
        print("SKIPPED opening a run: GS4D_PROGRAM does not name the program gs4d")
        pytest.skip("GS4D_PROGRAM does not name the program gs4d")
    root = tmp_path_factory.mktemp("run")

    def gs4d_program(*arguments):
        done = subprocess.run([program, *arguments], cwd=root, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr

    gs4d_program("synth", "balls", "-o", "data", "--size", "32", "--train-views", "6", "--val-views", "1", "--test-views", "2")
    drawn = ("--set", "schedule.antialias=true", "--set", "schedule.dilation=0.1")
    gs4d_program("train", "data", "-m", "fourdgs", "--preset", "tiny", "--steps", "20", *drawn, "-o", "run")
    gs4d_program("export", "run", "-o", "scene.gs4d")
    return root


def test_a_run_and_its_compact_file(folder):
    run, compact = gs4d.load(folder / "run"), gs4d.load(folder / "scene.gs4d")
    assert (run.method, run.step) == (compact.method, compact.step) == ("fourdgs", 20)
    assert len(run.times) >= 2 and run.times[0] == 0 and (np.diff(run.times) > 0).all()
    assert len(run.cameras) == 6 and run.cameras[0]["width"] == 32
    view = run.cameras[3]
    place = {key: view[key] for key in ("viewmat", "K", "width", "height")}
    image = run.render(**place, t=view["t"], threads=1)
    assert image["colors"].shape == (32, 32, 3) and image["alphas"].max() > 0.1
    assert np.array_equal(image["colors"], run.render(**place, t=view["t"], threads=2)["colors"])
    # The compact file has rounded numbers.
    assert gs4d.psnr(compact.render(**place, t=view["t"])["colors"], image["colors"]) > 30

    splats = run.splats(view["t"], view)
    assert (splats["rasterize_mode"], splats["eps2d"]) == ("antialiased", 0.1)
    renders, alphas, _ = gs4d.rasterization(
        **splats, viewmats=place["viewmat"][None].astype(np.float32), Ks=place["K"][None].astype(np.float32), width=32,
        height=32, backgrounds=run.background[None])
    assert np.abs(renders[0] - image["colors"]).max() < 1e-4 and np.abs(alphas[0] - image["alphas"]).max() < 1e-4
    moved = run.splats(run.times[-1])["means"] - run.splats(0)["means"]
    assert moved.shape == splats["means"].shape and np.isfinite(moved).all()


def test_data_that_are_not_where_they_are_said_to_be_are_an_error(folder):
    run = gs4d.load(folder / "run", data=folder / "nowhere")
    for read in (lambda: run.times, lambda: run.cameras, lambda: run.splats(0)):
        with pytest.raises(ValueError, match="nowhere"):
            read()
    place = gs4d.load(folder / "run").cameras[0]
    assert len(run.splats(0, place)["means"]) > 0


def test_what_does_not_fit_is_refused(folder):
    run = gs4d.load(folder / "run")
    with pytest.raises(ValueError, match="time"):
        run.splats(float("nan"))
    with pytest.raises(ValueError, match=r"viewmat must have shape \[4, 4\], not \[3, 3\]"):
        run.render(np.eye(3), np.eye(3), 8, 8, 0)
    with pytest.raises(ValueError, match="background must have 3 values"):
        run.render(np.eye(4), np.eye(3), 8, 8, 0, background=[1])


def test_what_is_no_run_is_refused(tmp_path):
    with pytest.raises(ValueError, match=tmp_path.name):
        gs4d.load(tmp_path)
