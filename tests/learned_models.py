"""Folders with tiny models of the real classes, weights drawn at random, as users have them."""

import json
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import torch
import transformers

from scenediff_classic.regions.sam import SamRegions

MEAN, STD = [0.4, 0.5, 0.6], [0.2, 0.25, 0.3]

DINO_KINDS = ("dinov2", "dinov2_with_registers", "dinov3_vit")
SAM_KINDS = ("sam", "sam2", "sam2_video")

SAM_SIDE = 128
"""Side of the square input of the tiny SAM models."""


def save(model: Any, folder: Path, **processor: Any) -> Path:
    """Write the model and its processor's options."""
    model.save_pretrained(folder)
    options = {"image_mean": MEAN, "image_std": STD, "rescale_factor": 1 / 255, "resample": 2}
    (folder / "preprocessor_config.json").write_text(json.dumps(options | processor))
    return folder


def dino(kind: str, folder: Path) -> Path:
    """A folder with a DINO model."""
    torch.manual_seed(1)
    sizes = {"hidden_size": 32, "num_hidden_layers": 2, "num_attention_heads": 2}
    if kind == "dinov2":
        options = transformers.Dinov2Config(image_size=56, patch_size=14, **sizes)
        model = transformers.Dinov2Model(options)
    elif kind == "dinov2_with_registers":
        options = transformers.Dinov2WithRegistersConfig(
            image_size=56, patch_size=14, num_register_tokens=4, **sizes
        )
        model = transformers.Dinov2WithRegistersModel(options)
    else:
        options = transformers.DINOv3ViTConfig(
            image_size=64, patch_size=16, intermediate_size=64, num_register_tokens=3, **sizes
        )
        model = transformers.DINOv3ViTModel(options)
    return save(model, folder)


def sam(kind: str, folder: Path) -> Path:
    """A folder with a SAM model."""
    torch.manual_seed(2)
    model = _sam() if kind == "sam" else _sam2(kind)
    with torch.no_grad():  # as they are drawn, all logits are nearly 0
        for weights in model.mask_decoder.parameters():
            if weights.dim() > 1:
                weights.mul_(15)
    return save(model, folder)


def _sam() -> Any:
    vision = transformers.SamVisionConfig(
        image_size=SAM_SIDE, hidden_size=32, output_channels=32, num_hidden_layers=2,
        num_attention_heads=2, mlp_dim=64, num_pos_feats=16, window_size=4,
        global_attn_indexes=[1], initializer_range=0.02,
    )  # fmt: skip
    prompts = transformers.SamPromptEncoderConfig(
        hidden_size=32, image_size=SAM_SIDE, image_embedding_size=SAM_SIDE // 16
    )
    return transformers.SamModel(
        transformers.SamConfig(
            vision_config=vision, prompt_encoder_config=prompts,
            mask_decoder_config=transformers.SamMaskDecoderConfig(**_decoder()),
        )
    )  # fmt: skip


def _sam2(kind: str) -> Any:
    backbone = transformers.Sam2HieraDetConfig(
        image_size=[SAM_SIDE, SAM_SIDE], hidden_size=8, num_attention_heads=1,
        blocks_per_stage=[1, 1, 2, 1], embed_dim_per_stage=[8, 16, 32, 64],
        num_attention_heads_per_stage=[1, 2, 2, 2], window_size_per_stage=[4, 4, 4, 4],
        global_attention_blocks=[3],
    )  # fmt: skip
    vision = transformers.Sam2VisionConfig(
        backbone_config=backbone, backbone_channel_list=[64, 32, 16, 8], fpn_hidden_size=32,
        backbone_feature_sizes=[[SAM_SIDE // n, SAM_SIDE // n] for n in (4, 8, 16)],
    )  # fmt: skip
    prompts = {"hidden_size": 32, "image_size": SAM_SIDE}
    if kind == "sam2":
        options = transformers.Sam2Config(
            vision_config=vision, prompt_encoder_config=prompts, mask_decoder_config=_decoder()
        )
        return transformers.Sam2Model(options)
    video = transformers.Sam2VideoConfig(
        vision_config=vision, prompt_encoder_config=prompts, mask_decoder_config=_decoder(),
        image_size=SAM_SIDE, memory_attention_hidden_size=32, memory_attention_num_layers=1,
        memory_attention_feed_forward_hidden_size=32, memory_encoder_hidden_size=32,
        memory_encoder_output_channels=16, mask_downsampler_embed_dim=32,
        memory_fuser_embed_dim=32, memory_fuser_intermediate_dim=32, memory_fuser_num_layers=1,
    )  # fmt: skip
    return transformers.Sam2VideoModel(video)


def _decoder() -> dict[str, Any]:
    return {
        "hidden_size": 32, "mlp_dim": 64, "num_attention_heads": 2, "iou_head_hidden_dim": 32,
    }  # fmt: skip


@dataclass
class BrightChannels:
    """Stands for a SAM model: the three masks are where the channels of its input are bright."""

    side: int = 64
    calls: int = 0

    def __post_init__(self) -> None:
        """Say the size of the input where models say it."""
        self.config = SimpleNamespace(prompt_encoder_config=SimpleNamespace(image_size=self.side))

    def get_image_embeddings(self, pixels: torch.Tensor) -> torch.Tensor:
        """The picture itself."""
        assert pixels.shape == (1, 3, self.side, self.side)
        return pixels

    def __call__(self, image_embeddings, input_points, multimask_output):
        """The same masks for every prompt."""
        assert multimask_output
        self.calls += 1
        count = input_points.shape[1]
        logits = 20 * image_embeddings.repeat(count, 1, 1, 1)[None]
        scores = torch.tensor([[0.99, 0.95, 0.3]]).repeat(count, 1)[None]
        return SimpleNamespace(pred_masks=logits, iou_scores=scores)


def answered_by(model: BrightChannels, regions: SamRegions) -> SamRegions:
    """The plug-in with its model replaced."""
    regions.__dict__["_model"] = model, "cpu"
    return regions
