"""The devices on which PyTorch's kernels are tested."""

import pytest

from scenediff_classic.devices import cuda_available

TORCH_DEVICES = [
    pytest.param("cpu", id="torch"),
    pytest.param(
        "cuda",
        id="torch on cuda",
        marks=pytest.mark.skipif(not cuda_available(), reason="there is no CUDA device here"),
    ),
]
"""Parameters for `devices.in_torch`."""
