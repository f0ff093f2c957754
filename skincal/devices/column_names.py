"""Names of columns and of labelled values: times, counters, and axes of a wrench, as programs and boards write them."""

from __future__ import annotations

import re

from skincal.devices.netft_page import FORCE_UNITS, TORQUE_UNITS

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
WRENCH_AXES = ("fx", "fy", "fz", "mx", "my", "mz")
_TIME_UNIT = (
    "(s|ms|us|ns|sec(?:ond)?s?|msecs?|millis(?:econds?)?|usecs?|micros(?:econds?)?|\u00b5s|\u03bcs|nsecs?|nanos(?:econds?)?)"
)
TIME_COLUMN_RE = re.compile(
    r"(?:t|[%_]*time|zeit|uhrzeit|zeitpunkt|zeitstempel|temps|horodatage|tiempo|tempo|"
    r"datetime|date[ _/]?time|elapsed(?:[ _]time)?|clock|rosbagtimestamp|"
    rf"(?:.*[./])?(?:stamp|timestamp|time[ _]stamp))(?:(?!s$)[ _/,]*(?:in )?[\[(]?{_TIME_UNIT}[\])]?|s)?"
)
CLOCK_COLUMN_RE = re.compile(r"(ms|us|msec|usec|millis|micros|milliseconds|microseconds)(?:\(\))?")
COUNTER_COLUMN_RE = re.compile(
    r"(?:(?:.*[./])?header[./])?(?:seq|sequence|index|counter|count|frame|sample|samples|row|line|packet|no|nr|number|id)\.?"
    r"(?:[ _](?:no|nr|number|id|index|count|counter))?\.?|(?:rdt|f/t|ft)[ _]?seq(?:uence)?"
)
_WRENCH_AXIS_RE = re.compile(
    r"(?:.*[./_ ])?([fmt]|force|torque|moment|kraft|drehmoment|couple)[._/ ,-]*([xyz])"
    r"((?:[ _,/]*[\[(].*[\])]|[ _,/]*[a-z][a-z .*\u00b7-]*)?)"
)
_BRACKETS_RE = re.compile(r"[\[(]")
MOMENT_UNITS = {**TORQUE_UNITS, "mnm": 1e-3, "ncm": 1e-2, "knmm": 1.0}
_UNIT_WORDS = (("newtons?", "n"), ("millimet(er|re)s?", "mm"), ("met(er|re)s?", "m"), ("lbf", "lb"), ("kgf", "kg"), ("gf", "g"))


def short_unit(unit: str | None) -> str | None:
    """Return a unit of time as `s`, `ms`, `us` or `ns`."""
    if unit is None:
        return None
    first = {"\u00b5": "us", "\u03bc": "us"}.get(unit[0])
    return first or (
        "us" if unit.startswith(("us", "mic")) else "ns" if unit[0] == "n" else "ms" if unit.startswith(("ms", "mil")) else "s"
    )


def axis_of(name: str) -> tuple[str, str] | None:
    """Return axis and unit of a column of a force or moment; `None` if the name is none."""
    found = _WRENCH_AXIS_RE.fullmatch(name)
    if found is None:
        return None
    axis = ("f" if found[1][0] in "fk" else "m") + found[2]
    unit = plain_unit(found[3])
    # A word without brackets may be anything.
    if unit and not _BRACKETS_RE.search(found[3]) and unit not in {**FORCE_UNITS, **MOMENT_UNITS}:
        return None
    return axis, unit


def plain_unit(text: str) -> str:
    """Return a unit in small letters without marks."""
    unit = re.sub("[^a-z]", "", text.lower())
    for pattern, short in _UNIT_WORDS:
        unit = re.sub(pattern, short, unit)
    return unit
