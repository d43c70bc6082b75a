"""RC-3D's layout."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from data_tools.benchmarks.rc3d import read_rc3d, read_rc3d_depth
from scenediff_classic.errors import InputError


@pytest.fixture
def root(tmp_path: Path) -> Path:
    part = tmp_path / "part1"
    part.mkdir()
    names = [f"{place}_{k}.jpg" for place in ("shelf", "desk") for k in range(3)]
    for k, name in enumerate(names):
        Image.new("RGB", (64, 48), (k, 0, 0)).save(part / name)
        depth = np.full((12, 16), 1500 + k, np.uint16)
        depth[0, 0] = 0
        Image.fromarray(depth).save(part / f"depth_{Path(name).stem}.png")
    notes = [{"image_id": 10, "bbox": [1, 2, 30, 4]}, {"image_id": 12, "bbox": [5, 6, 7, 8]},
             {"image_id": 11, "bbox": [0, 0, 1, 1]}]  # fmt: skip
    images = [{"id": 10 + k, "file_name": name} for k, name in enumerate(names)]
    content = json.dumps({"images": images, "annotations": notes})
    (part / "coco_annotations.json").write_text(content)
    return tmp_path


def test_pairs_are_the_outer_photos_of_each_triple(root: Path) -> None:
    pairs = list(read_rc3d(root))
    assert [(a.name, b.name) for a, b in pairs] == [("shelf_0", "shelf_2"), ("desk_0", "desk_2")]
    first, second = pairs[0]
    assert first.boxes.tolist() == [[1, 2, 31, 6]]
    assert second.boxes.tolist() == [[5, 6, 12, 14]]
    assert pairs[1][0].boxes.shape == (0, 4)
    assert first.image.shape == (48, 64, 3)
    assert np.isnan(first.depth[0, 0])
    assert second.depth[3, 3] == pytest.approx(1.502)
    again = list(read_rc3d(root))  # reading changes nothing
    assert np.array_equal(again[0][0].boxes, first.boxes)


def test_what_cannot_be_read_is_named(root: Path) -> None:
    with pytest.raises(InputError, match="holds no part1"):
        list(read_rc3d(root / "part1"))
    (root / "part1" / "depth_desk_0.png").unlink()
    with pytest.raises(InputError, match="depth_desk_0"):
        list(read_rc3d(root))
    (root / "part1" / "coco_annotations.json").write_text('{"images": 3}')
    with pytest.raises(InputError, match="COCO"):
        list(read_rc3d(root))


def test_depth_of_the_real_pair(real_data: Path) -> None:
    depth = read_rc3d_depth(real_data / "cyws3d_ship_pair" / "depth_ship_0.png")
    assert depth.shape == (192, 256)
    assert 0.5 < np.nanmedian(depth) < 2
