"""CYWS-2D (co-attention) and CYWS-3D (register and difference), with the published names of
weights.

Both take pictures as RGB from 0 to 1, ``(b, 2, 3, h, w)``, and give head maps of all ``2b``
pictures: first and second of the first pair, first and second of the next one, and so on.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from baselines.cyws.decoder import CenterNetHead, HeadMaps, UNetDecoder
from baselines.cyws.dino_vit import DinoViT
from baselines.cyws.registration import Registration, plain_difference
from baselines.cyws.resnet import ResNet

IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


def _normalised(pictures: Tensor) -> Tensor:
    mean, std = (pictures.new_tensor(v).reshape(3, 1, 1) for v in (IMAGENET_MEAN, IMAGENET_STD))
    return (pictures - mean) / std


# --- 2D -----------------------------------------------------------------------------------------


class _AttentionLayer(nn.Module):
    def __init__(self, channels: int, hidden: int) -> None:
        super().__init__()
        self.query_dimensionality_reduction = nn.Conv2d(channels, hidden, 1)
        self.reference_dimensionality_reduction = nn.Conv2d(channels, hidden, 1)


class CoAttention(nn.Module):
    """Every place of a picture looks for itself in the other one, the same way in both.

    Parameters
    ----------
    subtract : bool
        Give what differs from the attended features in place of these: the same to a network
        that has learnt it, and easier to learn.
    """

    def __init__(self, channels: int, hidden: int, *, subtract: bool = False) -> None:
        super().__init__()
        self.attention_layer = _AttentionLayer(channels, hidden)
        self.subtract = subtract

    def forward(self, features: Float[Tensor, "b 2 c h w"]) -> tuple[Tensor, Tensor]:
        """Own features beside the attended ones (b, 2, 2c, h, w), and logits (b, 2, n, n)."""
        b, _, c, h, w = features.shape
        flat = features.flatten(0, 1)
        query = self.attention_layer.query_dimensionality_reduction(flat)
        key = self.attention_layer.reference_dimensionality_reduction(flat)
        query = query.reshape(b, 2, -1, h * w).transpose(2, 3)
        logits = query @ key.reshape(b, 2, -1, h * w).flip(1)
        values = features.reshape(b, 2, c, h * w).transpose(2, 3).flip(1)
        attended = (logits.softmax(-1) @ values).transpose(2, 3).reshape(features.shape)
        beside = features - attended if self.subtract else attended
        return torch.cat([features, beside], 2), logits


class _UNet(nn.Module):
    def __init__(self, encoder: ResNet, decoder: UNetDecoder) -> None:
        super().__init__()
        self.encoder, self.decoder = encoder, decoder


class Cyws2D(nn.Module):
    """Co-attention on the deepest levels, then decode either picture.

    Parameters
    ----------
    widths : sequence of int
        Channels of the decoder's blocks: five end at the input's resolution, four at half of it.
    hidden : sequence of int
        Channels in which places are compared, deepest level first: one for each level with
        co-attention (three as published).
    subtract : bool
        See `CoAttention`.
    """

    def __init__(
        self,
        encoder: ResNet,
        widths: Sequence[int] = (256, 256, 128, 128, 64),
        hidden: Sequence[int] = (256, 128, 64),
        *,
        imagenet: bool = False,
        subtract: bool = False,
    ) -> None:
        super().__init__()
        self.imagenet = imagenet
        deep = encoder.channels[: -len(hidden) - 1 : -1]
        self.coattention_modules = nn.ModuleList(
            CoAttention(c, d, subtract=subtract) for c, d in zip(deep, hidden, strict=True)
        )
        levels = [*encoder.channels[: -len(hidden)], *(2 * c for c in deep[::-1])]
        self.unet_model = _UNet(encoder, UNetDecoder(levels, widths))
        self.centernet_head = CenterNetHead(widths[-1])

    def forward(
        self, images: Float[Tensor, "b 2 3 h w"], registration: Registration | None = None
    ) -> HeadMaps:
        """The maps of all pictures; a registration is not used."""
        return self.with_attention(images)[0]

    def with_attention(
        self, images: Float[Tensor, "b 2 3 h w"]
    ) -> tuple[HeadMaps, list[tuple[tuple[int, int], Tensor]]]:
        """Also the grid and the logits (b, 2, n, n) of each co-attention, deepest first."""
        flat = images.flatten(0, 1)
        levels = self.unet_model.encoder(_normalised(flat) if self.imagenet else flat)
        logits = []
        for k, attend in enumerate(self.coattention_modules, start=1):
            paired = levels[-k].unflatten(0, (-1, 2))
            joined, seen = attend(paired)
            levels[-k] = joined.flatten(0, 1)
            logits.append((tuple(paired.shape[-2:]), seen))
        return self.centernet_head(self.unet_model.decoder(levels)), logits


# --- 3D -----------------------------------------------------------------------------------------


def _differences(levels: Sequence[Tensor], registration: Registration | None) -> list[Tensor]:
    paired = (level.unflatten(0, (-1, 2)) for level in levels)
    compare = plain_difference if registration is None else registration.difference
    return [compare(level).flatten(0, 1) for level in paired]


class Cyws3D(nn.Module):
    """Register and difference a residual encoder's levels, then decode."""

    def __init__(self, encoder: ResNet, widths: Sequence[int]) -> None:
        super().__init__()
        self.encoder = encoder
        self.decoder = UNetDecoder(encoder.channels, widths)
        self.centernet_head = CenterNetHead(widths[-1])

    def forward(
        self, images: Float[Tensor, "b 2 3 h w"], registration: Registration | None = None
    ) -> HeadMaps:
        """The maps of all pictures; no registration = pixels correspond as they are."""
        levels = self.encoder(_normalised(images.flatten(0, 1)))
        return self.centernet_head(self.decoder(_differences(levels, registration)))


