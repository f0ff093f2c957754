"""Forms of text lines that boards print, in one table: `LINE_FORMS`.

Each row has a name, the bytes of some lines as an example, and the reader of one line. A reader returns `None` for a line
that may mean something else. It knows no link, no width and no line before; `skincal/streams/decoders/line_streams.py` does.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import NamedTuple, cast

from skincal.devices.column_names import (
    CLOCK_COLUMN_RE,
    COUNTER_COLUMN_RE,
    MOMENT_UNITS,
    TIME_COLUMN_RE,
    WRENCH_AXES,
    axis_of,
    plain_unit,
)
from skincal.devices.netft_page import FORCE_UNITS

HEXADECIMAL_FORM = "hexadecimal without 0x"
LINE_SHOWN_MAX_CHARS = 60
PAIRS_MIN = 6
"""Fields such as `0,200` that are a number and a value each: fewer may be decimals whose digits happen to count."""
CLEAN_TEXT_MIN_BYTES = 4
"""Bytes of a line that is shown. A shorter one may be chance."""
CHANNEL_UNITS = (
    "mv|v|uv|n|mn|kn|pa|hpa|kpa|mpa|bar|mbar|psi|g|gf|kg|kgf|lb|lbf|ohms?|kohms?|pf|nf|ut|mt|ma|ua|%|counts?|raw|lsb"
)
"""Units that may follow a channel's value. None of them has hexadecimal digits alone."""
NUMBER_PATTERN = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf)"
_COMMA_NUMBER_PATTERN = r"[-+]?\d+,\d+"
_LABEL_NAME = r"(?P<name>[A-Za-z_](?:[A-Za-z_ ]{0,30}[A-Za-z_])?)?[ _]?[\[(]?(?P<number>\d{1,6})?[\])]?"
_LABEL_END = (
    r"(?:[ ]?(?P<unit>[A-Za-z%][A-Za-z.*]*(?: m)?)(?=\s*(?:[,;|\t]|$)|\s+[A-Za-z_\[(0-9]+[^,;|]*?[:=]))?\s*(?P<end>[,;|]|\s|$)"
)
_LABEL_RE = re.compile(rf"\s*{_LABEL_NAME}\s*[:=]\s*(?P<value>{NUMBER_PATTERN})(?![\d.]){_LABEL_END}", re.IGNORECASE)
"""A label, its number, its value and a unit, up to the separator."""
_COMMA_NUMBER_RE = re.compile(_COMMA_NUMBER_PATTERN)
_COMMA_LABEL_RE = re.compile(
    rf"\s*{_LABEL_NAME}\s*[:=]\s*(?P<value>{_COMMA_NUMBER_PATTERN})(?![\d.,]){_LABEL_END}", re.IGNORECASE
)
"""The same with a decimal comma."""
_BARE_LABEL_RE = re.compile(
    rf"\s*(?P<name>[A-Za-z_]+)[\[(]?(?P<number>\d{{1,6}})[\])]?[\s,;|]\s*(?P<value>{NUMBER_PATTERN})(?![\w.])(?P<unit>)"
    r"\s*(?P<end>[,;|]|\s|$)",
    re.IGNORECASE,
)
"""A label without a colon: `T0 200`."""
_CELL_RE = re.compile(
    r"\s*(?P<name>[A-Za-z_]*?)[ _]?(?:r(?:ow)?[ _]?(?P<row>\d{1,3})[ _,]*c(?:ol(?:umn)?)?[ _]?(?P<column>\d{1,3})"
    rf"|\[(?P<row2>\d{{1,3}})\]\[(?P<column2>\d{{1,3}})\])\s*[:=]\s*(?P<value>{NUMBER_PATTERN})(?![\w.])\s*(?:[,;|]|\s|$)",
    re.IGNORECASE,
)
"""A value named by row and column, up to the separator."""
_UNIT_VALUE_RE = re.compile(
    rf"\s*(?P<value>{NUMBER_PATTERN}) ?(?P<unit>[A-Za-z%][A-Za-z.*]*(?: m(?![A-Za-z]))?)\s*(?:[,;|]|\s|$)"
)
_TITLE_RE = re.compile(r"[#$@!>]?\s?(?P<name>[A-Za-z_][A-Za-z_ ]{0,30}?)\s*[:=]\s*(?P<rest>\S.*)")
_NUMBERED_TITLE_RE = re.compile(
    r"#?(?:(?P<name>[A-Za-z_][A-Za-z_ ]{0,30}?)[ _]?)?[\[(]?#?(?P<number>\d{1,9})[\])]?\s*[:=|>]\s*(?P<rest>\S.*)"
    r"|(?P<name2>[A-Za-z_]+)(?P<number2>\d{1,9})[\s,;]\s*(?P<rest2>\S.*)"
)
_WORD_RE = re.compile(
    r"[#$@!>]?\s?(?P<name>[A-Za-z_][A-Za-z_ ]{0,30})[\s,;]\s*(?P<rest>[-+.\d].*)|[#$@!>]\s?(?P<bare>[-+.\d].*)"
)
_SENTENCE_RE = re.compile(r"[$!](?P<body>(?P<name>[A-Za-z][A-Za-z0-9_]*),(?P<rest>[^*]*))\*(?P<sum>[0-9A-Fa-f]{2})")
_CLOCK_TIME = r"\d\d?:\d\d:\d\d"
_PREFIX_RES = tuple(
    map(
        re.compile,
        (
            r"[IDVWE] \((?:\d+|[\d:.]+)\) (?P<tag>[\w.-]{1,40}): (?P<rest>.+)",  # ESP-IDF
            r"\[ *\d+\]\[[IDVWE]\]\[[^\]]*\] (?P<tag>\w+)\(\): (?P<rest>.+)",  # Arduino of the ESP32
            rf"\[{_CLOCK_TIME}\.\d{{3}},\d{{3}}\] <\w+> (?P<tag>[\w.-]{{1,40}}): (?P<rest>.+)",  # Zephyr
            rf"\d{{4}}-\d\d-\d\d {_CLOCK_TIME},\d{{3}} - (?:(?P<tag>[\w.-]{{1,40}}) - )?[A-Z]+ - (?P<rest>.+)",  # Python
            r"(?:DEBUG|INFO|WARNING|ERROR):(?P<tag>[\w.-]{1,40}):(?P<rest>.+)",
            rf"\[?(?:\d{{4}}-\d\d-\d\d[T ])?{_CLOCK_TIME}(?:\.\d{{1,9}})?\]?(?: ?(?:->|[>,;])|\s)\s*(?P<rest>.+)",  # monitors
            r"\[(?P<tag>[A-Za-z][\w .-]{0,30})\]:? ?(?P<rest>.+)",
        ),
    )
)
"""What loggers and serial monitors print before a line."""
_HEX_RE = re.compile(r"[0-9A-Fa-f]{1,8}")
_HEX_LETTER_RE, _HEX_DIGIT_RE = re.compile(r"[A-Fa-f]"), re.compile(r"\d")
_ROW_RE, _ROWS_RE = re.compile(r"\[([^\[\]]*)\]"), re.compile(r"(?:\[[^\[\]]+\][\s,;]*)+")
_CHANNEL_UNIT_RE = re.compile(CHANNEL_UNITS, re.IGNORECASE)
_COLOUR_RE = re.compile(rb"\x1b\[[\d;]*m")
_PAIRS_RE = re.compile(rf"\d+,(?:{NUMBER_PATTERN})(?:(?:\s*;\s*|\s+)\d+,(?:{NUMBER_PATTERN}))+[; \t]*")
_COMMA_LIST_RE = re.compile(r"\d+,\d+(?:[\s|]+[-+]?\d+,\d+)+")
_CLOSING_BRACKETS = {"[": "]", "(": ")", "{": "}", "<": ">"}


