"""Heads of LabVIEW measurement files (`.lvm`): separator, names, units, and the moment at which their time is 0."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from skincal.model.errors import InputError

FIRST_WORDS = "LabVIEW Measurement"
HEAD_END = "***End_of_Header***"
TIME_NAME = "t_s"
ABSOLUTE_MIN_S = 1e9
"""s. Times above it count since 1904, and need no moment of the head."""
_SEPARATOR_OF_WORD = {"tab": "\t", "comma": ","}
_MOMENT_RE = re.compile(r"(\d{4})[/.-](\d\d?)[/.-](\d\d?) (\d\d?):(\d\d):(\d\d(?:[.,]\d{1,6})?)\d*")


@dataclass(frozen=True, slots=True)
class LabviewHead:
    """Head of a LabVIEW measurement file."""

    separator: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    """Of each column; empty where the file names none."""
    names_at: int
    """Line of the names among those of the head."""
    start_s: float
    """Seconds since 1970 at its time 0; 0 if the head does not say it."""


def is_labview(first_line: str) -> bool:
    """Check whether a file begins as a LabVIEW measurement file does."""
    return first_line.startswith(FIRST_WORDS)


def read_labview_head(path: Path, lines: Sequence[str]) -> LabviewHead:
    """Read the lines before the first row.

    Raises InputError: the head has no end, or its times are not in one column.
    """
    ends = [k for k, line in enumerate(lines) if line.startswith(HEAD_END)]
    at = ends[-1] + 1 if ends else len(lines)
    if not ends or at == len(lines):
        raise InputError(
            f"{path}: its head has no {HEAD_END} and no names after it; expected a whole LabVIEW measurement file."
        )
    words = next((line[len("Separator") :].strip("\t ,").lower() for line in lines if line.startswith("Separator")), "tab")
    separator = _SEPARATOR_OF_WORD.get(words, "\t")
    rows = [[field.strip() for field in line.split(separator)] for line in lines[:at]]
    # The second head repeats some words of the first one, by channel.
    facts = {row[0]: row[1:] for row in rows if len(row) > 1}
    columns, dimension = _first(facts, "X_Columns", "One"), _first(facts, "X_Dimension", "Time")
    if columns.lower() != "one" or dimension.lower() != "time":
        raise InputError(
            f"{path}: has X_Columns {columns} and X_Dimension {dimension}; expected One column of Time: in 'Write To "
            "Measurement File' choose 'One column only' for X values."
        )
    names = tuple(field.strip().lower() for field in lines[at].split(separator))
    labels = facts.get("Y_Unit_Label", [])
    units = ("", *labels[: len(names) - 1])
    return LabviewHead(separator, (TIME_NAME, *names[1:]), units, at, _start_s(facts))


def _first(facts: dict[str, list[str]], key: str, missing: str) -> str:
    return next((word for word in facts.get(key, []) if word), missing)


def _start_s(facts: dict[str, list[str]]) -> float:
    found = _MOMENT_RE.match(f"{_first(facts, 'Date', '')} {_first(facts, 'Time', '')}")
    if found is None:
        return 0.0
    try:
        year, month, day, hour, minute = map(int, found.groups()[:5])
        moment = datetime(year, month, day, hour, minute, tzinfo=UTC)
    except ValueError:
        return 0.0
    return moment.timestamp() + float(found[6].replace(",", "."))
