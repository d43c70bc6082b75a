"""0.8 L1 + 0.2 (1 - SSIM) between a rendered picture and a captured one, with its gradient.

SSIM (Wang et al. 2004) with an 11 x 11 Gaussian window of sigma 1.5 and zeros outside the picture.
Blurring is its own adjoint, so the gradient takes three more blurs and no graph. OpenCV blurs on
the CPU; on CUDA the same formula runs in PyTorch.
"""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from numba import njit

SSIM_SHARE = 0.2
_SIDE, _SIGMA = 11, 1.5
_C1, _C2 = 0.01**2, 0.03**2


@dataclass(frozen=True)
class Target:
    """A picture to be matched, and what its comparisons have in common."""

    planes: Float[torch.Tensor, "c h w"]
    mean: Float[torch.Tensor, "c h w"]
    """Blurred."""
    square: Float[torch.Tensor, "c h w"]
    """Its square, blurred."""
    ignore: Bool[torch.Tensor, "h w"] | None = None
    """Pixels that count as matched, and as black in the windows of others."""

    @staticmethod
    def of(
        planes: Float[torch.Tensor, "c h w"], ignore: Bool[np.ndarray, "h w"] | None = None
    ) -> "Target":
        """Prepare a picture (channels first)."""
        known = ignore is None or not ignore.any()
        hidden = None if known else torch.from_numpy(np.asarray(ignore)).to(planes.device)
        planes = planes.contiguous() if hidden is None else planes.masked_fill(hidden, 0)
        return Target(planes, _blur(planes), _blur(planes * planes), hidden)


def planes_of(image: UInt8[np.ndarray, "h w 3"]) -> Float[torch.Tensor, "3 h w"]:
    """A picture as float32 between 0 and 1, channels first."""
    return torch.from_numpy(image.transpose(2, 0, 1).astype(np.float32) / np.float32(255))


def photometric_loss(
    planes: Float[torch.Tensor, "c h w"], target: Target, ssim_share: float = SSIM_SHARE
) -> Float[torch.Tensor, ""]:
    """``(1 - share) * L1 + share * (1 - SSIM)``, the mean over pixels and channels."""
    if target.ignore is not None:
        planes = torch.where(target.ignore, target.planes, planes)
    l1 = (planes - target.planes).abs().mean()
    return (1 - ssim_share) * l1 + ssim_share * (1 - ssim(planes, target))


def ssim(planes: Float[torch.Tensor, "c h w"], target: Target) -> Float[torch.Tensor, ""]:
    """Structural similarity, the mean over pixels and channels; pictures range from 0 to 1."""
    mean = _Ssim.apply(planes, target)
    return torch.as_tensor(mean)


def psnr(error_squared: float) -> float:
    """Peak signal-to-noise ratio, in dB, of a mean squared error of values from 0 to 1."""
    return math.inf if error_squared == 0 else -10 * math.log10(error_squared)


class _Ssim(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, planes: torch.Tensor, target: Target) -> torch.Tensor:
        planes = planes.contiguous()
        blurred = (_blur(planes), _blur(planes * planes), _blur(planes * target.planes))
        terms = _terms_on_cuda if planes.is_cuda else _terms_on_cpu
        value, *slopes = terms(*blurred, target.mean, target.square)
        ctx.save_for_backward(planes, target.planes, *slopes)
        return value

    @staticmethod
    def backward(ctx: Any, *grads: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        planes, other, d_mean, d_square, d_product = ctx.saved_tensors
        inner = _blur(d_mean) + 2 * planes * _blur(d_square) + other * _blur(d_product)
        return grads[0] / planes.numel() * inner, None


def _blur(planes: torch.Tensor) -> torch.Tensor:
    if planes.is_cuda:
        place = torch.arange(_SIDE, device=planes.device, dtype=planes.dtype) - _SIDE // 2
        window = torch.exp(-place * place / (2 * _SIGMA**2))
        window = (window / window.sum()).reshape(1, 1, -1, 1)
        half = torch.nn.functional.conv2d(planes[:, None], window, padding=(_SIDE // 2, 0))
        other = window.transpose(2, 3)
        return torch.nn.functional.conv2d(half, other, padding=(0, _SIDE // 2))[:, 0]
    out = np.empty(planes.shape, planes.numpy().dtype)
    for source, blurred in zip(planes.numpy(), out, strict=True):
        cv2.GaussianBlur(
            source, (_SIDE, _SIDE), _SIGMA, dst=blurred, borderType=cv2.BORDER_CONSTANT
        )
    return torch.from_numpy(out)


def _terms_on_cuda(
    m: torch.Tensor, xx: torch.Tensor, xy: torch.Tensor, n: torch.Tensor, yy: torch.Tensor
) -> tuple[torch.Tensor, ...]:
    """Mean SSIM; gradients of each pixel's with respect to the three blurred pictures."""
    top_m, top_s = 2 * m * n + _C1, 2 * (xy - m * n) + _C2
    low_m, low_s = m * m + n * n + _C1, xx - m * m + yy - n * n + _C2
    low = low_m * low_s
    value = top_m * top_s / low
    d_mean = 2 * n * (top_s - top_m) / low - 2 * m * value * (1 / low_m - 1 / low_s)
    return value.mean(), d_mean, -value / low_s, 2 * top_m / low


def _terms_on_cpu(*blurred: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """As `_terms_on_cuda`, in one pass over the pixels."""
    slopes = [np.empty(blurred[0].numel(), blurred[0].numpy().dtype) for _ in range(3)]
    total = _ssim_terms(*(b.numpy().ravel() for b in blurred), *slopes)
    mean = torch.tensor(total / blurred[0].numel(), dtype=blurred[0].dtype)
    return mean, *(torch.from_numpy(s.reshape(blurred[0].shape)) for s in slopes)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def _ssim_terms(m, xx, xy, n, yy, d_mean, d_square, d_product):
    r = m.dtype.type
    one, two, c1, c2 = r(1), r(2), r(_C1), r(_C2)
    total = 0.0
    for i in range(len(m)):
        top_m, top_s = two * m[i] * n[i] + c1, two * (xy[i] - m[i] * n[i]) + c2
        low_m, low_s = (
            m[i] * m[i] + n[i] * n[i] + c1,
            xx[i] - m[i] * m[i] + yy[i] - n[i] * n[i] + c2,
        )
        by_m, by_s = one / low_m, one / low_s
        value = top_m * top_s * by_m * by_s
        d_mean[i] = two * (n[i] * (top_s - top_m) * by_m * by_s - m[i] * value * (by_m - by_s))
        d_square[i] = -value * by_s
        d_product[i] = two * top_m * by_m * by_s
        total += value
    return total
