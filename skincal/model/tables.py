"""A table of a TOML file, read so that each missing, wrong or unknown value is named with its place in the file."""

from __future__ import annotations

import re
import reprlib
import tomllib
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError, plain_text
from skincal.model.given import TEXT_MOST, read_regular

T = TypeVar("T")

LENGTH_MAX = 10.0
"""m. No length of a robot is larger; millimetres taken for metres are."""
ANGLE_MAX = 3600.0
"""Degrees: ten turns, more than any joint of an arm makes."""
INTEGER_MAX = 10**18
"""Whole numbers of 64 bits end soon after; no count, channel or setting is as large."""
DIRECTION_MAX = 1e100
"""The square of a longer vector, or of one shorter than its inverse, leaves the range of a double: its direction is lost."""
DOTS_MOST = 32
"""A scene has tables three deep; the time to read a dotted name grows with the square of its dots."""
_DOTTED = re.compile(rf"(?<![\w\"'-])(?:[\w\"'-]++[ \t]*+\.[ \t]*+){{{DOTS_MOST}}}")
_SHORT = reprlib.Repr()
_SHORT.maxlist, _SHORT.maxstring, _SHORT.maxother, _SHORT.maxlevel = 16, 60, 60, 4


def read_text(path: Path) -> str:
    """Return a file's text, its ends of line as they are; `InputError` says why it cannot be read."""
    data = read_regular(path, TEXT_MOST)
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}: not a TOML file (line {line} is not UTF-8 text); correct that line.") from None


def parse_toml(text: str, path: Path) -> dict[str, Any]:
    """Return the content of a TOML file's text; `InputError` says what is wrong with it and where."""
    if _DOTTED.search(text):
        raise InputError(f"{path}: a name has {DOTS_MOST} dots or more; expected a few levels.")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{path}: its lists or tables are nested too deep; expected a few levels.") from None
    except ValueError as error:  # also for numbers of very many digits
        raise InputError(f"{path}: not a TOML file ({error}); correct that line.") from None


def shown(value: object) -> str:
    """Return how a value is written, with its middle left out where it is long."""
    try:
        return _SHORT.repr(value)
    except ValueError:  # Python writes no number of more than 4,300 digits
        return "a number of very many digits"


