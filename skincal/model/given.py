"""Files and documents that a stranger may have made: read whole, and only what is bearable.

Every whole file that a scene, a session or a command names is read here: a regular file, so that a device never ends and a pipe
never answers, and not beyond a limit, which is looked at before a byte is read. Every JSON document is read here, too.
"""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path
from typing import Any, BinaryIO

from skincal.model.errors import InputError

TEXT_MOST = 4 << 20
"""Bytes of a scene, a layout or a position file. A layout of 100,000 channels has 2 MB; TOML of this size is read in 4 s."""
MESH_MOST = 200 << 20
"""Bytes of a mesh. A million triangles are 50 MB of STL; a cover that is printed has a tenth."""
DOCUMENT_MOST = 16 << 20
"""Bytes of a JSON document. The truth on 100,000 taxels has 10 MB."""


def open_regular(path: Path, *, what: str = "file", advice: str = "check the path") -> BinaryIO:
    """Open a regular file for reading.

    `what` is the kind of file in the sentence on one that is missing, `advice` what to do then.

    Raises InputError: it is missing, a folder, a device or a pipe, or it cannot be read.
    """
    try:
        _demand_regular(path, path.stat(), advice)
        # It may have become a pipe since: opening that must not wait.
        file = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        try:
            _demand_regular(path, os.fstat(file), advice)
            return os.fdopen(file, "rb")
        except InputError:
            os.close(file)
            raise
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such {what}; {advice}.") from None
    except (OSError, ValueError) as error:  # a name with a NUL is a ValueError
        why = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{path}: cannot be read ({why}); check the path and its rights.") from None


def read_regular(path: Path, most: int, *, what: str = "file", advice: str = "check the path") -> bytes:
    """Return the bytes of a regular file of at most so many bytes.

    Raises InputError: as for `open_regular`; also where the file is larger.
    """
    with open_regular(path, what=what, advice=advice) as file:
        size = os.fstat(file.fileno()).st_size
        try:
            # What it grows by meanwhile is not read: Python makes room for as much as is asked for.
            data = file.read(size) if size <= most else b""
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror}); check the disk.") from None
    if size > most:
        raise InputError(f"{path}: has {size} bytes; expected a {what} of at most {most}; {advice}.")
    return data


def _demand_regular(path: Path, found: os.stat_result, advice: str) -> None:
    if not stat.S_ISREG(found.st_mode):
        seen = "a folder" if stat.S_ISDIR(found.st_mode) else "a device or a pipe"
        raise InputError(f"{path}: is {seen}; expected a file; {advice}.")


def parse_json(data: bytes | str) -> Any:
    """Parse a JSON document.

    Raises ValueError: it is none, is nested too deep, has whole numbers beyond 64 bits, or holds NaN or Infinity.
    """
    try:
        return json.loads(data, parse_int=_whole_number, parse_constant=_refuse_constant)
    except RecursionError:
        raise ValueError("it is nested too deep") from None


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no number of JSON")


def _whole_number(digits: str) -> int:
    if len(digits) > 20:
        raise ValueError(f"a whole number of {len(digits)} digits")
    number = int(digits)
    if not -(1 << 63) <= number < 1 << 63:
        raise ValueError("a whole number beyond 64 bits")
    return number
