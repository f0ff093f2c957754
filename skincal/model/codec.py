"""JSON of frozen dataclasses: each field is written by its type, and checked against its declared type when it is read.

NaN is null, an infinite number is "inf" or "-inf", an array is a list, a member of an enum its name. Fields with the metadata
`{"stored": False}` are left out. Floats come back bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from enum import Enum
from functools import lru_cache, partial
from types import NoneType, UnionType
from typing import Any, TypeVar, cast, get_args, get_origin, get_type_hints

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.model.tables import quoted

T = TypeVar("T")
PARSE_ERRORS = (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError)
"""Errors of `from_json` on JSON that skincal never wrote."""
OPTIONAL_FIELD: Mapping[str, Any] = {"optional": True}
"""Metadata of a field that is left out while it is `None`, so that older files keep their bytes."""
ARRAY_SHAPES: Mapping[str, tuple[int | None, ...]] = {
    "tip": (3,), "force": (3,), "moment": (3,), "wrench": (6,), "rest_wrench": (6,), "link_from_sensor": (4, 4),
    "vectors": (None, 3),
}  # fmt: skip
"""Shapes of arrays by the name of their field, `None` for any length; all others have one dimension."""
MAX_POSE_COORDINATE_M = 1e3
"""m. Largest number in a pose: no sensor is a kilometre away."""


def to_json(value: Any) -> Any:
    """Convert a value to what `json.dumps` takes."""
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None if math.isnan(value) else str(float(value))
    if isinstance(value, np.ndarray):
        return to_json(cast("list[Any]", value.tolist()))
    if isinstance(value, list | tuple):
        return [to_json(item) for item in cast("list[Any]", value)]
    if isinstance(value, Enum):
        return value.name
    stored = [item for item in fields(value) if item.metadata.get("stored", True)]
    absent = {item.name for item in stored if item.metadata.get("optional") and getattr(value, item.name) is None}
    return {item.name: to_json(getattr(value, item.name)) for item in stored if item.name not in absent}


def from_json(kind: type[T], document: Mapping[str, Any]) -> T:
    """Read a dataclass from a JSON object. Missing fields have their defaults.

    Raises one of `PARSE_ERRORS`: a field is missing, unknown or of another type.
    """
    readers = _readers(kind)
    if unknown := document.keys() - readers.keys():
        raise ValueError(f"unknown name {quoted(sorted(unknown)[0])}")
    values: dict[str, Any] = {}
    for name, (read, is_required) in readers.items():
        if name in document:
            values[name] = read(document[name])
        elif is_required:
            raise KeyError(name)
    return kind(**values)


@lru_cache
def _readers(kind: type[Any]) -> dict[str, tuple[Callable[[Any], Any], bool]]:
    """Map each stored field to its reader, and whether it must be given."""
    hints = get_type_hints(kind)
    return {
        item.name: (_reader(hints[item.name], item.name), item.default is MISSING and item.default_factory is MISSING)
        for item in fields(kind)
        if item.metadata.get("stored", True)
    }


def _reader(wanted: Any, name: str) -> Callable[[Any], Any]:
    """Choose the reader of a declared type."""
    if get_origin(wanted) is UnionType:
        (inner,) = [_reader(each, name) for each in get_args(wanted) if each is not NoneType]
        return lambda value: None if value is None else inner(value)
    if get_origin(wanted) is tuple:
        read_item = _reader(get_args(wanted)[0], name)
        return lambda value: tuple(map(read_item, _as_list(value)))
    if wanted in (FloatArray, IntArray):
        if name == "link_from_sensor":
            return lambda value: _shared_pose(np.array(value, dtype=np.float64).tobytes())
        kind, shape = np.float64 if wanted == FloatArray else np.int64, ARRAY_SHAPES.get(name)
        return lambda value: _read_array(value, kind, shape)
    if wanted is float:
        return _read_float
    if issubclass(wanted, Enum):
        members = {**{each.value: each for each in wanted}, **wanted.__members__}
        return lambda value: members[value]
    return partial(from_json, wanted) if hasattr(wanted, "__dataclass_fields__") else partial(_exact, wanted)


def _as_list(value: Any) -> list[Any]:
    return _exact(list, list(cast("tuple[Any]", value)) if isinstance(value, tuple) else value)


def _exact(kind: type[Any], value: Any) -> Any:
    # The very type: to Python true and false are whole numbers.
    if type(value) is not kind:
        raise TypeError(f"{quoted(value)} is not of type {kind.__name__}")
    return value


def _read_float(value: Any) -> float:
    if value is None:
        return math.nan
    if type(value) not in (float, int) and value not in ("inf", "-inf"):
        raise TypeError(f"{quoted(value)} is no number")
    return float(value)


def _read_array(value: Any, kind: type[Any], shape: tuple[int | None, ...] | None) -> Any:
    array = np.array(_exact(list, value), dtype=kind)  # as a float, null is NaN and "inf" infinity
    if array.shape != tuple(len(value) if size is None else size for size in shape or (None,)):
        raise ValueError(f"an array has the shape {array.shape}")
    return array


@lru_cache(maxsize=64)
def _shared_pose(raw: bytes) -> FloatArray:
    """Read a pose, (4, 4), from its bytes: one read-only array for all pokes in it."""
    pose = np.frombuffer(raw).reshape(4, 4)
    if not np.abs(pose).max() < MAX_POSE_COORDINATE_M:  # nor NaN
        raise ValueError("a pose is none of a robot")
    return pose