@dataclass(frozen=True, slots=True)
class LineReading:
    """Numbers of one line, as its form names them."""

    form: str
    title: str = ""
    """Word that names the numbers, such as the base of the labels."""
    lists: dict[str, list[float]] = field(default_factory=dict[str, list[float]])
    """Numbers by position, by the name of their list."""
    channels: dict[int, float] = field(default_factory=dict[int, float])
    """Numbers by the number of their label."""
    axes: dict[str, float] = field(default_factory=dict[str, float])
    """Force in N and moment in N m, by axis."""
    cells: dict[tuple[int, int], float] = field(default_factory=dict[tuple[int, int], float])
    """Numbers by row and column."""
    lead: dict[str, float] = field(default_factory=dict[str, float])
    """Clock and counter, by name."""
    number: int | None = None
    """Number in the title: of a frame, of a row, or of one of several sensors."""
    unit: str = ""
    """Unit of all numbers, which then are no wrench."""
    is_sure: bool = True
    """Whether the line itself shows how it is to be read. If not, a line of the same form that does comes first."""
    fault: str = ""
    """Why the line cannot be used although its form is known; empty if it can."""
    checksum: str = ""
    """Checksum that is not that of the line."""


class _Label(NamedTuple):
    name: str
    number: int | None
    value: float
    unit: str


