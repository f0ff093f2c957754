"""Form of a table in a text file: its encoding, its separator, its names and units, and its rows.

The names are the first line that names a time and is as wide as rows below it. Lines before it are facts of the program that
wrote the file; lines between it and the first row are units or remarks. A table without names begins with its first row.
"""

from __future__ import annotations

import codecs
import contextlib
import csv
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from io import TextIOWrapper
from itertools import islice, zip_longest
from pathlib import Path
from typing import TypeAlias

from skincal.files.importers.labview import HEAD_END, is_labview, read_labview_head
from skincal.files.importers.table_values import (
    FIELD_SHOWN_MAX_CHARS,
    NumberEvidence,
    is_date,
    is_time_of_day,
    may_need_evidence,
    time_kind,
    to_float,
)
from skincal.files.importers.workbook import is_workbook, sheets_of
from skincal.model.errors import InputError, plural
from skincal.model.given import open_regular

MAX_LINE_CHARS = 4 << 20
"""100,000 channels have a quarter of it."""
COLUMN_SEPARATORS = {";": "semicolon", "\t": "tab", ",": "comma"}
"""The first of these in a line of names separates the columns, else spaces do."""
HEAD_LINES = 60
"""Lines that are searched for the names and the first rows."""
SHEET_ENCODING = "sheet "
"""Begins the encoding of a table that is a sheet of a workbook; its name follows."""
ENCODING_PROBE_BYTES = 1 << 16
MAX_JOINED_LINES = 1000
"""Lines of a field in quotes, such as an array of numpy."""
EMPTY_WORDS = frozenset(("", "nan", "null", "none", "na", "n/a", "nat"))
_BYTE_ORDER_MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
_SEPARATOR_LINE_RE = re.compile(r'"?sep=(.?)"?\s*', re.IGNORECASE)
_OPEN_QUOTE_RE = re.compile(r'(?:^|[,;\t])\s*"')
_LIST_RE = re.compile(r"(?:\w+\()?[\[(].*[\])]+", re.DOTALL)
_LIST_MARKS_RE = re.compile(r"[\[\](),;\s]+")
_TWO_NUMBERS_RE = re.compile(r"\d\s+[-+.\d]")
_UNIT_RE = re.compile(
    r"[\[(]?[A-Za-z\u00b5\u03bc\u00b0%][A-Za-z\u00b5\u03bc\u00b0%\u00b7\u22c5*/^. \-0-9]{0,15}[\])]?|[-/1]|\[\]|\(\)"
)
_NAME_UNIT_RE = re.compile(r"(?:[\[(].*[\])]|[_ ](?:s|ms|us|ns|n|nm|nmm|deg|rad))$")
"""Unit at the end of a name."""

NamesTime: TypeAlias = Callable[[Sequence[str]], bool]
"""Whether some of these names, in small letters, say the time."""


@dataclass(frozen=True, slots=True)
class TableForm:
    """Text form of a table.

    Raises InputError in its methods: the file cannot be read.
    """

    path: Path
    encoding: str
    separator: str | None
    names: tuple[str, ...]
    """Names of the columns in small letters; empty without."""
    facts: tuple[str, ...]
    """Lines before the names."""
    width: int
    skipped: int
    """Lines before the first row; blank ones and comments do not count."""
    examples: tuple[tuple[str, ...], ...]
    """First rows; lists are values."""
    list_columns: tuple[tuple[int, int], ...] = ()
    """Columns of the file that hold a list each, and the number of its values."""
    findings: tuple[str, ...] = ()
    start_s: float = 0.0
    """Seconds since 1970 at its time 0, for times that count from the begin of the file; 0 if it is unknown."""

    def lines(self) -> Iterator[str]:
        """Yield the lines with a row."""
        return islice(_lines(self.path, self.encoding, self.separator), self.skipped, None)

    def split(self, line: str, splits: int = -1) -> list[str]:
        """Split a line into fields. With `splits` the rest of the line after that many fields may stay together."""
        marks = [mark for mark in " \t\"'" if mark != self.separator]
        if self.list_columns or any(mark in line for mark in marks):
            row = split_fields(line, self.separator, -1 if self.list_columns else splits)
        else:
            row = line.split(self.separator, splits)
        row = _spread(row, self.list_columns) if self.list_columns else row
        # An empty field after the last column is none: some programs end every row with a separator.
        while len(row) > self.width and not row[-1] and splits < 0:
            row.pop()
        return row

    def number_uses(self) -> dict[str, str]:
        """Find the use of the marks in numbers that do not say it themselves.

        Raises InputError: no field of the file shows it, or two contradict each other.
        """
        if self.separator == ",":
            needs = any('"' in line and may_need_evidence(line) for line in self.lines())
        else:
            needs = any(may_need_evidence(line) and (self.separator or "," in line) for line in self.lines())
        if not needs:
            return {}
        evidence = NumberEvidence(self.separator in (",", None))
        for row, line in enumerate(self.lines(), start=1):
            evidence.add(self.split(line), row)
        return evidence.uses(self.path)

    def has_gaps(self) -> bool:
        """Check whether a row may lack some of its values, by its letters alone."""
        mark = self.separator or "\t"
        signs = (mark * 2, f"{mark} ", '""', "n", "N")
        return any(line[0] == mark or line[-1] == mark or any(sign in line for sign in signs) for line in self.lines())


