"""Makes trace.safetensors and trace.expected.safetensors: a small checkpoint in the layout of TRACE, and the splats of its formulas.

    python make_trace.py

Layout and formulas are those of vLAR-group/PhysInOne at commit 810043f, folder
baselines/Future_Frame_Prediction/Long-term_Future_Frame_Prediction/TRACE: scene/deform_model.py, utils/time_utils.py, utils/physics_utils.py,
gaussian_renderer/__init__.py. They are written anew in plain Python, in double precision; nothing needs to be installed.
"""
import json
import math
import random
import struct
from pathlib import Path

HERE = Path(__file__).resolve().parent
TIMES = [0.0, 0.37, 1.0]
LAST, RATE = 0.6, 15  # when the field ends, steps in a unit of time
COUNT, WIDTH, DEPTH, TIME_HIDDEN, TIME_OUT, LAW_WIDTH, LAW_LAYERS = 20, 16, 8, 8, 30, 12, 2
rng = random.Random(5)


def single(value):
    return struct.unpack("<f", struct.pack("<f", value))[0]


def normal(count, mean=0.0, deviation=1.0):
    return [single(rng.gauss(mean, deviation)) for _ in range(count)]


def linear(outputs, inputs, gain=1.0):
    """Weight, row by row, and bias."""
    return normal(outputs * inputs, 0.0, gain / max(inputs, 1) ** 0.5), normal(outputs, 0.0, 0.25 * gain)


def apply(layer, x):
    weight, bias = layer
    n = len(x)
    return [b + math.fsum(w * v for w, v in zip(weight[k * n : k * n + n], x)) for k, b in enumerate(bias)]


def encode(x, bands):
    waves = (f([v * 2.0**k for v in x]) for k in range(bands) for f in (sines, cosines))
    return [*x, *(v for wave in waves for v in wave)]


