"""Forms of text lines that boards print, in one table: `LINE_FORMS`.

Each row has a name, the bytes of some lines as an example, and the reader of one line. A reader returns `None` for a line
that may mean something else. It knows no link, no width and no line before; `skincal/streams/decoders/line_streams.py` does.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import reduce
from typing import cast

from skincal.devices.column_names import (
    CLOCK_COLUMN_RE,
    COUNTER_COLUMN_RE,
    MOMENT_UNITS,
    TIME_COLUMN_RE,
    WRENCH_AXES,
    axis_of,
    plain_unit,
)
from skincal.devices.netft import FORCE_UNITS

HEXADECIMAL_FORM = "hexadecimal without 0x"
LINE_SHOWN_MAX_CHARS = 60
CLEAN_TEXT_MIN_BYTES = 4
"""Bytes of a line that is shown. A shorter one may be chance."""
_NUMBER_PATTERN = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf)"
_LABEL_RE = re.compile(
    rf"\s*(?P<name>[A-Za-z_](?:[A-Za-z_ ]{{0,30}}[A-Za-z_])?)?[ _]?[\[(]?(?P<number>\d{{1,6}})?[\])]?\s*[:=]\s*"
    rf"(?P<value>{_NUMBER_PATTERN})(?![\w.])"
    r"(?:[ ]?(?P<unit>[A-Za-z][A-Za-z.*]*(?: m)?)(?=\s*(?:[,;|\t]|$)|\s+[A-Za-z_]+\s*[:=]))?"
    r"\s*(?P<end>[,;|]|\s|$)",
    re.IGNORECASE,
)
"""A label, its number, its value and a unit, up to the separator."""
_TITLE_RE = re.compile(r"[#$@!>]?\s?(?P<name>[A-Za-z_][A-Za-z_0-9 ]{0,30}?)\s*[:=]\s*(?P<rest>\S.*)")
_SENTENCE_RE = re.compile(r"[$!](?P<body>(?P<name>[A-Za-z][A-Za-z0-9_]*),(?P<rest>[^*]*))\*(?P<sum>[0-9A-Fa-f]{2})")
_PREFIX_RE = re.compile(r"[IDVWE] \(\d+\) (?P<tag>[\w.-]{1,40}): (?P<esp>.+)|\d\d:\d\d:\d\d\.\d{1,6} -> (?P<monitor>.+)")
_HEX_RE = re.compile(r"[0-9A-Fa-f]{1,8}")
_HEX_LETTER_RE, _HEX_DIGIT_RE = re.compile(r"[A-Fa-f]"), re.compile(r"\d")
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
    lead: dict[str, float] = field(default_factory=dict[str, float])
    """Clock and counter, by name."""
    fault: str = ""
    """Why the line cannot be used although its form is known; empty if it can."""


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
    if ";" in line:
        return line.replace(",", ".").removesuffix(";").split(";")
    if "," in line:
        return line.removesuffix(",").split(",")
    return line.split()


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
    named: list[tuple[str, int | None, float, str]] = []
    at = 0
    while at < len(text):
        found = _LABEL_RE.match(text, at)
        if found is None or (not found["name"] and not found["number"]):
            return None
        number = None if found["number"] is None else int(found["number"])
        named.append(((found["name"] or "").lower(), number, float(found["value"]), found["unit"] or ""))
        at = found.end()
    return _sort_labels("labels", named) if named else None


def _sort_labels(form: str, named: list[tuple[str, int | None, float, str]]) -> LineReading | None:
    """Sort labelled numbers into channels, axes, clock and counter; `None` if two have one meaning."""
    channels, axes, lead = dict[int, float](), dict[str, float](), dict[str, float]()
    bases: set[str] = set()
    for name, number, value, unit in named:
        axis = axis_of(name) if number is None else None
        if number is not None:
            # A unit may change from line to line (mV, V).
            if number in channels or unit:
                return None
            bases.add(name)
            channels[number] = value
        elif axis is not None:
            factor = _unit_factor(axis[0], unit)
            if axis[0] in axes or factor is None:
                return None
            axes[axis[0]] = value * factor
        elif is_clock_or_counter(name):
            lead[name] = value
    if len(bases) > 1 or not (channels or axes) or (axes and set(axes) != set(WRENCH_AXES)):
        return None
    return LineReading(form, next(iter(bases), ""), channels=channels, axes=axes, lead=lead)


def _unit_factor(axis: str, unit: str) -> float | None:
    return (FORCE_UNITS if axis.startswith("f") else MOMENT_UNITS).get(plain_unit(unit)) if unit else 1.0


def _read_brackets(text: str) -> LineReading | None:
    if len(text) < 3 or _CLOSING_BRACKETS.get(text[0]) != text[-1]:
        return None
    if text[0] == "[" and (values := _json_numbers(_parse_json(text))) is not None:
        return LineReading("brackets", lists={"": values})
    values = to_numbers(split_fields(text[1:-1].strip()))
    return None if values is None or "_" in text else LineReading("brackets", lists={"": values})


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
    singles = [
        (base.lower(), int(digits) if digits else None, number, "")
        for key, value in pairs.items()
        if value is not None and (number := _json_number(value)) is not None
        for base, digits in re.findall(r"^(.*?)[_ ]?(\d{0,6})$", key)
    ]
    sorted_labels = _sort_labels("JSON object", singles)
    if sorted_labels is None and any(each[1] is not None or axis_of(each[0]) for each in singles):
        return None
    if sorted_labels is not None:
        return LineReading(
            "JSON object", sorted_labels.title, lists, sorted_labels.channels, sorted_labels.axes, sorted_labels.lead
        )
    lead = {name: value for name, number, value, _ in singles if number is None and is_clock_or_counter(name)}
    return LineReading("JSON object", lists=lists, lead=lead) if lists else None


def _read_titled(text: str) -> LineReading | None:
    found = _TITLE_RE.fullmatch(text)
    if found is None:
        return None
    rest, name = found["rest"], found["name"].strip().lower()
    brackets = _read_brackets(rest)
    values = brackets.lists[""] if brackets is not None else None if "_" in rest else to_numbers(split_fields(rest))
    # One number with a title is a label.
    return LineReading("title", name, {name: values}) if values is not None and len(values) > 1 else None


def _read_sentence(text: str) -> LineReading | None:
    found = _SENTENCE_RE.fullmatch(text)
    values = None if found is None or "_" in found["rest"] else to_numbers(split_fields(found["rest"]))
    if found is None or values is None:
        return None
    name, right = found["name"].lower(), reduce(lambda sum_, byte: sum_ ^ byte, found["body"].encode(), 0)
    if right != int(found["sum"], 16):
        return LineReading("checksum", name, fault=f"Checksum *{found['sum']} of a line is wrong; expected *{right:02X}")
    return LineReading("checksum", name, {name: values})


def _read_leading_comma(text: str) -> LineReading | None:
    values = to_numbers(split_fields(text[1:].strip())) if text.startswith(",") and "_" not in text else None
    return None if values is None else LineReading("leading comma", lists={"": values})


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


def _read_prefix(text: str) -> LineReading | None:
    """Read the numbers behind a log's level, time and tag, or behind a monitor's time."""
    found = _PREFIX_RE.fullmatch(text)
    if found is None:
        return None
    rest = (found["esp"] or found["monitor"]).strip()
    values = None if "_" in rest else to_numbers(split_fields(rest))
    inner = read_line(rest) if values is None else LineReading("plain", lists={"": values})
    if inner is None or inner.form in (HEXADECIMAL_FORM, "prefix"):
        return None
    title = f"{(found['tag'] or '').lower()} {inner.form} {inner.title}".strip()
    return LineReading("prefix", title, inner.lists, inner.channels, inner.axes, inner.lead, inner.fault)


# ------------------------------------------------------------------ the table


def _has_any(marks: str) -> Callable[[str], bool]:
    return lambda line: any(mark in line for mark in marks)


LINE_FORMS = (
    LineForm(
        "log or monitor prefix",
        b"I (1200) skin: 1,2,3,4\nI (1220) skin: 5,6,7,8\n",
        _read_prefix,
        lambda line: " -> " in line or re.match(r"[IDVWE] \(", line) is not None,
    ),
    LineForm("checksum", b"$SKIN,1,2,3,4*1B\n$SKIN,5,6,7,8*13\n", _read_sentence, lambda line: line[:1] in "$!"),
    LineForm("JSON object", b'{"skin":[1,2,3,4]}\n{"skin":[5,6,7,8]}\n', _read_object, lambda line: line.startswith("{")),
    LineForm("brackets", b"[1, 2, 3, 4]\n[5, 6, 7, 8]\n", _read_brackets, lambda line: line[:1] in "[(<"),
    LineForm("title", b"#SKIN=1,2,3,4\n#SKIN=5,6,7,8\n", _read_titled, lambda line: line.startswith("#")),
    LineForm("labels", b"T0:1,T1:2,T2:3,T3:4\nT0:5,T1:6,T2:7,T3:8\n", _read_labels, _has_any(":=")),
    LineForm(
        "hexadecimal with 0x",
        b"0x1F,0x02,0x03,0x04\n0x1A,0x06,0x07,0x08\n",
        _read_prefixed_hex,
        lambda line: "0x" in line.lower(),
    ),
    LineForm("leading comma", b",1,2,3,4\n,5,6,7,8\n", _read_leading_comma, lambda line: line.startswith(",")),
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


def last_clean_line(tail: bytes) -> str:
    """Return the last whole line of some bytes, cut; empty if these are no clean text."""
    lines = [each for each in re.split(rb"[\r\n]+", tail)[:-1] if each.strip()]
    # The first one may have lost its begin.
    text = lines[-1].strip() if lines else b""
    clean = tail.isascii() and all(byte >= 32 or byte in b"\t\r\n" for byte in tail) and 127 not in tail
    if not clean or len(text) < CLEAN_TEXT_MIN_BYTES:
        return ""
    shown = text.decode("ascii").replace("\t", " ")
    return shown if len(shown) <= LINE_SHOWN_MAX_CHARS else f"{shown[: LINE_SHOWN_MAX_CHARS - 3]}..."
