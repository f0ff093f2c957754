"""Columns of a table by their names: the time, a counter, and the values of each stream.

A column that is known by its name is never a taxel. Of the others, taxels are one family of numbered columns (`t0 t1 ...`),
with the number of the scene's channels where it is known, else all of them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

from skincal.devices.column_names import (
    CLOCK_COLUMN_RE,
    COUNTER_COLUMN_RE,
    MOMENT_UNITS,
    TIME_COLUMN_RE,
    WRENCH_AXES,
    axis_of,
    plain_unit,
    short_unit,
)
from skincal.devices.netft_page import FORCE_UNITS
from skincal.devices.pose_names import NO_POSE_NAMES, POSE_UNIT, PoseNames, axis_letters
from skincal.files.importers.table_form import TableForm
from skincal.files.importers.table_values import is_date, is_time_of_day, to_float
from skincal.model.errors import InputError, plural
from skincal.model.pose_form import POSE_WIDTHS
from skincal.model.readings import Stream
from skincal.model.skin_axes import AXIS_NAMES, ValueOrder

UNIX_NS = (1e18, 5e18)
"""Nanoseconds since 1970 of the years 2001 to 2128; as seconds they would be no time of any clock."""
NAMES_SHOWN_MAX = 8
_DATE_COLUMN_RE = re.compile(r"(?:date|day|datum)(?: \[.*\])?")
_SECONDS_COLUMN_RE = re.compile(r"((?:.*[./_ ])?)(?:sec|secs|seconds)")
_NANOSECONDS_COLUMN_RE = re.compile(r"((?:.*[./_ ])?)(?:nanosec|nanosecs|nsec|nsecs|nanoseconds)")
_STATUS_COLUMN_RE = re.compile(r"(?:.*[./_ ])?status(?: ?\(hex\))?")
_HEADER_FIELD_RE = re.compile(r"(?:.*[./])?(?:header|layout)[./].*")
_NUMBERED_COLUMN_RE = re.compile(r"((?:.*[./])?\D*?)(\d+)[\])]?(?:[ _]*[\[(]\D[^\])]*[\])])?")
_GRID_COLUMN_RE = re.compile(r"((?:.*[./])?\D*?)(\d+)(\D+)(\d+)([\])]?)")
"""Row and column of a taxel in a mat: `r0c0`, `t_0_1`, `skin/0/1`."""
_NUMBER_WITHIN_RE = re.compile(r"(\D*)(\d+)(\D+)")
"""A number with a word behind it: `t0_raw`."""
_VECTOR_COLUMN_RES = (
    re.compile(r"(?P<base>\D*)(?P<number>\d+)[ ._/\])-]*(?:f|b)?(?P<axis>[xyz])(?:[ _]*[\[(]\D*[\])])?"),
    re.compile(r"(?P<base>\D*?)(?P<axis>[xyz])[ ._/\[(-]*(?P<number>\d+)[\])]?(?:[ _]*[\[(]\D*[\])])?"),
)
"""A value of a taxel of three axes: `s1_x`, `t0.fz [n]`; `x1`, `fz_12`."""
_HEX_NUMBER_RE = re.compile("[0-9a-f]{1,4}")
_JOINT_COLUMN_RE = re.compile(r".*[ _]*[\[(]?(deg|rad)[\])]?")
_JOINT_NAME_RE = re.compile(r".+[ _\[(](?:deg|rad)[\])]?")
_JOINT_WORD_RE = re.compile(r"joint|(?:^|[^a-z])(?:j|q|a|axis|pos|position|angle)[ _\[(]?\d|position$|angle$")
_POSE_COLUMN_RE = re.compile(
    r"(?:.*[./_ ])?(?:(?:p|t|pos|position|translation)?[._]?[xyz]|(?:q|quat|rot|r|orientation|rotation)[._]?[xyzw]"
    rf"|roll|pitch|yaw|w|[abc](?=[ _]*[\[(]?(?:deg|rad|\u00b0))){POSE_UNIT}"
)
"""Columns of a position, a quaternion, a rotation vector, or three angles; a, b and c alone may be anything."""
_QUATERNION_0_RE = re.compile(r"(.*[./_ ])?q0")
"""w of NDI's quaternion `q0 qx qy qz`, or the first joint of a robot."""
_PRESSURE_CENTRE_RE = re.compile(r"(?:.*[./_ ])?(?:a|cop|cop_|cop |p|cp)[xy](?:[ _]*[\[(].*)?")


@dataclass(frozen=True, slots=True)
class TimeColumns:
    """Columns that say the time of a row."""

    columns: tuple[int, ...]
    """One, a day and a time of day, or seconds and nanoseconds."""
    unit: str | None
    """Of the first column; `None` if its name has none."""
    title: str
    is_split: bool = False
    """Whether the columns are seconds and nanoseconds."""


