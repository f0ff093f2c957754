"""Checks on a calibration before it is written; each exists because a published position file had that fault.

Sources: the history of icub-main `app/skinGui/conf/positions` (a typo of 10 cm in the torso 29cc1b07e, a mirrored
patch c89409d3a, swapped patches 60dcc37a5, a wrong column ab19cf6a9), and the statistics of the files themselves:
copies of a neighbour's position, normals of length 0.6 to 1, taxels missing in a module.

Write a calibration in one of four formats, and say what is wrong with it and what it leaves out.

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
from numpy.typing import NDArray

from skincal.files.atomic import write_atomically
from skincal.files.calibration import Calibration, PlacedTaxels, placed_taxels
from skincal.files.icub import ORIGIN_RADIUS, SKIN_PARTS, icub_text, parse_icub, skin_part
from skincal.files.json_file import json_text
from skincal.geometry import FloatArray, IntArray, cross_matrix
from skincal.mesh.lay import LaidSkin, lay
from skincal.mesh.load import Finding, load_surface
from skincal.mesh.search import nearest_points
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError, list_channels, plural
from skincal.model.scene import SurfaceSpec
from skincal.model.skin import Layout, Module
from skincal.sentences import correction_words
from skincal.taxels.result import Estimate, Method, State

BOX_MARGIN = 0.020
"""m. A taxel lies on the part: the paper's largest error is 19.4 mm, a typo is 100 mm."""
SAME_PLACE = 1e-6
"""m. Positions nearer than the file's last digit are one position."""
UNIT_TOLERANCE = 1e-6
"""A unit vector of doubles is unit to 1e-15; more than this was never normalised."""
CHIRALITY_TAXELS = 6
"""Least taxels of a module whose handedness is judged: three more than a plane fit uses up."""
CHIRALITY_RATIO = 0.6
"""The mirrored layout must fit this much better to say so; the paper's modules fit 2.1 mm straight, 10.4 mm mirrored."""
NEIGHBOUR_SPACINGS = 1.3
"""Taxels of one module within this many spacings are neighbours: 1.0 apart, the next ring is 1.7."""
SPACING_RATIOS = (0.7, 1.4)
"""Median distance of neighbours over that of the layout: 4 to 6 mm for 5 mm, and room for scatter, which widens it."""


@dataclass(frozen=True, slots=True, eq=False)
class LintReference:
    """Where the skin should be, as far as it is known otherwise."""

    points: FloatArray
    """(n, 3) float, metres: the surface's vertices, or the places as planned."""
    normals: FloatArray | None
    """(taxels, 3) float, unit, outward: for each placed taxel that of the nearest place; None where unknown."""
    what: str
    """Such as `"the surface"`."""


def lint(calibration: Calibration, method: Method, reference: LintReference | None = None) -> tuple[str, ...]:
    """Return one sentence for each fault of one method's positions; none if it is fit to be loaded."""
    taxels = placed_taxels(calibration.of(method))
    name = method.value
    if not len(taxels.channels):
        return (f"{name}: no taxel has a position; poke some more before you load such a file.",)
    finite = np.asarray(np.isfinite(np.hstack([taxels.positions, taxels.normals])).all(axis=1))
    sentences = _bad_numbers(taxels, finite)
    good = PlacedTaxels(taxels.channels[finite], taxels.positions[finite], taxels.normals[finite], taxels.sd[finite])
    sentences += [*_at_origin(good), *_same_place(good), *_normal_lengths(good)]
    if reference is not None:
        sentences += _outside(good, reference)
        if reference.normals is not None:
            sentences += _inward(good, reference.normals[finite], reference.what)
    layout = calibration.scene.skin.layout
    if layout is not None:
        sentences += [
            *_wrong_channels(good, layout),
            *_mirrored(good, layout),
            *_spacing(good, layout),
            *_centres(good, layout),
        ]
    return tuple(f"{name}: {sentence}" for sentence in sentences)


def _bad_numbers(taxels: PlacedTaxels, finite: NDArray[np.bool_]) -> list[str]:
    bad = taxels.channels[~finite]
    return [f"NaN or infinite position or normal: channels {list_channels(bad)}."] if len(bad) else []


def _at_origin(taxels: PlacedTaxels) -> list[str]:
    zero = taxels.channels[np.abs(taxels.positions).max(axis=1, initial=0.0) <= ORIGIN_RADIUS]
    return [f"at 0 0 0, which readers take as no taxel: channels {list_channels(zero)}."] if len(zero) else []


def _same_place(taxels: PlacedTaxels) -> list[str]:
    # Neighbouring cells are not compared: copies agree in every digit.
    cells = np.round(taxels.positions / SAME_PLACE).astype(np.int64)
    _, group, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    shared = taxels.channels[count[group.ravel()] > 1]
    if not len(shared):
        return []
    return [f"the same position for several taxels, so at most one is right: channels {list_channels(shared)}."]


def _normal_lengths(taxels: PlacedTaxels) -> list[str]:
    lengths = np.linalg.norm(taxels.normals, axis=1)
    off = taxels.channels[(lengths > 0) & (np.abs(lengths - 1.0) > UNIT_TOLERANCE)]
    without = taxels.channels[lengths == 0]
    sentences = [f"a normal that is not unit: channels {list_channels(off)}."] if len(off) else []
    if len(without):
        sentences.append(f"no normal, written as 0 0 0: channels {list_channels(without)}.")
    return sentences