@dataclass(frozen=True, slots=True)
class LineForm:
    """Form of lines that is read."""

    name: str
    example: bytes
    """Some lines of a skin of four channels, or of a wrench."""
    read: Callable[[str], LineReading | None]
    is_shown_for: Callable[[str], bool]
    """Whether this form is the nearest one to a line that cannot be read."""


def split_fields(line: str) -> list[str]:
    """Split a stripped line at its separator; one separator at the end is allowed."""
    if "|" in line:
        return line.removeprefix("|").removesuffix("|").split("|")
    # A semicolon that ends a list is no separator; after one comma it may be.
    if line.endswith(";") and line.count(";") == 1 and (line.count(",") > 1 or ("," not in line and " " in line)):
        line = line[:-1]
    if "," not in line:
        return line.removesuffix(";").split(";") if ";" in line else line.split()
    if (";" in line or " " in line or "\t" in line) and (pairs := _split_pairs(line)):
        return pairs
    if ";" in line:
        return line.replace(",", ".").removesuffix(";").split(";")
    return line.removesuffix(",").split(",")


def _split_pairs(line: str) -> list[str]:
    """Split `0,200;1,201;2,202`, a number and a value each; empty for other lines.

    Numbers that count from 0 or 1 through many fields are no values with a decimal comma.
    """
    if not _PAIRS_RE.fullmatch(line):
        return []
    words = re.split(r"[,;\s]+", line.rstrip("; \t"))
    numbers = [int(word) for word in words[::2]]
    counts = numbers[0] in (0, 1) and numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    return words if counts and len(numbers) >= PAIRS_MIN else []


def to_numbers(fields: list[str]) -> list[float] | None:
    """Read all fields as numbers, `nan` and `inf` included; `None` if one is no number."""
    try:
        return [float(field) for field in fields]
    except ValueError:
        return None


def hex_numbers(fields: list[str]) -> list[float] | None:
    """Read all fields as hexadecimal digits without 0x; `None` if one has another character."""
    words = [each.strip() for each in fields]
    return [float(int(word, 16)) for word in words] if all(map(_HEX_RE.fullmatch, words)) else None


def has_hex_letters(fields: list[str]) -> bool:
    """Check whether all fields are hexadecimal digits without 0x, with a letter and a decimal digit among them."""
    text = "".join(fields)
    return bool(_HEX_LETTER_RE.search(text) and _HEX_DIGIT_RE.search(text)) and hex_numbers(fields) is not None


def is_clock_or_counter(name: str) -> bool:
    """Check whether a name in small letters is that of a clock or a counter."""
    return any(pattern.fullmatch(name) for pattern in (TIME_COLUMN_RE, CLOCK_COLUMN_RE, COUNTER_COLUMN_RE))


# ------------------------------------------------------------------ readers


def _read_labels(text: str) -> LineReading | None:
    named = _match_all(_LABEL_RE, text)
    return None if named is None else _sort_labels("labels", [_label_of(found) for found in named])


