"""Weights are found without a network, checked before any work, and never unpickled."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("transformers")

import huggingface_hub
import torch
from safetensors.torch import load_file, save_file

from scenediff_classic import cli, terminal, weights
from scenediff_classic.errors import InputError
from scenediff_classic.features.dino import DinoFeatures
from scenediff_classic.presets import configured, weight_files
from scenediff_classic.regions.sam import SamRegions
from scenediff_classic.weights import find_weights
from tests.learned_models import dino, sam
from tests.plane_scene import VASE, render


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return dino("dinov2", tmp_path_factory.mktemp("weights") / "saved")


@pytest.fixture
def folder(saved: Path, tmp_path: Path) -> Path:
    """A copy to damage."""
    return Path(shutil.copytree(saved, tmp_path / "model"))


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty Hugging Face cache."""
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_CACHE", str(tmp_path / "hub"))
    return tmp_path / "hub"


def refusal(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        configured(learned_features=str(folder))
    return str(caught.value)


def test_without_the_extra_one_sentence_says_how_to_get_it(
    saved: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "transformers", None)
    assert "pip install 'scenediff-classic[learned]'" in refusal(saved)
    assert configured()  # all else works


def test_the_core_neither_needs_nor_imports_the_extra() -> None:
    code = (
        "import sys; sys.modules['transformers'] = sys.modules['safetensors'] = None\n"
        "import scenediff_classic.cli\n"
        "from scenediff_classic.presets import configured\n"
        "configured(device='cpu'); sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("name", ["/no/such/folder", "../model", "a/b/c", "", "two words"])
def test_neither_a_folder_nor_an_id(name: str) -> None:
    with pytest.raises(InputError, match="neither a folder nor a model id"):
        find_weights(name)


def test_a_model_in_the_users_cache_is_found_without_a_network(cache: Path, saved: Path) -> None:
    with pytest.raises(InputError, match="fetch it with --allow-download"):
        find_weights("someone/tiny")
    home = cache / "models--someone--tiny"
    shutil.copytree(saved, home / "snapshots" / "abc")
    (home / "refs").mkdir()
    (home / "refs" / "main").write_text("abc")
    features = DinoFeatures("someone/tiny", long_cells=3)
    assert features.source.folder == home / "snapshots" / "abc"
    assert features(render([VASE], "before", 0, (0.0, 0.0, 0.0))).shape[1] == 3


def test_a_download_is_made_on_request_only_and_never_of_pickles(
    saved: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def fetch(name: str, **options) -> str:
        calls.append((name, options["local_files_only"]))
        assert options["allow_patterns"] == ["*.json", "*.safetensors"]
        return str(saved)

    monkeypatch.setattr(huggingface_hub, "snapshot_download", fetch)
    configured(learned_features="someone/tiny")
    assert set(calls) == {("someone/tiny", True)}
    configured(learned_features="someone/tiny", allow_download=True)
    assert calls.count(("someone/tiny", False)) == 1


def test_a_download_that_fails_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(name: str, **options) -> str:
        raise OSError("no route to host\nand a long story")

    monkeypatch.setattr(huggingface_hub, "snapshot_download", fail)
    with pytest.raises(InputError, match=r"cannot be downloaded .*: no route to host$"):
        find_weights("someone/tiny", download=True)


def test_pickles_are_refused_unread(folder: Path) -> None:
    class Trap:
        def __reduce__(self):
            return (Path.touch, (folder / "sprung",))

    (folder / "model.safetensors").unlink()
    torch.save(Trap(), folder / "pytorch_model.bin")
    assert "no model.safetensors" in refusal(folder)
    assert not (folder / "sprung").exists()


def test_a_model_of_another_kind_is_refused(saved: Path, tmp_path: Path) -> None:
    assert "of type sam: dinov2 or" in refusal(sam("sam", tmp_path / "sam"))
    with pytest.raises(InputError, match="of type dinov2: sam or sam2"):
        configured(learned_regions=str(saved))


def test_code_that_comes_with_a_model_is_not_run(folder: Path) -> None:
    described = json.loads((folder / "config.json").read_bytes())
    described["auto_map"] = {"AutoModel": "trap.Model"}
    (folder / "config.json").write_text(json.dumps(described))
    (folder / "trap.py").write_text("raise SystemExit('sprung')")
    assert DinoFeatures(str(folder)).source.load("cpu")


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("config.json", None, "config.json is missing"),
        ("config.json", "{", "cannot be read"),
        ("config.json", "[]", "not the description of a model"),
        ("config.json", "{}", "of type None"),
        ("preprocessor_config.json", None, "preprocessor_config.json is missing"),
        ("preprocessor_config.json", '{"image_mean": 3}', "does not say how"),
        (
            "preprocessor_config.json",
            '{"image_mean": [0, 0, 0], "image_std": [1, 0, 1]}',
            "no sense",
        ),
        ("model.safetensors", "x" * 100, "is damaged"),
    ],
)
def test_a_damaged_folder_is_refused_in_one_sentence(
    folder: Path, name: str, content: str | None, expected: str
) -> None:
    (folder / name).unlink()
    if content is not None:
        (folder / name).write_text(content)
    assert expected in refusal(folder)


def test_weights_cut_short_are_refused(folder: Path) -> None:
    whole = (folder / "model.safetensors").read_bytes()
    (folder / "model.safetensors").write_bytes(whole[:-10])
    assert "is damaged" in refusal(folder)


def test_a_model_without_some_of_its_weights_is_refused(folder: Path) -> None:
    tensors = load_file(folder / "model.safetensors")
    del tensors["layernorm.weight"]
    save_file(tensors, folder / "model.safetensors", {"format": "pt"})
    with pytest.raises(InputError, match=r"lacks weights .* layernorm.weight"):
        DinoFeatures(str(folder)).source.load("cpu")


def test_weights_of_another_shape_are_refused(folder: Path) -> None:
    described = json.loads((folder / "config.json").read_bytes())
    (folder / "config.json").write_text(json.dumps(described | {"hidden_size": 64}))
    with pytest.raises(InputError, match="cannot be loaded as a dinov2 model"):
        DinoFeatures(str(folder)).source.load("cpu")


def test_half_precision_weights_are_computed_with_in_full(folder: Path) -> None:
    tensors = {k: v.half() for k, v in load_file(folder / "model.safetensors").items()}
    save_file(tensors, folder / "model.safetensors", {"format": "pt"})
    model, _ = DinoFeatures(str(folder)).source.load("cpu")
    assert {p.dtype for p in model.parameters()} == {torch.float32}
    assert not any(p.requires_grad for p in model.parameters())


def test_the_model_goes_to_the_chosen_device(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weights, "chosen_device", lambda device: "meta")
    model, device = DinoFeatures(str(saved), "auto").source.load("auto")
    assert device == "meta"
    assert {p.device.type for p in model.parameters()} == {"meta"}


def test_newer_processor_files_count_first(folder: Path) -> None:
    joint = {"image_processor": {"image_mean": [0, 0, 0], "image_std": [1, 1, 1], "resample": 3}}
    (folder / "processor_config.json").write_text(json.dumps(joint))
    found = DinoFeatures(str(folder)).source.preprocessing
    assert (found.mean, found.std, found.resampling) == ((0, 0, 0), (1, 1, 1), 3)
    assert found.scale == pytest.approx(1 / 255)


def test_options_and_weights_become_part_of_the_record(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    masks = sam("sam2", tmp_path / "sam2")
    config = configured(device="cpu", learned_features=str(folder), learned_regions=str(masks))
    assert config.features == DinoFeatures(str(folder), "cpu")
    assert config.regions == SamRegions(str(masks), "cpu")
    (folder / "README.md").write_text("decides nothing")
    names = ["config.json", "preprocessor_config.json", "model.safetensors"]
    expected = [folder / n for n in names] + [masks / n for n in names]
    assert list(weight_files(config)) == expected
    assert weight_files(replace(config, features=configured().features)) == tuple(expected[3:])

    recorded = {}
    monkeypatch.setattr(
        cli, "run_detection", lambda *a, **options: recorded.update(options, config=a[4])
    )
    monkeypatch.setattr(terminal, "read_result", lambda path: sys.exit("recorded"))
    detect = cli.Detect(
        tmp_path, tmp_path, tmp_path, device="cpu",
        learned_features=str(folder), learned_regions=str(masks),
    )  # fmt: skip
    with pytest.raises(SystemExit, match="recorded"):
        detect()
    assert recorded["config"] == config
    assert list(recorded["uses"]) == expected