@dataclass(frozen=True, slots=True)
class ValueColumns:
    """Columns of the values of a stream."""

    at: tuple[int, ...]
    """-1 for a taxel whose column is missing."""
    factors: tuple[float, ...]
    """To N, N m, degrees or raw values."""
    findings: tuple[str, ...] = ()
    pose_names: PoseNames = NO_POSE_NAMES
    """What the names state on the numbers of a pose."""
    value_order: ValueOrder | None = None
    """Order of the values of taxels of three axes by their names; `None` if these name no axes."""


@dataclass(slots=True)
class _Family:
    """Columns whose names differ by a number alone."""

    base: str
    end: str = ""
    """Behind the number."""
    at: dict[int, int] = field(default_factory=dict[int, int])
    """Column by number."""
    grid_width: int = 0
    """Columns of a mat, whose taxels are numbered along its rows; 0 for one number a name."""
    grid_first: tuple[int, int] = (0, 0)
    """First row and first column of a mat."""
    between: str = ""
    """Between row and column."""

    def __str__(self) -> str:
        first, last = self.name(min(self.at)), self.name(max(self.at))
        return f"{first} to {last}" if last != first else first

    def name(self, number: int) -> str:
        if not self.grid_width:
            return f"{self.base}{number}{self.end}"
        row, column = divmod(number, self.grid_width)
        return f"{self.base}{row + self.grid_first[0]}{self.between}{column + self.grid_first[1]}{self.end}"

    @property
    def span(self) -> int:
        return max(self.at) - min(self.at) + 1

    @property
    def missing(self) -> list[int]:
        return [number for number in range(min(self.at), max(self.at)) if number not in self.at]


def names_time(names: Sequence[str]) -> bool:
    """Check whether some of the names say the time."""
    has_pair = any(_SECONDS_COLUMN_RE.fullmatch(name) for name in names) and any(map(_NANOSECONDS_COLUMN_RE.fullmatch, names))
    return has_pair or any(TIME_COLUMN_RE.fullmatch(name) or CLOCK_COLUMN_RE.fullmatch(name) for name in names)