sines = lambda x: [math.sin(v) for v in x]
cosines = lambda x: [math.cos(v) for v in x]
relu = lambda x: [max(v, 0.0) for v in x]
silu = lambda x: [v / (1.0 + math.exp(-v)) for v in x]
cross = lambda a, b: [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
along = lambda x, h, v: [a + h * b for a, b in zip(x, v)]


def unit(q):
    length = math.sqrt(math.fsum(v * v for v in q))
    return [v / length for v in q]


def multiply(p, q):
    (a, *u), (b, *v) = p, q
    return [a * b - math.fsum(s * t for s, t in zip(u, v)), *(a * t + b * s + c for s, t, c in zip(u, v, cross(u, v)))]


# The networks.
joined = 3 * 17 + TIME_OUT
time_net = [linear(TIME_HIDDEN, 13), linear(TIME_OUT, TIME_HIDDEN)]
inputs = [joined] + [WIDTH + joined if k == DEPTH // 2 else WIDTH for k in range(DEPTH - 1)]
trunk = [linear(WIDTH, n, 1.4) for n in inputs]
heads = {"warp": linear(3, WIDTH, 0.7), "rotation": linear(4, WIDTH, 0.7), "scaling": linear(3, WIDTH, 0.5)}
law = [linear(LAW_WIDTH, 28), *(linear(LAW_WIDTH, LAW_WIDTH, 1.4) for _ in range(LAW_LAYERS)), linear(12, LAW_WIDTH, 1.4)]


def field(x, t):
    features = apply(time_net[1], relu(apply(time_net[0], encode([t], 6))))
    first = h = encode(x, 8) + features
    for k, layer in enumerate(trunk):
        h = relu(apply(layer, h))
        if k == DEPTH // 2:
            h = first + h
    return (apply(heads[name], h) for name in ("warp", "rotation", "scaling"))


def carried(x, t, end):
    """Position and turn after the law, read once at `t`, has ruled until `end`."""
    h = encode([*x, t], 3)
    for layer in law[:-1]:
        h = silu(apply(layer, h))
    out = apply(law[-1], h)
    twist, rate = out[:6], [v * abs(v) / 10 for v in out[6:]]
    velocity = lambda x: along(twist[:3], 1.0, cross(twist[3:], x))
    turn = [1.0, 0.0, 0.0, 0.0]
    while end - t > 1e-9:
        h = min(1.0 / RATE, end - t)
        middle = along(x, 0.5 * h, velocity(x))
        twist = along(twist, 0.5 * h, rate)
        x = along(x, h, velocity(middle))
        angle = math.sqrt(math.fsum(w * w for w in twist[3:]))
        turn = multiply([math.cos(0.5 * angle * h), *(math.sin(0.5 * angle * h) * w / angle for w in twist[3:])], turn)
        twist, t = along(twist, 0.5 * h, rate), t + h
    return x, turn


def splat(row, t):
    at = min(t, LAST)
    shift, turn, growth = field(row["x"], at)
    x, quat = along(row["x"], 1.0, shift), multiply(unit(turn), unit(row["rot"]))
    if t > at:
        x, further = carried(x, at, t)
        quat = multiply(further, quat)
    return x, [math.exp(s + g) for s, g in zip(row["scale"], growth)], quat


def save(name, tensors, about):
    """A safetensors file of F32 tensors, `NAME: (shape, values)`."""
    head, data = {"__metadata__": about}, b""
    for key, (shape, values) in tensors.items():
        assert math.prod(shape) == len(values), key
        head[key] = {"dtype": "F32", "shape": shape, "data_offsets": [len(data), len(data) + 4 * len(values)]}
        data += struct.pack(f"<{len(values)}f", *values)
    text = json.dumps(head).encode()
    text += b" " * (-len(text) % 8)
    (HERE / f"{name}.safetensors").write_bytes(struct.pack("<Q", len(text)) + text + data)


columns = {c: [single(rng.uniform(-1.3, 1.3)) for _ in range(COUNT)] for c in "xyz"}
columns |= {f"n{c}": [0.0] * COUNT for c in "xyz"}
columns |= {f"f_dc_{k}": normal(COUNT, 0, 0.6) for k in range(3)}
columns |= {f"f_rest_{k}": normal(COUNT, 0, 0.1) for k in range(45)}
columns |= {"opacity": normal(COUNT, 0.5)}
columns |= {f"scale_{k}": normal(COUNT, -2.0, 0.4) for k in range(3)}
columns |= {f"rot_{k}": normal(COUNT) for k in range(4)}
columns |= {f"deform_code_{k}": [0.0] * COUNT for k in range(2)}
tensors = {f"ply.{name}": ([COUNT], values) for name, values in columns.items()}


def put(name, layer):
    weight, bias = layer
    tensors[f"{name}.weight"] = ([len(bias), len(weight) // len(bias)], weight)
    tensors[f"{name}.bias"] = ([len(bias)], bias)


put("deform.timenet.0", time_net[0]), put("deform.timenet.2", time_net[1])
[put(f"deform.linear.{k}", layer) for k, layer in enumerate(trunk)]
[put(f"deform.gaussian_{name}", layer) for name, layer in heads.items()]
put("deform.gate_func.0", linear(WIDTH, 0)), put("deform.gate_func.2", linear(1, WIDTH))
tensors["vel.vel_net.embedder.frequency_bands"] = ([3], [1.0, 2.0, 4.0])
[put(f"vel.vel_net.weight_net.{f'{k + 1}.0' if k else 0}", layer) for k, layer in enumerate(law)]
args = dict(sh_degree=3, white_background=True, eval=True, is_blender=True, is_6dof=False, max_time=LAST, light=True, physics_code=16,
            freegave=False, fps=RATE)
save("trace", tensors, {"code": "TRACE", "iteration": "40", "args": json.dumps(args)})

rows = [{"x": [columns[c][i] for c in "xyz"], "scale": [columns[f"scale_{k}"][i] for k in range(3)],
         "rot": [columns[f"rot_{k}"][i] for k in range(4)]} for i in range(COUNT)]
color = lambda i: [columns[f"f_dc_{c}"][i] for c in range(3)] + [columns[f"f_rest_{15 * c + k}"][i] for k in range(15) for c in range(3)]
expected = {}
for k, t in enumerate(TIMES):
    moved = [splat(row, single(t)) for row in rows]
    for part, (name, width) in enumerate([("means", 3), ("scales", 3), ("quats", 4)]):
        expected[f"{name}.{k}"] = ([COUNT, width], [v for m in moved for v in m[part]])
    expected[f"opacities.{k}"] = ([COUNT], [1 / (1 + math.exp(-v)) for v in columns["opacity"]])
    expected[f"sh.{k}"] = ([COUNT, 48], [v for i in range(COUNT) for v in color(i)])
save("trace.expected", expected, {"code": "TRACE", "commit": "810043f", "times": json.dumps(TIMES)})
steps = [max(math.dist(a[0], b[0]) for a, b in zip(*(([splat(r, t) for r in rows]) for t in pair))) for pair in ((0.0, 0.37), (LAST, 1.0))]
print(f"{len(tensors)} tensors; splats move by up to {steps[0]:.2f} and {steps[1]:.2f}")
