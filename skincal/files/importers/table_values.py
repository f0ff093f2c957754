"""Numbers and dates in the fields of a table.

A mark in a number is a decimal mark or separates thousands. Most fields say it themselves: `0,5`, `12.25`, `1,040.5`,
`1.040.000`. A field of one mark before three digits does not (`1,040`): the other fields of the file decide, in this order:

1. a field whose mark is the same, and is decimal or separates thousands;
2. a field whose decimal mark is the other one: then this one separates thousands.

If there is none, the file is refused: both readings are possible. With commas between columns a point is the decimal
mark, unless a comma has two readings as well.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from functools import partial
from itertools import pairwise

from skincal.model.errors import InputError

MARK_NAMES = {",": "comma", ".": "point"}
OTHER_MARK = {",": ".", ".": ","}
FIELD_SHOWN_MAX_CHARS = 40
"""Characters of a field that a sentence shows."""
_GROUP_SPACES = " \u00a0\u2009\u202f'\u2019"
"""Marks between groups of three digits that are never decimal marks."""
_GROUPED_RE = re.compile(rf"[+-]?\d{{1,3}}(?:[{_GROUP_SPACES}]\d{{3}})+(?:[.,]\d*)?")
_DECIMAL, _THOUSANDS, _EITHER = "decimal", "thousands", "either"
_DIGITS_AS_NINE = str.maketrans("12345678", "9" * 8)
MAX_REMEMBERED_SHAPES = 1 << 16
_EITHER_RE = re.compile(r"[+-]?[1-9]\d{0,2}([.,])\d{3}")
_ONE_MARK_RE = re.compile(r"[+-]?\d*([.,])\d*(?:e[+-]?\d+)?", re.IGNORECASE)
_THOUSANDS_RE = re.compile(
    r"[+-]?[1-9]\d{0,2}(?:(,)\d{3}(?:(?:,\d{3})+|(?:,\d{3})*\.\d*)|(\.)\d{3}(?:(?:\.\d{3})+|(?:\.\d{3})*,\d*))"
)
_MAYBE_EITHER_RE = re.compile(r"(?<![\d.,])[1-9]\d{0,2}[.,]\d{3}(?![\d.,eE])")

_TIME_OF_DAY = r"(\d{1,2}):(\d\d):(\d\d)(?:[.,](\d{1,12}))?\s*([ap]m)?"
_ZONE_PATTERN = r"\s*(z|utc|[+-]\d\d(?::?\d\d)?)?"
_MONTH_WORDS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_DATE_PATTERNS = {
    "ymd": r"(?P<y>\d{4})[-/](?P<m>\d\d?)[-/](?P<d>\d\d?)",
    "dmy": r"(?P<d>\d\d?)\.(?P<m>\d\d?)\.(?P<y>\d{4})",
    "slashes": r"(?P<m>\d\d?)/(?P<d>\d\d?)/(?P<y>\d{4})",
    "month d, y": r"(?P<m>[a-z]{3})[a-z]*\.? (?P<d>\d\d?),? (?P<y>\d{4}),?",
    "d month y": r"(?P<d>\d\d?)[- ](?P<m>[a-z]{3})[a-z]*\.?[- ](?P<y>\d{4}),?",
}
_DATE_RES = [re.compile(pattern, re.IGNORECASE) for pattern in _DATE_PATTERNS.values()]
_MOMENT_RES = [
    re.compile(rf"{pattern}(?:T|\s+){_TIME_OF_DAY}{_ZONE_PATTERN}", re.IGNORECASE) for pattern in _DATE_PATTERNS.values()
]
_TIME_OF_DAY_RE = re.compile(_TIME_OF_DAY, re.IGNORECASE)
DAY_S = 86400.0
MAX_STEP_BACK_S = 3600.0
"""s. Times of day that are earlier than the first one by less are out of order, and not of the next day."""
_SLASHES_RE = re.compile(r"\d\d?/\d\d?/\d{4}")


# ------------------------------------------------------------------ numbers


@dataclass(slots=True)
class NumberEvidence:
    """Fields of a file that show how its marks are used; each with the number of its row."""

    point_is_usual: bool
    """The file is separated by commas."""
    found: dict[tuple[str, str], tuple[str, int]] = field(default_factory=dict[tuple[str, str], tuple[str, int]])
    """First field by mark and use."""
    _shapes: set[str] = field(default_factory=set[str])
    """Fields so far with 9 in place of every digit but 0: what they show is the same."""

    def add(self, fields: Iterable[str], row: int) -> None:
        """Note the fields of a row that have marks."""
        for text in fields:
            shape = text.translate(_DIGITS_AS_NINE)
            if shape not in self._shapes:
                if len(self._shapes) < MAX_REMEMBERED_SHAPES:
                    self._shapes.add(shape)
                use = mark_use(text)
                if use is not None:
                    self.found.setdefault(use, (text, row))

    def uses(self, path: object) -> dict[str, str]:
        """Return the use of each mark in the fields that do not say it themselves.

        Raises InputError: no field decides, or two contradict each other.
        """
        uses: dict[str, str] = {}
        for mark, name in MARK_NAMES.items():
            either = self.found.get((mark, _EITHER))
            if either is None:
                continue
            decimal, thousands = self.found.get((mark, _DECIMAL)), self.found.get((mark, _THOUSANDS))
            against = thousands or self.found.get((OTHER_MARK[mark], _DECIMAL))
            if decimal and against:
                raise InputError(
                    f"{path}: the {name} is decimal in {_quoted(decimal)}, and cannot be so beside {_quoted(against)}; "
                    f"{_quoted(either)} is unclear. Save it again without thousands separators, and with one decimal mark."
                )
            if decimal or thousands:
                uses[mark] = _DECIMAL if decimal else _THOUSANDS
            elif (OTHER_MARK[mark], _DECIMAL) in self.found:
                uses[mark] = _THOUSANDS
            elif mark == "." and self.point_is_usual and (",", _EITHER) not in self.found:
                uses[mark] = _DECIMAL
            else:
                value = re.sub("[.,]", "", either[0])
                raise InputError(
                    f"{path}: {_quoted(either)} may be {value} or {either[0].replace(',', '.')}, and no other number of the "
                    "file shows which. Save it again without thousands separators, and with a decimal point."
                )
        return uses


def _quoted(place: tuple[str, int]) -> str:
    return f"{place[0][:FIELD_SHOWN_MAX_CHARS]!r} (row {place[1]})"


def may_need_evidence(text: str) -> bool:
    """Check whether a line may have a field that does not say itself what its mark is."""
    return _MAYBE_EITHER_RE.search(text) is not None


def mark_use(text: str) -> tuple[str, str] | None:
    """Return mark and use in a number, by the number alone; `None` if it has no mark or is no number."""
    if found := _EITHER_RE.fullmatch(text):
        return found[1], _EITHER
    if found := _THOUSANDS_RE.fullmatch(text):
        return found[1] or found[2], _THOUSANDS
    found = _ONE_MARK_RE.fullmatch(text)
    return (found[1], _DECIMAL) if found and len(text.strip("+-.,eE")) else None


def to_float(text: str, uses: dict[str, str] | None = None) -> float | None:
    """Read a number; `None` if the text is none.

    Parameters
    ----------
    uses : use of the marks in fields that do not say it themselves; decimal where it is unknown
    """
    # `float` takes 1_000 for a number.
    if "_" in text:
        return None
    if not uses:
        try:
            return float(text)
        except ValueError:
            pass
    try:
        return _marked_float(text, uses or {})
    except ValueError:
        return None


def _marked_float(text: str, uses: dict[str, str]) -> float:
    use = mark_use(text)
    if use is None:
        # Spaces or apostrophes between groups of three digits.
        text = re.sub(f"[{_GROUP_SPACES}]", "", text).replace(",", ".") if _GROUPED_RE.fullmatch(text) else text
        return float(text)
    mark, how = use
    if how == _EITHER:
        how = uses.get(mark, _DECIMAL)
    return float(text.replace(mark, "").replace(",", ".") if how == _THOUSANDS else text.replace(",", "."))


# ------------------------------------------------------------------ dates


def time_kind(text: str, uses: dict[str, str] | None = None) -> str:
    """Classify the time in a field; empty if it is no time."""
    if to_float(text, uses) is not None:
        return "number"
    moment = next((found for pattern in _MOMENT_RES if (found := pattern.fullmatch(text))), None)
    if moment is None:
        return ""
    return "date with a zone" if moment[moment.re.groups] else "date without one"


def is_date(text: str) -> bool:
    """Check whether a field is a day without a time."""
    return any(pattern.fullmatch(text) for pattern in _DATE_RES)


def is_time_of_day(text: str) -> bool:
    """Check whether a field is a time without a day."""
    return _TIME_OF_DAY_RE.fullmatch(text) is not None


def time_of_day_reader(first: str) -> Callable[[str], float | None]:
    """Return the function that converts times of day to seconds since the midnight before `first`, `None` for other text."""
    return partial(_time_of_day_seconds, _time_of_day_seconds(0.0, first) or 0.0)


def _time_of_day_seconds(first_s: float, text: str) -> float | None:
    found = _TIME_OF_DAY_RE.fullmatch(text)
    if found is None:
        return None
    hour, minute, second, fraction, half = found.groups()
    hours = int(hour) % 12 + 12 * (half.lower() == "pm") if half else int(hour)
    seconds = hours * 3600.0 + int(minute) * 60.0 + float(f"{second}.{fraction or 0}")
    # A recording is shorter than a day: an earlier time is one after midnight.
    return seconds + DAY_S if seconds < first_s - MAX_STEP_BACK_S else seconds


def find_slash_order(dates: Iterable[str]) -> str:
    """Name the order of day and month that lets the days of a file, in dates with slashes, follow each other.

    Empty for other dates. A single day is read as month/day, unless that is not possible: only differences of times count.
    Raises ValueError: both orders, or none, are possible.
    """
    found = [match[0] for text in dates if (match := _SLASHES_RE.match(text))]
    days = [tuple(map(int, text.split("/"))) for text in dict.fromkeys(found)]
    if not days:
        return ""
    possible = [order for order, first in (("month/day", 0), ("day/month", 1)) if _follow_each_other(days, first)]
    if len(days) == 1 and possible:
        return possible[0]
    if len(possible) != 1:
        first, last = found[0], found[-1]
        raise ValueError(f"{first} and {last} are no days that follow each other, neither as day/month nor as month/day")
    return possible[0]


def _follow_each_other(days: Sequence[tuple[int, ...]], month_at: int) -> bool:
    """Check whether days in the order of a file, as numbers, exist and are neighbours."""
    try:
        ordinals = [date(day[2], day[month_at], day[1 - month_at]).toordinal() for day in days]
    except ValueError:
        return False
    return all(abs(b - a) == 1 for a, b in pairwise(ordinals))


def date_reader(first: str, order: str) -> Callable[[str], float | None]:
    """Return the function that converts dates as the first one of a file to seconds since 1970, `None` for any other text.

    Parameters
    ----------
    order : of day and month in dates with slashes, see `find_slash_order`
    """
    pattern = next(each for each in _MOMENT_RES if each.fullmatch(first))
    return partial(_date_seconds, pattern, time_kind(first), order == "day/month")


def _date_seconds(pattern: re.Pattern[str], kind: str, is_day_first: bool, text: str) -> float | None:
    found = pattern.fullmatch(text)
    if found is None or time_kind(text) != kind:
        return None
    hour, minute, second, fraction, half, zone = found.groups()[-6:]
    year, month, day = found["y"], found["m"].lower(), found["d"]
    if is_day_first:
        month, day = day, month
    if month in _MONTH_WORDS:
        month = str(_MONTH_WORDS.index(month) + 1)
    hours = int(hour) % 12 + 12 * (half.lower() == "pm") if half else int(hour)
    micro = f"{fraction or 0:0<6}"[:6]
    offset = "+00:00" if not zone or zone[0] not in "+-" else zone
    try:
        moment = f"{year}-{int(month):02}-{int(day):02}T{hours:02}:{minute}:{second}.{micro}{offset}"
        return datetime.fromisoformat(moment).astimezone(UTC).timestamp()
    except (ValueError, OverflowError):  # the 30th of February
        return None
