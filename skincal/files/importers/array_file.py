"""Named arrays of a file: NumPy, HDF5, MATLAB, Parquet, or one matrix a frame as text.

Each container is read by a well-kept library, which is imported with the first file of its kind. Nothing that runs code while
it is read is opened: pickle, and arrays of Python objects, which are pickle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from math import prod
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from skincal.model.errors import InputError
from skincal.model.given import open_regular

MAX_ARRAY_BYTES = 4 << 30
"""Of an array in memory: a day of 64 channels at 100 Hz is 4 GB in double precision."""
MAX_ARRAYS = 5000
NAMES_SHOWN_MAX = 8
LEROBOT_INFO = "meta/info.json"
READ_ERRORS = (OSError, RuntimeError, MemoryError, ArithmeticError, LookupError, ValueError, TypeError, AttributeError)
"""Raised by the libraries if a file is damaged."""
_HDF5_MARK, _ZIP_MARK, _OLE_MARK = b"\x89HDF\r\n\x1a\n", b"PK\x03\x04", b"\xd0\xcf\x11\xe0"
_PARQUET_MARK = b"PAR1"
_ANY_MARKS = (b"MATLAB 7.3", _HDF5_MARK, _PARQUET_MARK)
_MARKS_OF_SUFFIX = {
    ".npz": ("a file of numpy.savez", (_ZIP_MARK,)), ".h5": ("HDF5", ()), ".hdf5": ("HDF5", ()), ".parquet": ("Parquet", ()),
}  # fmt: skip
"""Kind of a file, and how it begins, by the end of its name; any of the marks above is right as well."""
HEAD_BYTES = 1024
_PICKLE_SUFFIXES = (".pkl", ".pickle", ".joblib", ".pt", ".pth")

AnyArray: TypeAlias = NDArray[Any]


@dataclass(frozen=True, slots=True, eq=False)
class NamedArray:
    """An array in a file."""

    name: str
    shape: tuple[int, ...]
    kind: str
    """Kind of its values as numpy has it: `iufb` are numbers, `M` and `m` are times."""
    read: Callable[[], AnyArray]
    """Reads it whole, in the shape above; may raise one of `READ_ERRORS`."""
    unit: str = ""
    """Stated in the file; empty without."""
    frame: str = ""
    """Name of its frame of reference, stated in the file; empty without."""
    labels: tuple[str, ...] = ()
    """Names of the values of a row, stated in the file; empty without."""
    trouble: str = ""
    """Why it cannot be read; empty if it can."""
    item_bytes: int = 8

    @property
    def is_number(self) -> bool:
        return not self.trouble and self.kind in "iufb" and bool(self.kind)

    @property
    def is_time(self) -> bool:
        """Whether its values are dates or durations."""
        return not self.trouble and self.kind in "mM" and bool(self.kind)

    @property
    def group(self) -> str:
        """Name up to its last part, with the separator."""
        return self.name[: len(self.name) - len(self.last_name)]

    @property
    def last_name(self) -> str:
        """Last part of the name."""
        return self.name.replace("/", ".").rpartition(".")[2]


@dataclass(frozen=True, slots=True, eq=False)
class ArrayFile:
    """A file of named arrays."""

    path: Path
    kind: str
    """Of the container, for sentences: `a MATLAB file`."""
    arrays: Mapping[str, NamedArray]
    rate: float | None = None
    """Rows a second, stated in the file."""
    findings: tuple[str, ...] = ()
    first_index: int = 0
    """Of rows and columns, as the program that wrote the file counts."""
    details: Mapping[str, str] = field(default_factory=dict[str, str])
    """Sentences on arrays that have another meaning, such as images, by name."""

    def read(self, array: NamedArray) -> AnyArray:
        """Read an array. Raises InputError: it cannot be read, or does not fit into memory."""
        if array.trouble:
            raise InputError(f"{self.path}: {array.name} {array.trouble}.")
        if prod(array.shape) * max(array.item_bytes, 1) > MAX_ARRAY_BYTES:
            raise InputError(
                f"{self.path}: {array.name} announces {' x '.join(map(str, array.shape))} values; expected at most "
                f"{MAX_ARRAY_BYTES >> 30} GiB: save a part of it."
            )
        try:
            values = np.asarray(array.read())
        except READ_ERRORS as error:
            raise InputError(
                f"{self.path}: {array.name} cannot be read ({one_line(error)}); the file is damaged or cut off."
            ) from None
        if values.shape != array.shape:
            raise InputError(f"{self.path}: {array.name} has another shape than the file says; it is damaged.")
        return values

    def list_names(self) -> str:
        """List arrays with their shapes, numbers first."""
        readable = [each for each in self.arrays.values() if each.is_number or each.is_time]
        shown = [f"{each.name} {list(each.shape)}" for each in readable[:NAMES_SHOWN_MAX]]
        more = len(readable) - len(shown)
        return (", ".join(shown) + (f" and {more} more" if more > 0 else "")) or "no array of numbers"


def one_line(error: BaseException) -> str:
    """Make the words of an error one short line without a full stop."""
    return (" ".join(str(error).split()).rstrip(".") or type(error).__name__)[:160]


def needs_package(what: str, package: str, extra: str) -> InputError:
    """Make the sentence on a package that is not installed."""
    return InputError(
        f"{what} read by the package {package}, which is not installed; install it: "
        f"python -m pip install 'skincal[{extra}]' (or python3 start.py --{extra})"
    )


def open_array_file(path: Path, episode: int | None = None) -> ArrayFile:
    """List the arrays of a file or folder.

    Parameters
    ----------
    episode : of a LeRobot data set; all of them if it is `None`

    Raises InputError: it cannot be read, has no array, or needs a package that is not installed.
    """
    found = _open(path, episode)
    if len(found.arrays) > MAX_ARRAYS:
        raise InputError(f"{path}: has {len(found.arrays)} arrays; expected at most {MAX_ARRAYS}: save those of one recording.")
    if not any(each.is_number for each in found.arrays.values()):
        troubles = [f"{each.name} {each.trouble}" for each in found.arrays.values() if each.trouble][:2]
        why = "; ".join(troubles) or "expected arrays of a wrench, a skin and their times"
        raise InputError(f"{path}: has no array of numbers; {why}.")
    return found


def _reader(module: str, name: str) -> Callable[..., ArrayFile]:
    return getattr(import_module(f"skincal.files.importers.{module}"), name)


def _open(path: Path, episode: int | None) -> ArrayFile:
    suffix = path.suffix.lower()
    if path.is_dir() or suffix == ".npy":
        folder = path if path.is_dir() else path.parent
        if (folder / LEROBOT_INFO).is_file():
            return _reader("parquet_arrays", "open_lerobot")(folder, episode)
        return _reader("numpy_arrays", "open_npy_folder")(folder)
    if suffix in _PICKLE_SUFFIXES:
        raise InputError(
            f"{path}: is pickle, which runs the code in it while it is read: files of others could do anything here. Save the "
            "arrays with numpy.savez(FILE, t=..., wrench=..., skin=...), or a table with to_parquet or to_csv."
        )
    with open_regular(path) as file:
        head = file.read(HEAD_BYTES)
    if not head:
        raise InputError(f"{path}: the file is empty; expected arrays of a wrench, a skin and their times.")
    _refuse_other(path, head)
    if head.startswith((b"MATLAB 7.3", _HDF5_MARK)):
        return _reader("hdf5_arrays", "open_hdf5")(path, is_matlab=head.startswith(b"MATLAB"))
    if head.startswith(_PARQUET_MARK):
        return _reader("parquet_arrays", "open_parquet")(path, episode)
    if suffix == ".mat":
        return _reader("matlab_arrays", "open_matlab")(path)
    if suffix == ".npz":
        return _reader("numpy_arrays", "open_npz")(path)
    return _reader("text_frames", "open_text_frames")(path)


def _refuse_other(path: Path, head: bytes) -> None:
    """Raise InputError: a file is not what its name says, or is neither a container nor text."""
    suffix = path.suffix.lower()
    kind, marks = _MARKS_OF_SUFFIX.get(suffix, ("", ()))
    if head.startswith(b"PARE"):
        raise InputError(f"{path}: is encrypted; write it again without encryption.")
    if kind and not head.startswith((*marks, *_ANY_MARKS)):
        raise InputError(f"{path}: does not begin as {kind}; it is damaged, cut off or another kind of file: save it again.")
    is_text = not head.startswith((_ZIP_MARK, _OLE_MARK)) and b"\0" not in head
    if not is_text and not head.startswith(_ANY_MARKS) and suffix not in (".mat", ".npz"):
        raise InputError(
            f"{path}: is none of the files with arrays that are read: .npz, .npy, .h5, .mat, .parquet, a LeRobot folder, or "
            "text with one matrix a frame."
        )
