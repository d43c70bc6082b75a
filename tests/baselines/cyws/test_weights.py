"""Weights are loaded whole or not at all, and never by running code."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from baselines.cyws import cli
from baselines.cyws.networks import Cyws3D
from baselines.cyws.presets import Dimension
from baselines.cyws.resnet import ResNet
from baselines.cyws.weights import (
    SHIPPED,
    fill,
    load_network,
    preset_of,
    read_state,
    write_weights,
)
from scenediff_classic.errors import InputError


def _network() -> Cyws3D:
    torch.manual_seed(0)
    return Cyws3D(ResNet((2, 2, 2, 2), 4), (16, 16, 8, 8))


def test_written_and_read_back(tmp_path: Path) -> None:
    network = _network().eval()
    write_weights(network, tmp_path / "w.safetensors")
    again, preset = load_network(tmp_path / "w.safetensors")
    assert (preset.architecture, preset.channels) == ("cyws3d-small", 4)
    assert not again.training
    pictures = torch.rand(1, 2, 3, 64, 64)
    with torch.inference_mode():
        first, second = network(pictures).heat, again(pictures).heat
    torch.testing.assert_close(first, second, rtol=0.05, atol=0.02)  # half precision


@pytest.mark.parametrize("nested", [False, True])
def test_plain_checkpoints_are_read(tmp_path: Path, nested: bool) -> None:
    state = _network().state_dict()
    torch.save({"state_dict": state, "epoch": 3} if nested else state, tmp_path / "c.ckpt")
    found = read_state(tmp_path / "c.ckpt")
    assert found.keys() == state.keys()
    fill(_network(), found, "it")


def test_all_that_does_not_fit_is_listed() -> None:
    network, state = _network(), _network().state_dict()
    before = {k: v.clone() for k, v in network.state_dict().items()}
    for name in [n for n in state if n.startswith("decoder.blocks.0.conv")]:
        del state[name]
    state["something.else"] = torch.zeros(2)
    state["encoder.bn1.weight"] = torch.zeros(7)
    with pytest.raises(InputError) as caught:
        fill(network, state, "weights.ckpt")
    message = str(caught.value)
    assert "weights.ckpt does not fit the network. 10 missing: decoder.blocks.0.conv1." in message
    assert ", ...; 1 unexpected: something.else" in message
    assert "1 of another shape: encoder.bn1.weight (7,) for (4,)" in message
    assert all(torch.equal(v, before[k]) for k, v in network.state_dict().items())


def test_code_is_not_run(tmp_path: Path) -> None:
    class Harm:
        def __reduce__(self) -> tuple[Any, ...]:
            return Path.touch, (tmp_path / "harm",)

    (tmp_path / "bad.ckpt").write_bytes(pickle.dumps({"state_dict": Harm()}))
    torch.save({"state_dict": Harm()}, tmp_path / "worse.ckpt")
    for name in ("bad.ckpt", "worse.ckpt"):
        with pytest.raises(InputError, match="no plain checkpoint"):
            read_state(tmp_path / name)
    assert not (tmp_path / "harm").exists()


@pytest.mark.parametrize("suffix", [".ckpt", ".pth", ".safetensors"])
@pytest.mark.parametrize("damage", ["cut", "nearly whole", "garbage", "empty"])
def test_damaged_files_are_refused_in_one_sentence(
    tmp_path: Path, suffix: str, damage: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"w{suffix}"
    state = _network().state_dict()
    if suffix == ".safetensors":
        save_file(state, path)
    else:
        torch.save({"state_dict": state}, path)
    load_network(path)  # as it was written, it is fine
    whole = path.read_bytes()
    path.write_bytes(
        {
            "cut": whole[: len(whole) // 2],
            "nearly whole": whole[:-1],
            "garbage": np.random.default_rng(0).bytes(len(whole)),
            "empty": b"",
        }[damage]
    )
    with pytest.raises(InputError, match=r"is no plain checkpoint|cannot be read"):
        load_network(path)
    photos = [str(tmp_path / "before.png"), str(tmp_path / "after.png")]
    call = [*photos, "-o", str(tmp_path / "out"), "--weights", str(path)]
    assert cli.main("3d", call) == 2  # before anything else is looked at
    said = " ".join(capsys.readouterr().err.split())
    assert said.startswith("Error: ")
    assert said.endswith(".")
    assert "Traceback" not in said
    assert not (tmp_path / "out").exists()


def test_overwritten_numbers_are_noticed() -> None:
    network, state = _network(), _network().state_dict()
    before = {k: v.clone() for k, v in network.state_dict().items()}
    state["encoder.bn1.weight"][2] = torch.nan
    with pytest.raises(InputError, match=r"it is damaged: encoder\.bn1\.weight holds numbers"):
        fill(network, state, "it")
    assert all(torch.equal(v, before[k]) for k, v in network.state_dict().items())


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_state(tmp_path / "absent.safetensors")
    (tmp_path / "cut.safetensors").write_bytes(b"12345678")
    with pytest.raises(InputError, match="cannot be read"):
        read_state(tmp_path / "cut.safetensors")
    torch.save([1, 2], tmp_path / "list.pt")
    with pytest.raises(InputError, match="no state dict"):
        read_state(tmp_path / "list.pt")
    save_file({"a": torch.zeros(1)}, tmp_path / "other.safetensors")
    with pytest.raises(InputError, match="no CYWS network"):
        load_network(tmp_path / "other.safetensors")
    with pytest.raises(InputError, match="no CYWS network"):
        preset_of({}, "it")


@pytest.mark.parametrize("model", ["2d", "3d"])
def test_shipped_weights_are_small_and_load(model: Dimension) -> None:
    assert SHIPPED[model].stat().st_size < 4_000_000
    network, preset = load_network(SHIPPED[model])
    assert preset.architecture == f"cyws{model}-small"
    with torch.inference_mode():
        maps = network(torch.rand(1, 2, 3, preset.height, preset.width))
    assert torch.isfinite(maps.heat).all()
