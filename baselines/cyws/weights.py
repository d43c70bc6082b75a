"""Weights of the networks: read safely, complete or not at all."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor, nn

from baselines.cyws.presets import PRESETS, Architecture, Dimension, Preset
from scenediff_classic.errors import InputError
from scenediff_classic.workspace import write_atomic

SHIPPED: dict[Dimension, Path] = {
    "2d": Path(__file__).with_name("models") / "cyws2d_small.safetensors",
    "3d": Path(__file__).with_name("models") / "cyws3d_small.safetensors",
}
"""Trained here (see the model cards beside them)."""
_MAY_BE_ABSENT = "feature_backbone.model."
_NAMED = 5


def read_state(path: Path) -> dict[str, Tensor]:
    """The tensors of a ``.safetensors`` file, or of a PyTorch checkpoint without any code in it.

    What lies under ``state_dict`` counts, if the checkpoint has that.

    Raises
    ------
    InputError
        If the file is missing or damaged, or would need code to be run.
    """
    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        stored = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, SafetensorError) as error:
        raise InputError(f"{path} cannot be read: {_line(error).rstrip('.')}.") from error
    except Exception as error:  # the unpickler's refusals and PyTorch's own kinds
        raise InputError(
            f"{path} is no plain checkpoint: it is damaged, or holds more than tensors, which is "
            "not read for it could run any code."
        ) from error
    state = stored.get("state_dict", stored) if isinstance(stored, Mapping) else None
    if not isinstance(state, Mapping) or not all(
        isinstance(k, str) and isinstance(v, Tensor) for k, v in state.items()
    ):
        raise InputError(f"{path} holds no state dict.")
    return dict(state)


def fill(network: nn.Module, state: Mapping[str, Tensor], source: str) -> nn.Module:
    """Load all weights, or none; the network is then ready to answer.

    The frozen DINO encoder may be absent altogether: it then keeps what it has.

    Raises
    ------
    InputError
        If names are missing, not known, or of another shape, in which case all kinds are listed;
        or if a number is not finite, as in a file overwritten by something else.
    """
    own = network.state_dict()
    wanted = set(own)
    if not any(name.startswith(_MAY_BE_ABSENT) for name in state):
        wanted = {name for name in wanted if not name.startswith(_MAY_BE_ABSENT)}
    # counters that only a training goes on with
    counters = {name for name in wanted if name.endswith("num_batches_tracked")}
    missing = sorted(wanted - counters - set(state))
    unexpected = sorted(set(state) - set(own))
    mismatched = [
        f"{name} {tuple(state[name].shape)} for {tuple(own[name].shape)}"
        for name in sorted(set(state) & set(own))
        if state[name].shape != own[name].shape
    ]
    problems = [
        f"{len(names)} {what}: {', '.join(names[:_NAMED])}{', ...' if names[_NAMED:] else ''}"
        for what, names in (
            ("missing", missing), ("unexpected", unexpected), ("of another shape", mismatched),
        )
        if names
    ]  # fmt: skip
    if problems:
        raise InputError(f"{source} does not fit the network. {'; '.join(problems)}.")
    broken = sorted(name for name, value in state.items() if not torch.isfinite(value).all())
    if broken:
        raise InputError(f"{source} is damaged: {broken[0]} holds numbers that are not finite.")
    network.load_state_dict({k: v.to(own[k].dtype) for k, v in state.items()}, strict=False)
    return network.eval().requires_grad_(False)


def preset_of(state: Mapping[str, Tensor], source: str) -> Preset:
    """The network that a state dict belongs to, by its names and shapes.

    Raises
    ------
    InputError
        If it is none of them.
    """
    stem = "unet_model.encoder.conv1.weight"
    name: Architecture
    if any(key.startswith("unet_encoder.") for key in state):
        return PRESETS["cyws3d-dino"]
    if stem in state:
        deep = any(".conv3." in key for key in state)
        five = "unet_model.decoder.blocks.4.conv1.0.weight" in state
        name = "cyws2d-small" if not five else "cyws2d-resnet50" if deep else "cyws2d-resnet18"
        return replace(PRESETS[name], channels=len(state[stem]))
    if "encoder.conv1.weight" in state:
        return replace(PRESETS["cyws3d-small"], channels=len(state["encoder.conv1.weight"]))
    raise InputError(f"{source} holds the weights of no CYWS network.")


def load_network(path: Path) -> tuple[nn.Module, Preset]:
    """A network with the weights of a file.

    Raises
    ------
    InputError
        If the file cannot be read, or does not hold all weights of one of the networks.
    """
    state = read_state(path)
    preset = preset_of(state, str(path))
    network = preset.build(bias="unet_encoder.0.conv1.bias" in state)
    return fill(network, state, str(path)), preset


def write_weights(network: nn.Module, path: Path) -> None:
    """As safetensors in half precision, without counters."""
    state = {
        name: value.detach().cpu().half().contiguous()
        for name, value in network.state_dict().items()
        if not name.endswith("num_batches_tracked")
    }
    write_atomic(path, save(state))


def _line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
