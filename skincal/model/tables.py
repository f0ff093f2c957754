"""A table of a TOML file: each missing, wrong or unknown value is refused with its location in the file."""

from __future__ import annotations

import re
import reprlib
import tomllib
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError, plain_text
from skincal.model.given import MAX_TEXT_BYTES, read_regular

Value = TypeVar("Value")

MAX_LENGTH_M = 10.0
"""m. No length of a robot is larger; millimetres taken for metres are."""
MAX_ANGLE_DEG = 3600.0
"""Ten turns: more than any joint of an arm makes."""
MAX_INTEGER = 10**18
"""Just below the limit of 64 bits; no count, channel or setting is as large."""
MAX_DIRECTION_VECTOR_LENGTH = 1e100
"""The square of a longer vector, or of one shorter than its inverse, is no finite number: its direction is lost."""
MAX_DOTS_IN_TABLE_NAME = 32
"""A scene has tables three deep; the time to read a dotted name grows with the square of its dots."""
_TOO_MANY_DOTS = re.compile(rf"(?<![\w\"'-])(?:[\w\"'-]++[ \t]*+\.[ \t]*+){{{MAX_DOTS_IN_TABLE_NAME}}}")
_short_repr = reprlib.Repr()
_short_repr.maxlist, _short_repr.maxstring, _short_repr.maxother, _short_repr.maxlevel = 16, 60, 60, 4

NETWORK_PATH = re.compile(r"[\\/]([\\/]|\?\?)")
"""Beginning of a name of Windows on another machine or of a device, such as `//HOST/share` and `\\\\.\\pipe`."""


def read_text(path: Path) -> str:
    """Read a text file; its line ends are not changed."""
    data = read_regular(path, MAX_TEXT_BYTES)
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}: not a TOML file (line {line} is not UTF-8 text); correct that line.") from None


def parse_toml(text: str, path: Path) -> dict[str, Any]:
    """Parse the text of a TOML file."""
    if _TOO_MANY_DOTS.search(text):
        raise InputError(f"{path}: a name has {MAX_DOTS_IN_TABLE_NAME} dots or more; expected a few levels.")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{path}: its lists or tables are nested too deep; expected a few levels.") from None
    except ValueError as error:  # also for numbers of very many digits
        raise InputError(f"{path}: not a TOML file ({error}); correct that line.") from None


def quoted(value: object) -> str:
    """Quote a value in a sentence, without its middle if it is long."""
    try:
        return _short_repr.repr(value)
    except ValueError:  # Python writes no number of more than 4,300 digits
        return "a number of very many digits"