def _match_all(pattern: re.Pattern[str], text: str) -> list[re.Match[str]] | None:
    """Cut a whole text into matches; `None` if a part of it does not match."""
    found: list[re.Match[str]] = []
    at = 0
    while at < len(text):
        each = pattern.match(text, at)
        if each is None or each.end() == at:
            return None
        found.append(each)
        at = each.end()
    return found or None


def _label_of(found: re.Match[str]) -> _Label:
    number = None if found["number"] is None else int(found["number"])
    value = float(found["value"].replace(",", "."))
    return _Label((found["name"] or "").lower(), number, value, found["unit"] or "")


def _sort_labels(form: str, named: Sequence[_Label]) -> LineReading | None:
    """Sort labelled numbers into channels, axes, clock and counter; `None` if two have one meaning."""
    channels, axes, lead = dict[int, float](), dict[str, float](), dict[str, float]()
    bases, units = set[str](), set[str]()
    named = _number_hex_labels(named)
    for name, number, value, unit in named:
        axis = axis_of(name) if number is None else None
        if number is not None:
            if number in channels or (unit and not _CHANNEL_UNIT_RE.fullmatch(unit)):
                return None
            bases.add(name)
            units.add(unit)
            channels[number] = value
        elif axis is not None:
            factor = _unit_factor(axis[0], unit)
            if axis[0] in axes or factor is None:
                return None
            axes[axis[0]] = value * factor
        elif is_clock_or_counter(name):
            lead[f"{name} {unit.lower()}".strip()] = value
        elif not name:
            return None
    # A unit may change from line to line (mV, V): it is part of the title.
    if len(bases) > 1 or len(units) > 1 or not (channels or axes) or (axes and set(axes) != set(WRENCH_AXES)):
        return None
    return LineReading(form, " ".join((*bases, *units)).strip(), channels=channels, axes=axes, lead=lead)


def _read_comma_labels(text: str) -> LineReading | None:
    """Read labels with a decimal comma. `T0:1,5` may also be two numbers, until a decimal or a unit decides."""
    named = _match_all(_COMMA_LABEL_RE, text)
    if named is None or any(each["end"] == "," for each in named) or (len(named) == 1 and not named[0]["unit"]):
        return None
    whole, decimals = zip(*(each["value"].split(",") for each in named), strict=True)
    if len({*map(len, decimals)}) > 1:
        return None
    is_sure = any(each["unit"] for each in named) or _are_decimals(whole, decimals)
    found = _sort_labels("labels with a decimal comma", [_label_of(each) for each in named])
    return None if found is None else replace(found, is_sure=is_sure)


def _read_comma_list(text: str) -> LineReading | None:
    """Read numbers with a decimal comma between spaces, tabs or bars. `0,51 0,52` may also be pairs, as with labels."""
    fields = re.split(r"\s*\|\s*|\s+", text)
    if len(fields) < 2 or not all(map(_COMMA_NUMBER_RE.fullmatch, fields)):
        return None
    whole, decimals = zip(*(field.split(",") for field in fields), strict=True)
    if len({*map(len, decimals)}) > 1:
        return None
    values = [float(field.replace(",", ".")) for field in fields]
    return LineReading("decimal comma", lists={"": values}, is_sure=_are_decimals(whole, decimals))


def _are_decimals(whole: Sequence[str], decimals: Sequence[str]) -> bool:
    """Check whether the digits behind commas cannot be whole numbers: `-0,5`, `1,05`."""
    has_zero = len(decimals[0]) > 1 and any(part.startswith("0") for part in decimals)
    return has_zero or any(part in ("-0", "+0") for part in whole)


def _read_bare_labels(text: str) -> LineReading | None:
    named = _match_all(_BARE_LABEL_RE, text)
    # One label alone may be a word before a number.
    if named is None or len(named) < 2 or any(_HEX_RE.fullmatch(each["name"] + each["number"]) for each in named):
        return None
    return _sort_labels("labels without a colon", [_label_of(each) for each in named])