class Table:
    """Gives out each value once; `done` refuses what was not asked for. Sentences begin with `where`: file and place."""

    def __init__(self, values: dict[str, Any], where: str) -> None:
        self._values = dict(values)
        self.where = where
        for key in self._values:
            _demand_plain(key, where)

    @property
    def keys(self) -> list[str]:
        """Names that were not taken yet, in the order of the file."""
        return list(self._values)

    def take(self, key: str, kind: type, default: Any = ...) -> Any:
        """Return a value of this kind; a whole number counts as a number, true and false do not."""
        # An ellipsis stands for no default, since None is one.
        if key not in self._values:
            if default is ...:
                raise InputError(f"{self.where}: {key} is missing; expected {_name(kind)}.")
            return default
        value = self._values.pop(key)
        if isinstance(value, int) and abs(value) > INTEGER_MAX:
            raise InputError(f"{self.where}: {key} has {_digits(value)} digits; expected {_name(kind)} of 18 at most.")
        if kind is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        # To Python true and false are whole numbers.
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise InputError(f"{self.where}: {key} is {shown(value)}; expected {_name(kind)}.")
        if isinstance(value, str):
            _demand_plain(value, f"{self.where}: {key}")
        if isinstance(value, float) and not np.isfinite(value):
            raise InputError(f"{self.where}: {key} is {value}; expected a finite number.")
        return value

    def array(self, key: str, shape: tuple[int | None, ...], default: Any = ..., *, gaps: bool = False) -> Any:
        """Return a list of numbers as an array of this shape, None for any length; with `gaps` NaN may stand in it."""
        value = self.take(key, list, default)
        if value is default:
            return default
        wanted = " x ".join("n" if size is None else str(size) for size in shape)
        try:
            array = np.array(value, dtype=float)
        except (TypeError, ValueError, OverflowError):
            # Rows of different lengths, words, or whole numbers beyond every double: nothing that fits any shape.
            array = np.empty(0)
        fits = array.ndim == len(shape) and all(s in (None, n) for s, n in zip(shape, array.shape, strict=True))
        if not fits or not (np.isfinite(array) | (gaps & np.isnan(array))).all():
            raise InputError(f"{self.where}: {key} is {shown(value)}; expected {wanted} finite numbers.")
        return array

    def direction(self, key: str) -> FloatArray:
        """Return three numbers as a unit vector."""
        vector: FloatArray = self.array(key, (3,))
        with np.errstate(over="ignore", under="ignore"):
            length = float(np.linalg.norm(vector))
        if not length > 0:
            raise InputError(f"{self.where}: {key} is {vector.tolist()}; expected a direction, which is not zero.")
        if not 1 / DIRECTION_MAX < length < DIRECTION_MAX:
            raise InputError(f"{self.where}: {key} is {vector.tolist()}; expected a direction, of a length near 1.")
        return vector / length

    def lengths_mm(self, key: str, shape: tuple[int | None, ...], default: Any = ..., *, gaps: bool = False) -> FloatArray:
        """Return an array that the file gives in millimetres, in metres; as `array`, and none beyond `LENGTH_MAX`."""
        lengths: FloatArray = self.array(key, shape, default, gaps=gaps)
        longest = float(np.nanmax(np.abs(lengths), initial=0.0))
        if longest > LENGTH_MAX * 1e3:
            raise InputError(
                f"{self.where}: {key} has a length of {longest:g}; millimetres up to {LENGTH_MAX * 1e3:g} were expected."
            )
        return lengths * 1e-3

    def choice(self, key: str, known: dict[str, T], default: Any = ...) -> T:
        """Return what stands for one of the words in `known`."""
        value = self.take(key, str, default)
        if value is default:
            return default
        if value not in known:
            raise InputError(f"{self.where}: {key} is {shown(value)}; expected one of {', '.join(known)}.")
        return known[value]

    def table(self, key: str) -> Table | None:
        """Return a table within this one; None where there is none."""
        values = self.take(key, dict, None)
        return None if values is None else Table(values, f"{self.where}: [{key}]")

    def each_table(self) -> list[tuple[str, Table]]:
        """Return the tables within this one, with their names; nothing else may be left in it."""
        return [(key, Table(self.take(key, dict), f"{self.where}: [{key}]")) for key in self.keys]

    def tables(self, key: str) -> list[Table]:
        """Return an array of tables; empty where there is none."""
        values = self.take(key, list, [])
        for value in values:
            if not isinstance(value, dict):
                raise InputError(f"{self.where}: {key} holds {shown(value)}; expected tables [[{key}]].")
        return [Table(value, f"{self.where}: [[{key}]] number {number}") for number, value in enumerate(values, start=1)]

    def done(self) -> None:
        """Refuse what is left.

        Raises InputError: a name was not asked for.
        """
        if self._values:
            raise InputError(f"{self.where}: unknown name {sorted(self._values)[0]!r}; check its spelling.")


def _demand_plain(text: str, where: str) -> None:
    """Refuse text that would reach a terminal or a file's header as an order."""
    if plain_text(text) != text:
        raise InputError(f"{where}: {shown(text)} holds a control character; expected plain text.")


def _digits(value: int) -> int:
    """Return how many decimal digits a whole number has; above some hundred, about how many."""
    return len(str(abs(value))) if value.bit_length() < 1000 else int(value.bit_length() * 0.30103) + 1


def _name(kind: type) -> str:
    return {str: "text", int: "a whole number", float: "a number", list: "a list", dict: "a table", bool: "true or false"}[kind]


def check_degrees(angles: FloatArray, what: str) -> None:
    """Refuse angles beyond `ANGLE_MAX`: of much larger ones no digit is left after the turns."""
    largest = float(np.abs(angles).max(initial=0.0))
    if largest > ANGLE_MAX:
        raise InputError(f"{what} has an angle of {largest:g}; degrees up to {ANGLE_MAX:g} were expected.")


def check_metres(lengths: FloatArray, what: str) -> None:
    """Refuse lengths beyond `LENGTH_MAX`.

    Raises InputError, whose sentence names the likely unit.
    """
    longest = float(np.abs(lengths).max(initial=0.0))
    if longest > LENGTH_MAX:
        raise InputError(
            f"{what} has a length of {longest:g}; metres up to {LENGTH_MAX:g} were expected: divide millimetres by 1000."
        )
