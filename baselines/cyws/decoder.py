"""From a feature pyramid to boxes: a U-Net decoder with scSE attention, and the CenterNet head."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn


class _ScSe(nn.Module):
    """Concurrent spatial and channel squeeze and excitation (Roy et al. 2018)."""

    def __init__(self, channels: int, reduction: int) -> None:
        super().__init__()
        inner = max(channels // reduction, 1)
        self.cSE = nn.Sequential(
            nn.AdaptiveAvgPool2d(1),
            nn.Conv2d(channels, inner, 1),
            nn.ReLU(),
            nn.Conv2d(inner, channels, 1),
            nn.Sigmoid(),
        )
        self.sSE = nn.Sequential(nn.Conv2d(channels, 1, 1), nn.Sigmoid())

    def forward(self, x: Tensor) -> Tensor:
        return x * self.cSE(x) + x * self.sSE(x)


class _Attention(nn.Module):
    """One more level in the names of weights, as published."""

    def __init__(self, channels: int, reduction: int) -> None:
        super().__init__()
        self.attention = _ScSe(channels, reduction)

    def forward(self, x: Tensor) -> Tensor:
        return self.attention(x)


def _conv_bn_relu(inside: int, outside: int) -> nn.Sequential:
    conv = nn.Conv2d(inside, outside, 3, 1, 1, bias=False)
    return nn.Sequential(conv, nn.BatchNorm2d(outside), nn.ReLU())


class _Block(nn.Module):
    """Twice as fine: enlarge, concatenate the skipped level, attend, convolve twice, attend."""

    def __init__(self, inside: int, skip: int, outside: int, *, attend: bool, reduction: int):
        super().__init__()
        self.conv1 = _conv_bn_relu(inside + skip, outside)
        self.conv2 = _conv_bn_relu(outside, outside)
        self.attention1 = _Attention(inside + skip, reduction) if attend else nn.Identity()
        self.attention2 = _Attention(outside, reduction) if attend else nn.Identity()

    def forward(self, x: Tensor, skip: Tensor | None) -> Tensor:
        if skip is None:
            x = nn.functional.interpolate(x, scale_factor=2.0, mode="nearest")
        else:
            x = nn.functional.interpolate(x, size=skip.shape[-2:], mode="nearest")
            x = torch.cat([x, skip], 1)
        return self.attention2(self.conv2(self.conv1(self.attention1(x))))


class UNetDecoder(nn.Module):
    """Blocks from the deepest level up.

    Parameters
    ----------
    levels : sequence of int
        Channels of the pyramid, shallow to deep.
    widths : sequence of int
        Channels after each block; where there are more blocks than levels to skip to, the last
        ones enlarge alone. The last block has no attention.
    """

    def __init__(self, levels: Sequence[int], widths: Sequence[int], reduction: int = 16) -> None:
        super().__init__()
        skips = [*levels[-2::-1], *[0] * len(widths)][: len(widths)]
        inside = [levels[-1], *widths[:-1]]
        self.blocks = nn.ModuleList(
            _Block(a, skip, b, attend=k + 1 < len(widths), reduction=reduction)
            for k, (a, skip, b) in enumerate(zip(inside, skips, widths, strict=True))
        )

    def forward(self, levels: Sequence[Tensor]) -> Tensor:
        """The finest map."""
        x, skips = levels[-1], list(levels[-2::-1])
        for k, block in enumerate(self.blocks):
            x = block(x, skips[k] if k < len(skips) else None)
        return x


@dataclass(frozen=True)
class HeadMaps:
    """What the head says of one picture (or a batch), on its grid.

    `heat` holds logits; sizes and offsets are in cells of the grid.
    """

    heat: Float[Tensor, "b 1 h w"]
    size: Float[Tensor, "b 2 h w"]
    """Width and height of the box whose centre lies in the cell."""
    offset: Float[Tensor, "b 2 h w"]
    """From the cell's corner to the centre, 0 to 1."""


class CenterNetHead(nn.Module):
    """Heat map of centres, sizes and offsets (Zhou et al. 2019)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        # the heat is a tenth everywhere, before anything is learnt
        self.heatmap_head = self._branch(channels, 1, bias=-2.197)
        self.wh_head = self._branch(channels, 2, std=0.001)
        self.offset_head = self._branch(channels, 2, std=0.001)

    @staticmethod
    def _branch(
        channels: int, outside: int, bias: float = 0.0, std: float | None = None
    ) -> nn.Sequential:
        last = nn.Conv2d(channels, outside, 1)
        nn.init.constant_(last.bias, bias)  # pyright: ignore[reportArgumentType]
        if std is not None:
            nn.init.normal_(last.weight, std=std)
        return nn.Sequential(nn.Conv2d(channels, channels, 3, 1, 1), nn.ReLU(), last)

    def forward(self, x: Tensor) -> HeadMaps:
        """The three maps."""
        return HeadMaps(self.heatmap_head(x), self.wh_head(x), self.offset_head(x))
