"""One direction, from renders to things."""

from baselines.threedgs_cd.detector import ThreedgsCdConfig, published
from baselines.threedgs_cd.merging import MergeConfig, merged
from baselines.threedgs_cd.searching import SearchConfig, searched
from tests.baselines.splat_change.scenes import both, iou, seen_by, silhouette
from tests.plane_scene import BOOK, CLOCK, VASE

CONFIG = SearchConfig()


def _changes(before, after):
    geometry = both(before, after)
    forth, back = (searched(geometry, seen_by(geometry, v), CONFIG) for v in ("after", "before"))
    return geometry, merged(forth, back, 0.9, 0.01, MergeConfig())


def test_one_thing_was_added() -> None:
    geometry, changes = _changes([BOOK], [BOOK, VASE])
    (change,) = changes
    assert change.before is None
    assert change.after is not None
    assert sorted(r.view for r in change.after.regions) == [3, 4, 5]
    nearest = geometry.views[3].depth.min()
    for r in change.after.regions:
        truth = silhouette(geometry, r.view, 1.05 * nearest / geometry.views[r.view].depth.max())
        assert iou(r.mask, truth) > 0.8


def test_one_thing_was_removed_and_one_added() -> None:
    _, changes = _changes([VASE], [CLOCK])
    assert [(c.before is None, c.after is None) for c in changes] == [(False, True), (True, False)]


def test_equal_captures() -> None:
    _, changes = _changes([VASE, BOOK], [VASE, BOOK])
    assert changes == []


def test_published_options_change_the_known_faults_alone() -> None:
    config = ThreedgsCdConfig()
    old = published(config)
    assert old.both_outputs
    assert old.search.association.fullest_only
    assert not old.search.association.late
    assert old.search.differences.floor == 0
    assert old.models == config.models
    assert old.search.differences.features == config.search.differences.features
