"""PASLCD: ten scenes, each with two sets of pictures from before the change.

Layout: ``<Scene>/Instance_1/{input_orig,input_orig_test,gt_mask}`` (or ``Instance_1/<Scene>/…``):
pictures before, pictures after, and a mask for each of the latter under the same stem.
``Instance_1`` has the light of the after pictures, ``Instance_2`` another light.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from data_tools.benchmarks.benchmark import BenchmarkPair
from data_tools.benchmarks.folder_checks import picture_files, picture_size
from data_tools.benchmarks.symmetric import symmetric_masks
from data_tools.benchmarks.truth_pictures import counts_by_picture, iou, mean, read_mask_picture
from scenediff_classic.detection_run import CaptureOptions
from scenediff_classic.errors import InputError
from scenediff_classic.evaluation.metrics import PixelCounts

LIGHTS = {"Instance_1": "similar light", "Instance_2": "different light"}
BEFORE, AFTER, TRUTH = "input_orig", "input_orig_test", "gt_mask"


@dataclass(frozen=True)
class SceneMasks:
    """What is kept of a judged pair."""

    scene: str
    light: str
    pictures: tuple[PixelCounts, ...]


@dataclass(frozen=True)
class PaslcdBenchmark:
    """Scenes times lights; only symmetric change is asked for."""

    root: Path
    name: str = "paslcd"

    @property
    def metrics(self) -> Mapping[str, str]:
        """IoU of each picture, averaged over a pair, then over a scene's lights, then scenes."""
        return {
            "miou": "mIoU",
            "miou_similar": "mIoU, similar light",
            "miou_different": "mIoU, different light",
        }

    def pairs(self) -> tuple[BenchmarkPair, ...]:
        """By scene, then by light; the group is the light."""
        folders = self._folders()
        if not folders:
            raise InputError(
                f"{self.root} holds no <Scene>/Instance_1/{AFTER}: is it PASLCD, unpacked?"
            )
        return tuple(_pair(scene, instance, folder) for scene, instance, folder in folders)

    def problems(self) -> tuple[str, ...]:
        """Everything that is wrong with any of the folders."""
        folders = self._folders()
        if not folders:
            return (f"{self.root} holds no <Scene>/Instance_1/{AFTER}: is it PASLCD, unpacked?",)
        found = [problem for _, _, folder in folders for problem in _problems(folder)]
        present = {(scene, instance) for scene, instance, _ in folders}
        for scene in sorted({scene for scene, _ in present}):
            for instance in LIGHTS:
                if (scene, instance) not in present:
                    found.append(f"{self.root}: scene '{scene}' has no {instance}.")
        return tuple(found)

    def statistics(self) -> Mapping[str, float]:
        """Scenes, pictures, and the mean share of changed pixels."""
        truths = [p for _, _, f in self._folders() for p in picture_files(f / TRUTH)]
        area = mean(float(read_mask_picture(path).mean()) for path in truths)
        return {
            "scenes": len({scene for scene, _, _ in self._folders()}),
            "pictures before": sum(len(picture_files(f / BEFORE)) for _, _, f in self._folders()),
            "pictures after": len(truths),
            "mean changed area": area or 0.0,
        }

    def judge(self, pair: BenchmarkPair, run: Path | None) -> SceneMasks:
        """Pixels of each after picture; see `symmetric_masks`."""
        assert pair.truth is not None
        truths = {path.stem: path for path in picture_files(pair.truth)}
        names, found = ({}, {}) if run is None else symmetric_masks(run)
        scene = pair.name.rpartition("_Instance_")[0]
        return SceneMasks(scene, pair.group, counts_by_picture(truths, names, found))

    def pool(self, judged: Sequence[SceneMasks]) -> dict[str, float | None]:
        """Scenes count alike, however many pictures they have."""
        lights = [LIGHTS["Instance_1"], LIGHTS["Instance_2"]]
        return {
            "miou": _over_scenes(judged),
            "miou_similar": _over_scenes([j for j in judged if j.light == lights[0]]),
            "miou_different": _over_scenes([j for j in judged if j.light == lights[1]]),
        }

    def _folders(self) -> list[tuple[str, str, Path]]:
        """(scene, instance, folder) of everything with after pictures, either way of nesting."""
        found = []
        for after in sorted(self.root.glob(f"*/*/{AFTER}")):
            inner, outer = after.parent, after.parent.parent
            if inner.name in LIGHTS:
                found.append((outer.name, inner.name, inner))
            elif outer.name in LIGHTS:
                found.append((inner.name, outer.name, inner))
        return sorted(found)


def _over_scenes(judged: Sequence[SceneMasks]) -> float | None:
    scenes: dict[str, list[float | None]] = {}
    for item in judged:
        scenes.setdefault(item.scene, []).append(mean(iou(c) for c in item.pictures))
    return mean(mean(values) for values in scenes.values())


def _pair(scene: str, instance: str, folder: Path) -> BenchmarkPair:
    return BenchmarkPair(
        f"{scene}_{instance}".replace(" ", "_"),
        CaptureOptions(folder / BEFORE),
        CaptureOptions(folder / AFTER),
        group=LIGHTS[instance],
        truth=folder / TRUTH,
        known_geometry=_joint_model(folder),
    )


def _joint_model(folder: Path) -> Path | None:
    """A COLMAP model of both sets with depth maps, as ``--geometry`` takes it; None without."""
    for model in (folder / "sparse" / "0", folder / "sparse"):
        named = any((model / f"cameras.{end}").is_file() for end in ("bin", "txt"))
        deep = any((d / "stereo" / "depth_maps").is_dir() for d in (folder, model, model.parent))
        if named and deep:
            return folder
    return None


def _problems(folder: Path) -> Iterator[str]:
    for part in (BEFORE, AFTER):
        files = picture_files(folder / part)
        if not files:
            yield f"{folder / part} holds no pictures."
        for path in files:
            if picture_size(path) is None:
                yield f"{path} cannot be read as a picture."
    shown = {path.stem: path for path in picture_files(folder / AFTER)}
    truths = {path.stem: path for path in picture_files(folder / TRUTH)}
    if not truths:
        yield f"{folder / TRUTH} holds no masks."
    for stem, path in truths.items():
        if stem not in shown:
            yield f"{path} belongs to no picture in {folder / AFTER}."
            continue
        size, expected = picture_size(path), picture_size(shown[stem])
        if size is None:
            yield f"{path} cannot be read as a picture."
        elif expected is not None and abs(size[0] * expected[1] - size[1] * expected[0]) > max(
            expected
        ):
            yield f"{path} has another shape than {shown[stem]}."
    for stem in shown.keys() - truths.keys() if truths else ():
        yield f"{shown[stem]} has no mask in {folder / TRUTH}."
