"""Both networks: sizes, published layouts, and answers that no neighbour in a batch changes."""

from collections.abc import Iterator

import numpy as np
import pytest
import torch
from torch import Tensor

from baselines.cyws.dino_vit import DinoViT
from baselines.cyws.networks import Cyws2D, Cyws3D, Cyws3DDino
from baselines.cyws.presets import PRESETS, Architecture
from baselines.cyws.registration import Registration
from baselines.cyws.resnet import ResNet
from baselines.cyws.weights import fill, preset_of


def _conv(name: str, out: int, inside: int, side: int) -> dict[str, Tensor]:
    return {f"{name}.weight": torch.randn(out, inside, side, side) * 0.02}


def _with_bias(name: str, out: int, inside: int, side: int) -> dict[str, Tensor]:
    return {**_conv(name, out, inside, side), f"{name}.bias": torch.zeros(out)}


def _norm(name: str, channels: int) -> dict[str, Tensor]:
    ones, zeros = torch.ones(channels), torch.zeros(channels)
    return {
        f"{name}.weight": ones, f"{name}.bias": zeros, f"{name}.running_mean": zeros,
        f"{name}.running_var": ones, f"{name}.num_batches_tracked": torch.tensor(1),
    }  # fmt: skip


def _decoder(name: str, deepest: int, skips: tuple[int, ...]) -> Iterator[dict[str, Tensor]]:
    inside = deepest
    for k, (skip, out) in enumerate(zip(skips, (256, 256, 128, 128, 64), strict=True)):
        block = f"{name}.blocks.{k}"
        for conv, wide in (("conv1", inside + skip), ("conv2", out)):
            yield _conv(f"{block}.{conv}.0", out, wide, 3)
            yield _norm(f"{block}.{conv}.1", out)
        for attention, wide in (("attention1", inside + skip), ("attention2", out)):
            if k < 4:
                part = f"{block}.{attention}.attention"
                yield _with_bias(f"{part}.cSE.1", wide // 16, wide, 1)
                yield _with_bias(f"{part}.cSE.3", wide, wide // 16, 1)
                yield _with_bias(f"{part}.sSE.0", 1, wide, 1)
        inside = out


def _head() -> Iterator[dict[str, Tensor]]:
    for branch, out in (("heatmap", 1), ("wh", 2), ("offset", 2)):
        yield _with_bias(f"centernet_head.{branch}_head.0", 64, 64, 3)
        yield _with_bias(f"centernet_head.{branch}_head.2", out, 64, 1)


def _published_2d() -> dict[str, Tensor]:
    encoder = "unet_model.encoder"
    parts = [_conv(f"{encoder}.conv1", 64, 3, 7), _norm(f"{encoder}.bn1", 64)]
    inside = 64
    for layer, (blocks, wide) in enumerate(zip((3, 4, 6, 3), (64, 128, 256, 512), strict=True), 1):
        for k in range(blocks):
            block = f"{encoder}.layer{layer}.{k}"
            for number, (a, b, side) in enumerate(
                ((inside, wide, 1), (wide, wide, 3), (wide, 4 * wide, 1)), 1
            ):
                parts += [
                    _conv(f"{block}.conv{number}", b, a, side),
                    _norm(f"{block}.bn{number}", b),
                ]
            if k == 0:
                parts.append(_conv(f"{block}.downsample.0", 4 * wide, inside, 1))
                parts.append(_norm(f"{block}.downsample.1", 4 * wide))
            inside = 4 * wide
    parts += _decoder("unet_model.decoder", 4096, (2048, 1024, 256, 64, 0))
    for k, (channels, hidden) in enumerate(((2048, 256), (1024, 128), (512, 64))):
        layer_name = f"coattention_modules.{k}.attention_layer"
        for side in ("query", "reference"):
            name = f"{layer_name}.{side}_dimensionality_reduction"
            parts.append(_with_bias(name, hidden, channels, 1))
    return {k: v for part in (*parts, *_head()) for k, v in part.items()}


def _published_3d() -> dict[str, Tensor]:
    parts: list[dict[str, Tensor]] = []
    for k in range(2):
        name = f"feature_backbone.sequence_to_spatial.{k}.norm"
        parts.append({f"{name}.weight": torch.ones(768), f"{name}.bias": torch.zeros(768)})
    for k in range(4):
        inside, block = 768 if k == 0 else 512, f"unet_encoder.{k}"
        parts += [_conv(f"{block}.conv1", 512, inside, 3), _norm(f"{block}.bn1", 512)]
        parts += [_conv(f"{block}.conv2", 512, 512, 3), _norm(f"{block}.bn2", 512)]
        parts += [_conv(f"{block}.shortcut.0", 512, inside, 1), _norm(f"{block}.shortcut.1", 512)]
    parts += _decoder("unet_decoder", 512, (512, 512, 512, 768, 0))
    for k, (inside, out) in enumerate(((64 + 768, 256), (256, 64)), 1):
        name = f"feature_fusion_block._conv_bn_layer{k}"
        parts += [_conv(f"{name}.0", out, inside, 3), _norm(f"{name}.1", out)]
    return {k: v for part in (*parts, *_head()) for k, v in part.items()}


def _registration(pairs: int, height: int, width: int) -> Registration:
    depth = torch.full((pairs, 2, height, width), 2.0)
    across = torch.eye(4).repeat(pairs, 2, 1, 1)
    across[:, 0, 0, 3], across[:, 1, 0, 3] = 0.1, -0.1
    return Registration(depth, across)


def test_published_2d_state_loads_and_runs() -> None:
    state = _published_2d()
    preset = preset_of(state, "it")
    assert (preset.architecture, preset.channels) == ("cyws2d-resnet50", 64)
    network = fill(preset.build(), state, "it")
    assert sum(p.numel() for p in network.parameters()) == pytest.approx(49.5e6, rel=0.001)
    assert torch.equal(network.state_dict()["unet_model.encoder.conv1.weight"],
                       state["unet_model.encoder.conv1.weight"])  # fmt: skip
    with torch.inference_mode():
        maps = network(torch.rand(1, 2, 3, 256, 256))
    assert maps.heat.shape == (2, 1, 256, 256)
    assert maps.size.shape == maps.offset.shape == (2, 2, 256, 256)
    assert torch.isfinite(maps.heat).all()


def test_published_3d_state_loads_and_runs() -> None:
    state = _published_3d()
    preset = preset_of(state, "it")
    assert preset.architecture == "cyws3d-dino"
    network = fill(preset.build(), state, "it")
    counts = [0, 0]
    for name, p in network.named_parameters():
        counts[name.startswith("feature_backbone.model.")] += p.numel()
    assert counts[0] == pytest.approx(31.5e6, rel=0.002)
    assert counts[1] == pytest.approx(85.8e6, rel=0.001)
    # a small picture: the frozen encoder's attention grows with its fourth power
    with torch.inference_mode():
        maps = network(torch.rand(1, 2, 3, 96, 96), _registration(1, 96, 96))
    assert maps.heat.shape == (2, 1, 96, 96)
    assert torch.isfinite(maps.heat).all()


def test_patches_overlap() -> None:
    vit = DinoViT(width=32, depth=2, heads=2)
    assert vit.grid(224, 224) == (55, 55)
    keys = vit(torch.rand(1, 3, 64, 40), (1,))
    assert [k.shape for k in keys] == [(1, 15 * 9, 32)]


SMALL: list[Architecture] = ["cyws2d-small", "cyws3d-small"]


@pytest.mark.parametrize("name", SMALL)
def test_neighbours_in_a_batch_change_nothing(name: Architecture) -> None:
    torch.manual_seed(0)
    network = PRESETS[name].build().eval()
    pictures = torch.rand(3, 2, 3, 64, 96)
    registration = _registration(3, 64, 96)
    registration.depth[:] += torch.rand(3, 2, 64, 96)
    order = torch.tensor([2, 0, 1])
    turned = Registration(registration.depth[order], registration.across[order])
    with torch.inference_mode():
        straight = network(pictures, registration)
        mixed = network(pictures[order], turned)
        alone = network(
            pictures[1:2], Registration(registration.depth[1:2], registration.across[1:2])
        )
    assert straight.heat.shape == (6, 1, 32, 48)
    again = mixed.heat.unflatten(0, (3, 2))[torch.argsort(order)].flatten(0, 1)
    torch.testing.assert_close(again, straight.heat, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(alone.heat, straight.heat[2:4], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", SMALL)
def test_either_order_of_a_pair(name: Architecture) -> None:
    torch.manual_seed(0)
    network = PRESETS[name].build().eval()
    pictures, registration = torch.rand(1, 2, 3, 64, 64), _registration(1, 64, 64)
    swapped = Registration(registration.depth.flip(1), registration.across.flip(1))
    with torch.inference_mode():
        straight, other = network(pictures, registration), network(pictures.flip(1), swapped)
    torch.testing.assert_close(other.heat, straight.heat.flip(0), rtol=1e-4, atol=1e-5)


def test_equal_pictures_have_no_difference() -> None:
    torch.manual_seed(0)
    network = Cyws3D(ResNet((1, 1, 1, 1), 8), (16, 16, 8, 8)).eval()
    same = torch.rand(1, 1, 3, 64, 64).expand(1, 2, -1, -1, -1)
    with torch.inference_mode():
        other = network(torch.rand(1, 1, 3, 64, 64).expand(1, 2, -1, -1, -1))
        torch.testing.assert_close(network(same).heat, other.heat)


def test_attention_is_over_the_other_picture() -> None:
    torch.manual_seed(0)
    network = Cyws2D(ResNet((1, 1, 1, 1), 8), (16, 16, 8, 8), (8, 8, 8)).eval()
    pictures = torch.rand(2, 2, 3, 64, 96)
    with torch.inference_mode():
        maps, logits = network.with_attention(pictures)
    assert maps.heat.shape == (4, 1, 32, 48)
    assert [grid for grid, _ in logits] == [(2, 3), (4, 6), (8, 12)]
    assert [seen.shape for _, seen in logits] == [(2, 2, n, n) for n in (6, 24, 96)]


def test_a_small_dino_network_is_trainable_but_for_its_encoder() -> None:
    torch.manual_seed(0)
    network = Cyws3DDino(DinoViT(32, 3, 2), 24, (16, 16, 8, 8, 8), (0, 2))
    maps = network(torch.rand(1, 2, 3, 64, 64), _registration(1, 64, 64))
    maps.heat.sum().backward()
    held = {n for n, p in network.named_parameters() if p.grad is None}
    assert held
    assert all(n.startswith("feature_backbone.model.") or "wh_" in n or "offset" in n for n in held)
    assert np.isfinite(maps.heat.detach().numpy()).all()
