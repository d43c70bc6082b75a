"""Where a stage computes: on the CPU, or on a CUDA device through PyTorch.

PyTorch is imported only once it is asked for: it takes a second and 200 MB.
"""

import ctypes
from typing import Literal

from scenediff_classic.errors import InputError

Device = Literal["auto", "cpu", "cuda"]
"""``auto`` is CUDA where there is any, otherwise the CPU."""


def chosen_device(device: Device) -> Literal["cpu", "cuda"]:
    """The device that an option stands for here.

    Raises
    ------
    InputError
        If CUDA is asked for and not there.
    """
    check_device(device)
    return "cpu" if device == "cpu" or not cuda_available() else "cuda"


def check_device(device: Device) -> None:
    """Raise an `InputError` if CUDA is asked for and not there."""
    if device == "cuda" and not cuda_available():
        raise InputError("PyTorch finds no CUDA device: choose the device cpu or auto instead.")


def cuda_available() -> bool:
    """Whether PyTorch can compute on a CUDA device here."""
    try:
        ctypes.CDLL("libcuda.so.1")  # without a driver, PyTorch need not be asked
    except OSError:
        return False
    import torch

    return torch.cuda.is_available()
