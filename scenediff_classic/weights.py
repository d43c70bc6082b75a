"""Weights of learned models: found on this computer, checked, and loaded.

Only safetensors are read, for a pickle can run any code; nothing is fetched unless `find_weights`
is told to. `transformers` is imported only once a learned plug-in is used.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8
from PIL import Image

from scenediff_classic.devices import Device, chosen_device
from scenediff_classic.errors import InputError

_MODEL_ID = re.compile(r"[\w-][\w.-]*(/[\w-][\w.-]*)?")


def find_weights(weights: str, *, download: bool = False) -> Path:
    """The folder that holds a model.

    Parameters
    ----------
    weights : str
        A folder as `save_pretrained` writes it, or a model id such as ``facebook/dinov2-base``,
        which is looked up in the user's Hugging Face cache.
    download : bool
        Fetch the model into that cache first, from the Hugging Face hub.

    Raises
    ------
    InputError
        If there is no such folder and no such model in the cache, or fetching fails.
    """
    folder = Path(weights).expanduser()
    if weights and folder.is_dir():
        return folder
    if not _MODEL_ID.fullmatch(weights):
        raise InputError(
            f"{weights} is neither a folder nor a model id such as facebook/dinov2-base."
        )
    hub = _extra("huggingface_hub")
    try:
        found = hub.snapshot_download(
            weights, local_files_only=not download, allow_patterns=["*.json", "*.safetensors"]
        )
    except Exception as error:  # no network, no such model, no permission, ...: the hub's own kinds
        if not download:
            raise InputError(
                f"{weights} is neither a folder nor a model in the Hugging Face cache: fetch it "
                "with --allow-download, or give the folder that holds its weights."
            ) from error
        raise InputError(
            f"{weights} cannot be downloaded from the Hugging Face hub: {_first_line(error)}"
        ) from error
    return Path(found)


@dataclass(frozen=True)
class Preprocessing:
    """From a picture to what a model was trained on."""

    mean: tuple[float, float, float]
    """Per channel, after `scale`."""
    std: tuple[float, float, float]
    scale: float
    """Factor on the 8-bit values."""
    resampling: int
    """Pillow's number of the filter."""

    def __call__(
        self, image: UInt8[np.ndarray, "h w 3"], height: int, width: int
    ) -> Float32[np.ndarray, "3 a b"]:
        """Resize (with anti-aliasing), then normalise."""
        filtered = Image.Resampling(self.resampling)
        resized = np.asarray(Image.fromarray(image).resize((width, height), filtered))
        scaled = resized.astype(np.float32) * np.float32(self.scale)
        values = (scaled - np.array(self.mean, np.float32)) / np.array(self.std, np.float32)
        return np.ascontiguousarray(values.transpose(2, 0, 1))


