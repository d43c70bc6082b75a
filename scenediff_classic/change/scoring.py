"""Region-level change scores (paper Sec. 4.2 and the first half of 4.3)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32

from scenediff_classic.change.feature_grids import FeatureGrids
from scenediff_classic.change.harmonise import HarmoniseConfig, harmonised
from scenediff_classic.change.kernels import best_cosine
from scenediff_classic.change.region_pooling import paint, region_descriptors, region_means
from scenediff_classic.change.visibility import (
    Comparable,
    Reprojection,
    VisibilityConfig,
    pair_views,
    reproject,
)
from scenediff_classic.change.voxel_smoothing import smooth_in_3d
from scenediff_classic.protocols import FeatureExtractor, Progress, silent
from scenediff_classic.types import Geometry, Regions, ScoreMaps, View

Scored = Float[np.ndarray, "..."]

MEASURED_SHARE = 1.0
"""All of a region must be measured for its E_geom to count in full."""


@dataclass(frozen=True)
class ScoringConfig:
    """Weights of the three cues and how they are pooled."""

    geometry_weight: float = 1.0
    """The paper's lambda_geom."""
    feature_weight: float = 0.5
    region_weight: float = 0.1
    geometry_cap: float = 0.3
    """What a depth difference beyond doubt counts, however large: a farther background is no
    stronger evidence."""
    geometry_noise: float = 0.01
    """Depth difference, relative to depth, that says nothing, at least: errors grow with depth."""
    geometry_noise_factor: float = 3.5
    """Two views in which the third quartile of how far regions are off (the mean difference of
    each) times this is larger have that as their noise: poses are worse than they should be. The
    errors of stereo average out over a region, those of poses don't. 0 turns this off."""
    geometry_scale: float = 6.0
    """How far beyond the noise, in units of it, a difference counts 1 - 1/e of the cap: a small
    thing stands out by little, but where depth is that exact it is no less certain."""
    shift_cells: int = 1
    """A feature may match within this many grid cells of its reprojection: registration is not
    perfect, and a silhouette off by a pixel is no change. 0 = the paper's exact comparison."""
    measured_share: float | None = None
    """Share of a region's visible pixels that must be measured for its E_geom to count in full; it
    is the mean over these pixels, and counts less in proportion where fewer are measured. Lower
    values find more where depth is patchy, and report more wrong depth as a change. None =
    `MEASURED_SHARE`, or what the preset says."""
    min_visible: float = 0.3
    """Regions with a smaller visible part have no score (0 after smoothing, as in the paper)."""
    voxel: float = 1 / 200
    """Side of the voxels that average scores over the views of a capture."""
    visibility: VisibilityConfig = field(default_factory=VisibilityConfig)
    harmonise: HarmoniseConfig = field(default_factory=HarmoniseConfig)

    @property
    def full_share(self) -> float:
        """The `measured_share` that counts."""
        return MEASURED_SHARE if self.measured_share is None else self.measured_share

    def depth_evidence(
        self, gap: Float[np.ndarray, "h w"], depth: Float[np.ndarray, "h w"], regions: Regions
    ) -> Float[np.ndarray, "h w"]:
        """What the depth differences of two views prove: E_geom of eq. 1, measured by its noise.

        Parameters
        ----------
        gap : float array
            Other view's depth minus reprojected depth; negative = in front of it, NaN = unknown or
            no evidence.
        depth : float array
            Depth of the same pixels in their own view, in the same unit as `gap`.
        regions : Regions
            Of the same view: the noise is what differs over most of them.

        Returns
        -------
        float array
            0 to `geometry_cap`, the same in any unit; a negative `gap` as it is, so that noise
            about zero does not add up; NaN where `gap` is.
        """
        relative = gap / depth
        off = np.abs(paint(region_means(relative, regions)[0], regions.labels))
        off = off[np.isfinite(relative) & np.isfinite(off)]
        usual = float(np.quantile(off, 0.75)) if len(off) else 0.0
        noise = max(self.geometry_noise, self.geometry_noise_factor * usual)
        beyond = np.maximum(relative / noise - 1, 0)
        certain = self.geometry_cap * -np.expm1(-beyond / self.geometry_scale)
        return np.where(gap > 0, certain, gap)

    def total(self, geometry: Scored, feature: Scored, region: Scored) -> Scored:
        """Weighted sum of the three terms (eq. 4); a region without counterpart term has 0."""
        return (
            self.geometry_weight * geometry
            + self.feature_weight * feature
            + self.region_weight * np.nan_to_num(region)
        )


