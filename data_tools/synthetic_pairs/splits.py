"""The named sets of pairs: fixed seeds, so that figures can be compared."""

from typing import Literal

from data_tools.synthetic_pairs.scene import HardCase, PairSpec
from data_tools.synthetic_pairs.trajectory import Trajectories

Split = Literal["demo", "tiny", "val", "sparse", "test"]

VAL_CASES: tuple[tuple[HardCase, ...], ...] = (
    (),
    ("lighting",),
    ("repeated",),
    (),
    ("no_change",),
    ("near_duplicate",),
    ("occlusion",),
    ("small",),
    (),
    ("low_texture",),
    ("no_change", "lighting"),
    (),
)
TEST_CASES: tuple[tuple[HardCase, ...], ...] = VAL_CASES * 2


def split_specs(split: Split) -> tuple[PairSpec, ...]:
    """The pairs of a named split.

    ``demo`` is one easy pair; ``tiny`` two small ones for tests; ``val`` 12 pairs for tuning;
    ``sparse`` 12 more of five pictures a capture; ``test`` 24 pairs from other families of objects
    and textures.
    """
    if split == "demo":
        return (
            PairSpec("demo_0000", 8, frames=8, close=True, kinds=("added", "removed", "moved")),
        )
    if split == "tiny":
        small = {"frames": 6, "width": 320, "height": 240, "texture_size": 1024, "close": True}
        return (
            PairSpec("tiny_0000", 100, kinds=("added", "removed", "moved"), **small),
            PairSpec("tiny_0001", 101, hard=("no_change",), **small),
        )
    first, frames, cases = {
        "val": (1000, 10, VAL_CASES),
        "sparse": (3000, 5, VAL_CASES),
        "test": (5000, 12, TEST_CASES),
    }[split]
    return tuple(
        PairSpec(
            f"{split}_{k:04d}",
            first + k,
            frames=frames,
            hard=case,
            held_out=split == "test",
            close=k % 2 == 0,
        )
        for k, case in enumerate(cases)
    )


def numbered_specs(
    scenes: int,
    seed: int,
    frames: int,
    width: int,
    height: int,
    hard: tuple[HardCase, ...],
    rigid_motion: int = 0,
    trajectories: Trajectories = "diverging",
) -> tuple[PairSpec, ...]:
    """Pairs outside the named splits, from the families of ``val``."""
    return tuple(
        PairSpec(
            f"pair_{k:04d}",
            10_000 * (seed + 1) + k,
            frames,
            width,
            height,
            hard,
            close=k % 2 == 0,
            texture_size=2048 if width > 400 else 1024,
            rigid_motion=rigid_motion,
            trajectories=trajectories,
        )
        for k in range(scenes)
    )
