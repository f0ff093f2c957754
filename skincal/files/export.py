"""Write a calibration in one of four formats, and say what is wrong with it and what it leaves out.

CSV (a row for each channel and method) and PLY (a point cloud for MeshLab, CloudCompare and ParaView) are made here; `icub.py`
and `json_file.py` make the other two. A fault that `lint.py` finds is reported and does not stop the writing.
"""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from skincal.files.atomic import write_atomically
from skincal.files.calibration import Calibration, placed_taxels
from skincal.files.icub import SKIN_PARTS, icub_text, parse_icub, skin_part
from skincal.files.json_file import json_text
from skincal.files.lint import LintReference, lint
from skincal.geometry.arrays import FloatArray
from skincal.mesh.lay import LaidSkin, lay
from skincal.mesh.load import Finding, load_surface
from skincal.mesh.search import nearest_points
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.scene import SurfaceSpec
from skincal.sentences import correction_words
from skincal.taxels.result import Estimate, Method, State

COLUMNS = ("channel", "module", "method", "state", "contacts", "x_m", "y_m", "z_m", "nx", "ny", "nz", "sd_mm")


def csv_text(calibration: Calibration) -> str:
    """Return the CSV text of every method; what is not known is left empty.

    Positions are metres in the link frame, `sd_mm` is the predicted sd along the weakest direction, millimetres. Numbers
    have every digit that a double needs.
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for estimates in calibration.estimates.values():
        for estimate in estimates:
            writer.writerow(_csv_row(calibration, estimate))
    return out.getvalue()


def _csv_row(calibration: Calibration, estimate: Estimate) -> list[str]:
    module = calibration.module_id(estimate.channel)
    sd = None if estimate.sd is None or estimate.position is None else estimate.sd * 1e3
    return [
        str(estimate.channel),
        "" if module is None else str(module),
        estimate.method.value,
        estimate.state.value,
        str(estimate.contacts),
        *_vector(estimate.position),
        *_vector(estimate.normal if estimate.position is not None else None),
        _number(sd),
    ]


def _vector(vector: FloatArray | None) -> list[str]:
    return ["", "", ""] if vector is None else [_number(value) for value in vector.tolist()]


def _number(value: float | None) -> str:
    return "" if value is None or not math.isfinite(value) else repr(float(value))


METHOD_CODE = {Method.FREE: 0, Method.SURFACE: 1, Method.MODULES: 2}
"""Of the property `method`: PLY has no text properties."""


def ply_text(calibration: Calibration, method: Method) -> str:
    """Return ASCII PLY: one vertex a taxel with a position, metres, link frame.

    Properties: `x y z`, unit normal `nx ny nz` (0 0 0 where unknown), `channel`, `method` (0 free, 1 surface, 2 modules),
    `sd_mm` (-1 where it is not determined).
    """
    taxels = placed_taxels(calibration.of(method))
    header = [
        "ply",
        "format ascii 1.0",
        f"comment skincal {calibration.version}, {method.value} method, metres, frame {_one_line(calibration.scene.link)}",
        "comment method 0 is free, 1 is surface, 2 is modules; sd_mm -1 is not determined; normal 0 0 0 is not known",
        *(f"comment {correction_words(used)}" for used in calibration.corrections),
        f"element vertex {len(taxels.channels)}",
        *(f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")),
        "property int channel",
        "property uchar method",
        "property float sd_mm",
        "end_header",
    ]
    rows = [
        f"{_ply_row(position)} {_ply_row(normal)} {channel} {METHOD_CODE[method]} {sd * 1e3 if math.isfinite(sd) else -1.0:.6g}"
        for channel, position, normal, sd in zip(
            taxels.channels.tolist(), taxels.positions.tolist(), taxels.normals.tolist(), taxels.sd.tolist(), strict=True
        )
    ]
    return "\n".join([*header, *rows]) + "\n"


def _ply_row(vector: list[float]) -> str:
    return " ".join(f"{value:.9g}" for value in vector)


def _one_line(text: str) -> str:
    return " ".join(text.split())


FORMATS = ("icub", "json", "csv", "ply")


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """What the scene says about the part's shape."""

    surface: Surface | None
    # The layout as planned, where there is no surface.
    laid: LaidSkin | None
    # Sentences on the mesh itself.
    findings: tuple[str, ...] = ()
    # Why a check could not be done, or says little.
    troubles: tuple[str, ...] = ()


