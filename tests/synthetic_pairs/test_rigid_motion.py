"""Most of a room moves as one, and nothing else does."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from data_tools.synthetic_pairs.changes import Item
from data_tools.synthetic_pairs.rigid_motion import GROUPS, SHIFT, TURN
from data_tools.synthetic_pairs.scene import PairSpec, compose
from data_tools.synthetic_pairs.splits import split_specs

SMALL = PairSpec("x", 3, frames=3, width=160, height=120, texture_size=256, close=True)


def corners(item: Item, video: str) -> np.ndarray:
    place = item.before if video == "before" else item.after
    assert place is not None
    standing = item.standing(place)
    return np.concatenate([part.mesh.points.reshape(-1, 3) for part in standing.parts])


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_all_that_moves_follows_one_rigid_motion(steps: int) -> None:
    scene = compose(replace(SMALL, rigid_motion=steps))
    still = compose(replace(SMALL, hard=("no_change",)))
    chosen = {name for group in GROUPS[:steps] for name in group}
    before, after = [], []
    for item in scene.items:
        goes = item.model.label in chosen or (item.before and item.before.support in chosen)
        assert (item.kind == "moved") == bool(goes)
        if goes:
            before.append(corners(item, "before"))
            after.append(corners(item, "after"))
        else:
            assert item.before == item.after
    a, b = np.concatenate(before).astype(float), np.concatenate(after).astype(float)
    u, _, vt = np.linalg.svd((b - b.mean(0)).T @ (a - a.mean(0)))
    turn = u @ vt
    np.testing.assert_allclose((a - a.mean(0)) @ turn.T, b - b.mean(0), atol=1e-5)
    assert abs(np.arctan2(turn[1, 0], turn[0, 0])) == pytest.approx(TURN, abs=1e-5)
    centre = np.array([*scene.room.table[:2], 0])
    shift = (a - centre) @ turn.T + centre
    assert (b - shift).mean(0) == pytest.approx(
        [np.sign(scene.room.table[0]) * SHIFT[0], SHIFT[1], 0], abs=1e-5
    )
    assert not chosen & {model.label for model in scene.room.furniture}
    ids = [identity for identity, _ in scene.things("before")]
    assert len(set(ids)) == len(ids)
    assert len(ids) == len(still.things("before"))


def test_nothing_is_pushed_through_a_wall() -> None:
    for seed in range(4):
        scene = compose(replace(SMALL, seed=seed, rigid_motion=2))
        for item in scene.items:
            xyz = corners(item, "after")
            assert np.abs(xyz[:, 0]).max() < scene.room.width / 2
            assert xyz[:, 1].max() < scene.room.depth


def test_no_named_split_has_it() -> None:
    for split in ("demo", "tiny", "val", "test"):
        assert not any(asdict(spec)["rigid_motion"] for spec in split_specs(split))