def _outside(taxels: PlacedTaxels, reference: LintReference) -> list[str]:
    low, high = reference.points.min(axis=0) - BOX_MARGIN, reference.points.max(axis=0) + BOX_MARGIN
    beyond = np.maximum(low - taxels.positions, taxels.positions - high).max(axis=1)
    out = beyond > 0
    if not out.any():
        return []
    return [
        f"more than {BOX_MARGIN * 1e3:.0f} mm outside the box of {reference.what}, by up to "
        f"{beyond.max() * 1e3:.0f} mm more: channels {list_channels(taxels.channels[out])}; check units, frame and arm pose."
    ]


def _inward(taxels: PlacedTaxels, outward: FloatArray, what: str) -> list[str]:
    inward = taxels.channels[np.sum(taxels.normals * outward, axis=1) < 0]
    if not len(inward):
        return []
    return [f"a normal that points into the part, against {what}: channels {list_channels(inward)}; check the wrench's sign."]


def _wrong_channels(taxels: PlacedTaxels, layout: Layout) -> list[str]:
    wrong = np.setdiff1d(taxels.channels, layout.channels)
    return [f"a position where the layout has no taxel: channels {list_channels(wrong)}."] if len(wrong) else []


def _pads_of(module: Module, taxels: PlacedTaxels) -> tuple[IntArray, IntArray]:
    """Return the indices of a module's placed taxels among its channels, and among the placed."""
    _, own, placed = np.intersect1d(module.channels, taxels.channels, return_indices=True)
    return own, placed


def _mirrored(taxels: PlacedTaxels, layout: Layout) -> list[str]:
    mirrored: list[int] = []
    for module in layout.modules:
        own, placed = _pads_of(module, taxels)
        normal = taxels.normals[placed].sum(axis=0)
        if len(own) >= CHIRALITY_TAXELS and np.linalg.norm(normal) > 0 and _looks_mirrored(
            module.pads[own], taxels.positions[placed], normal / np.linalg.norm(normal)
        ):  # fmt: skip
            mirrored.append(module.id)
    if not mirrored:
        return []
    return [
        f"mirrored against the layout, seen from outside: modules {list_channels(mirrored)}; check mirror and channel order."
    ]


def _looks_mirrored(pads: FloatArray, positions: FloatArray, normal: FloatArray) -> bool:
    """Return whether the mirror image of `pads` (k, 2) fits `positions` (k, 3), seen against `normal`, clearly better."""
    # Two directions across the normal: the plane in which the pads are compared.
    turn = cross_matrix(normal)
    across = turn @ np.eye(3)[np.abs(normal).argmin()]
    across = across / np.linalg.norm(across)
    flat = np.stack([positions @ across, positions @ (turn @ across)], axis=1)
    straight = _misfit(pads, flat)
    return _misfit(pads * np.array([-1.0, 1.0]), flat) < CHIRALITY_RATIO * straight


def _misfit(pads: FloatArray, flat: FloatArray) -> float:
    """Return the least |R pads + t - flat| over rotations R of the plane and shifts t; both (k, 2)."""
    a, b = pads - pads.mean(axis=0), flat - flat.mean(axis=0)
    # |R a - b|^2 = |a|^2 + |b|^2 - 2 (cos sum(a . b) + sin sum(a x b)), least where the angle has their direction.
    together = np.hypot(np.sum(a * b), np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    least = float(np.sum(a * a) + np.sum(b * b) - 2 * together)
    return max(least, 0.0) ** 0.5


def _spacing(taxels: PlacedTaxels, layout: Layout) -> list[str]:
    ratios: list[float] = []
    for module in layout.modules:
        own, placed = _pads_of(module, taxels)
        # Every pair of the module's taxels once.
        first, second = np.triu_indices(len(own), 1)
        pads, positions = module.pads[own], taxels.positions[placed]
        planned = np.linalg.norm(pads[first] - pads[second], axis=1)
        near = planned < NEIGHBOUR_SPACINGS * layout.spacing
        distances = np.linalg.norm(positions[first[near]] - positions[second[near]], axis=1)
        ratios += (distances / planned[near]).tolist()
    if not ratios:
        return []
    ratio = float(np.median(ratios))
    if SPACING_RATIOS[0] <= ratio <= SPACING_RATIOS[1]:
        return []
    return [
        f"neighbours lie {ratio:.2f} times as far apart as in the layout (median of {plural(len(ratios), 'pair')}); expected "
        f"{SPACING_RATIOS[0]} to {SPACING_RATIOS[1]}: poke more from other sides, or check the layout's unit."
    ]


def _centres(taxels: PlacedTaxels, layout: Layout) -> list[str]:
    placed = set(taxels.channels.tolist())
    lacking = [m.id for m in layout.modules if m.centre_channel not in placed and not placed.isdisjoint(m.channels.tolist())]
    if not lacking:
        return []
    return [f"no position for the centre taxel, which stands for the module in taxel2Repr: modules {list_channels(lacking)}."]


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
    Sentences: faults found (`skincal.files.export`) and what is left out. They do not stop the writing.

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
        sentences += _left_out(calibration.of(each), each)
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


def _left_out(estimates: tuple[Estimate, ...], method: Method) -> list[str]:
    without = [estimate.state for estimate in estimates if estimate.position is None]
    if not without:
        return []
    counts = Counter(without)
    states = ", ".join(f"{counts[state]} {state.value}" for state in State if counts[state])
    # The same for every format, so that who writes several of them reads it once.
    return [f"{method.value}: {len(without)} of {len(estimates)} taxels have no position ({states})."]


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
