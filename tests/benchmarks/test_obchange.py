"""The reader of robot recordings, on a generated room and on the real ones."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from data_tools.benchmarks import obchange, obchange_visits
from scenediff_classic.cameras import world_from_cam
from scenediff_classic.errors import InputError, OutputError
from scenediff_classic.geometry.known_cameras import KnownGeometry
from scenediff_classic.protocols import silent

LEVEL = 50
"""Grey value of all depth: 50.5 * 10 / 255 = 1.980 m."""


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Two visits with two views; the camera looks along world y from 1 m up."""
    pose = [[1, 0, 0, 0.5], [0, 0, 1, -2], [0, -1, 0, 1], [0, 0, 0, 1]]
    boxes: dict[int, list[dict[str, Any]]] = {
        1: [_box("mug", 310), _box("jar", 100), _box("tin", 500)],
        2: [_box("mug", 450), _box("jar", 102), _box("pan", 200)],
    }
    images = []
    for visit in (1, 2):
        for view in (1, 0):  # out of order, as nothing promises otherwise
            stem = f"Den/scene{visit}/{view}"
            folder = tmp_path / f"Den/scene{visit}"
            folder.mkdir(parents=True, exist_ok=True)
            colour = np.full((480, 640, 4), (10 * visit, view, 30, 0), np.uint8)
            Image.fromarray(colour).save(tmp_path / f"{stem}.png")
            depth = np.full((480, 640), LEVEL, np.uint8)
            depth[:10] = 0
            cv2.imwrite(str(tmp_path / f"{stem}d.png"), depth)
            images.append({
                "room": "Den", "visit": visit, "view": view, "rgb": f"{stem}.png",
                "depth": f"{stem}d.png", "cam_to_map": pose,
                "objects": boxes[visit] if view == 1 else [],
            })  # fmt: skip
    (tmp_path / "annotations.json").write_text(json.dumps({"images": images}))
    return tmp_path


def _box(name: str, x: float) -> dict[str, Any]:
    return {"name": name, "bbox_xyxy": [x, 230, x + 20, 250]}


def test_views_come_in_order_with_their_poses(root: Path) -> None:
    views = obchange_visits.read_visit(root, "Den", 1)
    assert [view.view for view in views] == [0, 1]
    np.testing.assert_allclose(
        world_from_cam(views[0].cam_from_world)[:3, 3], [0.5, -2, 1], atol=1e-12
    )
    assert [item.name for item in views[1].objects] == ["mug", "jar", "tin"]


def test_depth_is_in_metres_and_zero_is_unknown(root: Path) -> None:
    depth = obchange_visits.read_depth(obchange_visits.read_visit(root, "Den", 1)[0])
    assert depth.dtype == np.float32
    assert depth[20, 0] == pytest.approx(50.5 * 10 / 255)
    assert np.isnan(depth[:10]).all()


def test_captures_drop_the_alpha_channel(root: Path) -> None:
    capture = obchange_visits.read_capture(obchange_visits.read_visit(root, "Den", 2), "after")
    assert [frame.name for frame in capture.frames] == ["view_00.png", "view_01.png"]
    assert [frame.index for frame in capture.frames] == [0, 1]
    np.testing.assert_array_equal(capture.frames[1].image[0, 0], [20, 1, 30])
    assert capture.frames[0].focal_px == 554


def test_changes_are_told_by_name_and_place(root: Path) -> None:
    changes = obchange.changed_boxes(
        obchange_visits.read_visit(root, "Den", 1), obchange_visits.read_visit(root, "Den", 2)
    )
    # The mug shifts by 140 px * 1.98 m / 554 px = 0.50 m; the jar by 2 px = 0.007 m.
    assert {(c.name, c.kind, c.video, c.frame, c.box[0]) for c in changes} == {
        ("mug", "moved", "before", 1, 310.0),
        ("mug", "moved", "after", 1, 450.0),
        ("tin", "removed", "before", 1, 500.0),
        ("pan", "added", "after", 1, 200.0),
    }


