"""Arrays of an HDF5 file, read by `h5py`: plain data sets, MATLAB's version 7.3, and tables of pandas.

MATLAB stores its axes in reverse order, structs as groups, and cells as references to data sets below `#refs#`. pandas stores a
table as blocks of columns; with `format="table"` the names of the columns are pickle, which stays closed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from skincal.files.importers.array_file import (
    MAX_ARRAYS,
    READ_ERRORS,
    AnyArray,
    ArrayFile,
    NamedArray,
    needs_package,
    one_line,
)
from skincal.files.importers.matlab_arrays import OBJECT_TROUBLE
from skincal.model.errors import InputError
from skincal.model.given import open_regular

GROUP_MAX_DEPTH = 8
_UNIT_ATTRIBUTES = ("units", "unit")
_FRAME_ATTRIBUTES = ("frame_id", "frame")
_LABEL_ATTRIBUTES = ("names", "columns", "labels", "axes", "channels", "joint_names")
_RATE_ATTRIBUTES = ("rate", "fps", "sampling_rate", "sample_rate", "sampling_frequency", "fs", "rate_hz", "frequency")
_MATLAB_NUMBERS = frozenset(
    ("double", "single", "logical", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
)


def open_hdf5(path: Path, *, is_matlab: bool) -> ArrayFile:
    """List the arrays of an HDF5 file. Raises InputError: it is damaged, or `h5py` is missing."""
    with open_regular(path):
        pass
    try:
        import h5py  # pyright: ignore[reportMissingTypeStubs]
    except ImportError:
        raise needs_package("HDF5 files (.h5, MATLAB 7.3) are", "h5py", "hdf5") from None
    rate = None
    try:
        with h5py.File(path, "r") as file:
            found: dict[str, NamedArray] = {}
            for each in _walk(path, file, "", GROUP_MAX_DEPTH, set(), is_matlab=is_matlab):
                found[each.name] = each
                if len(found) > MAX_ARRAYS:
                    break
            rate = _rate_of(file)
    except READ_ERRORS as error:
        raise InputError(f"{path}: is no HDF5 file, or is cut off ({one_line(error)}); save it again.") from None
    if is_matlab:
        return ArrayFile(path, "a MATLAB file, version 7.3", found, rate, first_index=1)
    return ArrayFile(path, "an HDF5 file", found, rate)


def _walk(path: Path, group: Any, prefix: str, depth: int, seen: set[int], *, is_matlab: bool) -> Iterator[NamedArray]:
    """Describe the arrays of a group and of those in it. A group counts once: links may lead back."""
    import h5py  # pyright: ignore[reportMissingTypeStubs]

    h5: Any = h5py
    address: int = h5.h5o.get_info(group.id).addr
    if address in seen:
        return
    seen.add(address)
    if _text(group.attrs.get("pandas_type")):
        yield from _pandas_columns(path, group, prefix)
        return
    separator = "." if is_matlab else "/"
    for key in group:
        if key in ("#refs#", "#subsystem#") or not isinstance(group.get(key, getlink=True), h5.HardLink):
            continue
        value, name = group[key], f"{prefix}{key}"
        if isinstance(value, h5.Group):
            if "MATLAB_object_decode" in value.attrs:
                yield NamedArray(name, (), "", lambda: np.empty(()), trouble=OBJECT_TROUBLE)
            elif depth:
                yield from _walk(path, value, f"{name}{separator}", depth - 1, seen, is_matlab=is_matlab)
        elif isinstance(value, h5.Dataset):
            yield from _arrays_of(path, value, name, is_matlab=is_matlab)


def _arrays_of(path: Path, data: Any, name: str, *, is_matlab: bool) -> Iterator[NamedArray]:
    place, dtype = str(data.name), data.dtype
    shape: tuple[int, ...] = tuple(data.shape or ())
    facts: dict[str, Any] = {
        "unit": _attribute(data, _UNIT_ATTRIBUTES), "frame": _attribute(data, _FRAME_ATTRIBUTES), "labels": _labels(data),
        "item_bytes": dtype.itemsize,
    }  # fmt: skip
    if is_matlab:
        yield _matlab_array(path, data, name, facts)
    elif dtype.names is not None:
        for key in dtype.names:
            inner = dtype[key]
            yield NamedArray(f"{name}/{key}", (*shape, *inner.shape), inner.base.kind, partial(_read, path, place, key))
    elif dtype.kind == "O":
        yield NamedArray(name, shape, "", partial(_read, path, place, ""), trouble="holds texts or rows of unequal length")
    else:
        yield NamedArray(name, shape, dtype.kind, partial(_read, path, place, ""), **facts)


def _matlab_array(path: Path, data: Any, name: str, facts: dict[str, Any]) -> NamedArray:
    """Describe a variable of MATLAB, with its axes in MATLAB's order, and without those of length 1."""
    place, shape = str(data.name), tuple(size for size in reversed(data.shape) if size != 1)
    matlab_class = _text(data.attrs.get("MATLAB_class"))
    if "MATLAB_empty" in data.attrs:
        return NamedArray(name, (0,), "f", lambda: np.empty(0))
    if "MATLAB_object_decode" in data.attrs:
        return NamedArray(name, (), "", lambda: np.empty(()), trouble=OBJECT_TROUBLE)
    if matlab_class == "cell":
        first = data.file[data[(0,) * data.ndim]]
        if len(shape) == 1 and isinstance(first.dtype.kind, str) and first.dtype.kind in "iufb":
            inner = tuple(size for size in reversed(first.shape) if size != 1)
            return NamedArray(name, (*shape, *inner), first.dtype.kind, partial(_read_cells, path, place))
        return NamedArray(name, shape, "", lambda: np.empty(()), trouble="is a cell array: save a matrix, such as cat(1, C{:})")
    if data.dtype.kind == "O":
        trouble = "is an array of structs: save each field as a matrix"
        return NamedArray(name, shape, "", lambda: np.empty(()), trouble=trouble)
    is_number = not matlab_class or matlab_class in _MATLAB_NUMBERS
    return NamedArray(name, shape, data.dtype.kind if is_number else "U", partial(_read_matlab, path, place), **facts)


