"""Makes the files of this folder: small checkpoints in the layouts of four codes, and the splats that these codes make of them.

    python make.py CODES

CODES holds checkouts named 4DGaussians, Deformable-3D-GS, Grid4D and Scaffold-GS; their own modules are run, on the CPU. Grid4D's hash
encoder is a CUDA kernel: here it is written anew in torch. Needs torch, numpy, plyfile, safetensors, einops.
"""
import argparse
import importlib
import json
import subprocess
import sys
import tempfile
import types
from pathlib import Path

import numpy as np
import torch
from plyfile import PlyData, PlyElement
from safetensors.torch import save_file

HERE = Path(__file__).resolve().parent
EXPORT = HERE.parents[3] / "docs" / "guide" / "export_checkpoint.py"
CODES = Path(sys.argv[1]).resolve()
TIMES = [0.0, 0.37, 1.0]
COMMITS = {
    "4DGaussians": "843d5ac636c37e4b611242287754f3d4ed150144",
    "Deformable-3D-GS": "ac423728df780ee57a82025a6d7c4c7312fdf9bb",
    "Grid4D": "c9a93fb7d399d332c27e585ac05f9d6cfa31f250",
    "Scaffold-GS": "59c833b56bbbf510f3f64d40f81721995caced66",
}

plain_tensor, plain_empty = torch.tensor, torch.empty
torch.tensor = lambda *a, device=None, **k: plain_tensor(*a, **k)
torch.nn.Module.cuda = lambda self: self
torch.Tensor.cuda = lambda self: self


def stub(name, **members):
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__dict__.update(members)


def module(code, name):
    """A module of a code, with its own `scene` and `utils`."""
    for known in [k for k in sys.modules if k.split(".")[0] in ("scene", "utils", "gaussian_renderer")]:
        del sys.modules[known]
    for package in ("scene", "utils"):
        stub(package)
        sys.modules[package].__path__ = [str(CODES / code / package)]
    sys.path.insert(0, str(CODES / code))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.pop(0)


def seeded(net, gain=1.0):
    """Parameters that do something, also where a code starts at zero."""
    g = torch.Generator().manual_seed(7)
    for p in net.parameters():
        if p.requires_grad:
            fan = p.shape[-1] if p.dim() > 1 else 16
            p.data = gain * torch.randn(p.shape, generator=g) / fan**0.5
    return net


def cloud(n, degree, bound, seed):
    """Columns of a point_cloud.ply: normals left out, SH channel by channel."""
    rng = np.random.default_rng(seed)
    rest = 3 * ((degree + 1) ** 2 - 1)
    columns = dict(zip("xyz", rng.uniform(-bound, bound, (3, n))))
    columns |= {f"f_dc_{i}": rng.normal(0, 0.6, n) for i in range(3)}
    columns |= {f"f_rest_{i}": rng.normal(0, 0.1, n) for i in range(rest)}
    columns |= {"opacity": rng.normal(0.5, 1, n)}
    columns |= {f"scale_{i}": rng.normal(-2.0, 0.4, n) for i in range(3)}
    columns |= {f"rot_{i}": rng.normal(0, 1, n) for i in range(4)}
    return {k: v.astype(np.float32) for k, v in columns.items()}


def stack(columns, prefix, count):
    return torch.tensor(np.stack([columns[f"{prefix}{i}"] for i in range(count)], 1))


def attributes(columns):
    """Raw means, scales, rotations, opacities and SH [n, 16, 3] as the codes hold them."""
    n = len(columns["x"])
    rest = sum(k.startswith("f_rest_") for k in columns)
    sh = torch.cat([stack(columns, "f_dc_", 3)[:, None], stack(columns, "f_rest_", rest).reshape(n, 3, -1).transpose(1, 2)], 1)
    means = torch.tensor(np.stack([columns[k] for k in "xyz"], 1))
    return means, stack(columns, "scale_", 3), stack(columns, "rot_", 4), torch.tensor(columns["opacity"])[:, None], sh


