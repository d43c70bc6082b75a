"""KC-3D's layout, and its cameras and depth checked on its one rendered pair."""

import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from data_tools.benchmarks.kc3d import RenderedPhoto, read_kc3d, z_from_ray
from scenediff_classic.cameras import pixel_centres, project, sample, world_from_cam
from scenediff_classic.errors import InputError

NAMES = ("24478_831_2_0", "24478_831_2_1")


def _write_set(root: Path, poses: object, side: int = 256) -> None:
    """What the set has beside pictures and depth: masks, poses, the list of pairs."""
    record = {}
    for k, name in enumerate(NAMES, 1):
        mask = np.zeros((side, side), np.uint8)
        mask[1, k] = 255
        Image.fromarray(mask).save(root / f"mask_{name}.png")
        record |= {f"image{k}": f"{name}.png", f"depth{k}": f"depth_{name}.tiff"}
        record[f"mask{k}"] = f"mask_{name}.png"
    np.save(root / "24478_831_2.npy", np.array(poses, dtype=object), allow_pickle=True)
    (root / "data_split.pkl").write_bytes(pickle.dumps({"train": [record], "test": []}))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    for name in NAMES:
        picture = rng.integers(0, 255, (8, 8, 3), dtype=np.uint8)
        Image.fromarray(picture).save(tmp_path / f"{name}.png")
        depth = np.full((8, 8), 3, np.float32)
        depth[0, 0] = 0
        Image.fromarray(depth).save(tmp_path / f"depth_{name}.tiff")
    lens = np.array([[1.0, 0, -0.5], [0, -1.0, -0.5], [0, 0, -1.0]], np.float32)
    poses = {
        "intrinsics": lens,
        "positions": np.array([[0, 0, 5], [1, 0, 5]], np.float32),
        "rotations": [np.eye(3, dtype=np.float32)] * 2,
    }
    _write_set(tmp_path, poses, 8)
    return tmp_path


def test_pairs_of_a_split(root: Path) -> None:
    found = read_kc3d(root)
    assert list(found.pairs("test")) == []
    ((first, second),) = found.pairs("train", "z")
    assert (first.name, second.name) == NAMES
    assert np.argwhere(first.changed).tolist() == [[1, 1]]
    assert np.argwhere(second.changed).tolist() == [[1, 2]]
    assert np.isnan(first.depth[0, 0])
    assert first.depth[3, 3] == 3
    ((along, _),) = found.pairs("train")  # reading again finds the same, depth apart
    assert np.array_equal(along.image, first.image)
    assert 2.5 < along.depth[3, 3] < 3
    # the second camera stands one to the right of the first
    across = second.cam_from_world @ np.linalg.inv(first.cam_from_world)
    assert np.allclose(across[:3, 3], [-1, 0, 0])
    with pytest.raises(InputError, match="no split 'val'"):
        list(found.pairs("val"))


def test_files_that_are_not_trusted(root: Path) -> None:
    mark = root / "mark"

    class Attack:
        def __reduce__(self) -> tuple[object, tuple[str, str]]:
            return open, (str(mark), "w")

    kept = (root / "24478_831_2.npy").read_bytes()
    np.save(root / "24478_831_2.npy", np.array({"a": Attack()}, object), allow_pickle=True)
    with pytest.raises(InputError, match="was refused"):
        list(read_kc3d(root).pairs("train"))
    assert not mark.exists()
    (root / "24478_831_2.npy").write_bytes(kept[:100])
    with pytest.raises(InputError, match="damaged or cut short"):
        list(read_kc3d(root).pairs("train"))
    np.save(root / "24478_831_2.npy", np.array({"intrinsics": 3}, object), allow_pickle=True)
    with pytest.raises(InputError, match="holds no camera 0"):
        list(read_kc3d(root).pairs("train"))
    np.save(root / "24478_831_2.npy", np.array(["text"]))
    with pytest.raises(InputError, match="NumPy type"):
        list(read_kc3d(root).pairs("train"))
    record = pickle.loads((root / "data_split.pkl").read_bytes())
    record["train"][0]["image1"] = "../../etc/passwd"
    (root / "data_split.pkl").write_bytes(pickle.dumps(record))
    with pytest.raises(InputError, match="outside this folder"):
        list(read_kc3d(root).pairs("train"))
    (root / "data_split.pkl").write_bytes(pickle.dumps([1]))
    with pytest.raises(InputError, match="list of pairs"):
        read_kc3d(root)


def test_depth_along_rays() -> None:
    lens = np.array([[10.0, 0, 2], [0, 10.0, 2], [0, 0, 1]])
    z = z_from_ray(np.full((4, 4), 3, np.float32), lens)
    assert z[1, 1] == pytest.approx(3 / np.sqrt(1 + 2 * 0.05**2))


def test_the_rendered_pair_agrees_with_itself(real_data: Path, tmp_path: Path) -> None:
    folder = real_data / "cyws3d_ship_pair" / "kc3d_synthetic"
    for name in NAMES:
        shutil.copy(folder / f"{name}.png", tmp_path)
        shutil.copy(folder / f"depth_{name}.tiff", tmp_path)

    def both(what: str) -> list[np.ndarray]:
        return [np.load(folder / f"{what}{k}.npy") for k in (1, 2)]

    # the pair came with its cameras in files of their own: here as the set keeps them
    poses = {"intrinsics": both("intrinsics"), "positions": both("position")}
    _write_set(tmp_path, {**poses, "rotations": both("rotation")})

    def off(pair: tuple[RenderedPhoto, RenderedPhoto]) -> float:
        """Median disagreement of the second depth with the first one carried over."""
        first, second = pair
        rays = np.concatenate([pixel_centres(256, 256), np.ones((256, 256, 1))], -1)
        points = (rays @ np.linalg.inv(first.intrinsics).T) * first.depth[..., None]
        to_world = world_from_cam(first.cam_from_world)
        world = points @ to_world[:3, :3].T + to_world[:3, 3]
        xy, z = project(world, second.intrinsics, second.cam_from_world)
        return float(np.nanmedian(np.abs(sample(second.depth, xy, nearest=True) / z - 1)))

    (along_rays,) = read_kc3d(tmp_path).pairs("train", "ray")
    (along_axis,) = read_kc3d(tmp_path).pairs("train", "z")
    assert off(along_rays) < 0.02
    assert off(along_rays) < off(along_axis)