def test_written_visits_are_a_known_geometry(root: Path, tmp_path: Path) -> None:
    out = tmp_path / "pair"
    assert obchange.main([str(root), "Den", "1", "2", "-o", str(out)]) == 0
    assert sorted(p.name for p in (out / "before").iterdir()) == ["view_00.png", "view_01.png"]
    assert len(json.loads((out / "boxes.json").read_text())["boxes"]) == 4
    before = obchange_visits.read_capture(obchange_visits.read_visit(root, "Den", 1), "before")
    after = obchange_visits.read_capture(obchange_visits.read_visit(root, "Den", 2), "after")
    geometry = KnownGeometry(out / "geometry.npz", 640)(before, after, tmp_path, silent)
    assert [view.key for view in geometry.views] == [
        ("before", 0), ("before", 1), ("after", 0), ("after", 1),
    ]  # fmt: skip
    view = geometry.views[0]
    np.testing.assert_allclose(view.intrinsics, obchange.INTRINSICS)
    assert np.nanmedian(view.depth) * geometry.unit == pytest.approx(1.980, abs=1e-3)
    assert not view.measured[:10].any()


def test_bad_input_is_one_sentence_and_leaves_nothing(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "pair"
    assert obchange.main([str(root), "Den", "1", "9", "-o", str(out)]) == 2
    assert "it has: Den 1, Den 2" in capsys.readouterr().err
    (root / "Den/scene1/0d.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match="8-bit depth"):
        obchange.write_visits(root, "Den", 1, 2, out)
    assert not out.exists()
    assert not (tmp_path / ".pair.part").exists()
    (root / "annotations.json").write_text("{}")
    with pytest.raises(InputError, match="not an annotation"):
        obchange_visits.read_visit(root, "Den", 1)
    with pytest.raises(InputError, match="cannot be read"):
        obchange_visits.read_visit(tmp_path / "nowhere", "Den", 1)


def test_a_folder_with_files_is_not_overwritten(root: Path) -> None:
    with pytest.raises(OutputError, match="not empty"):
        obchange.write_visits(root, "Den", 1, 2, root / "Den")


def test_real_visits_agree_with_what_is_known_of_them(real_data: Path) -> None:
    root = real_data / "obchange_gh30"
    second, third = (obchange_visits.read_visit(root, "Kitchen", k) for k in (2, 3))
    assert len(second) == len(third) == 6
    kinds = {c.name: c.kind for c in obchange.changed_boxes(second, third)}
    assert kinds["soup_can"] == "removed"
    assert kinds["plate"] == "added"
    assert kinds["sugar_box"] == "moved"
    assert not {"illy_tin", "soap_bottle", "cleaner"} & set(kinds)


def test_the_negative_controls_have_no_changes(real_data: Path) -> None:
    # Beside these objects, boxes of other views of the same visits do change.
    root = real_data / "obchange_gh30"
    third, fourth = (obchange_visits.read_visit(root, "SmallRoom", k) for k in (3, 4))
    changes = obchange.changed_boxes(third, fourth)
    assert not [c for c in changes if c.frame in (0, 2, 4, 6, 7)]


def test_chosen_views_keep_what_all_views_tell(root: Path, tmp_path: Path) -> None:
    obchange.write_visits(root, "Den", 1, 2, tmp_path / "one", [1])
    boxes = json.loads((tmp_path / "one/boxes.json").read_text())["boxes"]
    assert {(b["name"], b["frame"]) for b in boxes} == {("mug", 0), ("tin", 0), ("pan", 0)}
    obchange.write_visits(root, "Den", 1, 2, tmp_path / "other", [0])
    assert json.loads((tmp_path / "other/boxes.json").read_text()) == {"boxes": []}
    with pytest.raises(InputError, match="Den 1 has no view 7"):
        obchange.write_visits(root, "Den", 1, 2, tmp_path / "none", [7])