def _read(path: Path, place: str, key: str) -> AnyArray:
    import h5py  # pyright: ignore[reportMissingTypeStubs]

    with h5py.File(path, "r") as file:
        data: Any = file[place]
        return np.asarray(data[key] if key else data[()])


def _read_matlab(path: Path, place: str) -> AnyArray:
    values = _read(path, place, "")
    return np.squeeze(values.transpose())


def _read_cells(path: Path, place: str) -> AnyArray:
    import h5py  # pyright: ignore[reportMissingTypeStubs]

    with h5py.File(path, "r") as file:
        data: Any = file[place]
        references = np.asarray(data[()]).transpose().ravel()
        return np.stack([np.squeeze(np.asarray(file[each][()]).transpose()) for each in references])  # pyright: ignore[reportIndexIssue]


# ------------------------------------------------------------------ pandas


def _pandas_columns(path: Path, group: Any, prefix: str) -> Iterator[NamedArray]:
    """Describe the columns of a table that pandas wrote (`to_hdf`)."""
    name = prefix.rstrip("/")
    if "table" in group:
        trouble = (
            "is a table of pandas whose column names are pickle, which runs code while it is read: write it again with "
            'to_hdf(..., format="fixed"), to_parquet or to_csv'
        )
        yield NamedArray(name, (), "", lambda: np.empty(()), trouble=trouble)
        return
    if "axis1" not in group or "axis0" not in group:
        yield NamedArray(name, (), "", lambda: np.empty(()), trouble="is a table of pandas with several levels: use to_parquet")
        return
    axis = group["axis1"]
    kind = "M" if _text(axis.attrs.get("kind")).startswith("datetime") else axis.dtype.kind
    index = _text(axis.attrs.get("name"))
    index_name = "index" if index in ("", "N.") else index
    yield NamedArray(f"{prefix}{index_name}", tuple(axis.shape), kind, partial(_read_index, path, str(axis.name)))
    number = 0
    while f"block{number}_values" in group:
        values, items = group[f"block{number}_values"], group[f"block{number}_items"]
        words = [each.decode(errors="replace") if isinstance(each, bytes) else str(each) for each in np.asarray(items).ravel()]
        for column, word in enumerate(words):
            read = partial(_read_block, path, str(values.name), column)
            yield NamedArray(f"{prefix}{word}", (int(values.shape[0]),), values.dtype.kind, read)
        number += 1


def _read_index(path: Path, place: str) -> AnyArray:
    import h5py  # pyright: ignore[reportMissingTypeStubs]

    with h5py.File(path, "r") as file:
        axis: Any = file[place]
        kind = _text(axis.attrs.get("kind"))
        if not kind.startswith("datetime"):
            return np.asarray(axis[()])
        unit = kind[len("datetime64[") : -1] if "[" in kind else "ns"
        return np.asarray(axis[()]).astype(np.int64).astype(f"M8[{unit.partition(',')[0]}]")


def _read_block(path: Path, place: str, column: int) -> AnyArray:
    import h5py  # pyright: ignore[reportMissingTypeStubs]

    with h5py.File(path, "r") as file:
        data: Any = file[place]
        return np.asarray(data[:, column])


# ------------------------------------------------------------------ attributes


def _text(value: Any) -> str:
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    return value if isinstance(value, str) else ""


def _attribute(data: Any, names: Sequence[str]) -> str:
    return next((text for name in names if (text := _text(data.attrs.get(name)))), "")


def _labels(data: Any) -> tuple[str, ...]:
    """Read the names of the values of a row from an attribute; empty without."""
    for name in _LABEL_ATTRIBUTES:
        words = data.attrs.get(name)
        if isinstance(words, np.ndarray) and words.ndim == 1:
            return tuple(each.decode(errors="replace") if isinstance(each, bytes) else str(each) for each in words)
    return ()


def _rate_of(file: Any) -> float | None:
    """Read the rate of the rows from an attribute of the file; `None` without."""
    for name in _RATE_ATTRIBUTES:
        with suppress(TypeError, ValueError, KeyError):
            rate = float(np.asarray(file.attrs[name]).item())
            return rate if np.isfinite(rate) and rate > 0 else None
    return None
