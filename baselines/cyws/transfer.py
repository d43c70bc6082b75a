"""A small 2D network that starts from what the 3D one has learnt.

Both have the same encoder and head, and decoders that differ in what comes in: the 3D one sees
what differs after registration, the 2D one its own features and what differs after co-attention.
"""

import torch

from baselines.cyws.networks import Cyws2D, Cyws3D
from scenediff_classic.errors import InputError


@torch.no_grad()
def start_from_3d(network: Cyws2D, learnt: Cyws3D) -> None:
    """Copy encoder, head and decoder; inputs that the 3D network lacks begin without any effect.

    Raises
    ------
    InputError
        If the networks differ in width.
    """
    mine, other = network.unet_model.encoder, learnt.encoder
    if [p.shape for p in mine.parameters()] != [p.shape for p in other.parameters()]:
        raise InputError("The 2D and the 3D network must be of the same width.")
    mine.load_state_dict(other.state_dict())
    network.centernet_head.load_state_dict(learnt.centernet_head.state_dict())
    channels = other.channels[::-1]
    attending = len(network.coattention_modules)
    own_blocks, blocks = network.unet_model.decoder.blocks, learnt.decoder.blocks
    for k, (own, block) in enumerate(zip(own_blocks, blocks, strict=True)):
        own.conv2.load_state_dict(block.conv2.state_dict())
        own.attention2.load_state_dict(block.attention2.state_dict())
        own.conv1[1].load_state_dict(block.conv1[1].state_dict())
        weight, source = own.conv1[0].weight, block.conv1[0].weight
        weight.zero_()
        # what comes from below, then what is skipped to; of pairs (own, difference) the latter
        deep = channels[0] if k == 0 else blocks[k - 1].conv2[0].out_channels
        shift = channels[0] if k == 0 else 0
        weight[:, shift : shift + deep] = source[:, :deep]
        at = deep + shift
        if k + 1 < attending:
            skipped = channels[k + 1]
            weight[:, at + skipped : at + 2 * skipped] = source[:, deep:]
