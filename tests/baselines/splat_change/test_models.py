"""Models are seen from the other capture's cameras; what they lack is known."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from baselines.gaussian_splatting.train import TrainConfig
from baselines.splat_change.answering import write_comparisons, write_mask
from baselines.splat_change.models import (
    ModelConfig,
    compared,
    completed,
    model,
    prepared,
    renders,
    shrunk,
)
from scenediff_classic.errors import AlignmentError, OutputError
from scenediff_classic.types import Comparison, Geometry, SparsePoints
from tests.baselines.splat_change.scenes import both, seen_by, untrained
from tests.plane_scene import VASE, scene

TINY = ModelConfig(120, 3000, 1, TrainConfig(iterations=6, degree=0, densify=None))


def test_shrunk_views_keep_their_rays() -> None:
    view = scene([VASE], []).views[0]
    small = shrunk(view, 60)
    assert small.shape == (45, 60)
    np.testing.assert_allclose(small.intrinsics[:2], view.intrinsics[:2] / 2)
    assert np.array_equal(np.unique(small.depth), np.unique(view.depth))
    assert shrunk(view, 500) is view


def test_a_capture_without_views_is_refused() -> None:
    whole = scene([], [])
    with pytest.raises(AlignmentError, match="No picture of one capture"):
        prepared(Geometry(whole.of("before"), SparsePoints.none()), 120)


def test_renders_look_like_pictures_where_nothing_changed() -> None:
    geometry = both([VASE], [VASE])
    for k, shown in seen_by(geometry, "after").items():
        view = geometry.views[k]
        off = np.abs(shown.image.astype(int) - view.image).mean(axis=-1)[shown.known]
        assert np.median(off) < 12
        ratio = shown.depth[shown.known] / view.depth[shown.known]
        assert np.median(np.abs(ratio - 1)) < 0.02


def test_what_the_model_never_saw_is_ignored() -> None:
    geometry = both([], [])
    view = geometry.views[3]
    aside = view.cam_from_world.copy()
    aside[0, 3] -= 0.5  # looks past the end of the wall
    moved = replace(geometry, views=(*geometry.views[:3], replace(view, cam_from_world=aside)))
    (shown,) = seen_by(moved, "after").values()
    lost = shown.as_view(moved.views[3])
    assert 0.05 < (~shown.known).mean() < 1
    assert np.array_equal(lost.ignore, ~shown.known)
    assert np.isnan(lost.depth[~shown.known]).all()


def test_every_other_frame() -> None:
    geometry = both([], [])
    assert compared(geometry, "after", 1) == [3, 4, 5]
    assert compared(geometry, "after", 2) == [3, 5]


def test_models_are_continued(tmp_path: Path) -> None:
    geometry = both([VASE], [])
    seen = []
    whole = model(geometry, "before", TINY, tmp_path / "a", lambda *p: seen.append(p))
    assert seen[-1] == ("before model", 6, 6)
    seen.clear()
    again = model(geometry, "before", TINY, tmp_path / "a", lambda *p: seen.append(p))
    assert seen == []  # finished: nothing is learned again
    view = geometry.views[4]
    first, second = (renders(g, [view])[0].image for g in (whole, again))
    assert np.array_equal(first, second)


def test_new_surfaces_join_the_model() -> None:
    geometry = both([], [VASE])
    reference = untrained(geometry, "before")
    config = ModelConfig(120, 20_000)
    whole = completed(reference, geometry, [3, 4, 5], config)
    nearer = np.concatenate([v.depth[v.depth < 0.85 * v.depth.max()] for v in geometry.views[3:]])
    added = whole.means[len(reference) :, 2].numpy()
    assert (np.abs(added - np.median(nearer)) < 0.02).mean() > 0.5
    assert len(added) > 100
    same = both([VASE], [VASE])
    more = len(completed(untrained(same, "before"), same, [3, 4, 5], config))
    assert more - len(untrained(same, "before")) < 0.5 * len(added)
    without = tuple(
        replace(v, depth=np.full_like(v.depth, np.nan), measured=np.zeros(v.shape, bool))
        for v in geometry.views
    )
    sparse = replace(geometry, views=without)
    sparse = replace(
        sparse,
        points=SparsePoints(
            np.random.default_rng(0).normal(size=(20, 3)), np.zeros((20, 3), np.uint8),
            np.array([[k, 3] for k in range(20)]),
        ),
    )  # fmt: skip
    assert completed(reference, sparse, [3, 4, 5], config) is reference


def test_pictures_are_written(tmp_path: Path) -> None:
    geometry = both([VASE], [])
    view = geometry.views[0]
    mask = np.zeros(view.shape, bool)
    mask[10:20, 10:20] = True
    one = Comparison(0, view.image, view.image, mask.astype(np.float32), mask)
    write_comparisons(tmp_path / "p", geometry, [one])
    written = cv2.imread(str(tmp_path / "p" / f"{view.video}_{view.index:04d}.jpg"))
    assert written is not None
    assert written.shape == (view.shape[0], 4 * view.shape[1], 3)
    write_mask(tmp_path / "p" / "a.png", mask)
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        write_mask(tmp_path / "file" / "a.png", mask)