def _read_cells(text: str) -> LineReading | None:
    named = _match_all(_CELL_RE, text)
    if named is None:
        return None
    cells = {(int(each["row"] or each["row2"]), int(each["column"] or each["column2"])): float(each["value"]) for each in named}
    names = {each["name"].lower() for each in named}
    return LineReading("row and column", names.pop(), cells=cells) if len(cells) == len(named) and len(names) == 1 else None


def _read_units(text: str) -> LineReading | None:
    """Read numbers with a unit behind each: channels with one unit, or three forces and three moments."""
    named = _match_all(_UNIT_VALUE_RE, text)
    if named is None or len(named) < 2:
        return None
    values, units = [float(each["value"]) for each in named], [each["unit"] for each in named]
    if len({*units}) == 1:
        is_known = _CHANNEL_UNIT_RE.fullmatch(units[0]) is not None
        return LineReading("units", units[0], {units[0]: values}, unit=units[0]) if is_known else None
    if len(values) != len(WRENCH_AXES):
        return None
    factors = [_unit_factor(axis, unit) for axis, unit in zip(WRENCH_AXES, units, strict=True)]
    axes = {
        axis: value * factor for axis, value, factor in zip(WRENCH_AXES, values, factors, strict=True) if factor is not None
    }
    return LineReading("units", " ".join(units), axes=axes) if len(axes) == len(factors) else None


def _number_hex_labels(named: Sequence[_Label]) -> Sequence[_Label]:
    """Give labels `TA` to `TF` their numbers next to `T0` to `T9`, if with these all numbers from 0 on are there."""
    base = next((each.name for each in named if each.number is not None), None)
    if base is None:
        return named
    texts = [each.name + ("" if each.number is None else str(each.number)) for each in named]
    rests = [text.removeprefix(base) if text.startswith(base) else "" for text in texts]
    numbers = [int(rest, 16) if _HEX_RE.fullmatch(rest) else -1 for rest in rests]
    is_whole = any(each.number is None and number >= 0 for each, number in zip(named, numbers, strict=True))
    if not is_whole or sorted(number for number in numbers if number >= 0) != list(range(sum(n >= 0 for n in numbers))):
        return named
    return [
        each._replace(name=base, number=number) if number >= 0 else each for each, number in zip(named, numbers, strict=True)
    ]


def _unit_factor(axis: str, unit: str) -> float | None:
    return (FORCE_UNITS if axis.startswith("f") else MOMENT_UNITS).get(plain_unit(unit)) if unit else 1.0


def _read_brackets(text: str) -> LineReading | None:
    if len(text) < 3 or _CLOSING_BRACKETS.get(text[0]) != text[-1]:
        return None
    if text[0] == "[" and (values := _json_numbers(_parse_json(text))) is not None:
        return LineReading("brackets", lists={"": values})
    inner = text[1:-1].strip()
    rows = [each.strip() for each in _ROW_RE.findall(inner)] if _ROWS_RE.fullmatch(inner) else [inner]
    lists = [_plain_numbers(row) for row in rows]
    values = [each for row in lists if row is not None for each in row]
    is_whole = all(row is not None and len(row) * len(rows) == len(values) for row in lists)
    return LineReading("brackets", lists={"": values}) if values and is_whole else None


def _plain_numbers(text: str) -> list[float] | None:
    """Read a list of plain numbers; `None` for anything else. Python reads 1_0 as ten."""
    return None if "_" in text else to_numbers(split_fields(text))


def opens_brackets(text: str) -> int:
    """Count the brackets of lists and objects that a text opens and does not close."""
    return sum(map(text.count, "[{")) - sum(map(text.count, "]}"))


def _parse_json(text: str) -> object:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None


def _json_numbers(value: object) -> list[float] | None:
    """Flatten a list of numbers, or of rows of one length; `None` for anything else. `null` is NaN."""
    if not isinstance(value, list) or not value:
        return None
    items = cast("list[object]", value)
    if all(isinstance(each, list) for each in items):
        rows = [_json_numbers(each) for each in items]
        whole = [row for row in rows if row is not None]
        return [each for row in whole for each in row] if len(whole) == len(rows) and len({*map(len, whole)}) == 1 else None
    numbers = [_json_number(each) for each in items]
    return None if None in numbers else [each for each in numbers if each is not None]


