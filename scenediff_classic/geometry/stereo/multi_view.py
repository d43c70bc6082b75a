"""Multi-view stereo: depth of every view from the other frames of its video.

It takes the place of the feed-forward depth of the paper (Sec. 4.1). Every view is matched on its
own, then once more with what the others found in mind; only depth that other views' depth
confirms is kept.
"""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32, Int32

from scenediff_classic.errors import OutputError
from scenediff_classic.geometry.stereo.consistency import count_supporters
from scenediff_classic.geometry.stereo.depth_confidence import PIXEL_BY_PIXEL, depth_confidence
from scenediff_classic.geometry.stereo.depth_map import DepthMap, Matcher
from scenediff_classic.geometry.stereo.patchmatch import PatchMatch
from scenediff_classic.geometry.stereo.view_selection import observed_points, select_sources
from scenediff_classic.protocols import Progress
from scenediff_classic.types import Geometry, View
from scenediff_classic.workspace import load_npz, save_npz

_KEPT = {"digest", "depth", "cost", "planes"}


@dataclass(frozen=True)
class MultiViewStereo:
    """Dense depth of all views, confirmed by one another."""

    matcher: Matcher = field(default_factory=PatchMatch)
    sources: int = 6
    """Source views of its own capture that a reference view is matched against."""
    enough_sources: int = 6
    """Where its own capture has fewer other views, views of the other capture help: what changed
    between the two is then judged by its own views alone."""
    borrowed_sources: int = 6
    """Views of the other capture that then help."""
    max_pixels: float = 1.5
    """Largest forward-backward error of a confirmed depth, in pixels."""
    max_relative: float = 0.01
    """Largest relative difference between depths that confirm each other."""
    pair_max_relative: float = 0.02
    """The same where a view has a single source: a short baseline tells depth less exactly."""
    min_supporters: int = 2
    """Views that must confirm a depth (fewer where a view has fewer sources of its own video)."""
    min_likelihood: float = 0.5
    """Confirmed depth that is less likely to be right, pixel by pixel, is dropped all the same."""
    sure_likelihood: float = 0.95
    """Depth counts as measured, and so as evidence of a change, only from here on. Strict, for
    wrong depth is reported as a change: with 0.5, two pairs without any gave eight objects."""
    pair_sure_likelihood: float = 0.5
    """The same where a view has a single source, which can hardly make it surer."""

    def __call__(self, geometry: Geometry, workspace: Path, progress: Progress) -> Geometry:
        """Fill `depth`, `confidence` and `measured` of every view.

        Parameters
        ----------
        geometry : Geometry
            Cameras and pictures; any depth they hold is ignored.
        workspace : Path
            Finished depth maps are kept in ``stereo/`` below it and reused if cameras,
            pictures and options are the same.
        progress : callable
            ``progress("stereo", passes over views done, passes over views)``.

        Returns
        -------
        Geometry
            Same cameras. Depth is NaN where it could not be found or was not confirmed.
        """
        work = StereoWork.of(self, geometry, workspace, progress)
        first = work.first_pass()
        second = work.second_pass(first)
        return replace(geometry, views=tuple(work.confirmed(first, second)))