class Table:
    """TOML table that gives each value once; `refuse_unknown_keys` refuses the rest. `where` begins each sentence."""

    def __init__(self, values: dict[str, Any], where: str) -> None:
        self._values = dict(values)
        self.where = where
        for key in self._values:
            require_plain(key, where)

    @property
    def keys(self) -> list[str]:
        """Names of the values that were not read yet, in the order of the file."""
        return list(self._values)

    def take(self, key: str, kind: type, default: Any = ...) -> Any:
        """Take a value of this type; a whole number counts as a number, true and false do not. `...` means no default."""
        if key not in self._values:
            if default is ...:
                raise InputError(f"{self.where}: {key} is missing; expected {_TYPE_NAMES[kind]}.")
            return default
        value = self._values.pop(key)
        if isinstance(value, int) and abs(value) > MAX_INTEGER:
            # `str` of a very long number is refused by Python; log10(2) is 0.30103.
            digits = len(str(abs(value))) if value.bit_length() < 1000 else int(value.bit_length() * 0.30103) + 1
            raise InputError(f"{self.where}: {key} has {digits} digits; expected {_TYPE_NAMES[kind]} of 18 at most.")
        if kind is float and type(value) is int:
            value = float(value)
        # To Python true and false are whole numbers.
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise InputError(f"{self.where}: {key} is {quoted(value)}; expected {_TYPE_NAMES[kind]}.")
        if isinstance(value, str):
            require_plain(value, f"{self.where}: {key}")
        if isinstance(value, float) and not np.isfinite(value):
            raise InputError(f"{self.where}: {key} is {value}; expected a finite number.")
        return value

    def array(self, key: str, shape: tuple[int | None, ...], default: Any = ..., *, gaps: bool = False) -> Any:
        """Take a list of numbers as an array of this shape, `None` for any length; with `gaps` it may hold NaN."""
        value = self.take(key, list, default)
        if value is default:
            return default
        wanted = " x ".join("n" if size is None else str(size) for size in shape)
        try:
            array = np.array(value, dtype=float)
        except (TypeError, ValueError, OverflowError):
            array = np.empty(0)  # rows of different lengths, words, or too large numbers: it fits no shape
        fits = array.ndim == len(shape) and all(s in (None, n) for s, n in zip(shape, array.shape, strict=True))
        if not fits or not (np.isfinite(array) | (gaps & np.isnan(array))).all():
            raise InputError(f"{self.where}: {key} is {quoted(value)}; expected {wanted} finite numbers.")
        return array

    def pose(self, key: str, default: Any = ...) -> FloatArray:
        """Take a rigid pose, (4, 4), metres."""
        pose: FloatArray = self.array(key, (4, 4), default)
        # Accepts a rotation written with a few digits, but no mirrored or scaled one.
        rotation = pose[:3, :3]
        if (
            np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3
            or np.linalg.det(rotation) < 0
            or pose[3].tolist() != [0, 0, 0, 1]
        ):
            raise InputError(
                f"{self.where}: {key} is not a rigid pose; expected a right-handed rotation, metres, last row 0 0 0 1."
            )
        check_metres(pose[:3, 3], f"{self.where}: {key}")
        return pose

    def direction(self, key: str) -> FloatArray:
        """Take three numbers as a unit vector."""
        vector: FloatArray = self.array(key, (3,))
        with np.errstate(over="ignore", under="ignore"):
            length = float(np.linalg.norm(vector))
        if not length > 0:
            raise InputError(f"{self.where}: {key} is {vector.tolist()}; expected a direction, which is not zero.")
        if not 1 / MAX_DIRECTION_VECTOR_LENGTH < length < MAX_DIRECTION_VECTOR_LENGTH:
            raise InputError(f"{self.where}: {key} is {vector.tolist()}; expected a direction, of a length near 1.")
        return vector / length

    def path(self, key: str, default: Any = ...) -> str:
        """Take the name of a file or folder on this machine.

        Opening a file on a Windows share sends the user's name and a hash of the password to the machine in its name.
        """
        named: str = self.take(key, str, default)
        if NETWORK_PATH.match(named):
            raise InputError(f"{self.where}: {named} lies on another machine; copy it beside the scene, and name it there.")
        return named

    def words(self, key: str, default: Any = ...) -> list[str]:
        """Take a list of different names."""
        names: list[Any] = self.take(key, list, default)
        if not all(isinstance(name, str) and name for name in names) or len(set(names)) < len(names):
            raise InputError(f"{self.where}: {key} is {quoted(names)}; expected a list of different names.")
        for name in names:
            require_plain(name, f"{self.where}: {key}")
        return names

    def lengths_mm(self, key: str, shape: tuple[int | None, ...], default: Any = ..., *, gaps: bool = False) -> FloatArray:
        """Take an array of millimetres, as `array`, and convert it to metres."""
        lengths: FloatArray = self.array(key, shape, default, gaps=gaps)
        longest = float(np.nanmax(np.abs(lengths), initial=0.0))
        if longest > MAX_LENGTH_M * 1e3:
            raise InputError(
                f"{self.where}: {key} has a length of {longest:g}; millimetres up to {MAX_LENGTH_M * 1e3:g} were expected."
            )
        return lengths * 1e-3

    def choice(self, key: str, known: dict[str, Value], default: Any = ...) -> Value:
        """Take one of the words in `known`; return its value."""
        value = self.take(key, str, default)
        if value is default:
            return default
        if value not in known:
            raise InputError(f"{self.where}: {key} is {quoted(value)}; expected one of {', '.join(known)}.")
        return known[value]

    def table(self, key: str) -> Table | None:
        """Take a table within this one; `None` if it is missing."""
        values = self.take(key, dict, None)
        return None if values is None else Table(values, f"{self.where}: [{key}]")

    def subtables(self) -> list[tuple[str, Table]]:
        """Read all remaining values as tables, with their names."""
        return [(key, Table(self.take(key, dict), f"{self.where}: [{key}]")) for key in self.keys]

    def tables(self, key: str) -> list[Table]:
        """Take an array of tables; empty if it is missing."""
        values = self.take(key, list, [])
        for value in values:
            if not isinstance(value, dict):
                raise InputError(f"{self.where}: {key} holds {quoted(value)}; expected tables [[{key}]].")
        return [Table(value, f"{self.where}: [[{key}]] number {number}") for number, value in enumerate(values, start=1)]

    def refuse_unknown_keys(self, table_of: Mapping[str, str] = MappingProxyType({})) -> None:
        """Raise InputError for names that were not read: they are misspelt, or belong to another table by `table_of`."""
        if self._values:
            name = sorted(self._values)[0]
            advice = f"it belongs to [{table_of[name]}]" if name in table_of else "check its spelling"
            raise InputError(f"{self.where}: unknown name {name!r}; {advice}.")


_TYPE_NAMES = {
    str: "text", int: "a whole number", float: "a number", list: "a list", dict: "a table", bool: "true or false"
}  # fmt: skip


def require_plain(text: str, where: str) -> None:
    """Refuse text that a terminal or a file's header would take for a command."""
    if plain_text(text) != text:
        raise InputError(f"{where}: {quoted(text)} holds a control character; expected plain text.")


def check_degrees(angles: FloatArray, what: str) -> None:
    """Refuse angles beyond `MAX_ANGLE_DEG`: after subtracting the turns no digit of them is left."""
    largest = float(np.abs(angles).max(initial=0.0))
    if largest > MAX_ANGLE_DEG:
        raise InputError(f"{what} has an angle of {largest:g}; degrees up to {MAX_ANGLE_DEG:g} were expected.")


def check_metres(lengths: FloatArray, what: str) -> None:
    """Refuse lengths beyond `MAX_LENGTH_M`; the sentence names the likely unit."""
    longest = float(np.abs(lengths).max(initial=0.0))
    if longest > MAX_LENGTH_M:
        raise InputError(
            f"{what} has a length of {longest:g}; metres up to {MAX_LENGTH_M:g} were expected: divide millimetres by 1000."
        )
