"""The compiled kernels once more, as plain NumPy in double precision: to read, and to test them.

Every function stands for the one of the same name in `kernels` or `smoothing`. One pixel at
a time and no care for speed.
"""

import numpy as np

from scenediff_classic.geometry.kernels import MIN_VARIANCE, UNSEEN, Rules
from scenediff_classic.geometry.pyramid import Pictures

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


def window(rules: Rules) -> tuple[np.ndarray, np.ndarray]:
    """(dx, dy) of the window's samples, row by row."""
    steps = np.arange(-rules.radius, rules.radius + 1, rules.stride)
    dy, dx = np.meshgrid(steps, steps, indexing="ij")
    return dx.ravel(), dy.ravel()


def load_patch(
    reference: np.ndarray, row: int, col: int, rules: Rules
) -> tuple[np.ndarray, np.ndarray, float]:
    """Bilateral weights (sum 1), weight times centred grey value, weighted variance."""
    dx, dy = window(rules)
    height, width = reference.shape
    centre = float(reference[row, col])
    rows, cols = np.clip(row + dy, 0, height - 1), np.clip(col + dx, 0, width - 1)
    values = reference[rows, cols].astype(float)
    known = ~np.isnan(values)
    if np.isnan(centre):
        return np.zeros(len(dx)), np.zeros(len(dx)), -1.0
    values = np.where(known, values, 0.0)
    weights = np.exp(-((values - centre) ** 2) * rules.sharpness - (dx**2 + dy**2) * rules.nearness)
    weights = np.where(known, weights, 0.0)
    weights /= weights.sum()
    centred = values - np.sum(weights * values)
    return weights, weights * centred, float(np.sum(weights * centred**2))


def source_cost(
    pictures: Pictures, source: int, x: float, y: float, plane: Plane, rules: Rules,
    weights: np.ndarray, weighted: np.ndarray, variance: float,
) -> float:  # fmt: skip
    """1 - bilaterally weighted NCC of the patch around (x, y), under a plane, in one source."""
    w, gx, gy = plane
    dx, dy = window(rules)
    warp = pictures.warps[source].astype(float)
    height, width = pictures.sizes[source]
    pixels = np.stack([x + dx, y + dy, np.ones(len(dx)), w + gx * dx + gy * dy])
    u, v, z = warp @ pixels
    centre_u, centre_v, centre_z = warp @ np.array([x, y, 1.0, w])
    slope = np.abs(warp[2, :2] + warp[2, 3] * np.array([gx, gy])).sum()
    if centre_z - rules.radius * slope <= 0:
        return float(UNSEEN)
    if not (0 <= centre_u < width * centre_z and 0 <= centre_v < height * centre_z):
        return float(UNSEEN)
    image = pictures.sources[source, :height, :width].astype(float)
    values = bilinear(image, u / z - 0.5, v / z - 0.5)
    mean = np.sum(weights * values)
    spread = np.sum(weights * values**2) - mean**2
    if not spread > MIN_VARIANCE:
        return float(UNSEEN)
    cost = 1 - np.sum(weighted * values) / np.sqrt(spread * variance)
    return min(float(cost), float(UNSEEN))


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
    pictures: Pictures, row: int, col: int, plane: Plane, rules: Rules
) -> tuple[np.ndarray, float]:
    """Sources sorted by the cost of a plane in them, and its mean over the best few."""
    weights, weighted, variance = load_patch(pictures.reference, row, col, rules)
    count = len(pictures.sources)
    if not variance > MIN_VARIANCE:
        return np.arange(count), float(UNSEEN)
    costs = np.array(
        [
            source_cost(
                pictures, s, col + 0.5, row + 0.5, plane, rules, weights, weighted, variance
            )
            for s in range(count)
        ]
    )
    order = np.argsort(costs, kind="stable")
    return order, float(np.mean(costs[order[: rules.best]]))


def plane_cost(
    pictures: Pictures, row: int, col: int, plane: Plane, order: np.ndarray, rules: Rules
) -> float:
    """Mean cost of a plane over the first few sources of `order`."""
    patch = load_patch(pictures.reference, row, col, rules)
    costs = [
        source_cost(pictures, s, col + 0.5, row + 0.5, plane, rules, *patch)
        for s in order[: rules.best].tolist()
    ]
    return float(np.mean(costs))


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


def score_planes(pictures: Pictures, rules: Rules, planes: np.ndarray, costs: np.ndarray) -> None:
    """Fill `costs` (h, w) with the cost of every pixel's own plane in `planes` (h, w, 3)."""
    for row, col in np.ndindex(*costs.shape):
        _, costs[row, col] = rank_sources(
            pictures, row, col, tuple(planes[row, col].tolist()), rules
        )


def sweep(
    pictures: Pictures, rules: Rules, planes: np.ndarray, costs: np.ndarray, offsets: np.ndarray,
    colour: int, amplitude: Number, explore: int, seed: int,
) -> None:  # fmt: skip
    """Improve in place the planes of one colour of the checkerboard."""
    height, width = costs.shape
    for row, col in np.ndindex(height, width):
        if (row + col) % 2 != colour:
            continue
        handed = neighbour_planes(planes, costs, offsets, row, col)
        if not load_patch(pictures.reference, row, col, rules)[2] > MIN_VARIANCE:
            adopt_best_neighbour(planes, handed, pictures.camera, row, col, rules)
            continue
        plane: Plane = tuple(planes[row, col].tolist())
        order, cost = rank_sources(pictures, row, col, plane, rules)
        state = plane, cost
        for plane, _ in handed:
            if not same_plane(plane, state[0], rules):
                state = better_of(state, plane, pictures, row, col, order, rules)
        for trial in range(explore + 3):
            r = [random_unit(seed, row * width + col, 3 * trial + i) for i in range(3)]
            plane = varied(state[0], trial - explore, r, amplitude, rules)
            state = better_of(state, plane, pictures, row, col, order, rules)
        planes[row, col], costs[row, col] = state


def better_of(
    state: tuple[Plane, float], plane: Plane, pictures: Pictures, row: int, col: int,
    order: np.ndarray, rules: Rules,
) -> tuple[Plane, float]:  # fmt: skip
    """The plane with the lower cost, and that cost; the old one on a tie."""
    if not allowed(pictures.camera, col + 0.5, row + 0.5, plane, rules):
        return state
    cost = plane_cost(pictures, row, col, plane, order, rules)
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
    planes: np.ndarray, handed: list[tuple[Plane, float]], camera: np.ndarray,
    row: int, col: int, rules: Rules,
) -> None:  # fmt: skip
    """Give a pixel that cannot be matched the plane of its cheapest neighbour; cost stays."""
    matched = [
        (cost, i)
        for i, (plane, cost) in enumerate(handed)
        if cost < UNSEEN and allowed(camera, col + 0.5, row + 0.5, plane, rules)
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
                np.exp(-((grey[i] - grey[row, col]) ** 2) * sharpness) * (1 - costs[i]) ** 2
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
