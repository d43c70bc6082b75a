"""PatchMatch on both devices: the same depth from either, and which one is chosen."""

import ctypes
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from scenediff_classic import devices
from scenediff_classic.errors import InputError
from scenediff_classic.geometry.stereo import costs_torch, kernels_torch, patchmatch
from scenediff_classic.geometry.stereo.depth_map import DepthMap
from scenediff_classic.geometry.stereo.devices import Kernels, compiled, in_torch, kernels_for
from scenediff_classic.geometry.stereo.multi_view import MultiViewStereo
from scenediff_classic.geometry.stereo.patchmatch import OFFSETS, PatchMatch
from scenediff_classic.geometry.stereo.view_selection import observed_points
from scenediff_classic.protocols import silent
from tests.geometry.stereo.test_kernels import CONSISTENT, random_pictures
from tests.geometry.stereo.torch_devices import TORCH_DEVICES
from tests.geometry.textured_room import room

MATCHER = PatchMatch(sweeps=(3, 2))
GEOMETRY, TRUTH = room(height=60, width=80, count=4)


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Threads of PyTorch that share a busy processor wait longer than they work."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def both_passes(kernels: Kernels, monkeypatch: pytest.MonkeyPatch) -> tuple[DepthMap, DepthMap]:
    """What both passes find for the first view; the others hand it their true depth."""
    monkeypatch.setattr(patchmatch, "kernels_for", lambda device: kernels)
    ignore = np.zeros((60, 80), bool)
    ignore[20:30, 30:45] = True
    view = replace(GEOMETRY.views[0], ignore=ignore)
    others = [replace(v, depth=d) for v, d in zip(GEOMETRY.views[1:], TRUTH[1:], strict=True)]
    points = GEOMETRY.points.xyz[observed_points(GEOMETRY)[0]]
    first = MATCHER.search(view, others, points)
    settled = first.cost < 0.1
    return first, MATCHER.revise(view, others, points, first, settled)


@pytest.mark.parametrize("device", TORCH_DEVICES)
def test_torch_finds_the_depth_that_numba_finds(
    device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernels_torch, "AT_ONCE", 2**18)
    in_numba = both_passes(compiled(), monkeypatch)
    on_device = both_passes(in_torch(device), monkeypatch)
    for a, b in zip(in_numba, on_device, strict=True):
        known = np.isfinite(a.depth)
        assert np.array_equal(known, np.isfinite(b.depth))
        same = np.abs(a.depth / b.depth - 1)[known] < 1e-3
        assert same.mean() >= 0.95  # near ties end either way, and their neighbours follow
        assert np.mean(np.abs(a.cost - b.cost) < 0.01) >= 0.95
        right = [np.mean(np.abs(m.depth / TRUTH[0] - 1)[known] < 0.02) for m in (a, b)]
        assert min(right) > 0.6
        assert abs(right[0] - right[1]) < 0.01


@pytest.mark.parametrize("device", TORCH_DEVICES)
def test_torch_finds_the_same_depth_every_time(
    device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernels_torch, "AT_ONCE", 2**18)
    one, two = (both_passes(in_torch(device), monkeypatch)[1] for _ in range(2))
    np.testing.assert_array_equal(one.planes, two.planes)
    np.testing.assert_array_equal(one.cost, two.cost)


def test_numbers_stay_on_the_device_in_single_precision() -> None:
    """On PyTorch's device without memory: it refuses to meet a tensor from elsewhere."""
    pictures = costs_torch.load(random_pictures(0), "meta")
    windows = kernels_torch.prepare_windows(pictures.reference, 3, 0.15)
    rules = costs_torch.PlainRules.of(CONSISTENT)
    planes = pictures.reference.new_empty(pictures.reference.numel(), 3)
    costs, pixels = planes[:, 0], torch.arange(len(planes), device="meta")
    patches = costs_torch.patches_at(pixels, pictures, windows)
    offsets = torch.tensor(OFFSETS, device="meta").long()
    shape = tuple(pictures.reference.shape)
    handed, handed_costs = kernels_torch.neighbour_planes(planes, costs, offsets, patches, shape)
    adopted = kernels_torch.adopt_best_neighbour(
        pictures, rules, patches, planes, costs, handed, handed_costs
    )
    draws = [kernels_torch.random_unit(2**31 - 1, pixels, i) for i in range(3)]
    varied = [kernels_torch.varied(planes, kind, draws, 0.1, rules) for kind in range(-1, 3)]
    best, ranked = costs_torch.rank_sources(pictures, rules, patches, planes)
    found = kernels_torch.better_of(
        pictures, rules, patches, best, planes, ranked, adopted, ranked < 1
    )
    for number in (*windows, handed, handed_costs, adopted, *draws, *varied, ranked, *found):
        assert (number.device.type, number.dtype) == ("meta", torch.float32)


def test_the_device_that_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    for available in (False, True):
        monkeypatch.setattr(devices, "cuda_available", lambda available=available: available)
        assert kernels_for("cpu") == compiled()
        on_cuda = kernels_for("auto").sweep is kernels_torch.sweep
        assert on_cuda == available
    assert kernels_for("cuda").sweep is kernels_torch.sweep
    monkeypatch.setattr(devices, "cuda_available", lambda: False)
    with pytest.raises(InputError, match="no CUDA device"):
        kernels_for("cuda")


def test_without_a_driver_there_is_no_cuda(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> None:
        raise OSError(name)

    monkeypatch.setattr(ctypes, "CDLL", absent)
    assert not devices.cuda_available()


def test_torch_is_not_imported_for_the_cpu() -> None:
    code = (
        "import sys; from scenediff_classic.presets import configured; "
        "from scenediff_classic.geometry.stereo.devices import kernels_for; "
        "configured(device='cpu'); kernels_for('cpu'); sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_kept_depth_map_serves_either_device(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    geometry, _ = room(height=24, width=32, count=3)
    stereo = MultiViewStereo(PatchMatch(sweeps=(1,), device="cpu"))
    first = stereo(geometry, tmp_path, silent)
    monkeypatch.setattr(devices, "cuda_available", lambda: True)  # would fail: nothing is there
    other = MultiViewStereo(PatchMatch(sweeps=(1,), device="cuda"))
    again = other(geometry, tmp_path, silent)
    for a, b in zip(first.views, again.views, strict=True):
        np.testing.assert_array_equal(a.depth, b.depth)
