"""What structure from motion tries, in order: how to match, and how to compute cameras."""

from dataclasses import dataclass, replace
from pathlib import Path

from scenediff_classic.geometry.registration.sparse_model import FeatureRecipe, MapperRecipe


@dataclass(frozen=True)
class Rung:
    """One attempt: how to match, and how to compute cameras from the matches."""

    features: FeatureRecipe
    mapper: MapperRecipe

    @property
    def name(self) -> str:
        """For logs and folders."""
        return f"{self.features.name}-{self.mapper.name}"


STANDARD = FeatureRecipe("standard")
SENSITIVE = FeatureRecipe("sensitive", peak_threshold=0.003, ratio=0.85)
THOROUGH = FeatureRecipe("thorough", peak_threshold=0.002, ratio=0.9, affine=True, guided=True)
INCREMENTAL = MapperRecipe("incremental")
RELAXED = MapperRecipe(
    "relaxed", init_inliers=30, init_angle=6.0, pose_inliers=12, two_view_points=True
)
GLOBAL = MapperRecipe("global", method="global")
TWO_VIEW = replace(RELAXED, name="two-view", init_angle=2.0, refine_lens=False)
"""For one photo against one photo: the focal length cannot be refined from a single pair."""

LADDER: tuple[Rung, ...] = (
    Rung(STANDARD, INCREMENTAL),
    Rung(STANDARD, RELAXED),
    Rung(SENSITIVE, RELAXED),
    Rung(THOROUGH, RELAXED),
    Rung(THOROUGH, GLOBAL),
)
"""From cheap and strict to costly and lenient; the first good result wins."""


def ladder(pictures: int, learned: Path | None = None) -> tuple[Rung, ...]:
    """The rungs for so many pictures.

    Parameters
    ----------
    learned : Path, optional
        Folder with the weights of ALIKED and LightGlue: they replace SIFT on all rungs, so that
        only the mapping becomes more lenient.
    """
    if learned is not None:
        features = FeatureRecipe("aliked", weights=learned)
        mappers = (TWO_VIEW,) if pictures == 2 else (INCREMENTAL, RELAXED, GLOBAL)
        return tuple(Rung(features, mapper) for mapper in mappers)
    if pictures == 2:
        return (Rung(STANDARD, TWO_VIEW), Rung(THOROUGH, TWO_VIEW))
    return LADDER