def read_form(path: Path, names_time: NamesTime, sheet: str = "") -> TableForm:
    """Find the form of a table.

    Parameters
    ----------
    sheet : of a workbook; empty for its first one with a time

    Raises InputError: the file cannot be read, is empty, is no text, or a list in it is cut short.
    """
    encoding = _find_encoding(path) if not is_workbook(path) else f"{SHEET_ENCODING}{_find_sheet(path, names_time, sheet)}"
    head = list(islice(_lines(path, encoding, "\t", comments=True), HEAD_LINES))
    if head and is_labview(head[0]):
        return _labview_form(path, encoding, head)
    if not any(line.strip("# \t") for line in head):
        raise InputError(f"{path}: the file is empty; expected rows of a time and values, with or without a header.")
    if "\ufffd" in head[0] or not re.sub(r"\s", " ", head[0]).isprintable():
        raise InputError(f"{path}: is no text; expected rows of a time and values, with or without a header.")
    separator_line = _SEPARATOR_LINE_RE.fullmatch(head[0])
    separators: tuple[str | None, ...] = (*COLUMN_SEPARATORS, None) if not is_workbook(path) else ("\t",)
    if separator_line:
        # A tab at the end of the line is stripped.
        separators = (separator_line[1] or "\t",)
        del head[0]
    forms = (_named_form(head, each, names_time) for each in separators)
    form = next((each for each in forms if each), None)
    form = form or next((_Head(each) for each in separators if _is_unnamed(head, each)), None)
    form = form or _unknown_form(head, separators)
    rows = [split_fields(line, form.separator) for line in head[form.first :] if not line.startswith("#")]
    lists = _find_lists(rows[0], path) if rows else ()
    names = _spread_names(form.names, lists)
    examples = tuple(tuple(_spread(row, lists)) for row in rows)
    skipped = bool(separator_line) + sum(not line.startswith("#") for line in head[: form.first])
    width = len(names) or max((_filled_width(row) for row in examples), default=0)
    return TableForm(path, encoding, form.separator, names, _facts(head, form), width, skipped, examples, lists, form.findings)


def _labview_form(path: Path, encoding: str, head: Sequence[str]) -> TableForm:
    """Read the form of a LabVIEW measurement file. Raises InputError: it has several heads, or see `read_labview_head`."""
    found = read_labview_head(path, head)
    first = found.names_at + 1
    if any(line.startswith(HEAD_END) for line in islice(_lines(path, encoding, "\t"), first, None)):
        raise InputError(
            f"{path}: has a head before each part of its rows; expected one: in 'Write To Measurement File' choose 'One header "
            "only', or save each part as a file."
        )
    names = tuple(_with_unit(*each) for each in zip_longest(found.names, found.units, fillvalue=""))
    examples = tuple(tuple(split_fields(line, found.separator)) for line in head[first:])
    # The last column is for comments, and most rows have none.
    if names[-1] == "comment" and not any(len(row) >= len(names) and row[len(names) - 1] for row in examples):
        names = names[:-1]
    return TableForm(
        path,
        encoding,
        found.separator,
        names,
        tuple(head[: found.names_at]),
        len(names),
        first,
        examples,
        start_s=found.start_s,
    )


def _facts(head: Sequence[str], form: _Head) -> tuple[str, ...]:
    """Return the lines before the names, and the comments between these and the first row."""
    first = form.first if form.names else next((k for k, line in enumerate(head) if not line.startswith("#")), len(head))
    between = (line for line in head[form.names_at : first] if line.startswith("#"))
    return (*head[: form.names_at], *between)


@dataclass(frozen=True, slots=True)
class _Head:
    """Reading of the first lines of a table with one separator."""

    separator: str | None
    names: tuple[str, ...] = ()
    names_at: int = 0
    first: int = 0
    """Line of the first row."""
    findings: tuple[str, ...] = ()


