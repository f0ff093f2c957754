"""Arrays of a Parquet file, read by `pyarrow`: each column is an array. A folder of LeRobot is many such files and their facts.

LeRobot (Hugging Face): `meta/info.json` has the frames a second (`fps`) and, for each feature, its type, shape and the names of
its values; `data/chunk-*/` has `file-*.parquet` (version 3) or `episode_*.parquet` (version 2). `timestamp` begins at 0 in
each episode. Images and videos are features, too.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from skincal.files.importers.array_file import (
    LEROBOT_INFO,
    READ_ERRORS,
    AnyArray,
    ArrayFile,
    NamedArray,
    needs_package,
    one_line,
)
from skincal.model.errors import InputError, plural
from skincal.model.given import MAX_JSON_BYTES, open_regular, parse_json, read_regular

EPISODE_GAP_S = 5.0
"""Between the last row of an episode and the first of the next one: no poke reaches across, and the sensor is tared again."""
EPISODE_COLUMN, TIME_COLUMN = "episode_index", "timestamp"
IMAGE_SENTENCE = "holds images of a camera: pixels are no taxels, and a tactile camera has no place for each; it is not read"
_LEVEL_RE = re.compile(r"'([^']*)'|(\d+)")
_LEVELS_RE = re.compile(r"\((?:'[^']*'|\d+)(?:, (?:'[^']*'|\d+))+\)")
"""Name of a column with several levels, as pandas writes it."""


def open_parquet(path: Path, episode: int | None = None) -> ArrayFile:
    """List the columns of a Parquet file. Raises InputError: it is damaged or encrypted, or `pyarrow` is missing."""
    # A file of a LeRobot data set has its facts two folders above.
    info = path.resolve().parent.parent.parent / LEROBOT_INFO
    if info.is_file():
        return _with_lerobot_facts(_open_files(path, [path]), info, episode)
    return _open_files(path, [path])


def open_lerobot(folder: Path, episode: int | None = None) -> ArrayFile:
    """List the features of a LeRobot data set.

    Raises InputError: it has no data, it is damaged, or `pyarrow` is missing.
    """
    paths = sorted(folder.glob("data/*/*.parquet")) or sorted(folder.glob("data/*.parquet"))
    if not paths:
        raise InputError(f"{folder}: has {LEROBOT_INFO} of LeRobot and no data/chunk-*/*.parquet; copy the whole data set.")
    return _with_lerobot_facts(_open_files(folder, paths), folder / LEROBOT_INFO, episode)


def _parquet(what: str) -> Any:
    try:
        import pyarrow.parquet  # pyright: ignore[reportMissingImports, reportMissingTypeStubs]
    except ImportError:
        raise needs_package(f"{what} are", "pyarrow", "parquet") from None
    return pyarrow.parquet


def _open_files(path: Path, paths: Sequence[Path]) -> ArrayFile:
    parquet = _parquet("Parquet files")
    rows, schema = 0, None
    for each in paths:
        with open_regular(each):
            pass
        try:
            file = parquet.ParquetFile(each)
            rows += file.metadata.num_rows
            schema = schema or file.schema_arrow
            file.close()
        except READ_ERRORS as error:
            why = one_line(error)
            advice = "write it again without encryption" if "ncrypt" in why else "write it again"
            raise InputError(f"{each}: is no Parquet file, is cut off or encrypted ({why}); {advice}.") from None
    arrays: dict[str, NamedArray] = {}
    for name, kind in _leaves(schema or (), ""):
        column = _column(paths, name, kind, rows)
        arrays[column.name] = column
    return ArrayFile(path, "a Parquet file", arrays)


def plain_name(name: str) -> str:
    """Write the name of a column with several levels, `('skin', '3')`, as `skin/3`."""
    return "/".join(quoted or digits for quoted, digits in _LEVEL_RE.findall(name)) if _LEVELS_RE.fullmatch(name) else name


def _leaves(fields: Iterable[Any], prefix: str) -> Iterator[tuple[str, Any]]:
    """Yield name and type of each column; a struct has several."""
    for field in fields:
        name = f"{prefix}{field.name}"
        if type(field.type).__name__ == "StructType":
            yield from _leaves(list(field.type), f"{name}.")
        else:
            yield name, field.type


def _column(paths: Sequence[Path], name: str, kind: Any, rows: int) -> NamedArray:
    """Describe a column. Lists must have one length, which the first row tells."""
    inner, is_list = kind, False
    while hasattr(inner, "value_type") and "List" in type(inner).__name__:
        inner, is_list = inner.value_type, True
    shown, read = plain_name(name), partial(_read_column, tuple(paths), name)
    try:
        dtype = np.dtype(inner.to_pandas_dtype())
        shape = _first_shape(paths[0], name) if is_list and rows else ()
    except (*READ_ERRORS, NotImplementedError):
        return NamedArray(shown, (rows,), "", read, trouble="has rows of unequal length, or of a type that is not known")
    if dtype.kind not in "iufbmM":
        return NamedArray(shown, (rows,), "", read, trouble="holds texts or bytes, and no numbers")
    return NamedArray(shown, (rows, *shape), dtype.kind, read, item_bytes=dtype.itemsize)


def _flat_column(table: Any, name: str) -> Any:
    """Find a column of a table, also within structs."""
    while name not in table.column_names:
        flat = table.flatten()
        if flat.column_names == table.column_names:
            raise KeyError(name)
        table = flat
    return table.column(name)


def _root(name: str, file: Any) -> str:
    """Name of the column in the file that holds a column of a struct."""
    known = file.schema_arrow.names
    return name if name in known else next(each for each in known if name.startswith(f"{each}."))


def _first_shape(path: Path, name: str) -> tuple[int, ...]:
    """Read the shape of the first row of a column of lists that is not missing."""
    import pyarrow as pa  # pyright: ignore[reportMissingImports, reportMissingTypeStubs]

    arrow: Any = pa
    with _parquet("Parquet files").ParquetFile(path) as file:
        for batch in file.iter_batches(1024, columns=[_root(name, file)]):
            column = _flat_column(arrow.Table.from_batches([batch]), name).drop_null()
            if len(column):
                return np.shape(column.slice(0, 1).to_pylist()[0])
    return (0,)


def _read_column(paths: Sequence[Path], name: str) -> AnyArray:
    """Read a column of all files; a missing row is NaN. Raises ValueError: its lists differ in length."""
    found: list[AnyArray] = []
    shape = None
    for path in paths:
        with _parquet("Parquet files").ParquetFile(path) as file:
            column = _flat_column(file.read(columns=[_root(name, file)]), name)
        for chunk in column.chunks:
            if "List" not in type(chunk.type).__name__:
                found.append(np.asarray(chunk.to_numpy(zero_copy_only=False)))
                continue
            shape = _first_shape(paths[0], name) if shape is None else shape
            found.append(_stacked(chunk, shape))
    return np.concatenate(found) if found else np.empty(0)


def _stacked(chunk: Any, shape: tuple[int, ...]) -> AnyArray:
    """Make lists of one shape an array, (rows, *shape). Raises ValueError: a list has another length."""
    present = np.asarray(chunk.is_valid().to_numpy(zero_copy_only=False), bool)
    values, rows = chunk.drop_null(), int(present.sum())
    for size in shape:
        lengths = np.asarray(values.value_lengths().to_numpy(zero_copy_only=False))
        if (lengths != size).any():
            raise ValueError(f"its lists have {int(lengths.min())} to {int(lengths.max())} values")
        values = values.flatten()
    flat = np.asarray(values.to_numpy(zero_copy_only=False)).reshape(rows, *shape)
    if present.all():
        return flat
    whole = np.full((len(present), *shape), np.nan)
    whole[present] = flat
    return whole


# ------------------------------------------------------------------ LeRobot


def _with_lerobot_facts(file: ArrayFile, info: Path, episode: int | None) -> ArrayFile:
    """Add names and rate from the facts of a data set, and select an episode."""
    try:
        facts: Any = parse_json(read_regular(info, MAX_JSON_BYTES))
        features: dict[str, Any] = dict(facts["features"])
        rate = float(facts["fps"])
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{info}: is no such file of LeRobot ({one_line(error)}); copy the whole data set.") from None
    arrays = dict(file.arrays)
    details: dict[str, str] = {}
    for name, feature in features.items():
        kind = str(feature.get("dtype", "")) if isinstance(feature, dict) else ""  # pyright: ignore[reportUnknownMemberType, reportUnknownArgumentType]
        if kind in ("video", "image"):
            details[name] = IMAGE_SENTENCE
            arrays.pop(name, None)
        elif name in arrays:
            arrays[name] = replace(arrays[name], labels=_labels(feature, arrays[name].shape[1:]))
    if TIME_COLUMN in arrays:
        arrays[TIME_COLUMN] = replace(arrays[TIME_COLUMN], unit="s")
    arrays = {name: each for name, each in arrays.items() if not any(name.startswith(f"{image}.") for image in details)}
    findings: list[str] = []
    if EPISODE_COLUMN in arrays and TIME_COLUMN in arrays:
        arrays, findings = _select_episode(file, arrays, episode)
    elif episode is not None:
        raise InputError(f"{file.path}: has no column {EPISODE_COLUMN}; leave out the episode.")
    return ArrayFile(file.path, "a LeRobot data set", arrays, rate, tuple(findings), details=details)


def _labels(feature: Any, shape: tuple[int, ...]) -> tuple[str, ...]:
    """Read the names of the values of a feature: a list, or a list below another name; empty without."""
    names: Any = feature.get("names") if isinstance(feature, dict) else None  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
    if isinstance(names, dict) and len(names) == 1:  # pyright: ignore[reportUnknownArgumentType]
        names = next(iter(names.values()))  # pyright: ignore[reportUnknownArgumentType, reportUnknownVariableType]
    words: list[Any] = list(names) if isinstance(names, list) else []  # pyright: ignore[reportUnknownArgumentType]
    return tuple(map(str, words)) if len(shape) == 1 and len(words) == shape[0] else ()


def _select_episode(
    file: ArrayFile, arrays: dict[str, NamedArray], episode: int | None
) -> tuple[dict[str, NamedArray], list[str]]:
    """Select the rows of an episode, or place all episodes one after another."""
    numbers = file.read(arrays[EPISODE_COLUMN]).ravel().astype(np.int64)
    times = file.read(arrays[TIME_COLUMN]).ravel().astype(np.float64)
    known = np.unique(numbers)
    if episode is not None:
        rows = np.flatnonzero(numbers == episode)
        if not len(rows):
            raise InputError(
                f"{file.path}: has no episode {episode}; it has {plural(len(known), 'episode')}, {known[0]} to {known[-1]}."
            )
        selected = {
            name: replace(each, shape=(len(rows), *each.shape[1:]), read=partial(_rows_of, each, rows))
            for name, each in arrays.items()
        }
        return selected, [f"episode {episode} of {len(known)}: {plural(len(rows), 'row')}."]
    if len(known) < 2:
        return arrays, []
    starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 1))
    shifted, end = times.copy(), 0.0
    for begin, after in zip(starts, [*starts[1:], len(times)], strict=True):
        shifted[begin:after] += end - times[begin]
        end = float(shifted[after - 1]) + EPISODE_GAP_S
    arrays[TIME_COLUMN] = replace(arrays[TIME_COLUMN], kind="f", read=lambda: shifted.reshape(arrays[TIME_COLUMN].shape))
    return arrays, [
        f"{len(starts)} episodes are placed one after another with {EPISODE_GAP_S:g} s between them; "
        "--episode N reads one, as does ?episode=N after the array."
    ]


def _rows_of(array: NamedArray, rows: AnyArray) -> AnyArray:
    return np.asarray(array.read())[rows]