def write(name, code, columns, args, save, expected):
    """The output folder of a code, exported by the documented program, and what it is expected to give."""
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        at = folder / "point_cloud" / "iteration_40"
        at.mkdir(parents=True)
        rows = np.empty(len(columns["x"]), dtype=[(k, "f4") for k in columns])
        for k, v in columns.items():
            rows[k] = v
        PlyData([PlyElement.describe(rows, "vertex")]).write(at / "point_cloud.ply")
        (folder / "cfg_args").write_text(str(argparse.Namespace(**args)))
        save(folder, at)
        subprocess.run([sys.executable, EXPORT, folder, HERE / f"{name}.safetensors"], check=True)
    about = {"code": code, "commit": COMMITS[code], "times": json.dumps(TIMES)}
    save_file({k: v.detach().float().clone().contiguous() for k, v in expected.items()}, HERE / f"{name}.expected.safetensors", about)


def moved(times, step):
    """Columns `NAME.K` of the K-th time."""
    out = {}
    for k, t in enumerate(times):
        means, scales, quats, opacities, sh = step(t)
        out |= {f"means.{k}": means, f"scales.{k}": scales, f"quats.{k}": quats, f"opacities.{k}": opacities[:, 0], f"sh.{k}": sh.flatten(1)}
    return out


def four_dgs():
    deformation = module("4DGaussians", "scene.deformation")
    planes = {"grid_dimensions": 2, "input_coordinate_dim": 4, "output_coordinate_dim": 16, "resolution": [4, 5, 3, 6]}
    args = dict(net_width=12, timebase_pe=4, defor_depth=2, posebase_pe=10, scale_rotation_pe=2, opacity_pe=2, timenet_width=4,
                timenet_output=4, bounds=1.6, kplanes_config=planes, multires=[1, 2], no_dx=False, no_grid=False, no_ds=False, no_dr=False,
                no_do=True, no_dshs=True, empty_voxel=False, grid_pe=0, static_mlp=False, apply_rotation=False)
    net = seeded(deformation.deform_network(argparse.Namespace(**args)), 0.7)
    for plane in (p for level in net.deformation_net.grid.grids for p in level):  # near 1, so that products of six are no zeros
        plane.data = 1 + 2 * plane.data
    net.deformation_net.set_aabb([1.1, 0.9, 1.3], [-1.0, -1.2, -0.8])
    columns = cloud(40, 3, 1.3, 1)
    means, scales, quats, opacities, sh = attributes(columns)

    def step(t):
        m, s, q, o, c = net(means, scales, quats, opacities, sh, torch.full((len(means), 1), t))
        return m, torch.exp(s), torch.nn.functional.normalize(q), torch.sigmoid(o), c

    save = lambda folder, at: torch.save(net.state_dict(), at / "deformation.pth")
    run = dict(sh_degree=3, white_background=True, eval=True, plane_tv_weight=1e-4, time_smoothness_weight=0.01, l1_time_planes=1e-4)
    write("4dgaussians", "4DGaussians", columns, args | run, save, moved(TIMES, step))


def deformable(name, blender):
    time_utils = module("Deformable-3D-GS", "utils.time_utils")
    net = seeded(time_utils.DeformNetwork(D=8, W=16, is_blender=blender), 1.2)
    if blender:  # the published time network is 256 wide; a narrower one keeps the file small
        net.timenet = seeded(torch.nn.Sequential(torch.nn.Linear(13, 8), torch.nn.ReLU(), torch.nn.Linear(8, 30)), 1.2)
    columns = cloud(30, 3, 1.3, 2)
    means, scales, quats, opacities, sh = attributes(columns)

    def step(t):
        d_means, d_quats, d_scales = net(means, torch.full((len(means), 1), t))
        quats_unit = torch.nn.functional.normalize(quats)
        return means + d_means, torch.exp(scales) + d_scales, quats_unit + d_quats, torch.sigmoid(opacities), sh

    def save(folder, at):
        (folder / "deform" / "iteration_40").mkdir(parents=True)
        torch.save(net.state_dict(), folder / "deform" / "iteration_40" / "deform.pth")

    args = dict(sh_degree=3, white_background=not blender, eval=True, is_blender=blender, is_6dof=False)
    write(name, "Deformable-3D-GS", columns, args, save, moved(TIMES, step))


