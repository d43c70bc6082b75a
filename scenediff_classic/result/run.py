"""``run.json``: how a result came to be."""

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from scenediff_classic.workspace import write_atomic

_SCHEMA_VERSION = 1


@dataclass(frozen=True)
class RunInfo:
    """How a result came to be; everything that ``run.json`` holds."""

    command: tuple[str, ...]
    """The command line, or the Python call, that made the run."""
    config: Mapping[str, Any]
    """Resolved configuration, ready for JSON (see `json_ready`)."""
    versions: Mapping[str, str]
    """Package name -> version, Python itself included."""
    seed: int
    stage_seconds: Mapping[str, float]
    """Stage -> wall-clock seconds, in the order in which the stages ran."""
    peak_memory_bytes: int | None = None
    git_commit: str | None = None
    fingerprint: Mapping[str, Any] = field(default_factory=dict)
    """What identifies the inputs and the options: a run is resumed only if it agrees."""


def json_ready(value: Any) -> Any:
    """Turn a configuration into plain JSON values.

    Dataclasses become objects whose ``type`` names the class, because in this project the class
    of an option object says which plug-in was chosen.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: json_ready(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"type": type(value).__name__, **fields}
    if isinstance(value, Mapping):
        return {str(key): json_ready(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        items = sorted(value, key=repr) if isinstance(value, (set, frozenset)) else value
        return [json_ready(item) for item in items]
    if isinstance(value, Enum):
        return json_ready(value.value)
    if isinstance(value, (np.generic, np.ndarray)):
        return json_ready(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return str(value)


def write_run(info: RunInfo, path: Path) -> None:
    """Write ``run.json``.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    fields = {f.name: getattr(info, f.name) for f in dataclasses.fields(info)}
    document = {"schema": _SCHEMA_VERSION, **json_ready(fields)}
    write_atomic(path, json.dumps(document, indent=2) + "\n")
