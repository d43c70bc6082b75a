"""Reading cameras and arrays that somebody else wrote: every surprise is an `InputError`."""

import zipfile
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float64

from scenediff_classic.errors import InputError


def read_npz(path: Path) -> dict[str, np.ndarray]:
    """All arrays of an ``.npz``; pickled objects are refused, not run."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {key: archive[key] for key in archive.files}
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist.") from error
    except (OSError, ValueError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(
            f"{path} cannot be read as an .npz of plain arrays (pickled objects are not allowed)."
        ) from error


def read_numbers(path: Path) -> Float64[np.ndarray, "rows columns"]:
    """A text file of numbers, one row a line."""
    try:
        return np.loadtxt(path, dtype=np.float64, ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read as a table of numbers.") from error


def rigid_pose(matrix: Float[np.ndarray, "r c"], source: str) -> Float64[np.ndarray, "4 4"]:
    """A 3x4 or 4x4 rigid transform, as 4x4 with an exact rotation.

    Parameters
    ----------
    source : str
        What the matrix belongs to, for the error message.

    Raises
    ------
    InputError
        If the matrix scales, shears or mirrors, is not finite, or has another shape.
    """
    if matrix.shape not in {(3, 4), (4, 4)} or not np.isfinite(matrix).all():
        raise InputError(f"The pose of {source} must be a finite 3x4 or 4x4 matrix.")
    rotation = matrix[:3, :3].astype(np.float64)
    rigid = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-2) and np.linalg.det(rotation) > 0
    if not rigid or (len(matrix) == 4 and not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-6)):
        raise InputError(
            f"The pose of {source} is not a rigid transform: its rotation scales or mirrors."
        )
    u, _, vt = np.linalg.svd(rotation)
    pose = np.eye(4)
    pose[:3, :3] = u @ vt  # nearest rotation: text files round
    pose[:3, 3] = matrix[:3, 3]
    return pose


def pinhole(matrix: Float[np.ndarray, "3 3"], source: str) -> Float64[np.ndarray, "3 3"]:
    """Intrinsics, checked to be a camera matrix with positive focal lengths."""
    k = np.asarray(matrix, dtype=np.float64)
    shaped = k.shape == (3, 3) and np.isfinite(k).all() and np.allclose(k[2], [0, 0, 1])
    if not shaped or k[0, 0] <= 0 or k[1, 1] <= 0 or k[1, 0] != 0:
        raise InputError(
            f"The intrinsics of {source} must be [[fx, s, cx], [0, fy, cy], [0, 0, 1]] in pixels."
        )
    return k
