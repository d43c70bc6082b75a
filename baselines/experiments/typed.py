"""Plain values of a configuration file, checked against the types that take them."""

import math
import types
import typing
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, Union

from scenediff_classic.errors import InputError

_NAMES = {str: "a text", int: "a whole number", float: "a number", bool: "true or false"}


def read_as(annotation: Any, value: Any, where: str) -> Any:
    """A plain value as `annotation` wants it.

    Parameters
    ----------
    annotation
        A dataclass, ``str``, ``int``, ``float``, ``bool``, ``Path``, a literal, a union, a tuple,
        or a mapping of texts, nested in any way.
    where : str
        File and key, as messages name them.

    Raises
    ------
    InputError
        If the value does not fit, or a key of a table is unknown or missing.
    """
    origin, parts = typing.get_origin(annotation), typing.get_args(annotation)
    if annotation is Any:
        return value
    if is_dataclass(annotation) and isinstance(annotation, type):
        return _table(annotation, value, where)
    if origin in (Union, types.UnionType):
        return _either(parts, value, where)
    if origin is Literal:
        if value in parts and type(value) in {type(p) for p in parts}:
            return value
        raise InputError(f"{where} must be one of {', '.join(map(str, parts))}, not {value!r}.")
    if origin is tuple:
        return _row(parts, value, where)
    if origin in (dict, Mapping):
        if not isinstance(value, Mapping):
            raise InputError(f"{where} must be a table, not {value!r}.")
        return {key: read_as(parts[1], item, f"{where}.{key}") for key, item in value.items()}
    return _plain(annotation, value, where)


def _plain(kind: Any, value: Any, where: str) -> Any:
    if kind is Path and isinstance(value, str) and value:
        return Path(value)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if kind in _NAMES and type(value) is kind:
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"{where} must be a finite number, not {value}.")
        return value
    wanted = "a path" if kind is Path else _NAMES.get(kind)
    if wanted is None:
        raise InputError(f"{where} cannot be set in a configuration.")
    raise InputError(f"{where} must be {wanted}, not {value!r}.")


def _either(parts: tuple[Any, ...], value: Any, where: str) -> Any:
    """Of a union; what no part takes is refused in the words of the last one but None."""
    if value is None and type(None) in parts:
        return None
    wanted = [p for p in parts if p is not type(None)]
    for part in wanted[:-1]:
        try:
            return read_as(part, value, where)
        except InputError:
            continue
    return read_as(wanted[-1], value, where)


def _row(parts: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, (list, tuple)):
        raise InputError(f"{where} must be a list, not {value!r}.")
    if len(parts) == 2 and parts[1] is Ellipsis:
        parts = (parts[0],) * len(value)
    if len(parts) != len(value):
        raise InputError(f"{where} must have {len(parts)} entries, not {len(value)}.")
    items = enumerate(zip(parts, value, strict=True), start=1)
    return tuple(read_as(part, item, f"{where}[{k}]") for k, (part, item) in items)


def _table(kind: type, value: Any, where: str) -> Any:
    if value is True:
        value = {}  # a part that is off by default is switched on
    if not isinstance(value, Mapping):
        raise InputError(f"{where} must be a table, not {value!r}.")
    known = {item.name: item for item in fields(kind) if item.init}
    for key in value:
        if key not in known:
            raise InputError(f"{where} has an unknown key '{key}': known are {', '.join(known)}.")
    for name, item in known.items():
        if name not in value and item.default is MISSING and item.default_factory is MISSING:
            raise InputError(f"{where} lacks the key '{name}'.")
    hints = typing.get_type_hints(kind)
    return kind(**{k: read_as(hints[k], v, f"{where}.{k}") for k, v in value.items()})
