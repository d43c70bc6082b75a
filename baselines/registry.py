"""Every change detector that can be compared, by name; imported only when it is used."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from scenediff_classic.errors import InputError
from scenediff_classic.pipeline import DetectConfig
from scenediff_classic.protocols import Progress
from scenediff_classic.types import Capture, ChangeResult, Evidence


class DetectWithConfig(Protocol):
    """As `scenediff_classic.pipeline.detect_changes`."""

    def __call__(
        self, before: Capture, after: Capture, config: Any, *, workspace: Path, progress: Progress
    ) -> tuple[ChangeResult, Evidence]:
        """Find what changed; keep finished work in `workspace`."""
        ...


def _no_files(config: Any) -> tuple[Path, ...]:
    return ()


@dataclass(frozen=True)
class Method:
    """A change detector as a comparison needs it."""

    configured: Callable[[DetectConfig, int], Any]
    """From the core's options (geometry, regions, features as an experiment sets them) and a seed
    to the detector's own: a frozen dataclass with a field ``geometry``."""
    detect: DetectWithConfig
    files: Callable[[Any], tuple[Path, ...]] = _no_files
    """Files whose content decides the result, such as weights."""


METHODS = {
    "scenediff-classic": "baselines.methods.classic:METHOD",
    "3dgs-cd": "baselines.methods.threedgs_cd:METHOD",
    "mv3dcd": "baselines.methods.mv3dcd:METHOD",
    "cyws3d": "baselines.methods.cyws:METHOD_3D",
    "cyws2d": "baselines.methods.cyws:METHOD_2D",
}
"""Name -> ``module:attribute`` of its `Method`."""


def load_method(name: str) -> Method:
    """A method by its name here, or by ``module:attribute`` of its own.

    Raises
    ------
    InputError
        If there is none of that name, or what it needs is not installed.
    """
    module, _, attribute = METHODS.get(name, name).partition(":")
    if not attribute:
        known = ", ".join(METHODS)
        raise InputError(f"There is no method '{name}': take {known}, or write module:attribute.")
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise InputError(f"The method '{name}' cannot be imported: {error}.") from error
    if not isinstance(found, Method):
        raise InputError(f"The method '{name}' is no baselines.registry.Method.")
    return found