@dataclass(frozen=True)
class RegionScores:
    """Scores and descriptors of a view's regions, by region label; NaN = not comparable."""

    geometry: Float[np.ndarray, "n"]
    feature: Float[np.ndarray, "n"]
    region: Float[np.ndarray, "n"]
    total: Float[np.ndarray, "n"]
    descriptors: Float32[np.ndarray, "n c"]
    """Unit-length mean feature of each region."""


@dataclass(frozen=True)
class Scores:
    """Change evidence of the whole scene; sequences follow `Geometry.views`."""

    maps: tuple[ScoreMaps, ...]
    regions: tuple[RegionScores, ...]
    pairs: tuple[tuple[int, int], ...]
    comparisons: Mapping[tuple[int, int], Float[np.ndarray, "n"]]
    """Score of every region of the first view when compared with the second alone; NaN = that one
    cannot see it."""
    light: float = 0.0
    """How much the light differs between the captures: `harmonise.Harmonised.light`."""


def score_changes(
    geometry: Geometry,
    regions: Sequence[Regions],
    features: FeatureExtractor,
    config: ScoringConfig,
    progress: Progress = silent,
    folder: Path | None = None,
) -> Scores:
    """Compare every pair of co-visible views, both ways, and pool the evidence.

    Parameters
    ----------
    geometry : Geometry
        In normalised units (`change.scale.normalised`).
    regions : sequence of Regions
        One per view.
    folder : Path, optional
        Where features lie while they are needed; the system's temporary folder if left out.
    """
    views = geometry.views
    pairs = pair_views(geometry, config.visibility)
    totals = [_Accumulator(view, r) for view, r in zip(views, regions, strict=True)]
    prepared = [Comparable.of(view, config.visibility) for view in views]
    alike = harmonised(geometry, pairs, config.harmonise, config.visibility)
    comparisons = {}

    def encoded(done: int) -> None:
        progress("features", done, len(views))

    with FeatureGrids.of(alike.geometry.views, features, folder, encoded) as grids:
        descriptors = [region_descriptors(grids[k], r) for k, r in enumerate(regions)]
        for done, (i, j) in enumerate(pairs):
            for a, b in ((i, j), (j, i)):
                seen = reproject(prepared[a], prepared[b], config.visibility)
                distance = feature_distance(grids[a], grids[b], seen, views[b], config.shift_cells)
                comparisons[a, b] = totals[a].add(
                    seen, distance, descriptors[a], descriptors[b], config
                )
            progress("scores", done + 1, len(pairs))
    averaged = [t.averaged(config) for t in totals]
    scores = _pooled(geometry, regions, averaged, descriptors, pairs, comparisons, config)
    return replace(scores, light=alike.light)


def reweighted(
    scores: Scores, geometry: Geometry, regions: Sequence[Regions], config: ScoringConfig
) -> Scores:
    """The same terms with other weights or another voxel; `comparisons` keep their old ones."""
    raw = [replace(m, total=config.total(m.geometry, m.feature, m.region)) for m in scores.maps]
    descriptors = [r.descriptors for r in scores.regions]
    pooled = _pooled(geometry, regions, raw, descriptors, scores.pairs, scores.comparisons, config)
    return replace(pooled, light=scores.light)


