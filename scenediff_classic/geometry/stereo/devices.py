"""Where PatchMatch computes: numba on the CPU, or PyTorch on a CUDA device.

PyTorch is imported only once it is asked for: it takes a second and 200 MB.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from scenediff_classic.devices import Device, chosen_device
from scenediff_classic.geometry.stereo import kernels
from scenediff_classic.geometry.stereo.pyramid import Pictures
from scenediff_classic.geometry.stereo.smoothing import smooth_planes
from scenediff_classic.geometry.stereo.windows import prepare_windows


class Kernels(NamedTuple):
    """The inner loops of PatchMatch for one device, as `kernels_reference` describes them.

    Planes and costs are NumPy arrays, changed in place; pictures and windows lie on the device.
    """

    load: Callable[[Pictures], Any]
    """Puts pictures on the device: what comes back stands for them in all other calls."""
    prepare_windows: Callable[..., Any]
    score_planes: Callable[..., None]
    sweep: Callable[..., None]
    smooth_planes: Callable[..., None]


def kernels_for(device: Device) -> Kernels:
    """The kernels that run on a device.

    Raises
    ------
    InputError
        If CUDA is asked for and not there.
    """
    chosen = chosen_device(device)
    return compiled() if chosen == "cpu" else in_torch(chosen)


def compiled() -> Kernels:
    """The kernels compiled with numba."""
    return Kernels(_as_it_is, prepare_windows, kernels.score_planes, kernels.sweep, smooth_planes)


def in_torch(device: str) -> Kernels:
    """The kernels in PyTorch, on any of its devices."""
    from scenediff_classic.geometry.stereo import kernels_torch

    return Kernels(
        partial(kernels_torch.load, device=device),
        kernels_torch.prepare_windows,
        kernels_torch.score_planes,
        kernels_torch.sweep,
        kernels_torch.smooth_planes,
    )


def _as_it_is(pictures: Pictures) -> Pictures:
    return pictures