def _json_number(value: object) -> float | None:
    if value is None:
        return float("nan")
    # Numbers of JSON have no limit; those that no double holds are refused.
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300 else None


def _read_object(text: str) -> LineReading | None:
    found = _parse_json(text) if text.startswith("{") else None
    if not isinstance(found, dict):
        return None
    pairs = cast("dict[str, object]", found)
    lists = {name.lower(): each for name, value in pairs.items() if (each := _json_numbers(value)) is not None}
    cells = _read_cells(",".join(f"{key}={value}" for key, value in pairs.items() if isinstance(value, int | float)))
    if cells is not None and len(cells.cells) == len(pairs):
        return replace(cells, form="JSON object")
    singles = [
        _Label(base.lower(), int(digits) if digits else None, number, "")
        for key, value in pairs.items()
        if value is not None and (number := _json_number(value)) is not None
        for base, digits in re.findall(r"^(.*?)[_ ]?(\d{0,6})$", key)
    ]
    sorted_labels = _sort_labels("JSON object", singles)
    if sorted_labels is None and any(each.number is not None or axis_of(each.name) for each in singles):
        return None
    if sorted_labels is not None:
        return replace(sorted_labels, lists=lists)
    lead = {name: value for name, number, value, _ in singles if number is None and is_clock_or_counter(name)}
    return LineReading("JSON object", lists=lists, lead=lead) if lists else None


def _read_titled(text: str) -> LineReading | None:
    found = _TITLE_RE.fullmatch(text)
    return None if found is None else _titled("title", found["name"], found["rest"])


def _titled(form: str, name: str, rest: str, number: int | None = None) -> LineReading | None:
    """Read a list of numbers with a title. One number with a title is a label."""
    brackets, title = _read_brackets(rest), name.strip().lower()
    values = _plain_numbers(rest) if brackets is None else brackets.lists[""]
    # The first number behind the name of a clock or counter is its value.
    if values is None or len(values) < 2 or (number is None and is_clock_or_counter(title)):
        return None
    return LineReading(form, title, {title: values}, number=number)


def _read_numbered_title(text: str) -> LineReading | None:
    """Read numbers behind a title with a number: of a frame, of a row, or of one of several sensors."""
    found = _NUMBERED_TITLE_RE.fullmatch(text)
    if found is None:
        return None
    name, number = found["name"] or found["name2"] or "", int(found["number"] or found["number2"])
    rest = found["rest"] or found["rest2"]
    # Hexadecimal digits, or one number with a decimal comma.
    if (found["name2"] and _HEX_RE.fullmatch(f"{name}{number}")) or re.fullmatch(_COMMA_NUMBER_PATTERN, rest):
        return None
    return _titled("numbered title", name, rest, number)


def _read_word(text: str) -> LineReading | None:
    """Read a list of numbers behind a word or a mark, without a colon."""
    found = _WORD_RE.fullmatch(text)
    if found is None:
        return None
    name, rest = found["name"] or "", found["rest"] or found["bare"]
    # A word of the letters A to F may be a hexadecimal number.
    return None if name and _HEX_RE.fullmatch(name) else _titled("word in front", name or text[0], rest)


def _read_sentence(text: str) -> LineReading | None:
    found = _SENTENCE_RE.fullmatch(text)
    values = None if found is None else _plain_numbers(found["rest"])
    if found is None or values is None:
        return None
    name, right = found["name"].lower(), reduce(lambda sum_, byte: sum_ ^ byte, found["body"].encode(), 0)
    reading = LineReading("checksum", name, {name: values})
    if right == int(found["sum"], 16):
        return reading
    fault = f"Checksum *{found['sum']} of a line is wrong; expected *{right:02X}"
    return replace(reading, fault=fault, checksum=found["sum"])


def _read_leading_comma(text: str) -> LineReading | None:
    values = _plain_numbers(text[1:].strip()) if text.startswith(",") else None
    return None if values is None else LineReading("leading comma", lists={"": values})