class TableColumns:
    """Columns of one table by their names.

    Raises InputError: no column is the time.
    """

    def __init__(self, form: TableForm) -> None:
        self.names, self.path = form.names, form.path
        self._form = form
        self._first = form.examples[0] if form.examples else ()
        self.time = self._find_time()
        numbers = (k for k, name in enumerate(self.names) if k not in self.time.columns and COUNTER_COLUMN_RE.fullmatch(name))
        self.number = next(numbers, None)
        self.texts = [k for k in range(len(self.names)) if self._is_text(k)]
        """Columns without a number in their first rows."""
        self.wrench = [k for k, name in enumerate(self.names) if self._is_free(k) and axis_of(name)]
        """Columns of forces and moments."""
        joints = [k for k, name in enumerate(self.names) if self._is_free(k) and _JOINT_NAME_RE.fullmatch(name)]
        self.joints = [k for k in joints if k not in self.wrench]
        """Columns of angles with a unit."""
        known = {*self.wrench, *self.joints}
        self.others = [k for k in range(len(self.names)) if self._is_free(k) and k not in known]
        """Columns that no name explains: taxels, or what the program does not know."""

    def _is_free(self, column: int) -> bool:
        name = self.names[column]
        return bool(name) and column not in (*self.time.columns, self.number, *self.texts) and not is_known_name(name)

    def _is_text(self, column: int) -> bool:
        fields = [row[column] for row in self._form.examples if column < len(row) and row[column]]
        return bool(fields) and all(to_float(text) is None for text in fields)

    def _find_time(self) -> TimeColumns:
        names, first = self.names, self._first
        for seconds, name in enumerate(names):
            if (found := _SECONDS_COLUMN_RE.fullmatch(name)) is not None:
                pair = (
                    k
                    for k, other in enumerate(names)
                    if (more := _NANOSECONDS_COLUMN_RE.fullmatch(other)) and more[1] == found[1]
                )
                for nanoseconds in pair:
                    return TimeColumns(
                        (seconds, nanoseconds), "s", f"the time columns {name!r} and {names[nanoseconds]!r}", True
                    )
        times = [(k, found[1]) for k, name in enumerate(names) if (found := TIME_COLUMN_RE.fullmatch(name))]
        times += [(k, found[1]) for k, name in enumerate(names) if (found := CLOCK_COLUMN_RE.fullmatch(name))]
        days = [k for k, text in enumerate(first) if is_date(text) and k < len(names)]
        clocks = [k for k, text in enumerate(first) if is_time_of_day(text) and k in [each for each, _ in times]]
        if days and clocks:
            title = f"the columns {names[days[0]]!r} and {names[clocks[0]]!r}"
            return TimeColumns((days[0], clocks[0]), "s", title)
        if not times:
            raise InputError(
                f"{self.path}: no column is the time; seen {self._list_names(range(len(names)))}; expected one named t_s, "
                "t_ms, t_us or t_ns."
            )
        at, unit = times[0]
        return TimeColumns((at,), short_unit(unit), f"the time column {names[at]!r}")

    def of_stream(self, stream: Stream, within: str, channels: int) -> ValueColumns:
        """Choose the columns of a stream.

        Parameters
        ----------
        within : begin of the names of the wanted columns; empty for all
        channels : of the skin; 0 if unknown

        Raises InputError: columns are missing, or more than one choice is possible.
        """
        within = within.lower()
        if within and not any(name.startswith(within) for name in self.names):
            raise InputError(f"{self.path}: no column begins with {within}; seen {self._list_names(range(len(self.names)))}.")
        match stream:
            case Stream.WRENCH:
                return self._wrench_columns([k for k in self.wrench if self.names[k].startswith(within)])
            case Stream.JOINTS:
                return self._joint_columns(within)
            case Stream.TOOL:
                return self._pose_columns([k for k in range(len(self.names)) if self.names[k].startswith(within)])
            case _:
                # Forces of taxels, `s1_fx`, have the names of a sensor's.
                columns = [k for k in self.others or self.wrench if self.names[k].startswith(within)]
                return self._vector_columns(columns, channels) or self._skin_columns(
                    [k for k in columns if k in self.others], channels
                )

    def _list_names(self, columns: Sequence[int]) -> str:
        return ", ".join(repr(name) if "," in name else name for name in (self.names[k] for k in columns[:NAMES_SHOWN_MAX]))

    # Force/torque

    def _wrench_columns(self, columns: Sequence[int]) -> ValueColumns:
        at: dict[str, int] = {}
        factor: dict[str, float] = {}
        for index in columns:
            axis, unit = axis_of(self.names[index]) or ("", "")
            if axis in at:
                raise InputError(
                    f"{self.path}: columns {self.names[at[axis]]!r} and {self.names[index]!r} both are {axis}; expected one "
                    "sensor's: leave out those of the other, or write the begin of the names after the file (FILE::/left)."
                )
            at[axis] = index
            factor[axis] = self._unit_factor(axis, unit, self.names[index])
        missing = [axis for axis in WRENCH_AXES if axis not in at]
        if missing:
            raise InputError(self._missing_axes(missing))
        has_units = any(unit for _, unit in filter(None, (axis_of(self.names[k]) for k in at.values())))
        counts, finding = self._by_facts([at[axis] for axis in WRENCH_AXES], has_units=has_units)
        factors = tuple(factor[axis] * counts.get(axis[0], 1.0) for axis in WRENCH_AXES)
        return ValueColumns(tuple(at[axis] for axis in WRENCH_AXES), factors, finding)

    def _missing_axes(self, missing: Sequence[str]) -> str:
        seen = self._list_names(range(len(self.names)))
        if {"mx", "my"} <= {*missing} and len(
            [k for k, name in enumerate(self.names) if _PRESSURE_CENTRE_RE.fullmatch(name)]
        ) >= 2:
            return (
                f"{self.path}: has the centre of pressure of a force plate (seen {seen}), and no moments mx and my. These need "
                "the height of the plate's surface, too: export the moments Mx My Mz about the plate's origin."
            )
        return (
            f"{self.path}: columns {', '.join(missing)} are missing; seen {seen}; expected fx fy fz mx my mz, in N "
            "and N m: name them so."
        )

    def _unit_factor(self, axis: str, unit: str, name: str) -> float:
        factors = FORCE_UNITS if axis.startswith("f") else MOMENT_UNITS
        if unit in ("", "count", "counts", "raw"):
            return 1.0
        if unit not in factors:
            expected = "N" if axis.startswith("f") else "N m"
            raise InputError(f"{self.path}: the unit of column {name!r} is not known; expected {expected}: convert its values.")
        return factors[unit]

    def _by_facts(self, columns: Sequence[int], *, has_units: bool) -> tuple[dict[str, float], tuple[str, ...]]:
        """Return factors of force and moment from the facts before the names: units, and counts a unit where there are counts.

        Raises InputError: the values are counts, and the facts do not say the unit; or a unit is not known.
        """
        facts = "\n".join(self._form.facts)
        counts = {kind: to_float(found[1].replace(",", "")) for kind, found in _facts(_COUNTS_RE, facts).items()}
        units = {kind: plain_unit(found[1]) for kind, found in _facts(_FACT_UNIT_RE, facts).items()}
        if not has_units and len(units) < len(_FACT_KINDS):
            units = {**comment_units(self.path, self._form.facts), **units}
        if has_units or not (counts or units):
            return {}, () if has_units else _mentioned_units(facts)
        are_counts = bool(counts) and self._are_whole(columns)
        factors: dict[str, float] = {}
        for kind, table in (("force", FORCE_UNITS), ("torque", MOMENT_UNITS)):
            unit, count = units.get(kind, "n" if kind == "force" else "nm"), counts.get(kind)
            if unit not in table or (are_counts and not count):
                raise InputError(
                    f"{self.path}: the lines before the names do not say the unit of its {kind}, or one that is not known; "
                    "expected 'Force Units' and 'Torque Units' (N, Nm, lbf, lbf-in, ...); of counts also 'Counts per Unit "
                    "Force' and those of the torque."
                )
            factors["f" if kind == "force" else "m"] = table[unit] / (count if are_counts and count else 1.0)
        said = "in the units of the lines before the names" if units else "in N and Nm"
        if are_counts:
            said = f"divided by {counts['force']:g} and {counts['torque']:g} counts a unit, by the lines before the names"
        elif counts:
            said += ", and not counts, as they have decimals"
        return factors, (f"the values are {said}.",)

    def _are_whole(self, columns: Sequence[int]) -> bool:
        """Check whether the first values are whole numbers."""
        uses = self._form.number_uses()
        values = [to_float(row[k], uses) for row in self._form.examples for k in columns if k < len(row)]
        return all(value is not None and value == round(value) for value in values if value is None or math.isfinite(value))

    # Joints

    def _joint_columns(self, within: str) -> ValueColumns:
        known = [k for k, name in enumerate(self.names) if self._is_joint(k, name) and name.startswith(within)]
        bases = {_family_base(self.names[k]) for k in known}
        families = self._families(self.others)
        has_more = bool(self.wrench) or any(len(each.at) > 1 and each.base not in bases for each in families)
        unnamed = [k for k in self.others if k not in known and (not has_more or _family_base(self.names[k]) in bases)]
        if unnamed or not known:
            raise InputError(self._unnamed_joints(unnamed or self.others))
        factors = [1.0 if joint_unit(self.names[k]) == "deg" else math.degrees(1.0) for k in known]
        return ValueColumns(tuple(known), tuple(factors))

    def _unnamed_joints(self, columns: Sequence[int]) -> str:
        """Say why columns are no joint angles."""
        likely = [k for k in columns if _JOINT_WORD_RE.search(self.names[k])] or list(columns)
        if not likely:
            seen = self._list_names(range(len(self.names)))
            return f"{self.path}: no column is a joint; seen {seen}; expected one a joint, such as j0_deg, j1_deg, ..."
        name = self.names[likely[0]]
        return (
            f"{self.path}: column {name!r} names no unit; expected names such as j0_deg or j0_rad. If it is the angle of a "
            f"joint, name it {name}_deg or {name}_rad, and the others so."
        )

    def _is_joint(self, column: int, name: str) -> bool:
        return column not in self.wrench and self._is_free(column) and _JOINT_COLUMN_RE.fullmatch(name) is not None

    # Poses of a tool

    @property
    def named_pose(self) -> list[int]:
        """Columns whose names are those of a pose; without a force, `tx ty tz` are a place and no torque."""
        has_force = any(axis.startswith("f") for axis, _ in filter(None, (axis_of(self.names[k]) for k in self.wrench)))
        known = (*self.time.columns, self.number, *self.texts, *(self.wrench if has_force else ()))
        return [k for k, name in enumerate(self.names) if k not in known and self._is_of_pose(name)]

    def _is_of_pose(self, name: str) -> bool:
        q0 = _QUATERNION_0_RE.fullmatch(name)
        if q0 is None:
            return _POSE_COLUMN_RE.fullmatch(name) is not None
        before = q0[1] or ""
        return f"{before}qx" in self.names and f"{before}qw" not in self.names

    def _pose_columns(self, columns: Sequence[int]) -> ValueColumns:
        """Choose the columns of a pose: x y z first, then those of the rotation, all in the order of the table."""
        named = [k for k in self.named_pose if k in columns]
        chosen = named if len(named) in POSE_WIDTHS else [k for k in self.others if k in columns]
        names = [self.names[k] for k in chosen]
        ends, stated = axis_letters(names), PoseNames.read(names)
        if stated.mistake is not None:
            raise InputError(
                f"{self.path}: its columns are {self._list_names(chosen)}, {stated.mistake.finding}; {stated.mistake.advice}."
            )
        if len(chosen) not in POSE_WIDTHS or (len(chosen) < 16 and ends[:3] not in (["x", "y", "z"], [""] * 3)):
            raise InputError(
                f"{self.path}: has no pose of a tool; seen {self._list_names(range(len(self.names)))}; expected x y z and the "
                "rotation in the order of [tool]: 6, 7 or 12 columns, or 16 of a matrix. FILE::NAME takes the columns whose "
                "names begin so."
            )
        order = "".join(ends[3:]) if len(chosen) == 7 else ""
        said = f"its columns are {self._list_names(chosen)}."
        if order in ("xyzw", "wxyz"):
            said += f' The quaternion is in the order {" ".join(order)}: [tool] needs rotation = "{order}".'
        elif len(chosen) == 7 and all(ends):
            raise InputError(
                f"{self.path}: its quaternion is in the order {' '.join(ends[3:])}; expected x y z w, or w x y z: order the "
                "columns so."
            )
        return ValueColumns(tuple(chosen), (1.0,) * len(chosen), (said,), stated)

    # Skin

    def _families(self, columns: Sequence[int], pattern: re.Pattern[str] = _NUMBERED_COLUMN_RE) -> list[_Family]:
        found: dict[tuple[str, str], _Family] = {}
        for column in columns:
            numbered = pattern.fullmatch(self.names[column])
            if numbered is None:
                continue
            base, end = numbered[1], numbered[3] if pattern.groups > 2 else ""
            family = found.setdefault((base, end), _Family(base, end))
            number = int(numbered[2])
            if number in family.at:
                raise InputError(
                    f"{self.path}: columns {self.names[family.at[number]]!r} and {self.names[column]!r} are number {number}; "
                    "expected one column a channel: leave out one of them."
                )
            family.at[number] = column
        for family in found.values():
            self._add_first(family, columns)
        return list(found.values())

    def _add_first(self, family: _Family, columns: Sequence[int]) -> None:
        """Add the column without a number: pandas numbers equal names from the second on, `skin skin.1 skin.2`."""
        if family.base.endswith(".") and min(family.at) == 1:
            first = next((k for k in columns if self.names[k] == family.base[:-1]), None)
            family.at |= {} if first is None else {0: first}

    def _grids(self, columns: Sequence[int]) -> list[_Family]:
        """Find mats: columns whose names differ in a row and a column. Their taxels are numbered along the rows."""
        found: dict[tuple[str, str, str], dict[tuple[int, int], int]] = {}
        for column in columns:
            if (named := _GRID_COLUMN_RE.fullmatch(self.names[column])) is not None:
                found.setdefault((named[1], named[3], named[5]), {})[int(named[2]), int(named[4])] = column
        grids: list[_Family] = []
        for (base, between, end), at in found.items():
            rows, places = [row for row, _ in at], [place for _, place in at]
            first, width = (min(rows), min(places)), max(places) - min(places) + 1
            if len({*rows}) > 1 and len({*places}) > 1 and width < 2 * len({*places}):
                numbered = {(row - first[0]) * width + place - first[1]: column for (row, place), column in at.items()}
                grids.append(_Family(base, end, numbered, width, first, between))
        return grids

    def _hexadecimal(self, family: _Family, columns: Sequence[int]) -> _Family | None:
        """Return the family whose numbers are hexadecimal, if with these all numbers from 0 on are there: `t9`, `ta`."""
        base = family.base
        rests = {k: self.names[k].removeprefix(base) for k in columns if self.names[k].startswith(base)}
        found = {int(rest, 16): k for k, rest in rests.items() if _HEX_NUMBER_RE.fullmatch(rest)}
        has_letters = any(not rests[k].isdigit() for k in found.values())
        is_whole = has_letters and sorted(found) == list(range(len(found))) and not family.end
        return _Family(base, at=found) if is_whole and {*family.at.values()} <= {*found.values()} else None

    def skin_families(self) -> list[tuple[str, int]]:
        """List begin of the names and number of channels of each family that may be a skin."""
        families = [each for each in (*self._families(self.others), *self._grids(self.others)) if len(each.at) > 1]
        return [(self._common_begin(each), len(self._in_order(each, 0).at)) for each in families]

    def _common_begin(self, family: _Family) -> str:
        """Return the begin of the names of a family, also of one whose first name has no number."""
        first = family.at.get(0)
        return family.base[:-1] if first is not None and self.names[first] == family.base[:-1] else family.base

    def _skin_columns(self, columns: list[int], channels: int) -> ValueColumns:
        if not columns:
            raise InputError(f"{self.path}: no column besides the time; expected one a channel, such as t0, t1, ...")
        grids = self._grids(columns)
        families = self._families(columns) or grids or self._families(columns, _NUMBER_WITHIN_RE)
        families = [self._hexadecimal(each, columns) or each for each in families]
        fitting = [each for each in families if channels and channels in (len(each.at), each.span)]
        fitting = fitting or [each for each in grids if channels and channels in (len(each.at), each.span)]
        if len(fitting) > 1:
            bases = " or ".join(f"{self.path.name}::{each.base}" for each in fitting)
            advice = f"name it: {bases}" if len({each.base for each in fitting}) == len(fitting) else "leave out the others"
            raise InputError(
                f"{self.path}: {' and '.join(map(str, fitting))} have {channels} channels each, as the scene; expected one "
                f"skin: {advice}."
            )
        numbered = sum(len(each.at) for each in families)
        if fitting:
            chosen = fitting[0]
        elif len(families) == 1 and numbered == len(columns):
            chosen = families[0]
        elif channels in (0, len(columns)):
            large = max(families, key=lambda each: len(each.at), default=None)
            if channels or large is None or len(large.at) * 2 <= len(columns):
                return self._as_they_stand(columns, families, channels)
            chosen = large
        else:
            raise InputError(self._wrong_width(columns, families, channels))
        if chosen.grid_width:
            self._check_grid(chosen)
        found = self._in_order(chosen, channels)
        if channels and len(found.at) != channels:
            raise InputError(self._wrong_width(columns, families, channels))
        left = [k for k in columns if k not in found.at]
        more = f" and {len(left) - NAMES_SHOWN_MAX} more" if len(left) > NAMES_SHOWN_MAX else ""
        mat = (
            f"the names are rows and columns of a mat: taken in the order of the file, channel 0 is {chosen.name(0)}, channel "
            f"{len(found.at) - 1} is {chosen.name(max(chosen.at))}."
        )
        findings = [
            *found.findings,
            *([mat] if chosen.grid_width else []),
            *([f"columns {self._list_names(left)}{more} are not read; the taxels are {chosen}."] if left else []),
        ]
        return ValueColumns(found.at, found.factors, tuple(findings))

    def _vector_columns(self, columns: Sequence[int], channels: int) -> ValueColumns | None:
        """Find taxels of three axes by names of a number and an axis; `None` unless these are the whole skin in an order."""
        for pattern in _VECTOR_COLUMN_RES:
            named = {k: found for k in columns if (found := pattern.fullmatch(self.names[k])) is not None}
            by_taxel = [(int(found["number"]), found["axis"]) for found in named.values()]
            numbers = sorted({number for number, _ in by_taxel})
            every = [(number, axis) for number in numbers for axis in AXIS_NAMES]
            by_axis = sorted(every, key=lambda each: each[1])
            one_base = len({found["base"] for found in named.values()}) == 1
            is_whole = len(numbers) > 1 and numbers[-1] - numbers[0] < len(numbers) and one_base
            # Two inertial sensors beside a skin have such names, too.
            is_most = channels == len(named) or (not channels and 2 * len(named) > len(columns))
            if is_whole and by_taxel in (every, by_axis) and is_most:
                self._check_no_other_skin(named, columns, channels)
                finding = f"its columns are x, y and z of {len(numbers)} taxels, {numbers[0]} to {numbers[-1]}."
                order = ValueOrder.BY_TAXEL if by_taxel == every else ValueOrder.BY_AXIS
                return ValueColumns(tuple(named), (1.0,) * len(named), (finding,), value_order=order)
        return None

    def _check_no_other_skin(self, named: Collection[int], columns: Sequence[int], channels: int) -> None:
        """Raise InputError: columns without an axis in their names have `channels` numbers, as the `named` ones have."""
        rest = [k for k in columns if k not in named]
        other = next(
            (each for each in (*self._families(rest), *self._grids(rest)) if channels in (len(each.at), each.span)), None
        )
        if other is not None:
            raise InputError(
                f"{self.path}: {other} and {self._list_names(sorted(named))} have {channels} channels each, as the scene; "
                f"expected one skin: name it by the begin of its names, such as {self.path.name}::{other.base}, or leave out "
                "the others."
            )

    def _check_grid(self, grid: _Family) -> None:
        """Raise InputError: the columns of a mat are not in the order of its rows, so that two numberings are possible."""
        at = [grid.at[number] for number in sorted(grid.at)]
        if at != sorted(at):
            names = self._list_names(sorted(at)[:5])
            raise InputError(self._unordered(names))

    def _unordered(self, names: str) -> str:
        return (
            f"{self.path}: the numbers in the names ({names}, ...) do not rise in the order of the file; expected one number a "
            "name, which is the channel: name the taxels t0, t1, ..."
        )

    def _as_they_stand(self, columns: Sequence[int], families: Sequence[_Family], channels: int) -> ValueColumns:
        """Take columns of several families, or without numbers, by distinct numbers, else in the order of the file.

        Raises InputError: some columns are of no family and others are, or the names count in another order than the file.
        """
        several = [each for each in families if len(each.at) > 1]
        members = {column for each in several for column in each.at.values()}
        strays = [k for k in columns if k not in members]
        if channels and several and strays:
            raise InputError(
                f"{self.path}: {self._list_names(strays)} and {' and '.join(map(str, several))} together are {channels} "
                "columns, as many as channels. Leave out what is no taxel; add a missing taxel as an empty column with its "
                "number, or number all taxels from one name (t0, t1, ...)."
            )
        number_of = {column: number for each in families for number, column in each.at.items()}
        numbers = sorted({*number_of.values()})
        if len(numbers) == len(columns) == numbers[-1] - numbers[0] + 1:
            return ValueColumns(tuple(sorted(columns, key=number_of.__getitem__)), (1.0,) * len(columns))
        names = [self.names[k] for k in columns]
        if not _counts_up(names):
            raise InputError(self._unordered(self._list_names(columns[:5])))
        finding = (
            f"the names have no one number a channel: taken in the order of the file, channel 0 is {names[0]}, "
            f"channel {len(names) - 1} is {names[-1]}."
        )
        return ValueColumns(tuple(columns), (1.0,) * len(columns), (finding,))

    def _in_order(self, family: _Family, channels: int) -> ValueColumns:
        """Order the columns of a family by their numbers. A missing number is a taxel without readings.

        Raises InputError: numbers are missing, though there are as many columns as channels.
        """
        numbers, missing = sorted(family.at), family.missing
        names = ", ".join(map(family.name, missing[:NAMES_SHOWN_MAX]))
        if missing and len(numbers) == channels:
            raise InputError(
                f"{self.path}: {family} are {plural(channels, 'column')}, as many as the scene has channels, but {names} "
                f"{'is' if len(missing) == 1 else 'are'} missing: the columns behind would be read as their neighbours. If the "
                f"skin has the missing numbers, too, [skin] channels of the scene is {family.span}; else number the columns "
                "without a gap."
            )
        fills = (
            missing
            and len(numbers) != channels
            and (family.span == channels or (not channels and family.span < 2 * len(numbers)))
        )
        if fills:
            at = tuple(family.at.get(number, -1) for number in range(numbers[0], numbers[-1] + 1))
            those = "that channel" if len(missing) == 1 else "those channels"
            finding = f"{plural(len(missing), 'column')} missing ({names}): no readings of {those}."
        else:
            at = tuple(family.at[number] for number in numbers)
            finding = (
                f"the numbers of {family} have gaps: taken in their order as channels 0 to {len(at) - 1}." if missing else ""
            )
        return ValueColumns(at, (1.0,) * len(at), (finding,) if finding else ())

    def _wrong_width(self, columns: Sequence[int], families: Sequence[_Family], channels: int) -> str:
        large = max(families, key=lambda each: len(each.at), default=None)
        scene = f"the scene has {plural(channels, 'channel')}"
        if large is None or len(large.at) < 2:
            return (
                f"{self.path}: {plural(len(columns), 'column')} may be taxels ({self._list_names(columns)}), and {scene}; "
                "expected one column a channel: number their names (t0, t1, ...), and leave out the others."
            )
        count = len(large.at)
        ends = ""
        if count < channels <= count + 2 and not large.missing:
            first, last = min(large.at), max(large.at)
            maybe = [large.name(number) for number in (first - 1, last + 1) if number >= 0]
            ends = f" If {' or '.join(maybe)} is missing, add it as an empty column."
        if count < channels and large.missing:
            names = ", ".join(map(large.name, large.missing[:NAMES_SHOWN_MAX]))
            return (
                f"{self.path}: its numbered columns are {large} without {names} ({plural(count, 'column')}), and {scene}. Add "
                "each missing taxel as an empty column, also those before the first or behind the last."
            )
        return (
            f"{self.path}: its numbered columns are {large} ({plural(count, 'column')}), and {scene}.{ends} If each of these "
            f"columns is a taxel, [skin] channels of the scene is {count}; else name the taxels alone so."
        )


