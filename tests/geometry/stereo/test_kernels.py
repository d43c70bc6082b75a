"""The kernels, in numba and in PyTorch, against their NumPy twins, on small random inputs."""

from typing import Any

import numpy as np
import pytest
import torch

from scenediff_classic.geometry.stereo import kernels, kernels_reference, kernels_torch
from scenediff_classic.geometry.stereo.devices import Kernels, compiled, in_torch
from scenediff_classic.geometry.stereo.patchmatch import OFFSETS
from scenediff_classic.geometry.stereo.pyramid import Pictures
from scenediff_classic.geometry.stereo.windows import Windows, prepare_windows
from tests.geometry.stereo.torch_devices import TORCH_DEVICES

RULES = kernels.Rules(
    radius=3, best=2, w_min=np.float32(0.2), w_max=np.float32(1.0), min_cosine=np.float32(0.1),
    cap=np.float32(0.8), consistency=np.float32(0.0), tolerance=np.float32(2.0),
    parallax=np.float32(0.05),
)  # fmt: skip
CONSISTENT = RULES._replace(consistency=np.float32(0.3))
GREY_SIGMA = 0.15


@pytest.fixture(params=["numba", *TORCH_DEVICES])
def fast(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Kernels:
    """The kernels of each implementation; PyTorch's in several chunks."""
    monkeypatch.setattr(kernels_torch, "AT_ONCE", 5000)
    return compiled() if request.param == "numba" else in_torch(request.param)


def random_pictures(seed: int, *, height: int = 14, width: int = 17) -> Pictures:
    """Three sources of different sizes, moderate rotations, one ignored pixel in each picture."""
    rng = np.random.default_rng(seed)
    sizes = np.array([[14, 17], [12, 19], [15, 15]], np.int32)
    sources = rng.uniform(0, 1, (3, 16, 20)).astype(np.float32)
    reference = rng.uniform(0, 1, (height, width)).astype(np.float32)
    reference[3, 4] = np.nan
    sources[0, 7, 7] = np.nan
    reference[9:, 10:] = 0.5  # a textureless corner
    warps = np.concatenate([np.eye(3), np.zeros((3, 1))], axis=1)[None].repeat(3, 0)
    warps[:, :, :3] += rng.normal(0, [[0.02, 0.02, 0.5], [0.02, 0.02, 0.5], [1e-3, 1e-3, 0.02]],
                                  (3, 3, 3))  # fmt: skip
    warps[:, :2, 3] = rng.normal(0, 6, (3, 2))
    warps[:, 2, 3] = rng.normal(0, 0.2, 3)
    camera = np.array([15.0, 16.0, width / 2, height / 2], np.float32)
    returns = np.stack([back(warp) for warp in warps]).astype(np.float32)
    depths = rng.uniform(0.2, 1.0, sources.shape).astype(np.float32)
    depths[:, 4:6] = 0  # unknown
    return Pictures(reference, sources, sizes, warps.astype(np.float32), depths, returns, camera)


def back(warp: np.ndarray) -> np.ndarray:
    """The map that undoes another one: x = A' y + b' w with the inverse depth seen from there."""
    inverse = np.linalg.inv(warp[:, :3])
    return np.c_[inverse, -inverse @ warp[:, 3]]


def windows_of(pictures: Pictures) -> Windows:
    return prepare_windows(pictures.reference, RULES.radius, GREY_SIGMA)


def on_device(fast: Kernels, pictures: Pictures) -> tuple[Any, Any]:
    """Pictures and their windows, as the kernels want them."""
    loaded = fast.load(pictures)
    return loaded, fast.prepare_windows(loaded.reference, RULES.radius, GREY_SIGMA)


def random_planes(seed: int, shape: tuple[int, int]) -> np.ndarray:
    rng = np.random.default_rng([seed, 1])
    planes = np.stack([rng.uniform(0.2, 1.0, shape), *rng.normal(0, 0.01, (2, *shape))], -1)
    return planes.astype(np.float32)


def test_random_numbers_equal_the_twin_and_are_even() -> None:
    arguments = [(s, p, d) for s in (0, 7, 2**31 - 1) for p in (0, 1, 999_999) for d in range(9)]
    plain = [kernels_reference.random_unit(*a) for a in arguments]
    assert [float(kernels.random_unit(*a)) for a in arguments] == plain
    in_torch = [kernels_torch.random_unit(s, torch.tensor([p]), d) for s, p, d in arguments]
    assert [float(x) for x in in_torch] == plain
    many = np.array([kernels_reference.random_unit(3, p, 2) for p in range(4000)])
    counts = np.histogram(many, bins=10, range=(0, 1))[0]
    assert np.abs(counts - 400).max() < 5 * 20  # 5 standard deviations of a binomial
    assert abs(np.corrcoef(many[:-1], many[1:])[0, 1]) < 0.06


@pytest.mark.parametrize("seed", range(2))
def test_windows_equal_the_twin(fast: Kernels, seed: int) -> None:
    pictures = random_pictures(seed)
    reference = pictures.reference
    on_device = fast.prepare_windows(fast.load(pictures).reference, 3, GREY_SIGMA)
    windows = Windows(*(np.asarray(torch.as_tensor(array).cpu()) for array in on_device))
    for row, col in np.ndindex(reference.shape):
        weights, weighted, variance = kernels_reference.load_window(
            reference, row, col, 3, GREY_SIGMA
        )
        if variance >= 0:
            np.testing.assert_allclose(windows.weights[row, col], weights, atol=1e-5)
            np.testing.assert_allclose(windows.weighted[row, col], weighted, atol=1e-5)
        np.testing.assert_allclose(windows.variance[row, col], variance, atol=1e-5)
    assert windows.variance[3, 4] == -1


def test_falloff_is_close_to_the_exponential() -> None:
    x = np.linspace(0, 20, 200)
    assert np.abs(kernels_reference.falloff(x) - np.exp(-x)).max() < 0.04


@pytest.mark.parametrize("rules", [RULES, CONSISTENT])
@pytest.mark.parametrize("seed", range(3))
def test_cost_of_planes_equals_the_twin(fast: Kernels, seed: int, rules: kernels.Rules) -> None:
    pictures = random_pictures(seed)
    planes = random_planes(seed, pictures.reference.shape)
    costs = np.empty(pictures.reference.shape, np.float32)
    plain = np.empty_like(costs)
    fast.score_planes(*on_device(fast, pictures), rules, planes, costs)
    kernels_reference.score_planes(pictures, windows_of(pictures), rules, planes, plain)
    # where a point falls on a pixel's rim, rounding may look up the depth of the next one
    assert np.mean(np.abs(costs - plain) < 2e-4) > 0.98
    worst = rules.cap + rules.consistency
    assert 0.2 < np.mean(plain < worst - 1e-6) < 1.0  # both kinds occur


@pytest.mark.parametrize(
    ("seed", "colour", "explore", "rules"),
    [(0, 0, 1, RULES), (1, 1, 0, RULES), (2, 0, 2, RULES), (3, 1, 0, CONSISTENT)],
)
def test_sweep_equals_the_twin(
    fast: Kernels, seed: int, colour: int, explore: int, rules: kernels.Rules
) -> None:
    pictures = random_pictures(seed)
    windows = windows_of(pictures)
    settled = np.random.default_rng(seed).uniform(size=pictures.reference.shape) < 0.2
    planes = random_planes(seed, pictures.reference.shape)
    costs = np.empty(pictures.reference.shape, np.float32)
    kernels_reference.score_planes(pictures, windows, rules, planes, costs)
    results = []
    inputs = on_device(fast, pictures), (pictures, windows)
    for sweep, given in zip((fast.sweep, kernels_reference.sweep), inputs, strict=True):
        state = planes.copy(), costs.copy()
        sweep(*given, rules, *state, settled, OFFSETS, colour, np.float32(2.0), explore, 11 + seed)
        results.append(state)
    (found, found_costs), (plain_planes, plain_costs) = results
    # Rounding may decide a near tie between two planes the other way: in few pixels, at no cost.
    same = np.isclose(found, plain_planes, rtol=1e-4, atol=1e-5).all(axis=-1)
    assert same.mean() > 0.97
    np.testing.assert_allclose(found_costs, plain_costs, atol=3e-3)
    rows, cols = np.indices(costs.shape)
    still = ((rows + cols) % 2 != colour) | settled
    assert np.array_equal(found[still], planes[still])  # those are only read
    assert np.all(found_costs <= costs + 1e-4)
    assert np.mean(found_costs < costs - 0.01) > 0.2


def test_planes_behind_a_source_are_not_seen_in_it(fast: Kernels) -> None:
    """Behind a camera, a point projects into its picture upside down."""
    pictures = random_pictures(0)
    pictures.warps[:] = [[1, 0, 0, -40], [0, 1, 0, -40], [0, 0, 1, -4]]
    planes = random_planes(0, pictures.reference.shape)
    rows, cols = np.indices(pictures.reference.shape) + 0.5
    w = planes[..., 0]
    z = 1 - 4 * w
    in_sight = [((x - 40 * w) / z >= 0) & ((x - 40 * w) / z < 12) for x in (rows, cols)]
    behind = (z < 0) & in_sight[0] & in_sight[1]
    costs = np.empty(behind.shape, np.float32)
    fast.score_planes(*on_device(fast, pictures), RULES, planes, costs)
    assert behind.sum() > 50
    assert np.all(costs[behind] == RULES.cap)


def test_pixels_without_texture_take_over_the_cheapest_plane(fast: Kernels) -> None:
    pictures = random_pictures(0)
    pictures.reference[4:, 6:] = 0.5
    planes = random_planes(0, pictures.reference.shape)
    costs = np.empty(pictures.reference.shape, np.float32)
    windows = windows_of(pictures)
    kernels_reference.score_planes(pictures, windows, RULES, planes, costs)
    plain = planes.copy(), costs.copy()
    found = planes.copy(), costs.copy()
    settled = np.zeros(costs.shape, bool)
    for sweep, given, state in (
        (kernels_reference.sweep, (pictures, windows), plain),
        (fast.sweep, on_device(fast, pictures), found),
    ):
        sweep(*given, RULES, *state, settled, OFFSETS, 0, np.float32(1.0), 0, 3)
    empty = ~(windows.variance > kernels.MIN_VARIANCE)
    np.testing.assert_allclose(found[0][empty], plain[0][empty], rtol=1e-5, atol=1e-6)
    assert np.array_equal(found[1][empty], costs[empty])
    assert np.mean(np.any(found[0] != planes, axis=-1)[empty]) > 0.2


def test_smoothing_equals_the_twin(fast: Kernels) -> None:
    pictures = random_pictures(5)
    planes = random_planes(5, pictures.reference.shape)
    costs = np.random.default_rng(5).uniform(0, 1, pictures.reference.shape).astype(np.float32)
    costs[:, :3] = 1.0  # worthless: does not count
    smoothed, plain = np.empty_like(planes), np.empty_like(planes)
    reference = fast.load(pictures).reference
    fast.smooth_planes(reference, planes, costs, 3, 3, np.float32(10.0), smoothed)
    kernels_reference.smooth_planes(
        pictures.reference, planes, costs, 3, 3, np.float32(10.0), plain
    )
    np.testing.assert_allclose(smoothed, plain, rtol=1e-5, atol=1e-6)
    assert np.mean(smoothed != planes) > 0.5


def test_smoothing_keeps_planes_and_steps_and_drops_outliers(fast: Kernels) -> None:
    """Planes that meet at a grey-value edge stay exact; a wrong pixel takes its side's plane."""
    rows, cols = np.mgrid[0:20, 0:20].astype(np.float32)
    left = cols < 10
    planes = np.stack(
        [np.where(left, 1 + 0.02 * cols, 2 - 0.01 * rows),
         np.where(left, 0.02, 0.0), np.where(left, 0.0, -0.01)], axis=-1,
    ).astype(np.float32)  # fmt: skip
    truth = planes.copy()
    planes[10, 8] = 5.0, 0.3, 0.3
    grey = np.where(left, 0.2, 0.8).astype(np.float32)
    smoothed = np.empty_like(planes)
    costs = np.full((20, 20), 0.1, np.float32)
    grey = fast.load(random_pictures(0)._replace(reference=grey)).reference
    fast.smooth_planes(grey, planes, costs, 6, 3, np.float32(100.0), smoothed)
    np.testing.assert_allclose(smoothed, truth, rtol=1e-5)


def test_offsets_lead_to_the_other_colour() -> None:
    assert np.all(np.abs(OFFSETS).sum(axis=-1) % 2 == 1)
    assert len(np.unique(OFFSETS[:, 0], axis=0)) == 8


def test_cost_of_a_pure_shift_by_hand(fast: Kernels) -> None:
    """Source = reference moved right by 3 pixels: the plane with that parallax costs nothing."""
    rng = np.random.default_rng(0)
    texture = rng.uniform(0, 1, (20, 30)).astype(np.float32)
    reference, source = texture[:, 3:27], np.pad(texture[:, :24], [(0, 1), (0, 1)], mode="edge")
    warp = np.array([[[1, 0, 0, 6.0], [0, 1, 0, 0], [0, 0, 1, 0]]], np.float32)
    pictures = Pictures(
        np.ascontiguousarray(reference), source[None],
        np.array([[20, 24]], np.int32), warp, np.zeros((1, 1, 1), np.float32), warp,
        np.array([20, 20, 12, 10], np.float32),
    )  # fmt: skip
    given = on_device(fast, pictures)
    planes = np.zeros((20, 24, 3), np.float32)
    planes[..., 0] = 0.5  # times b = 6: three pixels
    costs = np.empty((20, 24), np.float32)
    fast.score_planes(*given, RULES, planes, costs)
    assert np.abs(costs[3:-3, 3:-6]).max() < 1e-4
    assert np.all(costs[:, -3:] == RULES.cap)  # the source ends there
    planes[..., 0] = 0.7
    fast.score_planes(*given, RULES, planes, costs)
    assert costs[3:-3, 3:-6].mean() > 0.5