@dataclass(frozen=True)
class Weights:
    """A folder with the weights of one of some kinds of model.

    Making one checks what can be checked without loading.

    Raises
    ------
    InputError
        If the extra is not installed, the folder holds no model of these kinds, or its weights are
        pickles or damaged.
    """

    folder: Path
    classes: Mapping[str, str]
    """Model type as in ``config.json`` -> name of the class of `transformers` that can load it."""

    def __post_init__(self) -> None:
        """Refuse what cannot be loaded."""
        transformers = _extra("transformers")
        if self.kind not in self.classes:
            known = " or ".join(sorted(self.classes))
            raise InputError(f"{self.folder} holds a model of type {self.kind}: {known} is needed.")
        if not hasattr(transformers, self.classes[self.kind]):
            raise InputError(
                f"transformers {transformers.__version__} has no {self.classes[self.kind]}: "
                "pip install --upgrade transformers"
            )
        names = ("model.safetensors", "model.safetensors.index.json")
        if not any((self.folder / name).is_file() for name in names):
            raise InputError(
                f"{self.folder} holds no model.safetensors. Weights in other files (.bin, .pth) "
                "are pickles, which can run any code, and are not read: get them as safetensors."
            )
        for file in self.files:
            if file.suffix == ".safetensors":
                _check_safetensors(file)
        _ = self.preprocessing

    @cached_property
    def kind(self) -> str:
        """The model's type, as its ``config.json`` says."""
        return str(_read_json(self.folder / "config.json").get("model_type"))

    @property
    def files(self) -> tuple[Path, ...]:
        """All files that decide what the model answers."""
        names = ("config.json", "preprocessor_config.json", "processor_config.json")
        present = [self.folder / name for name in names if (self.folder / name).is_file()]
        index = self.folder.glob("model*.safetensors.index.json")
        return (*present, *sorted(index), *sorted(self.folder.glob("model*.safetensors")))

    @cached_property
    def preprocessing(self) -> Preprocessing:
        """How the model wants its pictures, as its processor's file says."""
        joint, single = self.folder / "processor_config.json", "preprocessor_config.json"
        found = _read_json(joint).get("image_processor") if joint.is_file() else None
        options = found if isinstance(found, dict) else _read_json(self.folder / single)
        normalised = options.get("do_normalize", True)
        try:
            out = Preprocessing(
                mean=_triple(options["image_mean"]) if normalised else (0.0, 0.0, 0.0),
                std=_triple(options["image_std"]) if normalised else (1.0, 1.0, 1.0),
                scale=options.get("rescale_factor", 1 / 255) * options.get("do_rescale", True)
                or 1.0,
                resampling=Image.Resampling(options.get("resample", Image.Resampling.BILINEAR)),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"{self.folder / single} does not say how pictures are normalised: {error}."
            ) from error
        if not np.isfinite([*out.mean, *out.std, out.scale]).all() or min(out.std) <= 0:
            raise InputError(f"{self.folder / single} holds numbers that make no sense.")
        return out

    def load(self, device: Device) -> tuple[Any, str]:
        """The model in float32, ready to answer, and the PyTorch device it is on.

        Raises
        ------
        InputError
            If the weights do not fit the model, or CUDA is asked for and not there.
        """
        transformers, torch = _extra("transformers"), _extra("torch")
        chosen = chosen_device(device)
        log = transformers.utils.logging
        verbosity, bars = log.get_verbosity(), log.is_progress_bar_enabled()
        log.set_verbosity_error()
        log.disable_progress_bar()  # it would tear our own bars
        try:
            model, report = getattr(transformers, self.classes[self.kind]).from_pretrained(
                self.folder,
                dtype=torch.float32,
                local_files_only=True,
                use_safetensors=True,
                output_loading_info=True,
            )
        except Exception as error:  # whatever the readers of these files stumble over
            raise InputError(
                f"{self.folder} cannot be loaded as a {self.kind} model: {_first_line(error)}"
            ) from error
        finally:
            log.set_verbosity(verbosity)
            if bars:
                log.enable_progress_bar()
        if report["missing_keys"]:
            raise InputError(
                f"{self.folder} lacks weights of its {self.kind} model, such as "
                f"{min(report['missing_keys'])}: fetch it again."
            )
        return model.eval().requires_grad_(False).to(chosen), chosen


def _extra(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        raise InputError(
            "Learned features and regions need packages that are not installed: "
            "pip install 'scenediff-classic[learned]'"
        ) from error


def _read_json(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(path.read_bytes())
    except FileNotFoundError as error:
        raise InputError(f"{path.parent} holds no complete model: {path.name} is missing.") from (
            error
        )
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path} cannot be read: {_first_line(error)}") from error
    if not isinstance(document, dict):
        raise InputError(f"{path} is not the description of a model.")
    return document


def _check_safetensors(file: Path) -> None:
    safetensors = _extra("safetensors")
    try:
        with safetensors.safe_open(file, "np"):  # reads the header, compares it with the length
            pass
    except (OSError, safetensors.SafetensorError) as error:
        raise InputError(f"{file} is damaged: {_first_line(error)}") from error


def _triple(values: Any) -> tuple[float, float, float]:
    red, green, blue = (float(v) for v in values)
    return red, green, blue


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
