"""The kernels of PatchMatch once more, in PyTorch: all pixels of a colour at once, for CUDA.

Every function stands for the one of the same name in `kernels_reference`, which is the one to
read. Planes and costs come and go as NumPy arrays, and are changed in place; pictures and windows
stay on the device. All operations are deterministic and in float32. Sums are rounded in another
order than by numba, so that near ties may end the other way.
"""

from collections.abc import Iterator

import numpy as np
import torch
from jaxtyping import Bool, Float32, Int64
from torch import Tensor

from scenediff_classic.geometry.stereo.costs_torch import (
    TEXTURE,
    LoadedPictures,
    LoadedWindows,
    Patches,
    PlainRules,
    allowed,
    cost_in,
    load,
    patches_at,
    rank_sources,
)
from scenediff_classic.geometry.stereo.kernels import Rules
from scenediff_classic.geometry.stereo.windows import window

Number = float | np.float32

__all__ = ["load", "prepare_windows", "random_unit", "score_planes", "smooth_planes", "sweep"]

AT_ONCE = 2**23
"""Samples (pixels, times sources, times samples of a window) on the device at once: 32 MiB each."""


def prepare_windows(
    reference: Float32[Tensor, "h w"], radius: int, grey_sigma: float
) -> LoadedWindows:
    """Windows of all pixels of a picture; see `windows.prepare_windows`."""
    device, (height, width) = reference.device, reference.shape
    dx, dy = (torch.tensor(steps, device=device) for steps in window(radius))
    distance = (dx * dx + dy * dy) * (0.5 / radius**2)
    flat = reference.flatten()
    weights = flat.new_empty(len(flat), len(dx))
    weighted, variance = torch.empty_like(weights), torch.empty_like(flat)
    for pixels in _chunks(torch.arange(len(flat), device=device), len(dx)):
        rows = (pixels[:, None] // width + dy.long()).clamp(0, height - 1)
        cols = (pixels[:, None] % width + dx.long()).clamp(0, width - 1)
        values = flat[rows * width + cols] - flat[pixels, None]
        known = ~values.isnan()
        values = torch.where(known, values, 0.0)
        weight = _falloff(values * values * (0.5 / grey_sigma**2) + distance) * known
        total = weight.sum(dim=1, keepdim=True)
        weight = torch.where(total > 0, weight / total, 0.0)
        centred = values - (weight * values).sum(dim=1, keepdim=True)
        weights[pixels], weighted[pixels] = weight, weight * centred
        variance[pixels] = (weight * centred * centred).sum(dim=1)
    variance = torch.where(reference.isnan(), -1.0, variance.reshape(height, width))
    weights, weighted = (a.reshape(height, width, -1) for a in (weights, weighted))
    return LoadedWindows(weights, weighted, variance, dx, dy)


def score_planes(
    pictures: LoadedPictures, windows: LoadedWindows, rules: Rules, planes: np.ndarray,
    costs: np.ndarray,
) -> None:  # fmt: skip
    """Fill `costs` (h, w) with the cost of every pixel's own plane in `planes` (h, w, 3)."""
    plain = PlainRules.of(rules)
    tried = _listed(planes, pictures)
    found = tried.new_empty(costs.size)
    for pixels in _chunks(torch.arange(costs.size, device=tried.device), _room(pictures, windows)):
        patches = patches_at(pixels, pictures, windows)
        found[pixels] = rank_sources(pictures, plain, patches, tried[pixels])[1]
    costs[...] = found.cpu().numpy().reshape(costs.shape)


def sweep(
    pictures: LoadedPictures, windows: LoadedWindows, rules: Rules, planes: np.ndarray,
    costs: np.ndarray, settled: np.ndarray, offsets: np.ndarray, colour: int, amplitude: Number,
    explore: int, seed: int,
) -> None:  # fmt: skip
    """Improve in place the planes of one colour of the checkerboard; see `kernels.sweep`."""
    plain = PlainRules.of(rules)
    before, at_cost = _listed(planes, pictures), _listed(costs, pictures)[:, 0]
    after, cost_after = before.clone(), at_cost.clone()
    steps = torch.tensor(offsets, device=before.device).long()
    rows, cols = np.indices(costs.shape)
    searched = ((rows + cols) % 2 == colour) & ~settled
    pixels = torch.tensor(np.flatnonzero(searched), device=before.device)
    textured = windows.variance.flatten()[pixels] > TEXTURE
    for chunk in _chunks(pixels[textured], _room(pictures, windows)):
        patches = patches_at(chunk, pictures, windows)
        handed, handed_cost = neighbour_planes(before, at_cost, steps, patches, costs.shape)
        after[chunk], cost_after[chunk] = _searched(
            pictures, plain, patches, before[chunk], handed, handed_cost.isfinite(),
            float(amplitude) * plain.parallax, explore, seed,
        )  # fmt: skip
    for chunk in _chunks(pixels[~textured], _room(pictures, windows)):
        patches = patches_at(chunk, pictures, windows)
        handed, handed_cost = neighbour_planes(before, at_cost, steps, patches, costs.shape)
        after[chunk] = adopt_best_neighbour(
            pictures, plain, patches, before[chunk], at_cost[chunk], handed, handed_cost
        )
    planes[...] = after.cpu().numpy().reshape(planes.shape)
    costs[...] = cost_after.cpu().numpy().reshape(costs.shape)


def _searched(
    pictures: LoadedPictures, rules: PlainRules, patches: Patches, planes: Float32[Tensor, "p 3"],
    handed: Float32[Tensor, "p groups 3"], given: Bool[Tensor, "p groups"], step: float,
    explore: int, seed: int,
) -> tuple[Float32[Tensor, "p 3"], Float32[Tensor, "p"]]:  # fmt: skip
    """The best planes after all hypotheses of a sweep, and their costs."""
    best, costs = rank_sources(pictures, rules, patches, planes)
    for group in range(handed.shape[1]):
        tried = handed[:, group]
        change = (tried - planes).abs()
        moved = change[:, 0] + rules.radius * (change[:, 1] + change[:, 2])
        worth = given[:, group] & ~(moved < 0.02 * rules.parallax)
        planes, costs = better_of(pictures, rules, patches, best, planes, costs, tried, worth)
    for trial in range(explore + 3):
        draws = [random_unit(seed, patches.index, 3 * trial + i) for i in range(3)]
        tried = varied(planes, trial - explore, draws, step, rules)
        worth = torch.ones_like(costs, dtype=torch.bool)
        planes, costs = better_of(pictures, rules, patches, best, planes, costs, tried, worth)
    return planes, costs


def better_of(
    pictures: LoadedPictures, rules: PlainRules, patches: Patches, best: Int64[Tensor, "p best"],
    planes: Float32[Tensor, "p 3"], costs: Float32[Tensor, "p"], tried: Float32[Tensor, "p 3"],
    worth: Bool[Tensor, "p"],
) -> tuple[Float32[Tensor, "p 3"], Float32[Tensor, "p"]]:  # fmt: skip
    """The planes with the lower cost, and that cost; the old ones on a tie or if not `worth`."""
    tried_costs = cost_in(best, pictures, rules, patches, tried).mean(dim=1)
    better = worth & allowed(pictures, rules, patches, tried) & (tried_costs < costs)
    return torch.where(better[:, None], tried, planes), torch.where(better, tried_costs, costs)


def varied(
    planes: Float32[Tensor, "p 3"], kind: int, draws: list[Tensor], step: float, rules: PlainRules
) -> Float32[Tensor, "p 3"]:
    """A random variation: below 0 any depth, 0 depth only, 1 slope only, 2 both."""
    w, gx, gy = planes.unbind(dim=1)
    if kind < 0:
        new = rules.w_min + (rules.w_max - rules.w_min) * draws[0]
        return torch.stack([new, gx * new / w, gy * new / w], dim=1)
    if kind != 1:
        w = w + step * (2 * draws[0] - 1)
    if kind != 0:
        gx = gx + step / rules.radius * (2 * draws[1] - 1)
        gy = gy + step / rules.radius * (2 * draws[2] - 1)
    return torch.stack([w, gx, gy], dim=1)


def random_unit(seed: int, pixels: Int64[Tensor, "p"], draw: int) -> Float32[Tensor, "p"]:
    """A well-mixed 32-bit hash of the arguments, its upper 24 bits as a fraction."""
    mask = 0xFFFFFFFF
    x = (seed * 0x9E3779B1 + pixels) & mask
    x = (x * (0x85EBCA6B - 2**32) + draw) & mask  # the same modulo 2^32, and fits into 63 bits
    for _ in range(2):
        x = x ^ (x >> 16)
        x = (x * 0x45D9F3B) & mask
    x = x ^ (x >> 16)
    return (x >> 8).float() * 2.0**-24


def neighbour_planes(
    planes: Float32[Tensor, "hw 3"], costs: Float32[Tensor, "hw"],
    offsets: Int64[Tensor, "groups n 2"], patches: Patches, shape: tuple[int, ...],
) -> tuple[Float32[Tensor, "p groups 3"], Float32[Tensor, "p groups"]]:  # fmt: skip
    """The cheapest neighbour's plane of each group, extended to the pixel, and its cost.

    The cost is infinite where all of a group lies outside the picture.
    """
    height, width = shape
    rows = patches.row[:, None, None] + offsets[..., 0]
    cols = patches.col[:, None, None] + offsets[..., 1]
    inside = (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)
    index = torch.where(inside, rows * width + cols, 0)
    ranked, order = torch.where(inside, costs[index], torch.inf).sort(dim=2, stable=True)
    index = index.gather(2, order)[..., 0]  # the first one on a tie, which argmin does not promise
    over, down = patches.col[:, None] - index % width, patches.row[:, None] - index // width
    w, gx, gy = planes[index].unbind(dim=2)
    return torch.stack([w + gx * over + gy * down, gx, gy], dim=2), ranked[..., 0]


def adopt_best_neighbour(
    pictures: LoadedPictures, rules: PlainRules, patches: Patches, planes: Float32[Tensor, "p 3"],
    costs: Float32[Tensor, "p"], handed: Float32[Tensor, "p groups 3"],
    handed_costs: Float32[Tensor, "p groups"],
) -> Float32[Tensor, "p 3"]:  # fmt: skip
    """The plane of the cheapest neighbour for pixels that cannot be matched."""
    for group in range(handed.shape[1]):
        tried, cost = handed[:, group], handed_costs[:, group]
        better = (cost < costs) & allowed(pictures, rules, patches, tried)
        planes = torch.where(better[:, None], tried, planes)
        costs = torch.where(better, cost, costs)
    return planes


def smooth_planes(
    grey: Float32[Tensor, "h w"], planes: np.ndarray, costs: np.ndarray, radius: int, stride: int,
    sharpness: Number, smoothed: np.ndarray,
) -> None:  # fmt: skip
    """Fill `smoothed` with the plane that says the weighted median inverse depth at each pixel."""
    device, (height, width) = grey.device, grey.shape
    flat = grey.flatten()
    given = torch.tensor(planes, device=device).reshape(-1, 3)
    match = 1 - torch.tensor(costs, device=device).flatten()
    steps = torch.arange(-radius, radius + 1, stride, device=device)
    down, over = (a.flatten() for a in torch.meshgrid(steps, steps, indexing="ij"))
    result = given.clone()
    for pixels in _chunks(torch.arange(len(flat), device=device), len(down)):
        rows, cols = pixels[:, None] // width + down, pixels[:, None] % width + over
        inside = (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)
        index = torch.where(inside, rows * width + cols, 0)
        contrast = flat[index] - flat[pixels, None]
        weights = _falloff(contrast * contrast * float(sharpness)) * match[index] * match[index]
        weights = torch.where(inside & (weights > 0), weights, 0.0)
        around = given[index]
        says = around[..., 0] - around[..., 1] * over - around[..., 2] * down
        says, order = torch.where(weights > 0, says, torch.inf).sort(dim=1, stable=True)
        middle = _middle(weights.gather(1, order))[:, None]
        w, chosen = says.gather(1, middle)[:, 0], index.gather(1, order.gather(1, middle))[:, 0]
        taken = torch.cat([w[:, None], given[chosen, 1:]], dim=1)
        known = (w > 0) & w.isfinite()  # infinite: no sample counts
        result[pixels] = torch.where(known[:, None], taken, given[pixels])
    smoothed[...] = result.cpu().numpy().reshape(smoothed.shape)


def _middle(weights: Float32[Tensor, "p k"]) -> Int64[Tensor, "p"]:
    """The first position at which half of all weight is passed, in ranked order."""
    half = weights.sum(dim=1) / 2
    passed = torch.zeros_like(half)
    middle = torch.zeros(len(weights), dtype=torch.int64, device=weights.device)
    for weight in weights.unbind(dim=1)[:-1]:  # CUDA's cumsum is not deterministic
        passed = passed + weight
        middle += passed < half
    return middle.minimum((weights > 0).sum(dim=1).clamp(min=1) - 1)


def _falloff(x: Tensor) -> Tensor:
    """Close to exp(-x)."""
    base = (1 - x / 8).clamp(min=0)
    base = base * base
    base = base * base
    return base * base


def _chunks(pixels: Int64[Tensor, "p"], each: int) -> Iterator[Int64[Tensor, "q"]]:
    """The pixels in parts that hold no more than `AT_ONCE` samples, `each` of them a pixel."""
    if len(pixels):
        yield from pixels.split(max(AT_ONCE // each, 1))


def _room(pictures: LoadedPictures, windows: LoadedWindows) -> int:
    """Samples that one pixel takes."""
    return len(pictures.sources) * len(windows.dx)


def _listed(array: np.ndarray, pictures: LoadedPictures) -> Float32[Tensor, "hw c"]:
    """A copy of the values of all pixels on the device, in row-major order."""
    height, width = pictures.reference.shape
    return torch.tensor(array, device=pictures.reference.device).reshape(height * width, -1)
