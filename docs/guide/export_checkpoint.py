"""A checkpoint of 4DGaussians, Deformable-3D-GS, Grid4D, Scaffold-GS or TRACE as one safetensors file.

    python export_checkpoint.py OUTPUT_FOLDER NAME.safetensors [ITERATION]

Runs where these codes run: it needs torch, plyfile and safetensors, and no GPU.
"""
import ast
import json
import sys
from pathlib import Path

import torch
from plyfile import PlyData
from safetensors.torch import save_file

folder, out = Path(sys.argv[1]), sys.argv[2]
names = [p.name.removeprefix("iteration_") for p in (folder / "point_cloud").glob("iteration_*")]
if not names:
    sys.exit(f"{folder} has no point_cloud/iteration_N")
# Grid4D has an `iteration_best`, too, with its number in a file.
iteration = sys.argv[3] if len(sys.argv) > 3 else max((n for n in names if n.isdigit()), key=int)
cloud = folder / "point_cloud" / f"iteration_{iteration}"
deform = folder / "deform" / f"iteration_{iteration}" / "deform.pth"
load = lambda path: torch.load(path, map_location="cpu", weights_only=True)

if (cloud / "deformation.pth").exists():
    code, parts = "4DGaussians", {"deformation": load(cloud / "deformation.pth")}
elif deform.with_name("code_field.pth").exists():
    sys.exit(f"{deform.parent} has the patterns of FreeGave, which gs4d does not read")
elif deform.with_name("vel.pth").exists():
    code, parts = "TRACE", {"deform": load(deform), "vel": load(deform.with_name("vel.pth"))}
elif deform.exists():
    state = load(deform)
    grid4d = isinstance(state, (tuple, list))
    code = "Grid4D" if grid4d else "Deformable-3D-GS"
    parts = dict(zip(("grid4d", "deform"), state)) if grid4d else {"deform": state}
elif (cloud / "checkpoints.pth").exists():
    code, parts = "Scaffold-GS", load(cloud / "checkpoints.pth")
else:
    code = "Scaffold-GS"
    parts = {p.stem: torch.jit.load(p, map_location="cpu").state_dict() for p in cloud.glob("*.pt")}
if not parts:
    sys.exit(f"{cloud} has no networks of a known code, nor has {deform.parent}")

vertex = PlyData.read(cloud / "point_cloud.ply")["vertex"]
tensors = {f"ply.{p.name}": torch.tensor(vertex[p.name]).float() for p in vertex.properties}
for part, state in parts.items():
    tensors |= {f"{part}.{name}": value.float().contiguous() for name, value in state.items()}
namespace = ast.parse((folder / "cfg_args").read_text().strip(), mode="eval").body
args = {k.arg: ast.literal_eval(k.value) for k in namespace.keywords}
number = iteration if iteration.isdigit() else (cloud / "iter.txt").read_text().split()[-1]
about = {"code": code, "iteration": number, "args": json.dumps(args)}
save_file(tensors, out, metadata=about)
print(f"{code}, iteration {number}: {len(tensors)} tensors -> {out}")
