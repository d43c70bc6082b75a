"""A 2D network starts from a 3D one."""

import pytest
import torch

from baselines.cyws.networks import Cyws2D, Cyws3D
from baselines.cyws.resnet import ResNet
from baselines.cyws.transfer import start_from_3d
from scenediff_classic.errors import InputError

WIDTHS = (16, 16, 8, 8)


def _pair(width: int) -> tuple[Cyws2D, Cyws3D]:
    torch.manual_seed(0)
    flat = Cyws2D(ResNet((1, 1, 1, 1), 8), WIDTHS, (8, 8, 8, 8), imagenet=True, subtract=True)
    return flat, Cyws3D(ResNet((1, 1, 1, 1), width), WIDTHS)


def test_equal_differences_are_decoded_alike() -> None:
    flat, learnt = (network.eval() for network in _pair(8))
    start_from_3d(flat, learnt)
    channels = learnt.encoder.channels
    levels = [torch.randn(2, c, 64 >> k, 64 >> k) for k, c in enumerate(channels)]
    levels[0].zero_()  # the finest level has no co-attention
    own = [torch.randn_like(level) for level in levels]
    doubled = [own[0], *(torch.cat(p, 1) for p in zip(own[1:], levels[1:], strict=True))]
    for network in (flat.unet_model.decoder, learnt.decoder):
        for block in network.blocks:  # attention sees other inputs: leave it out
            block.attention1 = torch.nn.Identity()
    with torch.inference_mode():
        torch.testing.assert_close(
            flat.unet_model.decoder(doubled), learnt.decoder(levels), rtol=1e-4, atol=1e-5
        )


def test_other_widths_are_refused() -> None:
    with pytest.raises(InputError, match="same width"):
        start_from_3d(*_pair(4))
