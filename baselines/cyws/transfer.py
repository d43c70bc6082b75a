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
    blocks = learnt.decoder.blocks
    for k, (own, block) in enumerate(zip(network.unet_model.decoder.blocks, blocks, strict=True)):
        for part in ("conv2", "attention2", "conv1.1"):
            own.get_submodule(part).load_state_dict(block.get_submodule(part).state_dict())
        weight, source = (b.get_parameter("conv1.0.weight") for b in (own, block))
        weight.zero_()
        # what comes from below, then what is skipped to; of pairs (own, difference) the latter
        shift = channels[0] if k == 0 else 0
        deep = channels[0] if k == 0 else len(blocks[k - 1].get_parameter("conv2.0.weight"))
        weight[:, shift : shift + deep] = source[:, :deep]
        at = deep + shift
        if k + 1 < attending:
            skipped = channels[k + 1]
            weight[:, at + skipped : at + 2 * skipped] = source[:, deep:]