def _named_form(head: Sequence[str], separator: str | None, names_time: NamesTime) -> _Head | None:
    """Find the line of names; `None` if no line names a time and is as wide as a row."""
    rows = [split_fields(line.lstrip("# "), separator) for line in head]
    for at, row in enumerate(rows):
        names = tuple(name.lower() for name in row[: _filled_width(row)])
        if len(names) < (1 if separator is None else 2) or _is_row(row) or not names_time(names):
            continue
        below = [other for other, line in zip(rows[at + 1 :], head[at + 1 :], strict=True) if not line.startswith("#")]
        if below and not any(len(other) >= len(names) >= _filled_width(other) for other in below):
            continue
        return _below_names(head, rows, separator, names, at)
    return None


def _below_names(
    head: Sequence[str], rows: Sequence[list[str]], separator: str | None, names: tuple[str, ...], at: int
) -> _Head:
    """Find the first row below the names, and take the units between."""
    first = next((k for k in range(at + 1, len(rows)) if not head[k].startswith("#") and _is_row(rows[k])), at + 1)
    between = [row for line, row in zip(head[at + 1 : first], rows[at + 1 : first], strict=True) if not line.startswith("#")]
    units = between[0] if between and all(not unit or _UNIT_RE.fullmatch(unit) for unit in between[0]) else []
    names = tuple(_with_unit(name, unit) for name, unit in zip_longest(names, units[: len(names)], fillvalue=""))
    ignored = len(between) - bool(units)
    findings = (f"{plural(ignored, 'line')} between the names and the first row: left out.",) if ignored else ()
    return _Head(separator, names, at, first, findings)


def _with_unit(name: str, text: str) -> str:
    """Append the unit from the line below a name. Raises InputError: the name has another one."""
    unit, own = text.strip("[]() ").lower(), _NAME_UNIT_RE.search(name)
    if not name or not any(letter.isalpha() or letter in "%\u00b0" for letter in unit):
        return name
    if own is None:
        return f"{name} [{unit}]"
    if re.sub("[^a-z%]", "", own[0]) != re.sub("[^a-z%]", "", unit):
        raise InputError(f"Column {name!r} has the unit {text!r} below its name; expected one unit: correct one of them.")
    return name


def _is_unnamed(head: Sequence[str], separator: str | None) -> bool:
    """Check whether the lines are rows of values with this separator, from the first on."""
    rows = [split_fields(line, separator) for line in head if not line.startswith("#")]
    return bool(rows) and all(
        _is_row(row) and (separator is None or len(row) > 1) and not any(_holds_two(field) for field in row) for row in rows[:2]
    )


def _holds_two(field: str) -> bool:
    """Check whether a field holds two numbers, so that another mark separates the columns."""
    return _TWO_NUMBERS_RE.search(field) is not None and not _is_value(field)


def _unknown_form(head: Sequence[str], separators: Sequence[str | None]) -> _Head:
    """Read the first line as names, with the first separator that it has; the columns then say what is missing."""
    at = next((k for k, line in enumerate(head) if not line.startswith("#")), 0)
    separator = next((each for each in separators if each and each in re.sub(r'"[^"]*"', "", head[at])), None)
    names = tuple(name.lower() for name in split_fields(head[at].lstrip("# "), separator))
    return _Head(separator if len(separators) > 1 else separators[0], names, at, at + 1)


def _is_row(fields: Sequence[str]) -> bool:
    """Check whether at least half of the fields are values."""
    filled = [field for field in fields if field]
    return 0 < len(filled) <= 2 * sum(map(_is_value, filled))


def _is_value(field: str) -> bool:
    return bool(time_kind(field)) or is_date(field) or is_time_of_day(field) or bool(_list_words(field))


def _filled_width(row: Sequence[str]) -> int:
    return max((index + 1 for index, field in enumerate(row) if field), default=0)


# ------------------------------------------------------------------ lists in a field


def _find_lists(row: Sequence[str], path: Path) -> tuple[tuple[int, int], ...]:
    """Find columns with lists, and the number of their values. Raises InputError: one is cut short."""
    found: list[tuple[int, int]] = []
    for column, field in enumerate(row):
        words = _list_words(field)
        if any("..." in word for word in words):
            raise InputError(
                f"{path}: the list in its column {column + 1} is cut short by '...'; expected all values: save it again, "
                "one column a value (numpy.savetxt), or as a whole list (tolist())."
            )
        found += [(column, len(words))] if words else []
    return tuple(found)


def _list_words(field: str) -> list[str]:
    """Return the numbers in a field of brackets, as words; none if it holds other things. Three points may stand between."""
    if not _LIST_RE.fullmatch(field):
        return []
    begin, end = field.find("["), field.rfind("]")
    inner = field[begin:end] if 0 <= begin < end else field
    words = [word for word in _LIST_MARKS_RE.split(inner) if word]
    return words if all("..." in word or to_float(word) is not None for word in words) else []


