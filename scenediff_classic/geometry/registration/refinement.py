"""The last bundle adjustment: robust, and with the optical centre where the pictures ask for it.

The mapper's own adjustment squares every error, so that a few wrong matches and blurred corners
bend the cameras. Here errors far above the median count little (Cauchy's loss).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from scenediff_classic.geometry.registration.colmap import models
from scenediff_classic.geometry.registration.sparse_model import SparseModel, residuals

LOSS_SCALE = 2.0
"""Errors beyond this many standard deviations lose their weight."""
MIN_EVIDENCE = 100.0
"""What a free optical centre must gain, in units of the errors' variance."""
MIN_GAIN = 0.02
"""The same for each residual. Errors are not independent, so that a gain can be significant by its
sum alone. Measured: rendered pictures with a true centre gain at most 0.0024, RedKitchen 0.012 (its
cameras get worse by it); templeRing 0.029, rendered pictures with an edge cut off 0.07 and more."""
MIN_SHIFT = 0.02
"""How far (share of the longer side) the centre must move to be believed. Without reason it drifts
by up to 0.006 on rendered photos and 0.013 on RedKitchen; templeRing's is 0.029."""
MAX_SHIFT = 0.25
"""Farther than this, the adjustment ran away."""


@dataclass(frozen=True)
class Evidence:
    """Whether pictures ask for an optical centre beside their middle."""

    gain: float
    """Robust error that a free centre saves, in units of the errors' variance."""
    residuals: int
    shift: float
    """Largest distance of a centre from its picture's middle, as a share of the longer side."""

    @property
    def convincing(self) -> bool:
        """True if the free centre is to be kept."""
        enough = max(MIN_EVIDENCE, MIN_GAIN * self.residuals)
        return self.gain >= enough and MIN_SHIFT <= self.shift <= MAX_SHIFT

    @staticmethod
    def weigh(
        fixed: Float64[np.ndarray, "n 2"],
        free: Float64[np.ndarray, "n 2"],
        loss_scale: float,
        shift: float,
    ) -> "Evidence":
        """Compare the reprojection errors with the centres fixed and free."""
        variance = max(spread(free), 1e-9) ** 2
        saved = _cauchy(fixed, loss_scale) - _cauchy(free, loss_scale)
        return Evidence(saved / variance, free.size, shift)


def refine(model: Path, output: Path, *, lens: bool) -> tuple[Path, str]:
    """Adjust a COLMAP model robustly; the folder of the result and a line for the log.

    Parameters
    ----------
    model : Path
        Folder of the model; it stays as it is.
    output : Path
        Folder below which results are written.
    lens : bool
        Refine focal length and distortion too, and try a free optical centre.
    """
    before = _errors(models.read_model(model))
    if len(before) == 0:
        return model, "No points to refine."
    loss_scale = max(LOSS_SCALE * spread(before), 1e-3)  # exact keypoints have no spread
    fixed = models.adjust(model, output / "fixed", loss_scale, lens=lens)
    errors = _errors(models.read_model(fixed))
    line = f"Robust adjustment: median error {_median(before):.2f} to {_median(errors):.2f} px"
    if not lens:
        return fixed, f"{line}."
    free = models.adjust(fixed, output / "free", loss_scale, lens=True, centre=True)
    freed = models.read_model(free)
    shift = _largest_shift(freed)
    if not Evidence.weigh(errors, _errors(freed), loss_scale, shift).convincing:
        return fixed, f"{line}."
    return free, f"{line}; optical centre {shift:.1%} of the longer side off the middle."


def spread(errors: Float64[np.ndarray, "n 2"]) -> float:
    """Standard deviation of one coordinate, as the median tells it."""
    return float(np.median(np.abs(errors)) / 0.6745)


def _errors(model: SparseModel) -> Float64[np.ndarray, "n 2"]:
    errors = residuals(model)
    return errors[np.isfinite(errors).all(axis=1)]


def _median(errors: Float64[np.ndarray, "n 2"]) -> float:
    return float(np.median(np.linalg.norm(errors, axis=1)))


def _cauchy(errors: Float64[np.ndarray, "n 2"], scale: float) -> float:
    return float(scale**2 * np.log1p((errors**2).sum(axis=1) / scale**2).sum())


def _largest_shift(model: SparseModel) -> float:
    """Of an optical centre from its picture's middle, as a share of the longer side."""
    shifts = []
    for lens in (picture.lens for picture in model.pictures):
        shift = lens.intrinsics[:2, 2] - np.array([lens.width, lens.height]) / 2
        shifts.append(float(np.hypot(*shift)) / max(lens.width, lens.height))
    return max(shifts)
