"""The standard file of 3D Gaussian splatting, which public viewers open.

One ``vertex`` of float32 a Gaussian: x y z, nx ny nz (zero), f_dc_0..2, f_rest_* (channel by
channel), opacity (logit), scale_0..2 (logarithms), rot_0..3 (w x y z).
"""

from pathlib import Path

import numpy as np
import torch

from baselines.gaussian_splatting.gaussians import MAX_DEGREE, Gaussians
from scenediff_classic.errors import InputError
from scenediff_classic.workspace import write_atomic

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_MAX_HEADER = 65536


def write_gaussians(path: Path, gaussians: Gaussians) -> None:
    """Write a binary PLY; the file appears complete or not at all.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    g = gaussians.map(lambda t: t.detach().cpu().to(torch.float32))
    n = len(g)
    rest = g.sh[:, 1:].transpose(1, 2).reshape(n, -1)
    columns = [g.means, torch.zeros(n, 3), g.sh[:, 0], rest, g.opacity_logits[:, None]]
    rows = torch.cat([*columns, g.log_scales, g.quaternions], dim=1).numpy().astype("<f4")
    properties = [f"property float {name}" for name in property_names(g.degree)]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {n}", *properties]
    header = "\n".join([*head, "end_header", ""])
    write_atomic(path, header.encode("ascii") + rows.tobytes())


def property_names(degree: int) -> list[str]:
    """All properties of a vertex, in order."""
    rest = 3 * ((degree + 1) ** 2 - 1)
    return [
        "x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{k}" for k in range(3)),
        *(f"f_rest_{k}" for k in range(rest)), "opacity", *(f"scale_{k}" for k in range(3)),
        *(f"rot_{k}" for k in range(4)),
    ]  # fmt: skip


def read_gaussians(path: Path) -> Gaussians:
    """Read a PLY that this project or another one wrote.

    Properties may come in any order and further ones are left out; all of them are scalars.

    Raises
    ------
    InputError
        If the file cannot be read, or is no such file.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}.") from error
    count, layout, body = _header(path, content)
    if len(body) < count * layout.itemsize:
        raise InputError(f"{path} is cut off: it ends before its {count} Gaussians do.")
    vertices = np.frombuffer(body, layout, count)
    rest = sum(name.startswith("f_rest_") for name in layout.names or ())
    degree = next((d for d in range(MAX_DEGREE + 1) if 3 * ((d + 1) ** 2 - 1) == rest), None)
    if degree is None:
        raise InputError(
            f"{path} has {rest} properties f_rest_*: spherical harmonics of degree 0 to 3 have "
            "0, 9, 24 or 45."
        )
    missing = [n for n in property_names(degree) if n not in (layout.names or ())]
    missing = [n for n in missing if not n.startswith("n")]  # normals say nothing
    if missing:
        raise InputError(f"{path} holds no Gaussians: the property {missing[0]!r} is missing.")

    def columns(*names: str) -> np.ndarray:
        return np.stack([vertices[n].astype(np.float32) for n in names], axis=1)

    rgb = columns(*(f"f_dc_{k}" for k in range(3)))[:, None]
    if rest:
        higher = columns(*(f"f_rest_{k}" for k in range(rest))).reshape(count, 3, -1)
        rgb = np.concatenate([rgb, higher.transpose(0, 2, 1)], axis=1)
    arrays = (
        columns("x", "y", "z"), columns("scale_0", "scale_1", "scale_2"),
        columns("rot_0", "rot_1", "rot_2", "rot_3"), columns("opacity")[:, 0], rgb,
    )  # fmt: skip
    if not all(np.isfinite(a).all() for a in arrays):
        raise InputError(f"{path} holds numbers that are not finite.")
    return Gaussians(*(torch.from_numpy(np.ascontiguousarray(a)) for a in arrays))


def _header(path: Path, content: bytes) -> tuple[int, np.dtype, bytes]:
    """Number and layout of the vertices, and everything after the header."""
    end = content.find(b"end_header", 0, _MAX_HEADER)
    line_end = content.find(b"\n", end)
    if not content.startswith(b"ply") or end < 0 or line_end < 0:
        raise InputError(f"{path} is not a PLY file.")
    lines = content[:end].decode("ascii", "replace").splitlines()
    words = [line.split() for line in lines if line.split()]
    if ["format", "binary_little_endian", "1.0"] not in words:
        raise InputError(f"{path} is not a binary little-endian PLY file, as splats come in.")
    elements = [k for k, w in enumerate(words) if w[0] == "element"]
    if not elements or len(words[elements[0]]) != 3 or words[elements[0]][1] != "vertex":
        raise InputError(f"{path} holds no Gaussians: its first element is not 'vertex'.")
    number = words[elements[0]][2]
    if not number.isdecimal():
        raise InputError(f"{path} says that it has {number!r} vertices, which is no number.")
    stop = elements[1] if len(elements) > 1 else len(words)
    properties = [w for w in words[elements[0] : stop] if w[0] == "property"]
    for w in properties:
        if len(w) != 3 or w[1] not in _TYPES:
            raise InputError(f"{path} has a property that no splat has: {' '.join(w)!r}.")
    try:
        layout = np.dtype([(w[2], "<" + _TYPES[w[1]]) for w in properties])
    except ValueError as error:
        raise InputError(f"{path} names the same property twice.") from error
    return int(number), layout, content[line_end + 1 :]