def _read_quoted(text: str) -> LineReading | None:
    fields = [each.strip() for each in split_fields(text)]
    if not all(len(each) > 2 and each[0] == each[-1] and each[0] in "\"'" for each in fields):
        return None
    values = _plain_numbers(",".join(each[1:-1] for each in fields))
    return None if values is None else LineReading("quotes", lists={"": values})


def _read_prefixed_hex(text: str) -> LineReading | None:
    fields = [each.strip().lower() for each in split_fields(text)]
    if not all(each.startswith("0x") and _HEX_RE.fullmatch(each[2:]) for each in fields):
        return None
    return LineReading("hexadecimal with 0x", lists={"": [float(int(each, 16)) for each in fields]})


def _read_hex(text: str) -> LineReading | None:
    """Read fields of hexadecimal digits, with a letter and a decimal digit among them."""
    fields = split_fields(text)
    values = hex_numbers(fields) if len(fields) > 1 and has_hex_letters(fields) else None
    return None if values is None else LineReading(HEXADECIMAL_FORM, lists={"": values})


def find_prefix(line: str) -> int:
    """Return the number of characters that a log or a serial monitor prints first."""
    found = next(filter(None, (pattern.fullmatch(line) for pattern in _PREFIX_RES)), None)
    return 0 if found is None else found.start("rest")


def _read_prefix(text: str) -> LineReading | None:
    """Read the numbers behind what a log or a serial monitor prints first."""
    found = next(filter(None, (pattern.fullmatch(text) for pattern in _PREFIX_RES)), None)
    if found is None:
        return None
    rest, tag = found["rest"].strip(), found.groupdict().get("tag") or ""
    values = _plain_numbers(rest)
    inner = read_line(rest) if values is None else LineReading("plain", lists={"": values})
    if inner is None or inner.form in (HEXADECIMAL_FORM, "prefix"):
        return None
    return replace(inner, form="prefix", title=f"{tag.lower()} {inner.form} {inner.title}".strip())


def _read_teleplot(text: str) -> LineReading | None:
    """Read `>T0:200`, and `>T0:1234:200` with a time."""
    found = re.fullmatch(rf">(?P<label>[^:]+):(?:\d+:)?(?P<value>{NUMBER_PATTERN})(?:\|\w)?", text)
    inner = None if found is None else _read_labels(f"{found['label']}:{found['value']}")
    return None if inner is None else replace(inner, form="Teleplot")


# ------------------------------------------------------------------ the table


def _has_any(marks: str) -> Callable[[str], bool]:
    return lambda line: any(mark in line for mark in marks)


