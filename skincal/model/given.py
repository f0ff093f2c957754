"""Read files and documents that may come from a stranger: whole, and never beyond a size limit.

Every file that a scene, a session or a command names is read here. It must be a regular file: a device never ends, and a pipe
may never answer. Its size is checked before a byte is read. Every JSON document is parsed here, too.
"""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path
from typing import Any, BinaryIO

from skincal.model.errors import InputError

MAX_TEXT_BYTES = 4 << 20
"""Of a scene, a layout or a position file. A layout of 100,000 channels has 2 MB; TOML of this size is read in 4 s."""
MAX_MESH_BYTES = 200 << 20
"""Of a mesh. A million triangles are 50 MB of STL; a printed cover has a tenth."""
MAX_JSON_BYTES = 16 << 20
"""Of a JSON document. The truth on 100,000 taxels has 10 MB."""


def open_regular(path: Path, *, what: str = "file", advice: str = "check the path") -> BinaryIO:
    """Open a regular file for reading.

    `what` is the kind of file in the sentence on a missing one, `advice` what the operator should do.
    """
    try:
        _require_regular_file(path.stat(), path, advice)
        # It may have become a pipe since: opening one must not wait.
        file = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        try:
            _require_regular_file(os.fstat(file), path, advice)
            return os.fdopen(file, "rb")
        except InputError:
            os.close(file)
            raise
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such {what}; {advice}.") from None
    except (OSError, ValueError) as error:  # a name with a NUL is a ValueError
        why = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{path}: cannot be read ({why}); check the path and its rights.") from None


def read_regular(path: Path, max_bytes: int, *, what: str = "file", advice: str = "check the path") -> bytes:
    """Read a regular file of at most `max_bytes`; `what` and `advice` as in `open_regular`."""
    with open_regular(path, what=what, advice=advice) as file:
        size = os.fstat(file.fileno()).st_size
        try:
            # A file that grows meanwhile is read up to its size before.
            data = file.read(size) if size <= max_bytes else b""
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror}); check the disk.") from None
    if size > max_bytes:
        raise InputError(f"{path}: has {size} bytes; expected a {what} of at most {max_bytes}; {advice}.")
    return data


def _require_regular_file(found: os.stat_result, path: Path, advice: str) -> None:
    if not stat.S_ISREG(found.st_mode):
        seen = "a folder" if stat.S_ISDIR(found.st_mode) else "a device or a pipe"
        raise InputError(f"{path}: is {seen}; expected a file; {advice}.")


def parse_json(data: bytes | str) -> Any:
    """Parse a JSON document.

    Raises ValueError: it is none, is nested too deep, has whole numbers beyond 64 bits, or holds NaN or Infinity.
    """
    text = data if isinstance(data, str) else data.decode(json.detect_encoding(data), "surrogatepass")
    try:
        return _JSON_DECODER.decode(text)
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


_JSON_DECODER = json.JSONDecoder(parse_int=_whole_number, parse_constant=_refuse_constant)
"""Made once: a session has thousands of documents, and `json.loads` would make one for each."""