_COUNTS_RE = r"counts per unit {}\W*([\d.,]*\d)"
_FACT_UNIT_RE = r"{} units?\W*([A-Za-z\u00b7.* -]+)"


_FACT_KINDS = {"force": "force", "torque": "(?:torque|moment)"}
_NEWTON_WORDS = (
    (re.compile(r"newtons?[ .*\u00b7\u22c5-]*millimet(?:er|re)s?", re.IGNORECASE), "Nmm"),
    (re.compile(r"newtons?[ .*\u00b7\u22c5-]*met(?:er|re)s?", re.IGNORECASE), "Nm"),
    (re.compile(r"newtons?", re.IGNORECASE), "N"),
)
_UNIT_WORD = r"((?:m|k)?N(?:[ .*\u00b7\u22c5-]?m?m|[ .*\u00b7\u22c5-]?cm)?|lbf?(?:[ .*-]?(?:in|ft))?)(?!\w|/(?!k?N))"
_UNIT_WORD_RE = re.compile(rf"(?<![\w.])(?<!(?<!N)/)(?<!\d )(?<!per ){_UNIT_WORD}")
"""A unit of force or moment in a text; not behind a number, which is a range, or in counts for each unit. `N/Nmm` are two."""


def comment_units(path: Path, facts: Sequence[str]) -> dict[str, str]:
    """Return the units of force and torque that comments name in words, such as `torque in Nmm` or `[N], [Nmm]`.

    Raises InputError: they name two units of one kind, or one that is not known.
    """
    found: dict[str, list[str]] = {"force": [], "torque": []}
    text = "\n".join(facts)
    for pattern, unit in _NEWTON_WORDS:
        text = pattern.sub(unit, text)
    for word in _UNIT_WORD_RE.findall(text):
        unit = plain_unit(word)
        kind = "torque" if unit in MOMENT_UNITS else "force"
        found[kind] += [] if unit in found[kind] else [unit]
    for kind, units in found.items():
        if len(units) > 1 or not {*units} <= {*FORCE_UNITS, *MOMENT_UNITS}:
            raise InputError(
                f"{path}: the lines before the rows name {' and '.join(units)}, and the names of the columns no unit; write "
                f"the unit of the {kind} into the names: fx [N], mx [Nm]."
            )
    units = {kind: units[0] for kind, units in found.items() if units}
    # A letter N alone may be a number of rows.
    return {} if units == {"force": "n"} else units


