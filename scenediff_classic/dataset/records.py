"""Typed values out of documents that nobody vouches for."""

import json
import math
import re
import reprlib
from pathlib import Path
from typing import Any, NoReturn

from scenediff_classic import masks
from scenediff_classic.errors import InputError
from scenediff_classic.types import Rle

MAX_FRAME = 10_000_000
"""Largest frame index accepted: more than 90 hours at 30 frames a second."""

_INTEGER = re.compile(r"-?[0-9]{1,9}")


def read_json(path: Path) -> Any:
    """Parsed JSON; NaN and Infinity, which are no JSON, are refused.

    Raises
    ------
    InputError
        The file is absent, unreadable or not JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror or error}).") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not valid JSON: it is damaged or cut short.") from error


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not JSON")


def mapping(value: object, where: str) -> dict[Any, Any]:
    """The value, if it is a dictionary."""
    if not isinstance(value, dict):
        raise InputError(f"{where} should be a mapping, not {type(value).__name__}.")
    return value


def sequence(value: object, where: str) -> list[Any]:
    """The value as a list, if it is one (or a tuple)."""
    if not isinstance(value, list | tuple):
        raise InputError(f"{where} should be a list, not {type(value).__name__}.")
    return list(value)


def entry(record: dict[Any, Any], key: str, where: str) -> Any:
    """The value under `key`, which must be there."""
    if key not in record:
        raise InputError(f"{where}: '{key}' is missing.")
    return record[key]


def index(value: object, where: str, lowest: int = 0) -> int:
    """A whole number from `lowest` to `MAX_FRAME`; text of digits counts, as JSON keys are text."""
    number = int(value) if isinstance(value, str) and _INTEGER.fullmatch(value) else value
    if isinstance(number, bool) or not isinstance(number, int):
        raise InputError(f"{where} should be a whole number, not {shown(value)}.")
    if not lowest <= number <= MAX_FRAME:
        raise InputError(f"{where} is {shown(number)}, outside {lowest} to {MAX_FRAME}.")
    return number


def number(value: object, where: str) -> float:
    """A finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < math.inf:
        raise InputError(f"{where} should be a finite number, not {shown(value)}.")
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{where} is too large a number.") from None


def text(value: object, where: str) -> str:
    """A text of reasonable length; a plain number or truth value is written out."""
    if not isinstance(value, str | int | float) or len(str(value)) > 10_000:
        raise InputError(f"{where} should be a short text, not {shown(value)}.")
    return str(value)


def shown(value: object) -> str:
    """The value in a message, cut short if long."""
    return reprlib.repr(value)


def flag(value: object, where: str) -> bool:
    """True or false; 0 and 1 count."""
    if value not in (True, False):
        raise InputError(f"{where} should be true or false, not {shown(value)}.")
    return bool(value)


def mask(value: object, where: str) -> Rle:
    """A verified run-length mask from ``{"size": [h, w], "counts": ...}``."""
    record = mapping(value, where)
    return masks.verified(entry(record, "size", where), entry(record, "counts", where), where)
