"""Box prompts reach a model of the real class as its own processor would send them."""

from pathlib import Path

import numpy as np
import pytest
import torch
import transformers

from baselines.splat_change.sam_boxes import SamBoxes
from baselines.splat_change.segmenting import BoxSegmenter
from tests.learned_models import MEAN, SAM_KINDS, SAM_SIDE, STD, sam
from tests.plane_scene import VASE, render

BOX = (30, 20, 90, 70)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("sam")
    return {kind: sam(kind, root / kind) for kind in SAM_KINDS}


@pytest.mark.parametrize("kind", SAM_KINDS)
def test_masks_have_the_pictures_size(folders: dict[str, Path], kind: str) -> None:
    image = render([VASE], "before", 0, (0.0, 0.0, 0.0)).image
    boxes = SamBoxes(str(folders[kind]), "cpu")
    assert isinstance(boxes, BoxSegmenter)
    first, again = boxes(image, BOX), boxes(image, BOX)
    assert first.mask.shape == image.shape[:2]
    assert 0 <= first.score <= 1
    assert np.array_equal(first.mask, again.mask)
    assert boxes.files


def test_same_mask_as_the_models_own_processor(folders: dict[str, Path]) -> None:
    image = render([VASE], "before", 0, (0.0, 0.0, 0.0)).image
    processor = transformers.SamProcessor(
        transformers.SamImageProcessorPil(
            size={"longest_edge": SAM_SIDE}, pad_size={"height": SAM_SIDE, "width": SAM_SIDE},
            image_mean=MEAN, image_std=STD,
        )
    )  # fmt: skip
    inputs = processor(image, input_boxes=[[list(map(float, BOX))]], return_tensors="pt")
    model = transformers.SamModel.from_pretrained(folders["sam"]).eval()
    boxes = inputs["input_boxes"].float()
    with torch.inference_mode():
        answer = model(
            pixel_values=inputs["pixel_values"], input_boxes=boxes, multimask_output=False
        )
    (masks,) = processor.post_process_masks(
        answer.pred_masks, inputs["original_sizes"], inputs["reshaped_input_sizes"]
    )
    ours = SamBoxes(str(folders["sam"]), "cpu")(image, BOX)
    assert np.mean(ours.mask == masks[0, 0].numpy()) > 0.97  # it interpolates twice, we once
    foreseen = float(answer.iou_scores[0, 0, 0])
    assert ours.score == pytest.approx(min(max(foreseen, 0), 1), abs=1e-3)
