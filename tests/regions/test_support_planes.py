"""Supports and things of the drawn box on its table."""

from dataclasses import replace

import numpy as np

from scenediff_classic.regions.support_planes import SupportConfig, support_planes
from scenediff_classic.regions.things_on_supports import ThingsOnSupportsRegions
from tests.regions.test_proposers import BOX, TABLE, WALL, box_on_table


def test_table_and_wall_are_found_where_they_are() -> None:
    view, seen = box_on_table()
    supports = support_planes(view, SupportConfig())
    table = supports.labels[seen == TABLE]
    number = np.bincount(table[table >= 0]).argmax()
    assert np.mean(table == number) > 0.95
    # 0.8 m below a camera that looks level: y = 0.8
    np.testing.assert_allclose(supports.planes[number], [0, 1 / 0.8, 0], atol=0.01)
    assert supports.level[number]
    np.testing.assert_allclose(supports.up, [0, -1, 0], atol=0.01)
    wall = supports.labels[seen == WALL]
    assert np.mean(wall >= 0) > 0.95
    assert not supports.level[np.bincount(wall[wall >= 0]).argmax()]
    assert np.mean(supports.labels[seen == BOX] >= 0) < 0.1


def test_above_and_below_a_table() -> None:
    view, _ = box_on_table()
    supports = support_planes(view, SupportConfig())
    assert supports.above(np.array([[0.1, 0.5, 2.0]])).all()
    assert not supports.above(np.array([[0.1, 1.2, 2.0]])).any()


def test_without_depth_there_are_neither() -> None:
    view, _ = box_on_table()
    blind = replace(view, depth=np.full(view.shape, np.nan, np.float32))
    supports = support_planes(blind, SupportConfig())
    assert len(supports.planes) == 0
    assert supports.up is None
    assert (ThingsOnSupportsRegions().things(blind, supports) == -1).all()


def test_pieces_above_the_same_spot_are_one_thing() -> None:
    """The box loses a strip of its depth: two pieces, upright over each other."""
    view, seen = box_on_table()
    rows = np.flatnonzero((seen == BOX).any(axis=1))
    middle = int(rows.mean())
    depth = view.depth.copy()
    depth[middle : middle + 2][seen[middle : middle + 2] == BOX] = np.nan
    # a front seen alone has no footprint but a line, so the upper half leans
    upper = (seen == BOX) & (np.arange(len(seen)) < middle)[:, None]
    depth[upper] += np.linspace(-0.1, 0.1, np.count_nonzero(upper), dtype=np.float32)
    split = replace(view, depth=depth)
    supports = support_planes(split, SupportConfig())
    joined = ThingsOnSupportsRegions().things(split, supports)
    apart = ThingsOnSupportsRegions(over=1.0).things(split, supports)
    at = np.isfinite(depth) & (seen == BOX)
    assert len(np.unique(joined[at & (joined >= 0)])) == 1
    assert len(np.unique(apart[at & (apart >= 0)])) == 2