def _pooled(
    geometry: Geometry,
    regions: Sequence[Regions],
    averaged: Sequence[ScoreMaps],
    descriptors: Sequence[np.ndarray],
    pairs: tuple[tuple[int, int], ...],
    comparisons: Mapping[tuple[int, int], np.ndarray],
    config: ScoringConfig,
) -> Scores:
    """Smooth the totals over the views of each capture, and read everything by region."""
    views = geometry.views
    if len(views) > 2:  # a pair of single photos has nothing to average over (paper Sec. 4.4)
        smoothed = smooth_in_3d(
            views, regions, [m.total for m in averaged], config.voxel, config.min_visible
        )
    else:
        smoothed = [m.total for m in averaged]
    maps, scored = [], []
    for m, total, r, d in zip(averaged, smoothed, regions, descriptors, strict=True):
        maps.append(replace(m, total=total))
        scored.append(
            RegionScores(
                geometry=region_means(m.geometry, r)[0],
                feature=region_means(m.feature, r)[0],
                region=region_means(m.region, r)[0],
                total=region_means(total, r)[0],
                descriptors=d,
            )
        )
    return Scores(tuple(maps), tuple(scored), pairs, comparisons)


def feature_distance(
    source: np.ndarray, target: np.ndarray, seen: Reprojection, target_view: View, shift_cells: int
) -> Float32[np.ndarray, "h w"]:
    """E_feat of eq. 2 at every source pixel (before masking): 1 - cosine; NaN where unknown.

    Computed once per feature cell; the best match within `shift_cells` counts.
    """
    height, width = seen.gap.shape
    rows, columns = source.shape[:2]
    cell_row = ((np.arange(rows) + 0.5) * height / rows).astype(int)
    cell_column = ((np.arange(columns) + 0.5) * width / columns).astype(int)
    xy = seen.xy[cell_row[:, None], cell_column]
    x = xy[..., 0] * np.float32(target.shape[1] / target_view.shape[1])
    y = xy[..., 1] * np.float32(target.shape[0] / target_view.shape[0])
    best = best_cosine(source, target, x, y, shift_cells)
    row = (np.arange(height) * rows // height)[:, None]
    column = np.arange(width) * columns // width
    return np.maximum(1 - best, 0)[row, column]


class _Accumulator:
    """Sums of one view's scores over the views it was compared with."""

    def __init__(self, view: View, regions: Regions) -> None:
        self.depth = view.depth
        self.regions = regions
        self.sums = np.zeros((3, *view.shape), np.float32)
        self.counts = np.zeros((3, *view.shape), np.float32)

    def add(
        self,
        seen: Reprojection,
        distance: np.ndarray,
        own: np.ndarray,
        other: np.ndarray,
        config: ScoringConfig,
    ) -> Float[np.ndarray, "n"]:
        """Pool one comparison over the regions and add it where the pair could see.

        Returns the score of every region in this comparison; NaN = not visible.
        """
        _, visible = region_means(np.where(seen.visible, 0.0, np.nan), self.regions)
        gap = np.where(seen.measured, seen.gap, np.nan)  # a guessed depth proves nothing
        e_geom, told = region_means(
            config.depth_evidence(gap, self.depth, self.regions), self.regions
        )
        full = np.maximum(config.full_share * visible, 1e-6)
        e_geom = np.nan_to_num(e_geom) * np.minimum(told / full, 1)
        e_feat, _ = region_means(np.where(seen.visible, distance, np.nan), self.regions)
        e_region = np.full(self.regions.count, np.nan)
        if len(other):
            e_region = 1 - (own @ other.T).max(axis=1)
        e_region[visible < 0.5] = np.nan  # the paper leaves out mostly masked regions
        for k, values in enumerate((e_geom, e_feat, e_region)):
            values[visible < config.min_visible] = np.nan
            painted = np.where(seen.visible, paint(values, self.regions.labels), np.nan)
            known = np.isfinite(painted)
            self.sums[k][known] += painted[known]
            self.counts[k] += known
        return config.total(e_geom, e_feat, e_region)

    def averaged(self, config: ScoringConfig) -> ScoreMaps:
        """Unweighted mean over the pairs that saw the pixel, and the weighted sum (eq. 4)."""
        with np.errstate(invalid="ignore"):
            geometry, feature, region = self.sums / np.where(self.counts > 0, self.counts, np.nan)
        return ScoreMaps(geometry, feature, region, config.total(geometry, feature, region))
