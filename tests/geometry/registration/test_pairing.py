"""Pairs to match: all while there are few pictures, then no more than a few a picture."""

from itertools import combinations
from pathlib import Path

import numpy as np

from scenediff_classic.geometry.registration import pairing
from scenediff_classic.geometry.registration.colmap.database import Database
from scenediff_classic.geometry.registration.pairing import matching_pairs, similar_pairs


def walk(count: int) -> np.ndarray:
    """Signatures of a camera on a circle: similar where the places are near."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def test_few_pictures_are_matched_exhaustively(tmp_path: Path) -> None:
    captures = [["before/0", "before/1"], ["after/0"]]
    database = Database(tmp_path / "not read", tmp_path, ())
    expected = list(combinations(["before/0", "before/1", "after/0"], 2))
    assert matching_pairs(captures, database, 0) == expected


def test_same_places_meet_across_captures() -> None:
    pairs = similar_pairs(np.concatenate([walk(90), walk(70)]), [90, 70])
    assert pairs == sorted(set(pairs))
    assert all(a < b for a, b in pairs)
    for i in range(90):
        partners = [b - 90 for a, b in pairs if a == i and b >= 90]
        assert round(i * 70 / 90) % 70 in partners


def test_pairs_grow_linearly() -> None:
    for count in (100, 200, 400):
        pairs = similar_pairs(np.concatenate([walk(count)] * 2), [count, count])
        a_picture = len(pairing.NEIGHBOURS) + 2 * pairing.SIMILAR
        assert len(pairs) <= 2 * count * a_picture


def test_neighbours_are_matched_whatever_they_look_like() -> None:
    noise = np.random.default_rng(0).normal(size=(130, 40))
    pairs = set(similar_pairs(noise, [70, 60]))
    assert {(i, i + 1) for i in range(69)} <= pairs
    assert {(i, i + 8) for i in range(70, 122)} <= pairs
    assert (69, 70) not in pairs or noise[69] @ noise[70] > 0  # no neighbours across captures


def test_signatures_are_alike_for_like_pictures() -> None:
    rng = np.random.default_rng(1)
    scenes = [rng.uniform(0, 255, (300, 128)).astype(np.float32) for _ in range(3)]
    noisy = [s + rng.normal(0, 4, s.shape).astype(np.float32) for s in scenes]
    signatures = pairing._signatures([*scenes, *noisy], seed=0)
    np.testing.assert_allclose(np.linalg.norm(signatures, axis=1), 1, atol=1e-5)
    likeness = signatures[:3] @ signatures[3:].T
    assert (likeness.argmax(axis=1) == [0, 1, 2]).all()
