"""Packs the package with a native module that is built already, as maturin would pack it:

    python tests/pack_wheel.py target/debug/libgs4d_py.so 0.1.0 out

writes ``out/gs4d-0.1.0-cp39-abi3-PLATFORM.whl`` (https://packaging.python.org/specifications/binary-distribution-format).
"""

import base64
import hashlib
import json
import re
import sys
import sysconfig
import zipfile
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]


def metadata(version):
    """The core metadata; strings and lists of strings of pyproject.toml are JSON."""
    project = (PACKAGE / "pyproject.toml").read_text(encoding="utf-8")
    value = lambda key: json.loads(re.search(rf"^{key} = (.+)$", project, re.MULTILINE).group(1))
    lines = ["Metadata-Version: 2.1", f"Name: {value('name')}", f"Version: {version}", f"Summary: {value('description')}",
             f"Requires-Python: {value('requires-python')}", *(f"Requires-Dist: {d}" for d in value("dependencies"))]
    return "\n".join(lines) + "\n"


def pack(module, version, folder):
    platform = re.sub(r"[-.]", "_", sysconfig.get_platform())
    tag, info = f"cp39-abi3-{platform}", f"gs4d-{version}.dist-info"
    files = {f"gs4d/{path.name}": path.read_bytes() for path in sorted((PACKAGE / "python" / "gs4d").glob("*.py"))}
    files["gs4d/_gs4d" + (".pyd" if sys.platform == "win32" else ".abi3.so")] = Path(module).read_bytes()
    files[f"{info}/METADATA"] = metadata(version).encode()
    files[f"{info}/WHEEL"] = f"Wheel-Version: 1.0\nGenerator: gs4d\nRoot-Is-Purelib: false\nTag: {tag}\n".encode()
    record = ""
    for name, data in files.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
        record += f"{name},sha256={digest},{len(data)}\n"
    files[f"{info}/RECORD"] = (record + f"{info}/RECORD,,\n").encode()
    with zipfile.ZipFile(Path(folder) / f"gs4d-{version}-{tag}.whl", "w") as wheel:
        for name, data in files.items():
            wheel.writestr(name, data)
    return wheel.filename


if __name__ == "__main__":
    print(pack(*sys.argv[1:]))