class _Spatial(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(channels)

    def forward(self, tokens: Tensor, grid: tuple[int, int], size: tuple[int, int]) -> Tensor:
        x = self.norm(tokens).transpose(1, 2).unflatten(2, grid)
        return nn.functional.interpolate(x, size, mode="bicubic")


class _Backbone(nn.Module):
    def __init__(self, model: DinoViT, channels: int) -> None:
        super().__init__()
        self.model = model.requires_grad_(False)
        self.sequence_to_spatial = nn.ModuleList([_Spatial(channels), _Spatial(channels)])


class _Reduce(nn.Module):
    """A residual block that halves the grid."""

    def __init__(self, inside: int, outside: int, bias: bool) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inside, outside, 3, 2, 1, bias=bias)
        self.bn1 = nn.BatchNorm2d(outside)
        self.conv2 = nn.Conv2d(outside, outside, 3, 1, 1, bias=bias)
        self.bn2 = nn.BatchNorm2d(outside)
        shortcut = nn.Conv2d(inside, outside, 1, 2, bias=bias)
        self.shortcut = nn.Sequential(shortcut, nn.BatchNorm2d(outside))

    def forward(self, x: Tensor) -> Tensor:
        y = torch.relu(self.bn1(self.conv1(x)))
        return torch.relu(self.bn2(self.conv2(y)) + self.shortcut(x))


class _Fusion(nn.Module):
    def __init__(self, inside: int, between: int, outside: int, bias: bool) -> None:
        super().__init__()
        self._conv_bn_layer1 = self._layer(inside, between, bias)
        self._conv_bn_layer2 = self._layer(between, outside, bias)

    @staticmethod
    def _layer(inside: int, outside: int, bias: bool) -> nn.Sequential:
        conv = nn.Conv2d(inside, outside, 3, 1, 1, bias=bias)
        return nn.Sequential(conv, nn.BatchNorm2d(outside), nn.ReLU())

    def forward(self, x: Tensor) -> Tensor:
        return self._conv_bn_layer2(self._conv_bn_layer1(x))


class Cyws3DDino(nn.Module):
    """CYWS-3D as published: keys of a frozen DINO ViT-B/8, registered and differenced.

    Parameters
    ----------
    width : int
        Channels of the four residual blocks that halve the grid.
    bias : bool
        Whether the convolutions of those blocks and of the fusion have one (a checkpoint's names
        tell).
    """

    def __init__(
        self,
        backbone: DinoViT | None = None,
        width: int = 512,
        widths: Sequence[int] = (256, 256, 128, 128, 64),
        blocks: tuple[int, int] = (2, 11),
        *,
        bias: bool = False,
    ) -> None:
        super().__init__()
        vit = DinoViT() if backbone is None else backbone
        keys, self.taken = vit.norm.weight.numel(), blocks
        self.feature_backbone = _Backbone(vit, keys)
        self.unet_encoder = nn.ModuleList(
            _Reduce(keys if k == 0 else width, width, bias) for k in range(4)
        )
        self.unet_decoder = UNetDecoder([keys, *[width] * 4], widths)
        self.feature_fusion_block = _Fusion(widths[-1] + keys, 256, 64, bias)
        self.centernet_head = CenterNetHead(64)

    def forward(
        self, images: Float[Tensor, "b 2 3 h w"], registration: Registration | None = None
    ) -> HeadMaps:
        """The maps of all pictures, as fine as these."""
        flat = images.flatten(0, 1)
        size = flat.shape[-2], flat.shape[-1]
        vit = self.feature_backbone.model
        with torch.no_grad():
            early, late = vit(_normalised(flat), self.taken)
        grid = vit.grid(*size)
        even = tuple(-(-g // 16) * 16 for g in grid)  # 55 tokens become 64 cells
        spatial = self.feature_backbone.sequence_to_spatial
        levels = [spatial[1](late, grid, even)]
        for block in self.unet_encoder:
            levels.append(block(levels[-1]))
        decoded = self.unet_decoder(_differences(levels, registration))
        beside = spatial[0](early, grid, tuple(decoded.shape[-2:]))
        fused = self.feature_fusion_block(torch.cat([decoded, beside], 1))
        fine = nn.functional.interpolate(fused, size, mode="bicubic")
        return self.centernet_head(fine)
