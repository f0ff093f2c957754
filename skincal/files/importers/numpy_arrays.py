"""Arrays of numpy: an archive of `numpy.savez`, or a folder with files of `numpy.save`.

Arrays of Python objects stay closed.
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from skincal.files.importers.array_file import AnyArray, ArrayFile, NamedArray, one_line
from skincal.model.errors import InputError
from skincal.model.given import open_regular

_NPY_ERRORS = (ValueError, OSError, EOFError, zipfile.BadZipFile, zlib.error, RuntimeError, SyntaxError)
OBJECTS_TROUBLE = (
    "holds Python objects, which are pickle and run code while they are read: save a plain array of numbers, such as "
    "numpy.stack(list)"
)


def open_npz(path: Path) -> ArrayFile:
    """List the arrays of an archive. Raises InputError: it is damaged, or encrypted."""
    arrays: dict[str, NamedArray] = {}
    with open_regular(path) as file:
        try:
            with zipfile.ZipFile(file) as archive:
                for each in archive.infolist():
                    if each.flag_bits & 1:
                        raise InputError(f"{path}: is encrypted; write it again without a password.")
                    if each.filename.endswith(".npy"):
                        with archive.open(each) as inner:
                            read = partial(_read_member, path, each.filename)
                            arrays |= _arrays_of(each.filename[: -len(".npy")], inner, read)
        except _NPY_ERRORS as error:
            raise InputError(
                f"{path}: is no archive of numpy.savez, or is cut off ({one_line(error)}); save it again."
            ) from None
    return ArrayFile(path, "an archive of numpy.savez", arrays)


def open_npy_folder(folder: Path) -> ArrayFile:
    """List the arrays in the `.npy` files of a folder. Raises InputError: there is none, or one is damaged."""
    arrays: dict[str, NamedArray] = {}
    for path in sorted(folder.glob("*.npy")):
        with open_regular(path) as file:
            try:
                arrays |= _arrays_of(path.stem, file, partial(_read_file, path))
            except _NPY_ERRORS as error:
                raise InputError(
                    f"{path}: is no file of numpy.save, or is cut off ({one_line(error)}); save it again."
                ) from None
    if not arrays:
        raise InputError(f"{folder}: holds no .npy file and no {'meta/info.json'} of LeRobot; name the file with the arrays.")
    return ArrayFile(folder, "a folder of numpy.save", arrays)


def _arrays_of(name: str, file: IO[bytes], read: Any) -> dict[str, NamedArray]:
    """Describe the array of a file by its header, or each field of a record array."""
    version = npy.read_magic(file)
    reader = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, dtype = reader(file)
    return {each.name: each for each in _fields(name, shape, dtype, read)}


def _fields(name: str, shape: tuple[int, ...], dtype: np.dtype[Any], read: Any) -> Iterator[NamedArray]:
    trouble = OBJECTS_TROUBLE if dtype.hasobject else ""
    if dtype.names is None or trouble:
        yield NamedArray(name, shape, dtype.kind, partial(read, ""), trouble=trouble, item_bytes=dtype.itemsize)
        return
    for key in dtype.names:
        inner = dtype[key]
        kind, size = (inner.base.kind, inner.base.itemsize) if inner.names is None else ("V", inner.itemsize)
        yield NamedArray(f"{name}.{key}", (*shape, *inner.shape), kind, partial(read, key), item_bytes=size)


def _read_member(path: Path, member: str, key: str) -> AnyArray:
    with open_regular(path) as file, zipfile.ZipFile(file) as archive, archive.open(member) as inner:
        values: AnyArray = npy.read_array(inner, allow_pickle=False)
    return values[key] if key else values


def _read_file(path: Path, key: str) -> AnyArray:
    with open_regular(path) as file:
        values: AnyArray = npy.read_array(file, allow_pickle=False)
    return values[key] if key else values
