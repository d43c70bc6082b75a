"""RC-3D's layout, and KC-3D's cameras checked on its one rendered pair."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from data_tools.benchmarks.rc3d import kc3d_camera, read_rc3d, read_rc3d_depth, z_from_ray
from scenediff_classic.cameras import pixel_centres, project, sample, world_from_cam
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


def test_depth_along_rays() -> None:
    lens = np.array([[10.0, 0, 2], [0, 10.0, 2], [0, 0, 1]])
    z = z_from_ray(np.full((4, 4), 3, np.float32), lens)
    assert z[1, 1] == pytest.approx(3 / np.sqrt(1 + 2 * 0.05**2))


def test_the_rendered_pair_agrees_with_itself(real_data: Path) -> None:
    folder = real_data / "cyws3d_ship_pair" / "kc3d_synthetic"
    raw = [np.asarray(Image.open(folder / f"depth_24478_831_2_{k}.tiff")) for k in (0, 1)]
    names = ("intrinsics", "rotation", "position")
    stored = [[np.load(folder / f"{name}{k}.npy") for name in names] for k in (1, 2)]
    cameras = [kc3d_camera(*arrays, 256, 256) for arrays in stored]

    def off(depth: list[np.ndarray]) -> float:
        """Median disagreement of the second depth with the first one carried over."""
        (lens, pose), (other, other_pose) = cameras
        rays = np.concatenate([pixel_centres(256, 256), np.ones((256, 256, 1))], -1)
        points = (rays @ np.linalg.inv(lens).T) * depth[0][..., None]
        to_world = world_from_cam(pose)
        world = points @ to_world[:3, :3].T + to_world[:3, 3]
        xy, z = project(world, other, other_pose)
        return float(np.nanmedian(np.abs(sample(depth[1], xy, nearest=True) / z - 1)))

    along_rays = [z_from_ray(d, k) for d, (k, _) in zip(raw, cameras, strict=True)]
    assert off(along_rays) < 0.02
    assert off(along_rays) < off(raw)


def test_depth_of_the_real_pair(real_data: Path) -> None:
    depth = read_rc3d_depth(real_data / "cyws3d_ship_pair" / "depth_ship_0.png")
    assert depth.shape == (192, 256)
    assert 0.5 < np.nanmedian(depth) < 2