def _spread(row: Sequence[str], lists: Sequence[tuple[int, int]]) -> list[str]:
    """Replace lists by their values; an empty field by as many empty ones."""
    count_of = dict(lists)
    found: list[str] = []
    for column, field in enumerate(row):
        count = count_of.get(column)
        found += [field] if count is None else _list_words(field) or [""] * count
    return found


def _spread_names(names: Sequence[str], lists: Sequence[tuple[int, int]]) -> tuple[str, ...]:
    count_of = dict(lists)
    found: list[str] = []
    for column, name in enumerate(names):
        count = count_of.get(column)
        kind = re.search("wrench|force|torque|moment|(?<![a-z])ft(?![a-z])", name)
        if count is None:
            found.append(name)
        elif count == 6 and kind and kind[0] in ("wrench", "ft", "force"):
            found += [f"{name}/{axis}" for axis in ("fx", "fy", "fz", "mx", "my", "mz")]
        elif count == 3 and kind and kind[0] in ("force", "torque", "moment"):
            found += [f"{name}/{kind[0]}_{axis}" for axis in "xyz"]
        else:
            found += [f"{name}[{index}]" for index in range(count)]
    return tuple(found)


# ------------------------------------------------------------------ file


def _find_encoding(path: Path) -> str:
    """Find the encoding by the byte order mark, or by the bytes at the begin: UTF-8, else that of Windows in Europe."""
    with contextlib.suppress(OSError), open_regular(path) as file:
        data = file.read(ENCODING_PROBE_BYTES)
        for mark, encoding in _BYTE_ORDER_MARKS:
            if data.startswith(mark):
                return encoding
        if data.count(0) * 3 > len(data):
            return "utf-16-le" if data[1::2].count(0) > data[::2].count(0) else "utf-16-be"
        try:
            codecs.getincrementaldecoder("utf-8")().decode(data)
        except UnicodeDecodeError:
            return "cp1252"
    return "utf-8"


def _lines(path: Path, encoding: str, separator: str | None, *, comments: bool = False) -> Iterator[str]:
    """Yield the lines that are not blank; those that begin with # with `comments` only.

    A field in quotes may have line ends in it.
    """
    if encoding.startswith(SHEET_ENCODING):
        yield from _comment_free(sheets_of(path)[encoding.removeprefix(SHEET_ENCODING)], comments=comments)
        return
    try:
        with TextIOWrapper(open_regular(path), encoding=encoding, errors="replace") as file:
            texts = iter(partial(file.readline, MAX_LINE_CHARS), "")
            for text in texts:
                if len(text) == MAX_LINE_CHARS:
                    raise InputError(f"{path}: a line has {MAX_LINE_CHARS} letters or more; expected a row a reading.")
                # A tab at an end follows or precedes an empty field.
                line = text.strip(" \r\n") if separator == "\t" else text.strip()
                if '"' in line and line.count('"') % 2 and _OPEN_QUOTE_RE.search(line):
                    line = _joined(line, texts, path)
                if line and not line.isspace() and (comments or not line.startswith("#")):
                    yield line
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path.") from None


def _comment_free(lines: Sequence[str], *, comments: bool) -> Iterator[str]:
    return (line for line in lines if comments or not line.startswith("#"))


def _find_sheet(path: Path, names_time: NamesTime, sheet: str) -> str:
    """Find a sheet by its name, or the first one that names a time.

    Raises InputError: the workbook has no such sheet, or is empty.
    """
    sheets = sheets_of(path)
    known = {name.lower(): name for name in sheets}
    if not sheets or (sheet and sheet.lower() not in known):
        seen = ", ".join(sheets) or "no sheet with a value"
        raise InputError(f"{path}: has no sheet {sheet or 'with rows'}; it has {seen}.")
    if sheet:
        return known[sheet.lower()]
    timed = (name for name, lines in sheets.items() if _named_form(lines[:HEAD_LINES], "\t", names_time))
    return next(timed, next(iter(sheets)))


def _joined(line: str, texts: Iterator[str], path: Path) -> str:
    """Append the lines up to the end of a quote."""
    for text in islice(texts, MAX_JOINED_LINES):
        line = f"{line} {text.strip()}"
        if line.count('"') % 2 == 0:
            return line
        if len(line) > MAX_LINE_CHARS:
            break
    raise InputError(f"{path}: a quote has no end in {line[:FIELD_SHOWN_MAX_CHARS]!r}; expected one before and after a field.")


def split_fields(line: str, separator: str | None, splits: int = -1) -> list[str]:
    """Split a line into its fields. A separator within double quotes belongs to its field."""
    if '"' in line:
        with contextlib.suppress(csv.Error):
            return [
                field.strip(" \t\"'") for field in next(csv.reader([line], delimiter=separator or " ", skipinitialspace=True))
            ]
    return [field.strip(" \t\"'") for field in line.split(separator, splits)]
