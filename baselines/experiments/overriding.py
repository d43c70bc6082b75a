"""Options of nested configurations, set by dotted names."""

import typing
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

from baselines.experiments.typed import read_as
from scenediff_classic.errors import InputError
from scenediff_classic.features.named import FEATURES
from scenediff_classic.protocols import FeatureExtractor, RegionProposer
from scenediff_classic.regions.named import REGIONS

_NAMED: dict[Any, Mapping[Any, Any]] = {FeatureExtractor: FEATURES, RegionProposer: REGIONS}
"""Plug-ins that are chosen by name."""


def dotted(options: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested tables as one: ``scoring.voxel = 1`` and ``"scoring.voxel" = 1`` mean the same."""
    flat: dict[str, Any] = {}
    for key, value in options.items():
        if isinstance(value, Mapping):
            flat |= dotted(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def overridden(config: Any, options: Mapping[str, Any], where: str) -> Any:
    """The configuration with some options replaced.

    Parameters
    ----------
    config
        A frozen dataclass, nested.
    options : mapping
        Dotted name -> plain value; plug-ins for features and regions by their names.
    where : str
        What messages call the table.

    Raises
    ------
    InputError
        If a name is unknown or a value is of the wrong type.
    """
    for path, value in dotted(options).items():
        config = _with(config, path, value, f"{where}: {path}")
    return config


def _with(config: Any, path: str, value: Any, where: str) -> Any:
    name, _, rest = path.partition(".")
    known = [f.name for f in fields(config)]
    if name not in known:
        have = ", ".join(known)
        raise InputError(f"{where}: {type(config).__name__} has no '{name}', only {have}.")
    annotation = typing.get_type_hints(type(config))[name]
    current = getattr(config, name)
    if rest:
        if not is_dataclass(current):
            raise InputError(f"{where}: '{name}' has no options of its own.")
        return replace(config, **{name: _with(current, rest, value, where)})
    if annotation in _NAMED:
        plug_ins = _NAMED[annotation]
        if value not in plug_ins:
            raise InputError(f"{where} must be one of {', '.join(plug_ins)}, not {value!r}.")
        return replace(config, **{name: plug_ins[value]})
    return replace(config, **{name: read_as(annotation, value, where)})
