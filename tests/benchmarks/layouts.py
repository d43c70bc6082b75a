"""Tiny folders in the published layouts of the benchmarks, and answers to them."""

import json
from pathlib import Path

import numpy as np
from PIL import Image

from scenediff_classic import masks
from scenediff_classic.dataset import AnnotatedPair, Prediction, write_annotations
from scenediff_classic.geometry.store import save_geometry
from scenediff_classic.types import Geometry
from tests.films import write_film

HEIGHT, WIDTH = 48, 64


def picture(path: Path, shade: int = 90, size: tuple[int, int] = (HEIGHT, WIDTH)) -> Path:
    """A plain picture."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size[::-1], (shade, 120, 30)).save(path)
    return path


def mask_picture(path: Path, mask: np.ndarray) -> Path:
    """A mask as black and white."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(mask.astype(np.uint8) * 255).save(path)
    return path


def scenediff(root: Path, truth: AnnotatedPair, pairs: tuple[str, ...] = ("one",)) -> Path:
    """Two captures of two seconds at 10 frames a second for each pair; the second is ``.MOV``."""
    for name in pairs:
        folder = root / "data" / name
        folder.mkdir(parents=True)
        times = range(0, 2000, 100)
        write_film(folder / "original_video1.mp4", times)
        write_film(folder / "original_video2.MOV", times)
        write_film(folder / "video1.mp4", [0])
        write_annotations(truth, folder)
    split(root, varied=pairs[:1], kitchen=pairs[1:])
    return root


def split(root: Path, varied: tuple[str, ...], kitchen: tuple[str, ...] = ()) -> None:
    """All pairs in ``val``."""
    (root / "splits").mkdir(exist_ok=True)
    for name in ("val", "test"):
        content = {"varied": list(varied), "kitchen": list(kitchen)} if name == "val" else {}
        content = content or {"varied": [], "kitchen": []}
        (root / "splits" / f"{name}_split.json").write_text(json.dumps(content))


def answer(
    run: Path,
    prediction: Prediction,
    after: tuple[str, ...],
    size: tuple[int, int],
    geometry: Geometry | None = None,
    before: tuple[str, ...] = ("a.png",),
) -> Path:
    """An output folder with ``changes.json``, and with a geometry if one is given."""
    run.mkdir(parents=True, exist_ok=True)
    objects = [
        {
            "id": i,
            "kind": item.kind,
            "views": [
                {
                    "video": v.video,
                    "frame": v.frame,
                    "confidence": v.confidence,
                    "rle": {"size": list(v.mask.size), "counts": v.mask.counts},
                }
                for v in item.views
            ],
        }
        for i, item in enumerate(prediction.objects)
    ]
    videos = {
        video: {
            "frames": [
                {"index": i, "name": name, "height": size[0], "width": size[1]}
                for i, name in enumerate(names)
            ]
        }
        for video, names in (("before", before), ("after", after))
    }
    content = {"schema": 1, "videos": videos, "objects": objects}
    (run / "changes.json").write_text(json.dumps(content))
    if geometry is not None:
        save_geometry(geometry, run / "geometry")
    return run


def block(x: int, y: int, wide: int, high: int, size: tuple[int, int] = (HEIGHT, WIDTH)):
    """A rectangle as a mask."""
    mask = np.zeros(size, bool)
    mask[y : y + high, x : x + wide] = True
    return mask


def rle(mask: np.ndarray):
    """Run lengths of a mask."""
    return masks.encode(mask)
