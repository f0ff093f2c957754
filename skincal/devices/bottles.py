"""Readings in a YARP bottle, whether it came in binary from a port or as text from a log.

Angles of joint ports are degrees. Of `measures:o` the sixth group holds six-axis sensors, the ninth skin patches, each
measure with a stamp of its own; of `stateExt:o` the first element is the joints' angles.
"""

from __future__ import annotations

import math
import re
from typing import TypeAlias

import numpy as np

from skincal.devices.decoding import TIME_STAMP_MAX_S
from skincal.geometry import FloatArray
from skincal.model.readings import Stream

Value: TypeAlias = "float | str | FloatArray | list[Value]"
"""One value of a bottle; a list of numbers is an array."""

MEASURES_WRENCH, MEASURES_SKIN, MEASURES_LISTS = 5, 8, 10
"""Index of the six-axis sensors and of the skin patches in the groups of `measures:o`; fewest groups (newer versions: 12)."""
STATE_EXT_LENGTHS = (22, 24)
"""Elements of `stateExt:o`, of 3.x and of 4.0."""
_NAN_RE = re.compile(rb"(?<![\w.#])[+-]?(?:nan(?:\(\w*\))?|1\.#(?:QNAN|SNAN|NAN|IND)\d*)(?:\.0)?(?![\w.#(])", re.IGNORECASE)
_INFINITY_RE = re.compile(rb"(?<![\w.#])([+-]?)(?:inf(?:inity)?|1\.#INF\d*)(?:\.0)?(?![\w.#])", re.IGNORECASE)
_NOT_FINITE_MARKS = (b"nan", b"inf", b"#")


def plain_not_finite(text: bytes) -> bytes:
    """Replace the texts of NaN and infinity that C libraries and YARP write (`-nan.0`, `-nan(ind)`, `1.#INF`) by `nan`, `inf`.

    YARP ends a number without a point with `.0`, and a negative NaN is one of these.
    """
    if not any(mark in text for mark in _NOT_FINITE_MARKS):
        return text
    return _INFINITY_RE.sub(rb"\1inf", _NAN_RE.sub(b"nan", text))


def as_vector(value: Value) -> FloatArray | None:
    """Read a list of numbers, also one nested alone in a list; `None` for anything else."""
    if isinstance(value, list) and len(value) == 1 and isinstance(value[0], (list, np.ndarray)):
        return as_vector(value[0])
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, list) and value and all(isinstance(each, float) for each in value):
        return np.array(value, np.float64)
    return None


def measures(groups: list[Value], which: int) -> list[tuple[FloatArray, float]]:
    """Read numbers and stamp, seconds, of each measurement of one group of `measures:o`."""
    group = groups[which]
    found: list[tuple[FloatArray, float]] = []
    for measure in group if isinstance(group, list) else []:
        if isinstance(measure, list) and len(measure) == 2 and isinstance(measure[1], float):
            values = as_vector(measure[0])
            if values is not None and abs(measure[1]) < TIME_STAMP_MAX_S:
                found.append((values, measure[1]))
    return found


def is_measures(value: Value) -> bool:
    """Check whether a bottle has the form of a message of `measures:o`."""
    return isinstance(value, list) and len(value) >= MEASURES_LISTS and all(isinstance(each, list) for each in value)


def values_of(value: Value, stream: Stream) -> tuple[FloatArray, float] | None:
    """Find the values of one stream in a bottle, with their own stamp, seconds (NaN without one); `None` if there are none.

    A bottle is a vector, a vector in one list, or has the form of `measures:o` or `stateExt:o`.
    """
    if isinstance(value, list) and is_measures(value):
        found = measures(value, {Stream.WRENCH: MEASURES_WRENCH, Stream.SKIN: MEASURES_SKIN}.get(stream, 0))
        if not found or stream is Stream.JOINTS:
            return None
        return found[0] if stream is Stream.WRENCH else (np.concatenate([values for values, _ in found]), found[0][1])
    vector = as_vector(value)
    if vector is None and isinstance(value, list) and len(value) in STATE_EXT_LENGTHS:
        vector = as_vector(value[0])
    return None if vector is None else (vector, math.nan)