LINE_FORMS = (
    LineForm(
        "log or monitor prefix",
        b"I (1200) skin: 1,2,3,4\nI (1220) skin: 5,6,7,8\n",
        _read_prefix,
        lambda line: find_prefix(line) > 0,
    ),
    LineForm("checksum", b"$SKIN,1,2,3,4*1B\n$SKIN,5,6,7,8*13\n", _read_sentence, lambda line: line[:1] == "$" and "*" in line),
    LineForm("JSON object", b'{"skin":[1,2,3,4]}\n{"skin":[5,6,7,8]}\n', _read_object, lambda line: line.startswith("{")),
    LineForm("brackets", b"[1, 2, 3, 4]\n[5, 6, 7, 8]\n", _read_brackets, lambda line: line[:1] in "[(<"),
    LineForm(
        "Teleplot", b">T0:1\n>T1:2\n>T2:3\n>T3:4\n>T0:5\n>T1:6\n>T2:7\n>T3:8\n", _read_teleplot, lambda line: line[:1] == ">"
    ),
    LineForm("title", b"#SKIN=1,2,3,4\n#SKIN=5,6,7,8\n", _read_titled, lambda line: line.startswith("#")),
    LineForm(
        "row and column",
        b"r0c0=1 r0c1=2 r1c0=3 r1c1=4\nr0c0=5 r0c1=6 r1c0=7 r1c1=8\n",
        _read_cells,
        lambda line: re.search(r"r(?:ow)?[ _]?\d+[ _,]*c(?:ol)?[ _]?\d|\]\[", line, re.IGNORECASE) is not None,
    ),
    LineForm(
        "numbered title",
        b"Row 0: 1 2\nRow 1: 3 4\nRow 0: 5 6\nRow 1: 7 8\n",
        _read_numbered_title,
        lambda line: re.match(r"[Rr]ow", line) is not None,
    ),
    LineForm(
        "labels with a decimal comma",
        b"T0:1,00;T1:2,00;T2:3,00;T3:4,00\nT0:5,00;T1:6,00;T2:7,00;T3:8,00\n",
        _read_comma_labels,
        lambda line: re.search(r"[:=]\s*-?\d+,\d+\s*[;\s|]", line) is not None,
    ),
    LineForm(
        "decimal comma",
        b"1,00 2,00 3,00 4,00\n5,00 6,00 7,00 8,00\n",
        _read_comma_list,
        lambda line: _COMMA_LIST_RE.fullmatch(line) is not None,
    ),
    LineForm("labels", b"T0:1,T1:2,T2:3,T3:4\nT0:5,T1:6,T2:7,T3:8\n", _read_labels, _has_any(":=")),
    LineForm(
        "labels without a colon",
        b"T0 1 T1 2 T2 3 T3 4\nT0 5 T1 6 T2 7 T3 8\n",
        _read_bare_labels,
        lambda line: re.match(r"[A-Za-z_]+\d+[ ,;]", line) is not None,
    ),
    LineForm(
        "units",
        b"1 mV, 2 mV, 3 mV, 4 mV\n5 mV, 6 mV, 7 mV, 8 mV\n",
        _read_units,
        lambda line: re.match(r"[-+.\d]+ ?[mkuMVNP]", line) is not None,
    ),
    LineForm(
        "hexadecimal with 0x",
        b"0x1F,0x02,0x03,0x04\n0x1A,0x06,0x07,0x08\n",
        _read_prefixed_hex,
        lambda line: "0x" in line.lower(),
    ),
    LineForm("leading comma", b",1,2,3,4\n,5,6,7,8\n", _read_leading_comma, lambda line: line.startswith(",")),
    LineForm("quotes", b'"1","2","3","4"\n"5","6","7","8"\n', _read_quoted, lambda line: line[:1] in "\"'"),
    LineForm("word in front", b"SKIN,1,2,3,4\nSKIN,5,6,7,8\n", _read_word, lambda line: _WORD_RE.fullmatch(line) is not None),
    LineForm(HEXADECIMAL_FORM, b"1F 02 0A 04\n1A 06 0B 08\n", _read_hex, lambda line: _read_hex(line) is not None),
)
PLAIN_EXAMPLE = "1,2,3,4"


def read_line(text: str) -> LineReading | None:
    """Read a stripped line that is not of plain numbers; `None` if no form fits."""
    found = (form.read(text) for form in LINE_FORMS)
    return next((each for each in found if each is not None), None)


def nearest_form(line: str) -> str:
    """Return an example line of the form that is read and is the nearest to `line`."""
    found = (form.example.split(b"\n")[0].decode() for form in LINE_FORMS if form.is_shown_for(line))
    return next(found, PLAIN_EXAMPLE)


def without_colours(line: bytes) -> bytes:
    """Remove the colours of a terminal, which loggers print."""
    return _COLOUR_RE.sub(b"", line)


def last_clean_line(tail: bytes) -> str:
    """Return the last whole line of some bytes, cut; empty if these are no clean text."""
    tail = without_colours(tail)
    lines = [each for each in re.split(rb"[\r\n]+", tail)[:-1] if each.strip()]
    # The first one may have lost its begin.
    text = lines[-1].strip() if lines else b""
    clean = tail.isascii() and all(byte >= 32 or byte in b"\t\r\n" for byte in tail) and 127 not in tail
    if not clean or len(text) < CLEAN_TEXT_MIN_BYTES:
        return ""
    shown = text.decode("ascii").replace("\t", " ")
    return shown if len(shown) <= LINE_SHOWN_MAX_CHARS else f"{shown[: LINE_SHOWN_MAX_CHARS - 3]}..."