def _mentioned_units(facts: str) -> tuple[str, ...]:
    """Warn of moments in another unit than N m that a text mentions behind a number; these may be a range."""
    words = (found[1] for found in re.finditer(rf"\d ?{_UNIT_WORD}", facts))
    word = next((each for each in words if MOMENT_UNITS.get(plain_unit(each), 1.0) != 1.0), "")
    if not word:
        return ()
    return (f"the lines before the rows mention {word}; the moments were read as N m. If not: write mx [{word}] and so on.",)


def _facts(pattern: str, text: str) -> dict[str, re.Match[str]]:
    found = {kind: re.search(pattern.format(words), text, re.IGNORECASE) for kind, words in _FACT_KINDS.items()}
    return {kind: each for kind, each in found.items() if each}


def is_known_name(name: str) -> bool:
    """Check whether a name is of a time, a counter, a status or the header of a message."""
    patterns = (TIME_COLUMN_RE, CLOCK_COLUMN_RE, _DATE_COLUMN_RE, COUNTER_COLUMN_RE, _STATUS_COLUMN_RE, _HEADER_FIELD_RE)
    return any(pattern.fullmatch(name) for pattern in patterns)


def time_unit_of(name: str) -> str | None:
    """Return the unit in the name of a time; `None` if it has none, or is no time."""
    found = TIME_COLUMN_RE.fullmatch(name) or CLOCK_COLUMN_RE.fullmatch(name)
    return short_unit(found[1]) if found else None


def joint_unit(name: str) -> str:
    """Return the unit at the end of a joint's name; empty without."""
    found = _JOINT_COLUMN_RE.fullmatch(name)
    return found[1] if found else ""


def _counts_up(names: Sequence[str]) -> bool:
    """Check whether names that differ in numbers alone stand together, with numbers that rise: `r0c0 r0c1 r1c0 r1c1`."""
    shapes = [re.sub(r"\d+", "#", name) for name in names]
    blocks = [
        (shape, [name for _, name in block]) for shape, block in groupby(zip(shapes, names, strict=True), lambda each: each[0])
    ]
    numbers = [[[int(word) for word in re.findall(r"\d+", name)] for name in block] for _, block in blocks]
    return len(blocks) == len({*shapes}) and all(block == sorted(block) for block in numbers)


def _family_base(name: str) -> str:
    """Return a name without its number and unit."""
    return re.sub(r"\d+.*", "", name)
