"""Tensors in, tensors out, gradients by autograd."""

import numpy as np
import pytest

import gs4d
from scenes import NAMES, scene

torch = pytest.importorskip("torch")


def tensors(**arguments):
    full = scene(**arguments)
    full["scales"] = full["scales"] + 1.5
    return {k: torch.from_numpy(v).requires_grad_() if isinstance(v, np.ndarray) else v for k, v in full.items()}


@pytest.mark.parametrize("options", [
    {}, {"channels": 4, "cameras": 2}, {"sh_degree": 1}, {"render_mode": "RGB+ED", "rasterize_mode": "antialiased"},
])
def test_gradcheck(options):
    call = {key: options[key] for key in ("render_mode", "rasterize_mode") if key in options}
    arguments = tensors(n=3, size=(6, 5), **{k: v for k, v in options.items() if k not in call})
    rest = {k: v for k, v in arguments.items() if k not in NAMES}
    free = {k: arguments[k] for k in NAMES}
    # The last row of viewmats and five entries of Ks are constants.
    mask = {"viewmats": torch.tensor([1.0, 1, 1, 0]).double()[:, None].expand(4, 4),
            "Ks": torch.tensor([[1.0, 0, 1], [0, 1, 1], [0, 0, 0]]).double()}
    fixed = {k: free[k].detach().clone() for k in mask}

    def draw(*values):
        named = dict(zip(NAMES, values))
        for key, m in mask.items():
            named[key] = fixed[key] + m * (named[key] - fixed[key])
        return gs4d.torch.rasterization(**named, **rest, **call)[:2]

    assert torch.autograd.gradcheck(draw, tuple(free.values()), eps=1e-6, atol=1e-5, rtol=1e-4)


def test_the_same_as_numpy():
    arguments = scene(dtype=np.float32, cameras=2)
    renders, alphas, meta, vjp = gs4d.rasterization_vjp(**arguments)
    grads = vjp(np.ones_like(renders), np.ones_like(alphas))
    leaves = {k: torch.from_numpy(v).requires_grad_() if isinstance(v, np.ndarray) else v for k, v in arguments.items()}
    got, got_alphas, got_meta = gs4d.torch.rasterization(**leaves)
    assert np.array_equal(got.detach(), renders) and np.array_equal(got_alphas.detach(), alphas)
    (got.sum() + got_alphas.sum()).backward()
    for key in NAMES:
        assert np.array_equal(leaves[key].grad, grads[key]), key
    assert np.array_equal(got_meta["means2d_grad"], meta["means2d_grad"])
    assert torch.equal(got_meta["radii"], torch.from_numpy(meta["radii"])) and got_meta["width"] == 12


def test_only_what_is_asked_for_gets_gradients():
    arguments = {k: torch.from_numpy(v) if isinstance(v, np.ndarray) else v for k, v in scene().items()}
    assert gs4d.torch.rasterization(**arguments)[0].grad_fn is None
    arguments["means"].requires_grad_()
    with torch.no_grad():
        assert gs4d.torch.rasterization(**arguments)[0].grad_fn is None
    gs4d.torch.rasterization(**arguments)[0].sum().backward()
    assert arguments["means"].grad.abs().max() > 0 and arguments["quats"].grad is None


def test_what_does_not_fit_is_refused_by_name():
    arguments = {k: torch.from_numpy(v) if isinstance(v, np.ndarray) else v for k, v in scene().items()}
    with pytest.raises(TypeError, match="means must be a tensor, not ndarray"):
        gs4d.torch.rasterization(**{**arguments, "means": arguments["means"].numpy()})
    with pytest.raises(ValueError, match="means is on meta"):
        gs4d.torch.rasterization(**{**arguments, "means": arguments["means"].to("meta")})
    with pytest.raises(TypeError, match="quats must be float64 as means are, not float32"):
        gs4d.torch.rasterization(**{**arguments, "quats": arguments["quats"].float()})
    with pytest.raises(TypeError, match="not float16"):
        gs4d.torch.rasterization(**{**arguments, "means": arguments["means"].half()})


def test_tensors_may_have_any_strides():
    arguments = scene(dtype=np.float32)
    want = gs4d.rasterization(**arguments)[0]
    means = torch.from_numpy(np.ascontiguousarray(arguments["means"].T)).requires_grad_()
    rest = {k: torch.from_numpy(v) if isinstance(v, np.ndarray) else v for k, v in arguments.items()}
    renders, _, _ = gs4d.torch.rasterization(**{**rest, "means": means.T})
    assert np.array_equal(renders.detach(), want)
    renders.mean().backward()
    assert means.grad.abs().max() > 0
