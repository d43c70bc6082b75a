"""The frozen encoder of CYWS-3D: a plain ViT-B/8 with DINO's names of weights, giving keys."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn


class _Attention(nn.Module):
    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(width, 3 * width)
        self.proj = nn.Linear(width, width)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        b, n, c = x.shape
        q, k, v = self.qkv(x).chunk(3, -1)
        split = [t.reshape(b, n, self.heads, -1).transpose(1, 2) for t in (q, k, v)]
        mixed = nn.functional.scaled_dot_product_attention(*split)
        return self.proj(mixed.transpose(1, 2).reshape(b, n, c)), k


class _Mlp(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(width, 4 * width)
        self.fc2 = nn.Linear(4 * width, width)

    def forward(self, x: Tensor) -> Tensor:
        return self.fc2(nn.functional.gelu(self.fc1(x)))


class _Block(nn.Module):
    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(width, eps=1e-6)
        self.attn = _Attention(width, heads)
        self.norm2 = nn.LayerNorm(width, eps=1e-6)
        self.mlp = _Mlp(width)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        mixed, keys = self.attn(self.norm1(x))
        x = x + mixed
        return x + self.mlp(self.norm2(x)), keys


class _Patches(nn.Module):
    def __init__(self, width: int, patch: int) -> None:
        super().__init__()
        self.proj = nn.Conv2d(3, width, patch, patch)


class DinoViT(nn.Module):
    """Keys of some blocks, on the grid of patches.

    Parameters
    ----------
    patch, stride : int
        Side of a patch, and pixels from one to the next: patches overlap if it is smaller.
    trained_on : int
        Side of the pictures whose positions the weights hold.
    """

    def __init__(
        self,
        width: int = 768,
        depth: int = 12,
        heads: int = 12,
        patch: int = 8,
        stride: int = 4,
        trained_on: int = 224,
    ) -> None:
        super().__init__()
        self.patch, self.stride = patch, stride
        self.cls_token = nn.Parameter(torch.zeros(1, 1, width))
        places = (trained_on // patch) ** 2 + 1
        self.pos_embed = nn.Parameter(torch.zeros(1, places, width))
        self.patch_embed = _Patches(width, patch)
        self.blocks = nn.ModuleList(_Block(width, heads) for _ in range(depth))
        self.norm = nn.LayerNorm(width, eps=1e-6)

    def forward(
        self, x: Float[Tensor, "b 3 h w"], wanted: tuple[int, ...]
    ) -> list[Float[Tensor, "b n c"]]:
        """Keys of the wanted blocks, patch by patch (row by row), without the class token's."""
        proj = self.patch_embed.proj
        x = nn.functional.conv2d(x, proj.weight, proj.bias, stride=self.stride)
        rows, columns = x.shape[-2:]
        x = x.flatten(2).transpose(1, 2)
        x = torch.cat([self.cls_token.expand(len(x), -1, -1), x], 1)
        x = x + self._places(rows, columns)
        found: list[Tensor] = []
        for number, block in enumerate(self.blocks):
            x, keys = block(x)
            if number in wanted:
                found.append(keys[:, 1:])
            if len(found) == len(wanted):
                break
        return found

    def grid(self, height: int, width: int) -> tuple[int, int]:
        """Patches along a picture's sides."""
        return (height - self.patch) // self.stride + 1, (width - self.patch) // self.stride + 1

    def _places(self, rows: int, columns: int) -> Tensor:
        side = math.isqrt(self.pos_embed.shape[1] - 1)
        grid = self.pos_embed[:, 1:].reshape(1, side, side, -1).permute(0, 3, 1, 2)
        grid = nn.functional.interpolate(grid, (rows, columns), mode="bicubic")
        return torch.cat([self.pos_embed[:, :1], grid.flatten(2).transpose(1, 2)], 1)
