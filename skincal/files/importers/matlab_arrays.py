"""Arrays of a MATLAB file up to version 7, read by scipy. Structs give their fields, cells of equal matrices one array."""

from __future__ import annotations

import warnings
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from skincal.files.importers.array_file import READ_ERRORS, ArrayFile, NamedArray, one_line
from skincal.model.errors import InputError

STRUCT_MAX_DEPTH = 6
OBJECT_TROUBLE = (
    "is an object of MATLAB (table, timetable, timeseries, string), which only MATLAB reads: save its columns as matrices, "
    "such as s = table2struct(T, 'ToScalar', true); save('NEW.mat', '-struct', 's')"
)


def open_matlab(path: Path) -> ArrayFile:
    """List the arrays of a MATLAB file of version 4 to 7. Raises InputError: it is damaged, or no such file."""
    from scipy.io.matlab import MatReadError, loadmat  # pyright: ignore[reportUnknownVariableType, reportMissingTypeStubs]

    load: Callable[..., Any] = loadmat  # pyright: ignore[reportUnknownVariableType]

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            content: dict[str, Any] = load(path, squeeze_me=True)
    except (*READ_ERRORS, zlib.error, EOFError, NotImplementedError, MatReadError) as error:
        raise InputError(
            f"{path}: is no MATLAB file, or is cut off ({one_line(error)}); save it again in MATLAB: save('NEW.mat', '-v7')."
        ) from None
    arrays = {
        each.name: each
        for name, value in content.items()
        if not name.startswith("__")
        for each in _arrays_of(name, value, STRUCT_MAX_DEPTH)
    }
    if content.get("__function_workspace__") is not None and "None" in content:
        # MATLAB's objects have no name in the file.
        arrays.pop("None", None)
        arrays["a variable"] = NamedArray("a variable", (), "", lambda: np.empty(()), trouble=OBJECT_TROUBLE)
    return ArrayFile(path, "a MATLAB file", arrays, first_index=1)


def _arrays_of(name: str, value: Any, depth: int) -> Iterator[NamedArray]:
    """Describe a value, and the fields of a struct."""
    array = np.asarray(value)
    if type(value).__name__ in ("MatlabOpaque", "MatlabFunction") or (array.dtype.names and "s0" in array.dtype.names):
        yield NamedArray(name, array.shape, "", lambda: array, trouble=OBJECT_TROUBLE)
    elif array.dtype.names is not None:
        if array.ndim or not depth:
            yield NamedArray(
                name, array.shape, "", lambda: array, trouble="is an array of structs: save each field as a matrix"
            )
            return
        for key in array.dtype.names:
            yield from _arrays_of(f"{name}.{key}", array[key].item(), depth - 1)
    elif array.dtype.kind == "O":
        cells = [np.asarray(each) for each in array.ravel()]
        if array.ndim == 1 and cells and all(each.shape == cells[0].shape and each.dtype.kind in "iufb" for each in cells):
            frames = np.stack(cells)
            yield NamedArray(name, frames.shape, frames.dtype.kind, lambda: frames)
        else:
            trouble = "is a cell array of unequal values: save a matrix, such as cat(1, C{:})"
            yield NamedArray(name, array.shape, "", lambda: array, trouble=trouble)
    else:
        yield NamedArray(name, array.shape, array.dtype.kind, lambda: array, item_bytes=array.dtype.itemsize)
