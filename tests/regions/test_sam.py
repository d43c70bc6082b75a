"""SAM regions against the published post-processing, on tiny models of the real classes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("transformers")

import torch
import transformers

from scenediff_classic import devices
from scenediff_classic.errors import InputError
from scenediff_classic.protocols import RegionProposer
from scenediff_classic.regions.sam import Proposals, SamRegions, distinct, in_pixels, painted
from scenediff_classic.types import View
from tests.learned_models import MEAN, SAM_KINDS, SAM_SIDE, STD, BrightChannels, answered_by, sam
from tests.plane_scene import BOOK, VASE, render

ALL = {"points_per_side": 4, "min_score": -100.0, "min_stability": 0.0}
"""Options that let the masks of a random model pass."""


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {kind: sam(kind, tmp_path_factory.mktemp(kind)) for kind in SAM_KINDS}


@pytest.fixture(scope="module", params=SAM_KINDS)
def folder(request: pytest.FixtureRequest, folders: dict[str, Path]) -> Path:
    return folders[request.param]


@pytest.fixture(scope="module")
def view() -> View:
    return render([VASE, BOOK], "before", 0, (0.0, 0.0, 0.0), width=131, height=97)


def test_regions_are_numbered_without_gaps(folder: Path, view: View) -> None:
    regions = SamRegions(str(folder), **ALL, min_area=20.0)
    assert isinstance(regions, RegionProposer)
    found = regions(view)
    assert found.labels.shape == view.shape
    assert found.labels.dtype == np.int32
    assert found.count > 1
    sizes = np.bincount(found.labels[found.labels >= 0])
    assert len(sizes) == found.count
    assert sizes.min() >= 20 * (131 / 518) ** 2
    np.testing.assert_array_equal(regions(view).labels, found.labels)


@pytest.mark.parametrize("size", [(97, 131), (131, 97), (64, 64), (31, 200)])
def test_masks_are_those_of_the_models_own_processor(
    folders: dict[str, Path], size: tuple[int, int]
) -> None:
    """SAM as published: pixels, prompts and masks of its processor, and of ours."""
    height, width = size
    rng = np.random.default_rng(3)
    image = np.kron(
        rng.integers(0, 255, (height // 10 + 1, width // 10 + 1, 3)), np.ones((10, 10, 1))
    )
    image = image[:height, :width].astype(np.uint8)
    processor = transformers.SamProcessor(
        transformers.SamImageProcessorPil(
            size={"longest_edge": SAM_SIDE}, pad_size={"height": SAM_SIDE, "width": SAM_SIDE},
            image_mean=MEAN, image_std=STD,
        )
    )  # fmt: skip
    steps = (np.arange(3) + 0.5) / 3
    half_y, half_x = (0.5 * n / int(n * SAM_SIDE / max(size) + 0.5) for n in size)
    points = [[x * width - half_x, y * height - half_y] for y in steps for x in steps]
    inputs = processor(image, input_points=[[[p] for p in points]], return_tensors="pt")
    model = transformers.SamModel.from_pretrained(folders["sam"]).eval()
    with torch.no_grad():
        answer = model(**{k: inputs[k].float() for k in ("pixel_values", "input_points")})
    expected = processor.post_process_masks(
        answer.pred_masks, inputs["original_sizes"], inputs["reshaped_input_sizes"]
    )[0].flatten(0, 1)
    scores = answer.iou_scores.flatten().numpy()
    ours = SamRegions(str(folders["sam"]), **ALL | {"points_per_side": 3}).propose(image)
    assert len(ours.scores) > 9
    for score, logits in zip(ours.scores, ours.logits, strict=True):
        mask = in_pixels(logits, ours.extent, size)
        alike = [np.mean(m.numpy() == mask) for m in expected[np.abs(scores - score) < 1e-3]]
        assert max(alike) > 0.95  # the masks are noise, and theirs are interpolated twice


def test_the_size_of_the_chunks_does_not_matter(folder: Path, view: View) -> None:
    whole = SamRegions(str(folder), **ALL)
    parts = replace(whole, chunk=5)
    a, b = whole.propose(view.image), parts.propose(view.image)
    np.testing.assert_allclose(a.scores, b.scores, atol=1e-4)
    np.testing.assert_allclose(a.logits, b.logits, rtol=0.01, atol=0.01)
    assert np.mean(whole(view).labels == parts(view).labels) > 0.99


@pytest.mark.parametrize("size", [(60, 80), (95, 71), (128, 128), (40, 301)])
def test_regions_lie_where_things_are(folder: Path, size: tuple[int, int]) -> None:
    """Whether a model pads (SAM) or stretches (SAM 2), masks come in the picture's pixels."""
    height, width = size
    image = np.zeros((height, width, 3), np.uint8)
    wanted = np.zeros(size, bool)
    wanted[height // 2 :, width // 3 : 3 * width // 4] = True
    image[wanted, 0] = 255
    image[: height // 4, -width // 5 :, 1] = 255
    blank = render([], "before", 0, (0.0, 0.0, 0.0), width=width, height=height)
    seen = replace(blank, image=image)
    model = BrightChannels()
    found = answered_by(
        model, SamRegions(str(folder), points_per_side=4, chunk=3, min_stability=0.5)
    )(seen)
    assert found.count == 2
    assert model.calls == 6  # 16 points, 3 at a time
    label = found.labels[height - 1, width // 2]
    overlap = (found.labels == label) & wanted
    assert overlap.sum() / ((found.labels == label) | wanted).sum() > 0.85
    assert found.labels[0, width - 1] not in (-1, label)
    assert found.labels[height - 1, 0] == -1


def test_prompts_form_a_regular_grid_over_the_picture(folder: Path) -> None:
    regions = SamRegions(str(folder), points_per_side=2, chunk=3)
    chunks = list(regions._prompts(40, 80))
    assert [len(c) for c in chunks] == [3, 1]
    expected = [[20, 10], [60, 10], [20, 30], [60, 30]]
    np.testing.assert_allclose(np.concatenate(chunks) + 0.5, expected)


def test_doubtful_masks_are_dropped(folders: dict[str, Path]) -> None:
    sharp = np.where(np.arange(20) < 10, 5.0, -5.0)
    soft = np.linspace(3, -3, 20)  # cut at +1 and at -1, it differs by half
    none = np.full(20, -0.5)
    logits = torch.tensor(np.array([sharp, soft, none]))[None, :, None]
    scores = torch.tensor([[0.85, 0.95, 0.95]])

    def count(kind: str, **options) -> int:
        return len(SamRegions(str(folders[kind]), **options)._trusted(logits, scores)[1])

    assert count("sam", min_stability=0.4) == 1  # SAM's usual score is 0.88, ...
    assert count("sam2", min_stability=0.4) == 2  # ... SAM 2's is 0.8
    assert count("sam2") == 1
    assert count("sam", min_score=0.9) == 0


def test_of_nearly_equal_masks_the_best_is_kept() -> None:
    rng = np.random.default_rng(0)
    base = rng.random((6, 9, 11)) < 0.5
    masks = base[rng.integers(0, 6, 40)] ^ (rng.random((40, 9, 11)) < 0.08)
    scores = np.sort(rng.random(40).astype(np.float32))[::-1].copy()
    kept: list[int] = []
    for k in range(40):
        ious = [(masks[k] & masks[j]).sum() / (masks[k] | masks[j]).sum() for j in kept]
        if all(iou <= 0.7 for iou in ious):
            kept.append(k)
    assert 6 <= len(kept) < 40
    logits = np.where(masks, 1, -1).astype(np.float16)
    found = distinct(Proposals(logits, scores, (9.0, 11.0)), 0.7)
    np.testing.assert_array_equal(found.scores, scores[kept])
    np.testing.assert_array_equal(found.logits > 0, masks[kept])


def test_a_whole_hides_its_parts_and_small_rests_are_dropped() -> None:
    masks = np.zeros((4, 20, 20), bool)
    masks[0, 4:8, 4:8] = True  # a part of the second
    masks[1, 2:12, 2:12] = True
    masks[2, 11:17, 2:12] = True  # beside it, one row hidden
    masks[3, :, :19] = True  # the picture
    logits = np.where(masks, 5, -5).astype(np.float16)
    proposals = Proposals(logits, np.ones(4, np.float32), (20.0, 20.0))
    found = painted(proposals, (20, 20), 30, 0.9)
    expected = np.full((20, 20), -1)
    expected[11:17, 2:12] = 1
    expected[2:12, 2:12] = 0
    np.testing.assert_array_equal(found.labels, expected)
    assert found.count == 2
    assert painted(proposals, (20, 20), 60, 0.9).count == 1
    np.testing.assert_array_equal(painted(proposals, (20, 20), 30, 1.0).labels >= 0, masks[3])


def test_without_any_mask_there_are_no_regions(folder: Path, view: View) -> None:
    found = SamRegions(str(folder), points_per_side=2, min_score=1e9)(view)
    assert found.count == 0
    assert (found.labels == -1).all()


def test_devices(folders: dict[str, Path], view: View, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "cuda_available", lambda: False)
    found = SamRegions(str(folders["sam"]), "auto", **ALL)(view)
    np.testing.assert_array_equal(
        SamRegions(str(folders["sam"]), "cpu", **ALL)(view).labels, found.labels
    )
    with pytest.raises(InputError, match="no CUDA device"):
        SamRegions(str(folders["sam"]), "cuda")(view)


@pytest.mark.skipif(not devices.cuda_available(), reason="there is no CUDA device here")
def test_cuda_finds_nearly_the_same(folder: Path, view: View) -> None:
    on_cpu = SamRegions(str(folder), "cpu", **ALL).propose(view.image)
    on_cuda = SamRegions(str(folder), "cuda", **ALL).propose(view.image)
    np.testing.assert_allclose(on_cuda.scores, on_cpu.scores, atol=0.01)
