"""The compiled kernels once more, as plain NumPy in double precision: to read, and to test them.

Every function stands for the one of the same name in `kernels`, `windows` or `smoothing`, and in
`kernels_torch` or `costs_torch`. One pixel at a time and no care for speed.
"""

import numpy as np

from scenediff_classic.geometry.stereo.kernels import MIN_VARIANCE, UNSEEN, Rules
from scenediff_classic.geometry.stereo.pyramid import Pictures
from scenediff_classic.geometry.stereo.windows import Windows, window

Plane = tuple[float, float, float]
Number = float | np.float32


def random_unit(seed: int, pixel: int, draw: int) -> float:
    """A well-mixed 32-bit hash of the arguments, its upper 24 bits as a fraction."""
    mask = 0xFFFFFFFF
    x = (seed * 0x9E3779B1 + pixel) & mask
    x = (x * 0x85EBCA6B + draw) & mask
    for _ in range(2):
        x ^= x >> 16
        x = (x * 0x45D9F3B) & mask
    x ^= x >> 16
    return (x >> 8) / 2**24


def falloff(x: np.ndarray) -> np.ndarray:
    """Close to exp(-x)."""
    return np.maximum(1 - x / 8, 0) ** 8


def load_window(
    reference: np.ndarray, row: int, col: int, radius: int, grey_sigma: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """One pixel of `prepare_windows`: weights (sum 1), weight times centred value, variance."""
    dx, dy = (a.astype(int) for a in window(radius))
    height, width = reference.shape
    centre = float(reference[row, col])
    rows, cols = np.clip(row + dy, 0, height - 1), np.clip(col + dx, 0, width - 1)
    values = reference[rows, cols].astype(float) - centre
    known = ~np.isnan(values)
    values = np.where(known, values, 0.0)
    contrast = values**2 / (2 * grey_sigma**2)
    weights = np.where(known, falloff(contrast + (dx**2 + dy**2) / (2 * radius**2)), 0.0)
    weights /= max(weights.sum(), 1e-30)
    centred = values - np.sum(weights * values)
    variance = float(np.sum(weights * centred**2))
    return weights, weights * centred, -1.0 if np.isnan(centre) else variance


def source_cost(
    source: int, pictures: Pictures, windows: Windows, rules: Rules, row: int, col: int,
    plane: Plane,
) -> float:  # fmt: skip
    """1 - bilaterally weighted NCC of the window of a pixel, under a plane, in one source."""
    w, gx, gy = plane
    x, y = col + 0.5, row + 0.5
    dx, dy = windows.dx.astype(float), windows.dy.astype(float)
    weights, weighted = windows.weights[row, col], windows.weighted[row, col]
    warp = pictures.warps[source].astype(float)
    height, width = pictures.sizes[source]
    centre = warp @ np.array([x, y, 1.0, w])
    # columns: change of the homogeneous source position per pixel right and down
    slopes = warp[:, :2] + warp[:, 3:] * np.array([gx, gy])
    if centre[2] - rules.radius * np.abs(slopes[2]).sum() <= 0:
        return float(UNSEEN)
    position = centre[:2] / centre[2]
    if not (0 <= position[0] < width and 0 <= position[1] < height):
        return float(UNSEEN)
    jacobian = (slopes[:2] - position[:, None] * slopes[2]) / centre[2]
    u, v = position[:, None] + jacobian @ np.stack([dx, dy])
    image = pictures.sources[source, :height, :width].astype(float)
    values = bilinear(image, u - 0.5, v - 0.5) - float(pictures.reference[row, col])
    mean = np.sum(weights * values)
    spread = np.sum(weights * values**2) - mean**2
    if not spread > MIN_VARIANCE:
        return float(UNSEEN)
    cost = 1 - np.sum(weighted * values) / np.sqrt(spread * windows.variance[row, col])
    return min(float(cost), float(UNSEEN))


def disagreement(
    source: int, pictures: Pictures, rules: Rules, row: int, col: int, w: float
) -> float:
    """Forward-backward error of a depth against a source's own one, as a share of tolerance."""
    there = pictures.warps[source].astype(float) @ np.array([col + 0.5, row + 0.5, 1.0, w])
    u, v = there[:2] / there[2]
    height, width = pictures.sizes[source]
    if not (0 <= u < width and 0 <= v < height):
        return 1.0
    found = float(pictures.depths[source, int(v), int(u)])
    if not found > 0:
        return 1.0
    back = pictures.returns[source].astype(float) @ np.array([u, v, 1.0, found])
    error = np.hypot(back[0] / back[2] - col - 0.5, back[1] / back[2] - row - 0.5)
    return min(float(error / rules.tolerance), 1.0)


def cost_in(
    source: int, pictures: Pictures, windows: Windows, rules: Rules, row: int, col: int,
    plane: Plane,
) -> float:  # fmt: skip
    """Cost of a plane in one source: how unlike it looks there, and what its depth there says."""
    cost = float(rules.cap)
    if windows.variance[row, col] > MIN_VARIANCE:
        cost = min(source_cost(source, pictures, windows, rules, row, col, plane), cost)
    if rules.consistency > 0:
        contradicted = disagreement(source, pictures, rules, row, col, plane[0])
        cost += float(rules.consistency) * contradicted
    return cost


def bilinear(image: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Values at array coordinates (column u, row v), held constant beyond the picture's rim."""
    height, width = image.shape
    u, v = np.clip(u, 0, width - 1), np.clip(v, 0, height - 1)
    left, top = u.astype(int), v.astype(int)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    fu, fv = u - left, v - top
    upper = (1 - fu) * image[top, left] + fu * image[top, right]
    lower = (1 - fu) * image[bottom, left] + fu * image[bottom, right]
    return (1 - fv) * upper + fv * lower


def rank_sources(
    pictures: Pictures, windows: Windows, rules: Rules, row: int, col: int, plane: Plane
) -> tuple[np.ndarray, float]:
    """Sources sorted by the cost of a plane in them, and its mean over the best few."""
    costs = np.array(
        [
            cost_in(s, pictures, windows, rules, row, col, plane)
            for s in range(len(pictures.sources))
        ]
    )
    order = np.argsort(costs, kind="stable")
    return order, float(np.mean(costs[order[: rules.best]]))


def plane_cost(
    pictures: Pictures, windows: Windows, rules: Rules, row: int, col: int, plane: Plane,
    order: np.ndarray,
) -> float:  # fmt: skip
    """Mean cost of a plane over the first few sources of `order`."""
    best = order[: rules.best].tolist()
    return float(np.mean([cost_in(s, pictures, windows, rules, row, col, plane) for s in best]))


def allowed(camera: np.ndarray, x: float, y: float, plane: Plane, rules: Rules) -> bool:
    """True for a plane inside the depth range that is not seen too edge-on."""
    w, gx, gy = plane
    if not rules.w_min <= w <= rules.w_max:
        return False
    fx, fy, cx, cy = camera.astype(float)
    ray = np.array([(x - cx) / fx, (y - cy) / fy, 1.0])
    normal = np.array([gx * fx, gy * fy, w - gx * fx * ray[0] - gy * fy * ray[1]])
    cosine = normal @ ray / (np.linalg.norm(normal) * np.linalg.norm(ray))
    return bool(cosine >= rules.min_cosine)


def score_planes(
    pictures: Pictures, windows: Windows, rules: Rules, planes: np.ndarray, costs: np.ndarray
) -> None:
    """Fill `costs` (h, w) with the cost of every pixel's own plane in `planes` (h, w, 3)."""
    for row, col in np.ndindex(*costs.shape):
        _, costs[row, col] = rank_sources(
            pictures, windows, rules, row, col, tuple(planes[row, col].tolist())
        )


def sweep(
    pictures: Pictures, windows: Windows, rules: Rules, planes: np.ndarray, costs: np.ndarray,
    settled: np.ndarray, offsets: np.ndarray, colour: int, amplitude: Number, explore: int,
    seed: int,
) -> None:  # fmt: skip
    """Improve in place the planes of one colour of the checkerboard."""
    height, width = costs.shape
    for row, col in np.ndindex(height, width):
        if (row + col) % 2 != colour or settled[row, col]:
            continue
        handed = neighbour_planes(planes, costs, offsets, row, col)
        if not windows.variance[row, col] > MIN_VARIANCE:
            adopt_best_neighbour(planes, costs, handed, pictures.camera, row, col, rules)
            continue
        plane: Plane = tuple(planes[row, col].tolist())
        order, cost = rank_sources(pictures, windows, rules, row, col, plane)
        state = plane, cost
        for plane, _ in handed:
            if not same_plane(plane, state[0], rules):
                state = better_of(state, plane, pictures, windows, rules, row, col, order)
        for trial in range(explore + 3):
            r = [random_unit(seed, row * width + col, 3 * trial + i) for i in range(3)]
            plane = varied(state[0], trial - explore, r, amplitude, rules)
            state = better_of(state, plane, pictures, windows, rules, row, col, order)
        planes[row, col], costs[row, col] = state


def better_of(
    state: tuple[Plane, float], plane: Plane, pictures: Pictures, windows: Windows, rules: Rules,
    row: int, col: int, order: np.ndarray,
) -> tuple[Plane, float]:  # fmt: skip
    """The plane with the lower cost, and that cost; the old one on a tie."""
    if not allowed(pictures.camera, col + 0.5, row + 0.5, plane, rules):
        return state
    cost = plane_cost(pictures, windows, rules, row, col, plane, order)
    return (plane, cost) if cost < state[1] else state


def same_plane(plane: Plane, other: Plane, rules: Rules) -> bool:
    """True if two planes move no sample of the window by more than 0.02 pixels of parallax."""
    change = np.abs(np.subtract(plane, other))
    return bool(change[0] + rules.radius * (change[1] + change[2]) < 0.02 * rules.parallax)


def varied(plane: Plane, kind: int, r: list[float], amplitude: Number, rules: Rules) -> Plane:
    """A random variation: below 0 any depth, 0 depth only, 1 slope only, 2 both."""
    w, gx, gy = plane
    if kind < 0:
        new = float(rules.w_min + (rules.w_max - rules.w_min) * r[0])
        return new, gx * new / w, gy * new / w
    step = float(amplitude * rules.parallax)
    if kind != 1:
        w += step * (2 * r[0] - 1)
    if kind != 0:
        gx += step / rules.radius * (2 * r[1] - 1)
        gy += step / rules.radius * (2 * r[2] - 1)
    return w, gx, gy


def neighbour_planes(
    planes: np.ndarray, costs: np.ndarray, offsets: np.ndarray, row: int, col: int
) -> list[tuple[Plane, float]]:
    """The cheapest neighbour's plane of each group, extended to the pixel, and its cost."""
    height, width = costs.shape
    handed = []
    for group in offsets:
        cells = [(row + r, col + c) for r, c in group]
        cells = [(r, c) for r, c in cells if 0 <= r < height and 0 <= c < width]
        if cells:
            r, c = min(cells, key=lambda cell: costs[cell])
            w, gx, gy = planes[r, c].tolist()
            handed.append(((w + gx * (col - c) + gy * (row - r), gx, gy), float(costs[r, c])))
    return handed


def adopt_best_neighbour(
    planes: np.ndarray, costs: np.ndarray, handed: list[tuple[Plane, float]],
    camera: np.ndarray, row: int, col: int, rules: Rules,
) -> None:  # fmt: skip
    """Give a pixel that cannot be matched the plane of its cheapest neighbour; cost stays."""
    matched = [
        (cost, i)
        for i, (plane, cost) in enumerate(handed)
        if cost < costs[row, col] and allowed(camera, col + 0.5, row + 0.5, plane, rules)
    ]
    if matched:
        planes[row, col] = handed[min(matched)[1]][0]


def smooth_planes(
    grey: np.ndarray, planes: np.ndarray, costs: np.ndarray, radius: int, stride: int,
    sharpness: Number, smoothed: np.ndarray,
) -> None:  # fmt: skip
    """Fill `smoothed` with the plane that says the weighted median inverse depth at each pixel."""
    height, width = costs.shape
    steps = range(-radius, radius + 1, stride)
    for row, col in np.ndindex(height, width):
        cells = [(row + r, col + c) for r in steps for c in steps]
        cells = [(r, c) for r, c in cells if 0 <= r < height and 0 <= c < width]
        weights = np.array(
            [
                falloff((grey[i] - grey[row, col]) ** 2 * sharpness) * (1 - costs[i]) ** 2
                for i in cells
            ]
        )
        says = np.array([planes[r, c] @ [1, col - c, row - r] for r, c in cells])
        smoothed[row, col] = planes[row, col]
        counted = np.flatnonzero(weights > 0)
        ranked = counted[np.argsort(says[counted], kind="stable")]
        if not len(ranked):
            continue
        passed = np.cumsum(weights[ranked])
        chosen = ranked[np.flatnonzero(passed >= passed[-1] / 2)[0]]
        if says[chosen] > 0:
            smoothed[row, col] = says[chosen], *planes[cells[chosen]][1:]