@dataclass(frozen=True)
class StereoWork:
    """One call: what is matched against what, and where finished maps lie.

    Maps are read back when they are needed: in memory, planes would be the largest part.
    """

    stereo: MultiViewStereo
    geometry: Geometry
    """Views without depth."""
    seen: Bool[np.ndarray, "views points"]
    sources: Sequence[tuple[int, ...]]
    folder: Path
    progress: Progress

    @staticmethod
    def of(
        stereo: MultiViewStereo, geometry: Geometry, workspace: Path, progress: Progress
    ) -> "StereoWork":
        """Choose the sources of every view and forget any depth."""
        blind = tuple(
            replace(v, depth=np.full(v.shape, np.nan, np.float32)) for v in geometry.views
        )
        sources = tuple(
            select_sources(
                geometry, i,
                count=stereo.sources, enough=stereo.enough_sources,
                borrowed=stereo.borrowed_sources,
            )
            for i in range(len(blind))
        )  # fmt: skip
        geometry = replace(geometry, views=blind)
        seen = observed_points(geometry)
        return StereoWork(stereo, geometry, seen, sources, workspace / "stereo", progress)

    def first_pass(self) -> tuple[View, ...]:
        """All views with the depth that each found by itself."""
        found = []
        for i, view in enumerate(self.geometry.views):
            self.progress("stereo", i, 2 * len(self.sources))
            others = [self.geometry.views[s] for s in self.sources[i]]
            found.append(replace(view, depth=self._first(i, view, others).depth))
        return tuple(found)

    def second_pass(self, first: Sequence[View]) -> tuple[View, ...]:
        """All views with the depth found with the others' depth in mind."""
        found = []
        for i, view in enumerate(first):
            self.progress("stereo", len(first) + i, 2 * len(first))
            found.append(replace(view, depth=self._second(i, first).depth))
        self.progress("stereo", 2 * len(first), 2 * len(first))
        return tuple(found)

    def confirmed(self, first: Sequence[View], second: Sequence[View]) -> Iterator[View]:
        """The views with what enough others agree with, and how sure it is.

        Sure depth must have been found and confirmed before the views knew of each other, too: in
        the second pass they can talk each other into a mistake. A single pair is spared this.
        """
        for i, view in enumerate(second):
            supporters = self._supporters(view, [second[s] for s in self.sources[i]])
            cost = self.cost(i)
            confidence, likelihood = (
                depth_confidence(weights, view.depth, cost, supporters)
                for weights in (self.stereo.matcher.confidence_weights, PIXEL_BY_PIXEL)
            )
            kept = self._enough(i, supporters) & (likelihood >= self.stereo.min_likelihood)
            if len(self.sources[i]) == 1:
                sure = kept & (likelihood >= self.stereo.pair_sure_likelihood)
            else:
                sure = kept & (likelihood >= self.stereo.sure_likelihood)
                sure &= self._found_alone(i, view, first)
            yield replace(
                view,
                depth=np.where(kept, view.depth, np.nan).astype(np.float32),
                confidence=np.where(kept, confidence, 0).astype(np.float32),
                measured=sure,
            )

    def _found_alone(self, i: int, view: View, first: Sequence[View]) -> Bool[np.ndarray, "h w"]:
        """Where the first pass had the same depth, confirmed by what others had found then."""
        supporters = self._supporters(first[i], [first[s] for s in self.sources[i]])
        with np.errstate(invalid="ignore"):
            change = np.abs(first[i].depth / view.depth - 1)
        return self._enough(i, supporters) & (change <= self.stereo.max_relative)

    def confidence(
        self, i: int, found: Sequence[View]
    ) -> tuple[Float32[np.ndarray, "h w"], Int32[np.ndarray, "h w"]]:
        """How likely the depth of a view is right, and how many others confirm it."""
        supporters = self._supporters(found[i], [found[s] for s in self.sources[i]])
        cost = self.cost(i)
        weights = self.stereo.matcher.confidence_weights
        return depth_confidence(weights, found[i].depth, cost, supporters), supporters

    def cost(self, i: int) -> Float32[np.ndarray, "h w"]:
        """What the second pass left at each pixel: 0 (looks identical) to 1 (nothing like it)."""
        return self._map("second", i).cost

    def _first(self, i: int, view: View, others: Sequence[View]) -> DepthMap:
        digest = self._digest(i, view, others, self.stereo.matcher)
        found = self._read("first", i, digest)
        if found is None:
            found = self.stereo.matcher.search(view, others, self._points(i))
            self._write("first", i, digest, found)
        return found

    def _second(self, i: int, first: Sequence[View]) -> DepthMap:
        others = [first[s] for s in self.sources[i]]
        limits = self.stereo.max_pixels, self._max_relative(others), self.stereo.min_supporters
        digest = self._digest(i, first[i], others, (self.stereo.matcher, *limits))
        found = self._read("second", i, digest)
        if found is None:
            settled = self._enough(i, self._supporters(first[i], others))
            before = self._map("first", i)
            found = self.stereo.matcher.revise(first[i], others, self._points(i), before, settled)
            self._write("second", i, digest, found)
        return found

    def _supporters(self, view: View, others: Sequence[View]) -> Int32[np.ndarray, "h w"]:
        return count_supporters(
            view,
            others,
            max_pixels=self.stereo.max_pixels,
            max_relative=self._max_relative(others),
        )

    def _max_relative(self, others: Sequence[View]) -> float:
        alone = len(others) == 1
        return self.stereo.pair_max_relative if alone else self.stereo.max_relative

    def _enough(self, i: int, supporters: Int32[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
        """True where a depth has the confirmation that it needs."""
        views = self.geometry.views
        own = sum(views[s].video == views[i].video for s in self.sources[i])
        return supporters >= max(min(self.stereo.min_supporters, own), 1)

    def _points(self, i: int) -> np.ndarray:
        """World points (n, 3) that a view observes."""
        return self.geometry.points.xyz[self.seen[i]]

    def _path(self, which: str, i: int) -> Path:
        view = self.geometry.views[i]
        return self.folder / f"{view.video}_{view.index:05d}_{which}.npz"

    def _read(self, which: str, i: int, digest: np.ndarray | None) -> DepthMap | None:
        """A finished map; with a digest, only if it is the same work."""
        kept = load_npz(self._path(which, i))
        if kept is None or kept.keys() != _KEPT:
            return None
        if digest is not None and kept["digest"] != digest:
            return None
        return DepthMap(kept["depth"], kept["cost"], kept["planes"])

    def _map(self, which: str, i: int) -> DepthMap:
        """A map that was written in this call."""
        found = self._read(which, i, None)
        if found is None:
            raise OutputError(f"{self._path(which, i)} was removed or damaged meanwhile.")
        return found

    def _write(self, which: str, i: int, digest: np.ndarray, found: DepthMap) -> None:
        save_npz(
            self._path(which, i),
            compress=False,  # noise hardly shrinks, and packing it takes as long as finding it
            digest=digest,
            depth=found.depth,
            cost=found.cost,
            planes=found.planes,
        )

    def _digest(self, i: int, view: View, others: Sequence[View], options: object) -> np.ndarray:
        """Changes whenever the depth map would."""
        digest = hashlib.sha256(repr((version("scenediff-classic"), options)).encode())
        for v in (view, *others):
            for array in (v.image, v.intrinsics, v.cam_from_world, v.ignore, v.depth):
                digest.update(np.ascontiguousarray(array).tobytes())
        digest.update(np.ascontiguousarray(self._points(i)).tobytes())
        return np.array(digest.hexdigest())
