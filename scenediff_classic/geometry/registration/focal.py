"""Focal lengths of unknown cameras, told from matches alone: the start of structure from motion.

Two pictures fix their focal length up to noise, because of the two equal singular values that an
essential matrix must have (R. Hartley, "Estimation of relative camera positions for uncalibrated
cameras", 1992; S. Bougnoux, "From projective to Euclidean space under any practical situation",
1998). The closed forms fail where the optical axes meet, which is how people photograph a thing.
So each candidate is judged by how well the best essential matrix explains the matches themselves,
and pairs vote: one that cannot tell has a flat vote.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from scenediff_classic.geometry.registration.sparse_model import EpipolarPair

CANDIDATES = np.geomspace(0.3, 3.0, 24)
"""Focal lengths that are tried, as multiples of the longer side."""
USUAL, USUAL_SPREAD = 0.85, 0.45
"""Focal length of phones and small cameras without zoom, and its spread (natural logarithm). It
decides only where the matches cannot."""
PAIRS = 10
"""At most so many pairs vote, those with the most matches."""
MATCHES = 150
"""At most so many matches of a pair are looked at."""
MIN_MATCHES = 20
"""A pair with fewer does not vote."""
INFLATION = 8.0
"""Errors of one pair are not independent: its evidence counts this many times less."""
VETO = 4.0
"""Largest say of one pair, in units of the errors' variance."""
OWN = 6.0
"""What a camera's own pairs must gain to give it another focal length than the rest."""


def vote_focal(
    pairs: Sequence[EpipolarPair], known: Mapping[int, float], cameras: Sequence[int]
) -> dict[int, float]:
    """Focal length of each unknown camera, as a multiple of its picture's longer side.

    Parameters
    ----------
    pairs : sequence of EpipolarPair
        Verified pairs with their fundamental matrices.
    known : mapping
        Focal lengths that are known, by camera.
    cameras : sequence of int
        All cameras.
    """
    unknown = [camera for camera in cameras if camera not in known]
    telling = [p for p in pairs if p.cameras[0] not in known or p.cameras[1] not in known]
    common = _votes(telling, known)
    found = {camera: _lowest(common) for camera in unknown}
    if len(unknown) > 1:
        for camera in unknown:
            own = [p for p in telling if p.cameras == (camera, camera)]
            votes = _votes(own, known)
            best = _lowest(votes)
            here = float(np.interp(np.log(found[camera]), np.log(CANDIDATES), votes))
            if here - votes.min() >= OWN:
                found[camera] = best
    return found


def _votes(pairs: Sequence[EpipolarPair], known: Mapping[int, float]) -> Float64[np.ndarray, "c"]:
    """What speaks against each candidate."""
    total = (np.log(CANDIDATES / USUAL) / USUAL_SPREAD) ** 2
    enough = [p for p in pairs if len(p.first) >= MIN_MATCHES]
    for pair in sorted(enough, key=lambda p: -len(p.first))[:PAIRS]:
        against = _misfit(pair, known)
        total += np.minimum((against - against.min()) / INFLATION, VETO)
    return total


def _lowest(votes: Float64[np.ndarray, "c"]) -> float:
    """The best candidate, between the steps."""
    best = int(votes.argmin())
    if not 0 < best < len(votes) - 1:
        return float(CANDIDATES[best])
    left, here, right = votes[best - 1 : best + 2]
    bend = left - 2 * here + right
    shift = 0.0 if bend <= 0 else 0.5 * (left - right) / bend
    step = np.log(CANDIDATES[1] / CANDIDATES[0])
    return float(CANDIDATES[best] * np.exp(step * np.clip(shift, -0.5, 0.5)))


