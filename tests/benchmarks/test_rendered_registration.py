"""What the benchmark of rendered pairs says beside the errors of cameras."""

from pathlib import Path

import numpy as np
import pytest

from data_tools.benchmarks.rendered_registration import (
    Registered,
    RenderedRegistration,
    confidence_rank,
    moved_share,
)
from scenediff_classic.errors import InputError


def test_share_of_pixels_on_moved_things(tmp_path: Path) -> None:
    instances = np.zeros((2, 2, 5), np.int32)
    instances[0, 0] = 3  # moved
    instances[1, 1, :2] = 4  # stays
    path = tmp_path / "truth_instances.npz"
    np.savez(path, instances=instances, id=np.array([3, 4]), kind=np.array(["moved", "unchanged"]))
    assert moved_share(path) == 0.25


def registered(confidence: list[float], centre: list[float]) -> Registered:
    errors = np.array(centre)
    return Registered("x", 0.0, np.array(confidence), errors, errors, 100, False)


def test_confidence_ranks_frames_over_all_pairs() -> None:
    telling = [registered([0.9, 0.1], [0.01, 0.5]), registered([0.5], [0.1])]
    assert confidence_rank(telling) == pytest.approx(-1)
    inverted = [registered([0.1, 0.9], [0.01, 0.5]), registered([0.5], [0.1])]
    assert confidence_rank(inverted) == pytest.approx(1)


def test_folders_without_pairs_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no rendered pairs"):
        RenderedRegistration((tmp_path,))()
