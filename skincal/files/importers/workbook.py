"""Sheets of an Excel workbook as the lines of a table, read by `openpyxl`: a tab between cells, and values for formulas."""

from __future__ import annotations

import datetime
import warnings
import zipfile
from functools import lru_cache
from pathlib import Path
from typing import Any

from skincal.files.importers.array_file import needs_package, one_line
from skincal.model.errors import InputError
from skincal.model.given import open_regular

WORKBOOK_SUFFIXES = (".xlsx", ".xlsm", ".xls")
SHEET_MARK = "!"
"""Between the name of a sheet and a column, as in Excel."""
_OLE_MARK = b"\xd0\xcf\x11\xe0"
MAX_CELLS = 50_000_000


def is_workbook(path: Path) -> bool:
    """Check by its name whether a file is a workbook."""
    return path.suffix.lower() in WORKBOOK_SUFFIXES


def sheets_of(path: Path) -> dict[str, tuple[str, ...]]:
    """Read the lines of each sheet that has some.

    Raises InputError: the file is no workbook, is encrypted, or `openpyxl` is missing.
    """
    with open_regular(path) as file:
        head = file.read(8)
    if head.startswith(_OLE_MARK):
        raise InputError(f"{path}: is encrypted, or of Excel before 2007; save it as .xlsx without a password.")
    found = path.stat()
    return _read(path, found.st_mtime_ns, found.st_size)


@lru_cache(maxsize=2)
def _read(path: Path, _changed_ns: int, _size: int) -> dict[str, tuple[str, ...]]:
    try:
        import openpyxl  # pyright: ignore[reportMissingModuleSource, reportMissingImports]
    except ImportError:
        raise needs_package("Excel workbooks are", "openpyxl", "excel") from None
    library: Any = openpyxl
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            book = library.load_workbook(path, read_only=True, data_only=True)
            try:
                return {sheet.title: lines for sheet in book.worksheets if (lines := _lines_of(sheet))}
            finally:
                book.close()
    except (OSError, ValueError, KeyError, TypeError, AttributeError, zipfile.BadZipFile, SyntaxError) as error:
        raise InputError(f"{path}: is no Excel workbook, or is cut off ({one_line(error)}); save it again as .xlsx.") from None


def _lines_of(sheet: Any) -> tuple[str, ...]:
    lines: list[str] = []
    cells = 0
    for row in sheet.iter_rows(values_only=True):
        cells += len(row)
        if cells > MAX_CELLS:
            raise ValueError(f"a sheet has more than {MAX_CELLS} cells")
        texts = [_text(value) for value in row]
        if any(texts):
            lines.append("\t".join(texts))
    return tuple(lines)


def _text(value: object) -> str:
    """Write a cell: numbers with all digits, times of day and durations as seconds, dates as ISO 8601."""
    match value:
        case None:
            return ""
        case bool():
            return str(int(value))
        case float():
            return repr(value)
        case datetime.datetime():
            return value.isoformat(" ")
        case datetime.time():
            midnight = datetime.timedelta(hours=value.hour, minutes=value.minute, seconds=value.second)
            return repr(midnight.total_seconds() + value.microsecond * 1e-6)
        case datetime.timedelta():
            return repr(value.total_seconds())
        case _:
            return " ".join(str(value).replace('"', "").split())