class HashEncoder(torch.nn.Module):
    """A multi-resolution hash grid as Grid4D's kernel computes it: sizes in single precision, smoothstep weights."""

    def __init__(self, input_dim, num_levels, level_dim, per_level_scale, base_resolution, log2_hashmap_size, desired_resolution):
        super().__init__()
        of_axes = lambda v: np.array([v] * input_dim if isinstance(v, int) else v, dtype=np.float64)
        base, last = of_axes(base_resolution), of_axes(desired_resolution)
        growth = np.exp2(np.log2(last / base) / (num_levels - 1))
        sizes = [int(min(2**log2_hashmap_size, np.prod(np.ceil(base * growth**i)))) for i in range(num_levels)]
        self.base, self.log_growth = base.astype(np.float32), np.log2(growth.astype(np.float32))
        self.register_buffer("offsets", torch.tensor(np.cumsum([0] + sizes).astype(np.int32)))
        self.register_buffer("per_level_scale", torch.tensor(growth.astype(np.float32)))
        self.register_buffer("base_resolution", torch.tensor(self.base))
        self.embeddings = torch.nn.Parameter(torch.empty(sum(sizes), level_dim))

    def forward(self, points, size=1):
        unit = ((points + size) / (2 * size)).detach().numpy().astype(np.float32)
        return torch.cat([self.level(unit, l) for l in range(len(self.offsets) - 1)], 1)

    def level(self, unit, l):
        first, entries = int(self.offsets[l]), int(self.offsets[l + 1] - self.offsets[l])
        scale = np.exp2(np.float32(l) * self.log_growth) * self.base - np.float32(1)
        res = np.ceil(scale).astype(np.int64) + 1
        at = unit * scale
        cell = np.floor(at).astype(np.int64)
        w = at - cell
        w = w * w * (3 - 2 * w)
        inside = ((unit >= 0) & (unit <= 1)).all(1)
        out = torch.zeros(len(unit), self.embeddings.shape[1])
        for corner in range(8):
            bits = np.array([corner >> d & 1 for d in range(3)])
            node = cell + bits
            weight = np.where(bits, w, 1 - w).prod(1) * inside
            if res.prod() > entries:
                index = node[:, 0] ^ (node[:, 1] * 2654435761 & 0xFFFFFFFF) ^ (node[:, 2] * 805459861 & 0xFFFFFFFF)
            else:
                index = node[:, 0] + res[0] * (node[:, 1] + res[1] * node[:, 2])
            out = out + torch.tensor(weight.astype(np.float32))[:, None] * self.embeddings[first + index % entries]
        return out


def grid4d():
    stub("hashencoder")
    stub("hashencoder.hashgrid", HashEncoder=HashEncoder)
    deform_model = module("Grid4D", "scene.deform_model")
    general = importlib.import_module("utils.general_utils")
    grid_args = dict(canonical_num_levels=5, canonical_level_dim=2, canonical_base_resolution=4, canonical_desired_resolution=24,
                     canonical_log2_hashmap_size=9, deform_num_levels=6, deform_level_dim=2, deform_base_resolution=[4, 4, 4],
                     deform_desired_resolution=[8, 8, 6], deform_log2_hashmap_size=8, bound=1.2)
    network_args = dict(depth=1, width=16, directional=True)
    model = deform_model.DeformModel(grid_args, network_args, reg_spatial_able=False, reg_temporal_able=False, scale_xyz=1.0)
    seeded(model.grid4d, 1.5), seeded(model.deform, 1.2)
    columns = cloud(40, 3, 1.3, 3)
    means, scales, quats, opacities, sh = attributes(columns)

    def step(t):
        d = model.step(means, torch.full((len(means), 1), t))
        turn, shift = general.quaternion_to_matrix(d["d_xyz"][:, :4]), d["d_xyz"][:, 4:, None]
        quats_unit = torch.nn.functional.normalize(quats)
        turned = (turn @ means[..., None] + shift)[..., 0]
        return turned, torch.exp(scales) + d["d_scaling"], quats_unit + d["d_rotation"], torch.sigmoid(opacities), sh

    def save(folder, at):
        (folder / "deform" / "iteration_40").mkdir(parents=True)
        torch.save((model.grid4d.state_dict(), model.deform.state_dict()), folder / "deform" / "iteration_40" / "deform.pth")

    args = dict(sh_degree=3, white_background=False, eval=True, grid_args=grid_args, network_args=network_args, scale_xyz=1.0)
    write("grid4d", "Grid4D", columns, args, save, moved(TIMES, step))


