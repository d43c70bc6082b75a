"""DINO features against the model called by hand, on tiny models of the real classes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

pytest.importorskip("transformers")

import torch
import transformers

from scenediff_classic import devices, weights
from scenediff_classic.errors import InputError
from scenediff_classic.features.dino import DinoFeatures, grid_shape
from scenediff_classic.protocols import FeatureExtractor
from scenediff_classic.types import View
from tests.learned_models import DINO_KINDS, MEAN, STD, dino
from tests.plane_scene import BOOK, VASE, render

PREFIX = {"dinov2": 1, "dinov2_with_registers": 5, "dinov3_vit": 4}
"""Tokens before the patches: class and registers."""


@pytest.fixture(scope="module", params=DINO_KINDS)
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return dino(request.param, tmp_path_factory.mktemp("dino") / request.param)


@pytest.fixture(scope="module")
def dinov2(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return dino("dinov2", tmp_path_factory.mktemp("dino"))


@pytest.fixture(scope="module")
def view() -> View:
    return render([VASE, BOOK], "before", 0, (0.0, 0.0, 0.0), width=131, height=97)


def pictured(height: int, width: int) -> View:
    """A view of random pixels."""
    pixels = np.random.default_rng(height * width).integers(0, 256, (height, width, 3), np.uint8)
    blank = render([], "before", 0, (0.0, 0.0, 0.0), width=width, height=height)
    return replace(blank, image=pixels)


def test_it_is_a_plug_in_with_the_papers_constants(folder: Path) -> None:
    features = DinoFeatures(str(folder))
    assert isinstance(features, FeatureExtractor)
    assert (features.similarity, features.merge) == (0.7, 1.4)


def test_equals_the_patch_tokens_of_the_model_called_by_hand(folder: Path, view: View) -> None:
    model = transformers.AutoModel.from_pretrained(folder).eval()
    patch = model.config.patch_size
    rows, columns = 6, 8
    resized = Image.fromarray(view.image).resize(
        (columns * patch, rows * patch), Image.Resampling.BILINEAR
    )
    pixels = (np.asarray(resized, np.float32) / 255 - np.float32(MEAN)) / np.float32(STD)
    with torch.no_grad():
        tokens = model(torch.tensor(pixels.transpose(2, 0, 1))[None]).last_hidden_state[0].numpy()
    places = tokens[PREFIX[model.config.model_type] :]
    expected = places / np.linalg.norm(places, axis=1, keepdims=True)
    found = DinoFeatures(str(folder), long_cells=8)(view)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected.reshape(rows, columns, -1), atol=1e-5)


def test_class_and_register_tokens_are_left_out(folder: Path, view: View) -> None:
    features = DinoFeatures(str(folder), long_cells=8)
    model, _ = features._model
    prefix = PREFIX[model.config.model_type]

    def numbered(module, inputs, output):
        tokens = output.last_hidden_state
        assert tokens.shape[1] == prefix + 48
        answer = torch.full((1, prefix + 48, 48), torch.nan)
        answer[0, prefix:] = torch.eye(48)
        output.last_hidden_state = answer
        return output

    handle = model.register_forward_hook(numbered)
    np.testing.assert_array_equal(features(view), np.eye(48).reshape(6, 8, 48))
    handle.remove()


def test_pixels_are_those_of_the_models_own_processor(dinov2: Path, view: View) -> None:
    processor = transformers.BitImageProcessorPil(
        size={"height": 84, "width": 112}, do_center_crop=False, do_convert_rgb=True,
        image_mean=MEAN, image_std=STD, resample=3,
    )  # fmt: skip
    expected = processor(view.image, return_tensors="np")["pixel_values"][0]
    ours = replace(DinoFeatures(str(dinov2)).source.preprocessing, resampling=3)
    np.testing.assert_allclose(ours(view.image, 84, 112), expected, atol=1e-5)


@pytest.mark.parametrize("size", [(97, 131), (131, 97), (64, 64), (7, 200), (1, 1), (900, 1201)])
def test_pictures_of_any_size_get_a_grid_of_unit_vectors(
    dinov2: Path, size: tuple[int, int]
) -> None:
    found = DinoFeatures(str(dinov2), long_cells=6)(pictured(*size))
    assert max(found.shape[:2]) == 6
    assert found.shape[:2] == grid_shape(size, 6)
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1, atol=1e-5)


@given(st.integers(1, 5000), st.integers(1, 5000), st.integers(1, 128))
def test_cells_are_nearly_square(height: int, width: int, long_cells: int) -> None:
    rows, columns = grid_shape((height, width), long_cells)
    assert max(rows, columns) == long_cells
    side = max(height, width) / long_cells
    assert abs(rows - height / side) <= 0.5 or rows == 1
    assert abs(columns - width / side) <= 0.5 or columns == 1


def test_the_size_of_a_picture_hardly_matters(dinov2: Path) -> None:
    small = render([VASE, BOOK], "before", 0, (0.0, 0.0, 0.0), 240, 180, 220.0)
    large = render([VASE, BOOK], "before", 0, (0.0, 0.0, 0.0), 2000, 1500, 1833.3)
    features = DinoFeatures(str(dinov2), long_cells=8)
    cosine = np.einsum("ijk,ijk->ij", features(small), features(large))
    assert cosine.min() > 0.99


def test_a_picture_is_encoded_by_itself_and_the_model_is_loaded_once(
    dinov2: Path, view: View, monkeypatch: pytest.MonkeyPatch
) -> None:
    loads = []
    load = weights.Weights.load
    monkeypatch.setattr(weights.Weights, "load", lambda *a: loads.append(a) or load(*a))
    features = DinoFeatures(str(dinov2), long_cells=5)
    first = features(view)
    features(pictured(50, 80))
    np.testing.assert_array_equal(features(view), first)
    assert len(loads) == 1
    np.testing.assert_array_equal(DinoFeatures(str(dinov2), long_cells=5)(view), first)


def test_devices(dinov2: Path, view: View, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "cuda_available", lambda: False)
    on_cpu = DinoFeatures(str(dinov2), "cpu", long_cells=4)(view)
    np.testing.assert_array_equal(DinoFeatures(str(dinov2), "auto", long_cells=4)(view), on_cpu)
    with pytest.raises(InputError, match="no CUDA device"):
        DinoFeatures(str(dinov2), "cuda")(view)


@pytest.mark.skipif(not devices.cuda_available(), reason="there is no CUDA device here")
def test_cuda_finds_nearly_the_same(folder: Path, view: View) -> None:
    on_cpu = DinoFeatures(str(folder), "cpu", long_cells=8)(view)
    on_cuda = DinoFeatures(str(folder), "cuda", long_cells=8)(view)
    np.testing.assert_allclose(on_cuda, on_cpu, atol=1e-3)