def write_calibration(
    calibration: Calibration,
    format: str,  # noqa: A002 - as the command's option
    path: Path,
    method: Method,
    part: str | None = None,
) -> tuple[str, ...]:
    """Write a calibration file; an older one is kept with `.bak` after its name.

    Parameters
    ----------
    format : `"icub"` and `"ply"` hold `method` alone, `"json"` and `"csv"` every method
    part : name of the skin part for the iCub file; see `skincal.files.icub.skin_part`

    Returns
    -------
    Sentences: faults found (`skincal.files.lint`) and what is left out. They do not stop the writing.

    Raises
    ------
    InputError
        The format or method is unknown, or the file cannot be written.
    """
    if format not in FORMATS:
        raise InputError(f"the format is {format!r}; expected one of {', '.join(FORMATS)}.")
    # Refuses a method without estimates before the mesh is loaded.
    calibration.of(method)
    shape = _part(calibration)
    text = _text(calibration, format, method, part, shape)
    methods = (method,) if format in ("icub", "ply") else tuple(calibration.estimates)
    sentences = [*(f"{correction_words(used)}." for used in calibration.corrections), *shape.troubles]
    for each in methods:
        sentences += lint(calibration, each, _reference(calibration, each, shape))
        sentences += _left_out(calibration.of(each), each, format)
    if format == "icub":
        sentences += [*_icub_traps(calibration, method, part), *_read_back(calibration, method, text)]
    write_atomically(path, text.encode("utf-8"))
    return tuple(sentences)


def _text(calibration: Calibration, format_: str, method: Method, part: str | None, shape: _Part) -> str:
    if format_ == "icub":
        return icub_text(calibration, method, part)
    if format_ == "json":
        return json_text(calibration, shape.findings)
    if format_ == "csv":
        return csv_text(calibration)
    return ply_text(calibration, method)


def _part(calibration: Calibration) -> _Part:
    """Load the part's shape; a missing mesh must not keep a calibration from being written."""
    scene = calibration.scene
    try:
        if scene.surface is None:
            laid = None if scene.skin.layout is None else lay(scene.skin.layout, scene.skin.anchor, None)
            return _Part(None, laid)
        surface, found = _load(scene.surface, _changed_ns(scene.surface.path))
    except InputError as error:
        return _Part(None, None, troubles=(f"the positions were not compared with the part's shape: {error}",))
    same = surface.sha256 == calibration.mesh_sha256
    trouble = f"{scene.surface.path}: the mesh changed since the estimates were computed; solve again."
    return _Part(surface, None, tuple(finding.sentence for finding in found), () if same else (trouble,))


@lru_cache(maxsize=1)
def _load(spec: SurfaceSpec, _version: int) -> tuple[Surface, tuple[Finding, ...]]:
    """Load a mesh once for the files of one calibration, which are written one after another."""
    return load_surface(spec)


def _changed_ns(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        # `load_surface` says what is wrong with it.
        return 0


def _reference(calibration: Calibration, method: Method, shape: _Part) -> LintReference | None:
    """Return where the skin should be: the surface, or else the layout as planned."""
    taxels = placed_taxels(calibration.of(method))
    finite = np.isfinite(taxels.positions).all(axis=1)
    if shape.surface is not None:
        normals = np.zeros((len(taxels.channels), 3))
        if finite.any():
            _, triangles = nearest_points(shape.surface, taxels.positions[finite])
            normals[finite] = shape.surface.normals[triangles]
        return LintReference(shape.surface.vertices, normals, "the surface")
    if shape.laid is None:
        return None
    places: FloatArray = shape.laid.places
    known = np.isfinite(places).all(axis=1)
    if not known.any():
        return None
    return LintReference(places[known], np.nan_to_num(shape.laid.normals[taxels.channels]), "the layout as planned")


def _left_out(estimates: tuple[Estimate, ...], method: Method, format_: str) -> list[str]:
    without = [estimate.state for estimate in estimates if estimate.position is None]
    if not without:
        return []
    counts = Counter(without)
    states = ", ".join(f"{counts[state]} {state.value}" for state in State if counts[state])
    how = {
        "icub": "rows of six zeros, which readers take as no position",
        "json": "written without a position",
        "csv": "written with an empty position",
        "ply": "left out",
    }[format_]
    return [f"{method.value}: {len(without)} of {len(estimates)} taxels have no position ({states}): {how}."]


def _icub_traps(calibration: Calibration, method: Method, part: str | None) -> list[str]:
    """Return what the robot's own readers would trip on; see `skincal.files.icub`."""
    sentences: list[str] = []
    last = calibration.scene.skin.channels - 1
    if any(estimate.channel == last and estimate.position is not None for estimate in calibration.of(method)):
        sentences.append(
            f"channel {last} is the last row and has a position: the skinPart reader of icub-main drops the last row; "
            "skinManager reads it."
        )
    name = skin_part(calibration, part)
    if name not in SKIN_PARTS:
        sentences.append(
            f"the part is named {name!r}, which no program of the robot knows; expected one of {', '.join(SKIN_PARTS)}: "
            "begin the scene's link name with it."
        )
    return sentences


def _read_back(calibration: Calibration, method: Method, text: str) -> list[str]:
    """Return what a reader finds in the text that was meant otherwise."""
    file = parse_icub(text, "the file as written")
    taxels = placed_taxels(calibration.of(method))
    placed = set(np.flatnonzero(file.positions.any(axis=1)).tolist())
    lost = set(taxels.channels.tolist()) - placed
    return [f"the file as written has no position for channel {channel}." for channel in sorted(lost)]