def scaffold(name, **options):
    stub("torch_scatter", scatter_max=None)
    stub("simple_knn"), stub("simple_knn._C", distCUDA2=None)
    stub("diff_gaussian_rasterization", GaussianRasterizationSettings=None, GaussianRasterizer=None)
    stub("jaxtyping", Shaped=type("Shaped", (), {"__class_getitem__": lambda cls, item: item[0]}))
    renderer = module("Scaffold-GS", "gaussian_renderer")
    model = importlib.import_module("scene.gaussian_model")
    sizes = dict(feat_dim=8, n_offsets=3, appearance_dim=options.get("appearance_dim", 0))
    flags = dict(use_feat_bank=options.get("bank", False), add_opacity_dist=False, add_cov_dist=True, add_color_dist=False)
    gaussians = model.GaussianModel(voxel_size=0.05, **sizes, **flags)
    gaussians.set_appearance(4)
    parts = {"opacity_mlp": gaussians.mlp_opacity, "cov_mlp": gaussians.mlp_cov, "color_mlp": gaussians.mlp_color}
    parts |= {"feature_bank_mlp": gaussians.mlp_feature_bank} if flags["use_feat_bank"] else {}
    parts |= {"appearance": gaussians.embedding_appearance} if sizes["appearance_dim"] else {}
    [seeded(p, 1.5) for p in parts.values()]
    rng = np.random.default_rng(4)
    n, k = 25, sizes["n_offsets"]
    anchor, feat, offset = rng.normal(0, 0.7, (n, 3)), rng.normal(0, 1, (n, 8)), rng.normal(0, 1, (n, k, 3))
    scaling, rotation = rng.normal(-1.5, 0.4, (n, 6)), np.tile([1.0, 0, 0, 0], (n, 1))
    columns = dict(zip(["x", "y", "z", "nx", "ny", "nz"], np.concatenate([anchor, 0 * anchor], 1).T))
    columns |= {f"f_offset_{i}": v for i, v in enumerate(offset.transpose(0, 2, 1).reshape(n, -1).T)}
    columns |= {f"f_anchor_feat_{i}": v for i, v in enumerate(feat.T)}
    columns |= {"opacity": np.full(n, -2.2)}
    columns |= {f"scale_{i}": v for i, v in enumerate(scaling.T)} | {f"rot_{i}": v for i, v in enumerate(rotation.T)}
    columns = {key: v.astype(np.float32) for key, v in columns.items()}
    single = lambda v: torch.nn.Parameter(torch.tensor(v.astype(np.float32)))
    gaussians._anchor, gaussians._anchor_feat, gaussians._offset, gaussians._scaling = map(single, (anchor, feat, offset, scaling))
    if sizes["appearance_dim"]:  # one vector for all cameras, as an importer has to choose one
        weight = gaussians.embedding_appearance.embedding.weight
        weight.data = weight.data.mean(0, keepdim=True).repeat(4, 1) + torch.tensor([[0.3], [-0.3], [0.1], [-0.1]])
        mean = weight.data.mean(0, keepdim=True)
    eye = torch.tensor([0.4, -0.3, -3.0])
    camera = types.SimpleNamespace(camera_center=eye, uid=0)
    keep = dict(state={p: net.state_dict() for p, net in parts.items()})
    if sizes["appearance_dim"]:
        keep["state"]["appearance"] = {"embedding.weight": weight.data.clone()}
        weight.data = mean.repeat(4, 1)
    gaussians.eval()
    means, colors, opacities, scales, quats = renderer.generate_neural_gaussians(camera, gaussians)
    expected = {"means.0": means, "colors.0": colors, "opacities.0": opacities[:, 0], "scales.0": scales, "quats.0": quats, "eye": eye}
    save = lambda folder, at: torch.save(keep["state"], at / "checkpoints.pth")
    args = dict(sh_degree=3, white_background=False, eval=True, voxel_size=0.05, **sizes, **flags)
    write(name, "Scaffold-GS", columns, args, save, expected)


stub("tkinter", W=None)
four_dgs()
deformable("deformable-blender", True)
deformable("deformable", False)
grid4d()
scaffold("scaffold")
scaffold("scaffold-bank", bank=True, appearance_dim=4)
