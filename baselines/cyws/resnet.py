"""Residual encoders in plain PyTorch, with torchvision's names of weights."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn


class BasicBlock(nn.Module):
    """Two 3x3 convolutions beside a shortcut (ResNet-18 and -34)."""

    expansion = 1

    def __init__(self, inside: int, width: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inside, width, 3, stride, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, 3, 1, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(width)
        self.downsample = _downsample(inside, width, stride)

    def forward(self, x: Tensor) -> Tensor:
        """Residual step."""
        y = torch.relu(self.bn1(self.conv1(x)))
        y = self.bn2(self.conv2(y))
        return torch.relu(y + (x if self.downsample is None else self.downsample(x)))


class Bottleneck(nn.Module):
    """A 3x3 convolution between two 1x1 ones (ResNet-50 and deeper)."""

    expansion = 4

    def __init__(self, inside: int, width: int, stride: int) -> None:
        super().__init__()
        outside = width * self.expansion
        self.conv1 = nn.Conv2d(inside, width, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, 3, stride, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(width)
        self.conv3 = nn.Conv2d(width, outside, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(outside)
        self.downsample = _downsample(inside, outside, stride)

    def forward(self, x: Tensor) -> Tensor:
        """Residual step."""
        y = torch.relu(self.bn1(self.conv1(x)))
        y = torch.relu(self.bn2(self.conv2(y)))
        y = self.bn3(self.conv3(y))
        return torch.relu(y + (x if self.downsample is None else self.downsample(x)))


def _downsample(inside: int, outside: int, stride: int) -> nn.Sequential | None:
    if stride == 1 and inside == outside:
        return None
    conv = nn.Conv2d(inside, outside, 1, stride, bias=False)
    return nn.Sequential(conv, nn.BatchNorm2d(outside))


class ResNet(nn.Module):
    """Features at strides 2, 4, 8, 16 and 32.

    Parameters
    ----------
    blocks : four ints
        Residual blocks of each layer.
    width : int
        Channels of the stem; 64 as published.
    bottleneck : bool
        Bottleneck blocks instead of basic ones.
    """

    def __init__(self, blocks: Sequence[int], width: int = 64, *, bottleneck: bool = False) -> None:
        super().__init__()
        block = Bottleneck if bottleneck else BasicBlock
        self.conv1 = nn.Conv2d(3, width, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.channels = [width]
        """Of each level, shallow to deep."""
        inside = width
        for level, count in enumerate(blocks):
            wide, steps = width << level, []
            for k in range(count):
                steps.append(block(inside, wide, 2 if k == 0 and level else 1))
                inside = wide * block.expansion
            setattr(self, f"layer{level + 1}", nn.Sequential(*steps))
            self.channels.append(inside)
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, x: Float[Tensor, "b 3 h w"]) -> list[Tensor]:
        """The levels, shallow to deep."""
        x = torch.relu(self.bn1(self.conv1(x)))
        levels = [x]
        x = torch.max_pool2d(x, 3, 2, 1)
        for level in range(1, 5):
            x = getattr(self, f"layer{level}")(x)
            levels.append(x)
        return levels