def _misfit(pair: EpipolarPair, known: Mapping[int, float]) -> Float64[np.ndarray, "c"]:
    """Robust error of the best essential matrix for each candidate, in units of the variance."""
    keep = np.linspace(0, len(pair.first) - 1, min(len(pair.first), MATCHES)).astype(int)
    first, second = _homogeneous(pair.first[keep]), _homogeneous(pair.second[keep])
    noise = np.median(np.abs(_sampson(pair.fundamental, first, second))) / 0.6745
    scale = 2 * max(noise, pair.pixel / 5)
    lenses = [
        (_lens(known.get(pair.cameras[0], c)), _lens(known.get(pair.cameras[1], c)))
        for c in CANDIDATES.tolist()
    ]
    poses = [_pose(two[:, None] * pair.fundamental * one) for one, two in lenses]
    costs = np.full(len(CANDIDATES), np.inf)
    # a start that is far off ends beside the best: begin once more where the neighbours ended
    count = len(CANDIDATES)
    for order, back in ((range(count), 1), (range(count), 1), (range(count - 2, -1, -1), -1)):
        for k in order:
            neighbour = k - back
            fresh = not np.isfinite(costs[k])
            start = poses[k] if fresh or not 0 <= neighbour < count else poses[neighbour]
            one, two = lenses[k]
            cost, pose = _fit(start, one, two, first, second, scale)
            if cost < costs[k]:
                costs[k], poses[k] = cost, pose
    return costs * len(pair.first) / len(keep)


def _lens(focal: float) -> Float64[np.ndarray, "3"]:
    return np.array([focal, focal, 1.0])


def _fit(
    start: tuple[np.ndarray, np.ndarray],
    one: Float64[np.ndarray, "3"],
    two: Float64[np.ndarray, "3"],
    first: Float64[np.ndarray, "n 3"],
    second: Float64[np.ndarray, "n 3"],
    scale: float,
) -> tuple[float, tuple[np.ndarray, np.ndarray]]:
    """Error of the best essential matrix near the given motion, and its motion; Gauss-Newton."""
    turn, move = start

    def errors(turn: np.ndarray, move: np.ndarray) -> np.ndarray:
        essential = _cross(move) @ turn
        return _sampson(essential / two[:, None] / one, first, second)

    error = errors(turn, move)
    cost, damping, delta = _robust(error, scale), 1e-3, 1e-6
    for _ in range(8):
        aside = np.linalg.svd(move[None])[2][1:]

        def moved(
            p: np.ndarray, turn: np.ndarray = turn, move: np.ndarray = move, b: np.ndarray = aside
        ) -> tuple[np.ndarray, np.ndarray]:
            there = move + p[3:] @ b
            return Rotation.from_rotvec(p[:3]).as_matrix() @ turn, there / np.linalg.norm(there)

        jacobian = np.stack(
            [(errors(*moved(delta * unit)) - error) / delta for unit in np.eye(5)], axis=1
        )
        weight = 1 / (1 + (error / scale) ** 2)
        hessian = jacobian.T @ (weight[:, None] * jacobian)
        hessian += np.diag(damping * np.diag(hessian) + 1e-12)
        step = -np.linalg.solve(hessian, jacobian.T @ (weight * error))
        candidate = moved(step)
        tried = errors(*candidate)
        saved = cost - _robust(tried, scale)
        if saved > 0:
            (turn, move), error, cost, damping = candidate, tried, cost - saved, damping / 10
            if saved < 0.1:
                break
        else:
            damping *= 10
            if damping > 1:
                break
    return cost, (turn, move)


def _robust(error: Float64[np.ndarray, "n"], scale: float) -> float:
    """Cauchy's loss, in units of the variance (`scale` is two standard deviations)."""
    return float(4 * np.log1p((error / scale) ** 2).sum())


def _pose(essential: Float64[np.ndarray, "3 3"]) -> tuple[np.ndarray, np.ndarray]:
    """A rotation and a direction of the nearest essential matrix; any of the four will do."""
    u, _, vt = np.linalg.svd(essential)
    u, vt = u * np.sign(np.linalg.det(u)), vt * np.sign(np.linalg.det(vt))
    return u @ np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]) @ vt, u[:, 2]


def _cross(t: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    return np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])


def _homogeneous(xy: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 3"]:
    return np.concatenate([xy, np.ones((len(xy), 1))], axis=1)


def _sampson(
    fundamental: Float64[np.ndarray, "3 3"],
    first: Float64[np.ndarray, "n 3"],
    second: Float64[np.ndarray, "n 3"],
) -> Float64[np.ndarray, "n"]:
    """Signed first-order distance of matches from their epipolar geometry."""
    there, back = first @ fundamental.T, second @ fundamental
    slope = (there[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1)
    return (there * second).sum(axis=1) / np.sqrt(np.maximum(slope, 1e-300))
