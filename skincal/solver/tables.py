"""The tables that Python and the compiled solver share: every struct and every common number, once.

`python -m tools.solver` writes `source/tables.h` from this module: the structs with the offset of each field, and the numbers.
Python passes each value by the name of its field (`machine.py`), so an order of arguments cannot be confused.

A field is its type in C and its meaning. Addresses are 32-bit offsets into the solver's memory. Offsets follow the rules of
wasm32, not those of Python's machine: each number is aligned to its own size. The compiler checks them.
"""

from __future__ import annotations

import math
import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from struct import Struct
from typing import Any

import numpy as np

from skincal.chi_square import CHI2_1DOF_MEDIAN, CHI2_2DOF_MEDIAN

_FORMAT_OF_TYPE = {"double": "<f8", "float": "<f4", "int": "<i4", "Word": "<u4", "unsigned char": "u1"}
_LETTER_OF_TYPE = {"double": "d", "float": "f", "int": "i", "Word": "I", "unsigned char": "B"}
"""In the notation of `struct`."""
_ADDRESS_TYPE = np.dtype("<u4")
_FIELD_TYPE = re.compile(r"(?P<const>const )?(?P<base>\w[\w ]*?)(?P<pointer> \*)?(?P<sizes>(\[\d+\])*)")


@dataclass(frozen=True)
class Field:
    """A field of a table."""

    name: str
    base: str
    """Type in C of the number or table that it is, or that it points to."""
    is_pointer: bool
    is_written: bool
    """Whether the solver may write where it points."""
    shape: tuple[int, ...]
    """Sizes of an array within the table; empty for one value."""
    meaning: str

    @property
    def target(self) -> Table | None:
        """The table that it is or points to; `None` for numbers."""
        return SHARED_TABLES.get(self.base)

    @cached_property
    def is_table(self) -> bool:
        """Whether it is or points to a table, and not to numbers."""
        return self.target is not None

    @cached_property
    def kind(self) -> np.dtype[Any]:
        """The kind of numbers that it is or points to."""
        return np.dtype(_FORMAT_OF_TYPE[self.base]) if self.target is None else self.target.dtype

    @property
    def stored(self) -> np.dtype[Any]:
        """What the table holds of it: for pointers, addresses."""
        return np.dtype((_ADDRESS_TYPE if self.is_pointer else self.kind, self.shape))

    @property
    def packed(self) -> str:
        """Its numbers in the notation of `struct`."""
        one = "I" if self.is_pointer else _LETTER_OF_TYPE[self.base] if self.target is None else self.target.packed
        return one * math.prod(self.shape)

    @property
    def alignment(self) -> int:
        """Bytes to whose multiple it is aligned."""
        if self.is_pointer or self.target is None:
            return (_ADDRESS_TYPE if self.is_pointer else self.kind).itemsize
        return self.target.alignment

    @property
    def declaration(self) -> str:
        """Its declaration in C."""
        const = "const " if self.is_pointer and not self.is_written else ""
        return f"{const}{self.base} {'*' * self.is_pointer}{self.name}{''.join(f'[{size}]' for size in self.shape)};"


def _field(name: str, text: str) -> Field:
    kind, _, meaning = text.partition(": ")
    found = _FIELD_TYPE.fullmatch(kind)
    if found is None:
        raise ValueError(f"{name}: no type of a field: {kind!r}")
    shape = tuple(int(size) for size in re.findall(r"\d+", found["sizes"]))
    is_pointer = found["pointer"] is not None
    return Field(name, found["base"], is_pointer, is_pointer and found["const"] is None, shape, meaning)


class Table:
    """A struct of the solver.

    Parameters
    ----------
    fields : type in C of each field, and after ": " its meaning
    """

    def __init__(self, name: str, meaning: str, fields: Mapping[str, str]) -> None:
        self.name, self.meaning = name, meaning
        self.fields = {field: _field(field, text) for field, text in fields.items()}

    @cached_property
    def alignment(self) -> int:
        """Bytes to whose multiple it is aligned."""
        return max(field.alignment for field in self.fields.values())

    @cached_property
    def offsets(self) -> dict[str, int]:
        """The bytes before each field."""
        offsets: dict[str, int] = {}
        end = 0
        for name, field in self.fields.items():
            offsets[name] = end + -end % field.alignment
            end = offsets[name] + field.stored.itemsize
        return offsets

    @cached_property
    def packed(self) -> str:
        """Its numbers, and the bytes between them, in the notation of `struct`."""
        text, end = "", 0
        for name, field in self.fields.items():
            text += "x" * (self.offsets[name] - end) + field.packed
            end = self.offsets[name] + field.stored.itemsize
        return text + "x" * (self.dtype.itemsize - end)

    @cached_property
    def packing(self) -> Struct:
        """Puts the numbers of the table, and of those in it, into bytes."""
        return Struct("<" + self.packed)

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """The table as a numpy type with named fields, aligned as on wasm32."""
        formats = [field.stored for field in self.fields.values()]
        end = list(self.offsets.values())[-1] + formats[-1].itemsize
        size = end + -end % self.alignment
        names, offsets = list(self.fields), list(self.offsets.values())
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})


FULL_TRUST_SDS = 2.8
"""Largest miss of a poke that counts fully, in three directions: noise exceeds it in 5 %, that of the simulated rig in 2 %."""
ZERO_TRUST_SDS = 3.8
"""Miss from which on a poke counts not at all: noise alone is beyond it in 2 of 1000."""
MIN_POKES_FOR_TRUST = 4
"""With fewer pokes all count fully: two of three can agree by chance."""
MIN_SUM_OF_POKE_TRUSTS = 2.0
"""Sum of trusts below which all pokes count fully: if hardly one is left, it is unknown which is right."""
FULL_WEIGHT_MAX_MISS_SDS = 2.0
"""Largest miss at which pokes have the same weight while point or pose is sought; beyond, it falls with the square."""
SMALL_SAMPLE_SPREAD_CORRECTION = 6.0
"""A spread found from n misses may be too small: it is raised, as limits of Student's t are, by this over its 2 n - 3 degrees
of freedom."""
NEIGHBOURS_SHARE_ONE_OFFSET_FROM = 0.4
"""Mean of sqrt(ln(1/k)) from which all neighbours' offsets are one (`uncertainty.h`). Measured on the simulated forearm: 0.19
if every taxel is poked as often, with 0.2 mm left in common; 0.39 and 0.47 at taxels never poked while two or one in three are,
with 1.1 and 1.6 mm: the common part grows as the square of the mean."""
PUSHED_FACE_MIN_COSINE = 1e-12
"""A triangle faces a push if push . normal is below minus this (both unit): tangent to the last digit is out, however it is
rounded."""
SINGLE_PRECISION_MARGIN_SHARE = 1e-6
"""Share by which the search tree enlarges radii and distances: ten times the rounding of single precision."""
NODE_CHILDREN = 8
"""Children of a node of the search tree: fewer take more steps, more take more numbers."""
SEARCH_TREE_MAX_DEPTH = 16
"""With eight children a node it is enough for any mesh."""
SHARED_NUMBERS: dict[str, float] = {
    "FULL_TRUST_SDS": FULL_TRUST_SDS,
    "ZERO_TRUST_SDS": ZERO_TRUST_SDS,
    "MIN_POKES_FOR_TRUST": MIN_POKES_FOR_TRUST,
    "MIN_SUM_OF_POKE_TRUSTS": MIN_SUM_OF_POKE_TRUSTS,
    "FULL_WEIGHT_MAX_MISS_SDS": FULL_WEIGHT_MAX_MISS_SDS,
    "SMALL_SAMPLE_SPREAD_CORRECTION": SMALL_SAMPLE_SPREAD_CORRECTION,
    "CHI2_1DOF_MEDIAN": CHI2_1DOF_MEDIAN,
    "CHI2_2DOF_MEDIAN": CHI2_2DOF_MEDIAN,
    "NEIGHBOURS_SHARE_ONE_OFFSET_FROM": NEIGHBOURS_SHARE_ONE_OFFSET_FROM,
    "PUSHED_FACE_MIN_COSINE": PUSHED_FACE_MIN_COSINE,
    "SINGLE_PRECISION_MARGIN_SHARE": SINGLE_PRECISION_MARGIN_SHARE,
    "NODE_CHILDREN": NODE_CHILDREN,
    "SEARCH_TREE_MAX_DEPTH": SEARCH_TREE_MAX_DEPTH,
}
"""The numbers that both sides use. Misses are in standard deviations."""

_TABLES_IN_ORDER = (
    Table(
        "Noise",
        "Standard deviations of the rig: `NoiseSettings` of `skincal/model/scene.py`.",
        {
            "force": "double: N",
            "moment": "double: N m",
            "contact": "double: metres",
            "reach": "double: metres",
            "radius": "double: metres",
            "pose_turn": "double: rad",
            "pose_shift": "double: metres",
        },
    ),
    Table(
        "Rivals",
        "When a second minimum is reported.",
        {"max_odds": "double: below these", "min_distance": "double: this far from the best one at least, metres"},
    ),
    Table(
        "Surface",
        "The tree and the mesh, as `skincal/mesh/search.py` writes them.",
        {
            "triangle_count": "Word",
            "level_count": "Word",
            "levels": f"const float *[{SEARCH_TREE_MAX_DEPTH}]: rows of eight nodes: x (8), y, z, radii, mean normals, sines",
            "node_counts": f"Word[{SEARCH_TREE_MAX_DEPTH}]: filled up to whole rows",
            "order": "const int *: (nt) the triangle that is node i of level 0",
            "places": "const int *: (nt) the node that each triangle is",
            "corners": "const double *: (nt, 9) of the node i: its corners, metres, from the tree's origin",
            "vertices": "const double *: (nv, 3) metres",
            "triangles": "const int *: (nt, 3)",
            "normals": "const double *: (nt, 3) unit",
            "slim": "const unsigned char *: (nt) slivers",
            "fan_starts": "const int *: (nv + 1) of each vertex in `fans`",
            "fans": "const int *: the triangles around each vertex",
            "walked": "int *: (nt), as the next two and the stamp for `rival.h`: which walk saw the node last",
            "lowest": "double *: (nv)",
            "lowest_stamp": "int *: (nv)",
            "stamp": "int",
            "origin": "double[3]: metres",
            "extent": "double: metres, largest distance of a vertex from the origin",
        },
    ),
    Table(
        "Ground",
        "What is walked on.",
        {"surface": "const Surface *", "over": "const int *: (nt, 3) the triangle behind each side, below zero at the rim"},
    ),
    Table(
        "Known",
        "How well a position is known.",
        {
            "covariance": "double[3][3]: metres^2",
            "worst_direction": "double[3]: unit",
            "sd": "double: metres, along it; infinite if a direction is not determined",
            "rms": "double: metres, root of the covariance's trace",
            "miss": "double: metres, weighted rms distance of the axes",
        },
    ),
    Table(
        "Answer",
        "Solution of a taxel. All numbers are 64-bit floats.",
        {
            "root": "double[3][3]: the rows' squares are |root p - offset|^2 and a constant (`factor.h`)",
            "offset": "double[3]",
            "solution": "double[3]: metres, least-squares point; of smallest norm if the rank is below three",
            "blind": "double[3]: unit direction that the rows do not determine if the rank is 2, else zeros",
            "rank": "double: number of determined directions of `solution`",
            "push": "double[3]: weighted mean of the push directions, shorter than 1 the more they differ",
            "outward": "double[3]: against it, unit",
            "opposed": "double: 1 if the pushes cancel, so that no side is outward",
            "free": "Known: `solution`",
            "point": "double[3]: metres, best point of the surface; NaN if no triangle faces the pushes",
            "value": "double: |root p - offset|^2 there",
            "triangle": "double: -1 without one",
            "on_surface": "Known: `point`",
            "rival": "double[3]: metres, second minimum",
            "rival_triangle": "double",
            "odds": "double: how many times less likely it is; infinite without one",
        },
    ),
    Table(
        "Task",
        "Question of `solve`: t taxels with n answers.",
        {
            "taxels": "Word",
            "answers": "Word",
            "starts": "const int *: (t + 1): taxel i has the answers starts[i] to starts[i + 1], at least one",
            "columns": "const double *: (17, n) as `Evidence.columns`",
            "weights": "const double *: (n)",
            "poses": "const int *: (n)",
            "noise": "const Noise *",
            "rivals": "const Rivals *",
            "trust": "double *: (n) found, or given if `trusting`",
            "trusting": "Word: whether trust is given",
            "free": "Word: whether to solve by the free method",
            "surface": "Surface *: null: no surface method",
            "starting": "const int *: (t) triangles where the optima are likely, -1 for none",
            "said": "Answer *: (t)",
        },
    ),
    Table(
        "Carry",
        "Question of `carry`: n contacts, to be carried into the link frame.",
        {
            "contacts": "Word",
            "forces": "const double *: (n, 3), sensor frame, N",
            "moments": "const double *: (n, 3), sensor frame, N m",
            "poses": "const double *: (n, 4, 4), link_from_sensor",
            "columns": "double *: (17, n) as `Evidence.columns`",
        },
    ),
    Table(
        "Systems",
        "Question of `factor`: least squares of t systems with m rows in all.",
        {
            "systems": "Word",
            "rows": "Word",
            "starts": "const int *: (t + 1)",
            "columns": "const double *: (4, m): A by columns, b",
            "roots": "double *: (t, 9)",
            "offsets": "double *: (t, 3)",
            "solutions": "double *: (t, 3)",
            "blind": "double *: (t, 3)",
            "ranks": "int *: (t)",
        },
    ),
    Table(
        "Search",
        "Question of `nearest` and `second`: best points of a surface, or second minima, for t metrics.",
        {
            "surface": "Surface *",
            "metrics": "Word",
            "all": "Word: whether every triangle is tried",
            "roots": "const double *: (t, 9)",
            "offsets": "const double *: (t, 3)",
            "pushes": "const double *: (t, 3); null: every triangle counts",
            "starting": "const int *: (t)",
            "best": "const double *: (t, 3), for second minima as the next two",
            "radii": "const double *: (t)",
            "limits": "const double *: (t)",
            "points": "double *: (t, 3)",
            "values": "double *: (t)",
            "triangles": "int *: (t); second minima: given if there is a best one, else -1",
            "tried": "int *: (t) how many triangles were solved",
        },
    ),
    Table(
        "Walks",
        "Question of `walk`: n walks over a surface.",
        {
            "ground": "const Ground *",
            "walks": "Word",
            "ways": "const double *: (n, 2) metres, along x and along normal x x",
            "points": "double *: (n, 3) metres, where they begin, then where they end",
            "x": "double *: (n, 3) unit, as `points`",
            "triangles": "int *: (n) as `points`",
        },
    ),
    Table(
        "Rules",
        "Thresholds of the search for a module's pose: `skincal/modules/pose_fit.py` has their values and reasons.",
        {
            "turn_to_length_radius": "double: metres",
            "min_pokes_per_arm_pose": "double",
            "robust_search_steps": "double",
            "max_step": "double: metres",
            "rounding_max_step": "double: metres",
            "converged_step": "double: metres",
            "min_curvature": "double: over that of the rows alone",
            "min_reversal_share": "double: of a step that is halved",
            "max_steps": "double",
            "min_singular_value_ratio": "double",
            "turn_max_sd": "double: rad, of a start",
            "residual_scale": "double: metres, of a start",
            "reweighting_steps": "double: of a start",
            "min_direction": "double: length of a direction in a plane below which it is across it",
        },
    ),
    Table(
        "Starts",
        "Question of `start_modules`: b modules, and e estimates of their taxels with a position.",
        {
            "modules": "Word",
            "rules": "const Rules *",
            "ground": "const Ground *: null: modules lie anywhere",
            "spans": "const int *: (b + 1): module i has the estimates spans[i] to spans[i + 1]",
            "flat": "const double *: (e, 2) metres, of their pads",
            "places": "const double *: (e, 3) metres",
            "outward": "const double *: (e, 3) unit",
            "weights": "const double *: (e) 1/metres^2",
            "planned": "const int *: (b) whether the next two are known",
            "planned_x": "const double *: (b, 3) unit",
            "planned_normals": "const double *: (b, 3) unit",
            "points": "double *: (b, 3) metres, of the poses",
            "x": "double *: (b, 3) unit",
            "normals": "double *: (b, 3) unit",
            "triangles": "int *: (b)",
            "known": "int *: (b) whether there is a pose",
        },
    ),
    Table(
        "Touches",
        "m pokes with a answers on modules with n pads and d unknowns each.",
        {
            "pokes": "Word",
            "unknowns": "Word",
            "starts": "const int *: (m + 1): poke i has the answers starts[i] to starts[i + 1]",
            "answers": "const int *: (a) pads",
            "shares": "const double *: (a) of the middle",
            "columns": "const double *: (17, m) as `Evidence.columns`",
            "poses": "const int *: (m) equal if the arm's pose is",
            "offsets": "const double *: (m) metres^2",
            "noise": "const Noise *",
            "rules": "const Rules *",
            "pads": "double *: (n, 3) metres",
            "changes": "double *: (n, 3, d), of the pads by the unknowns",
            "outward": "double *: (n, 3) unit",
        },
    ),
    Table(
        "RowTable",
        "The whitened rows of m pokes on modules.",
        {
            "row_slopes": "double *: (m, 2, d)",
            "row_misses": "double *: (m, 2)",
            "row_whiten": "double *: (m, 2, 2)",
            "row_normals": "double *: (m, 3) of the skin at the middles",
            "row_bends": "double *: (m, d, d), see `add_bends`",
        },
    ),
    Table(
        "Boards",
        "Question of `place_modules`: b modules to be placed.",
        {
            "touches": "Touches",
            "modules": "Word",
            "doubting": "Word: whether outliers count less",
            "spans": "const int *: (b + 1): module i has the pokes spans[i] to spans[i + 1]",
            "boards": "const int *: (b + 1): and these pads",
            "flat": "const double *: (n, 2) metres",
            "ground": "const Ground *: null: modules lie anywhere",
            "trust": "double *: (m) given, or found if `doubting`",
            "points": "double *: (b, 3) metres, of the poses: the start, then the answer",
            "x": "double *: (b, 3) unit, as `points`",
            "normals": "double *: (b, 3) unit, as `points`",
            "triangles": "int *: (b) as `points`",
            "under": "int *: (n) triangles of the pads",
            "covariances": "double *: (b, d, d)",
            "blind": "double *: (b, d, d): the directions that are not determined as rows, the others zero",
            "misses": "double *: (b) metres",
            "moving": "double *: (b) metres",
            "rows": "RowTable: at the answer",
        },
    ),
    Table(
        "ModuleRows",
        "Question of `module_rows`: the whitened rows of pokes on modules whose pads lie as given.",
        {
            "touches": "Touches",
            "row_slopes": "double *: as in `RowTable`, as the next four",
            "row_misses": "double *",
            "row_whiten": "double *",
            "row_normals": "double *",
            "row_bends": "double *",
        },
    ),
    Table(
        "SpreadRules",
        "How errors that pokes share spread: `skincal/taxels/shared_errors.py` has the values and reasons.",
        {
            "pokes_per_drift_block": "double",
            "max_drift_pair_gap": "double: difference of the numbers of two pokes",
            "drift_factor_if_corrected": "double: of the variance",
            "unranked_shift": "double: over the distance of the pokes",
            "min_information_ratio": "double",
            "skin": "double: metres, sd of its thickness",
        },
    ),
    Table(
        "HeightRules",
        "When a module is off its mesh: `skincal/modules/off_surface.py` has the values and reasons.",
        {
            "min_information_share": "double",
            "subtracted_skin_sds": "double",
            "max_sd": "double: metres",
            "significant_sds": "double",
        },
    ),
    Table(
        "TaxelSpread",
        "Question of `spread_taxels`: t taxels with positions and n answers, and k and l errors that pokes share.",
        {
            "taxels": "Word",
            "answers": "Word",
            "starts": "const int *: (t + 1) as in `Task`",
            "columns": "const double *: (17, n) as `Evidence.columns`",
            "weights": "const double *: (n)",
            "poses": "const int *: (n)",
            "pokes": "const int *: (n) their numbers",
            "unranked": "const unsigned char *: (n)",
            "trust": "const double *: (n)",
            "noise": "const Noise *",
            "rules": "const SpreadRules *",
            "on_surface": "Word: whether the taxels lie in the plane of their triangle",
            "corrected": "Word: whether a correction moved the arm poses",
            "positions": "const double *: (t, 3) metres",
            "normals": "const double *: (t, 3) unit, or zero",
            "errors": "Word: k, of all pokes",
            "pose_errors": "Word: l, of the pokes in one arm pose",
            "alike": "const double *: (n, 2, k) metres; a taxel's answers by the numbers of their pokes, as the next",
            "of_pose": "const double *: (n, 2, l) metres",
            "covariances": "double *: (t, 3, 3) metres^2, without and then with the shared errors",
            "worst": "double *: (t, 3) unit",
            "sds": "double *: (t) metres, along it",
            "rms": "double *: (t) metres",
            "moved": "double *: (t, 3, k) metres",
        },
    ),
    Table(
        "ModuleSpread",
        "Question of `spread_modules`: b modules with d unknowns and m pokes by number, and k and l errors that pokes share.",
        {
            "modules": "Word",
            "rows": "Word: m",
            "unknowns": "Word",
            "starts": "const int *: (b + 1): module i has the pokes starts[i] to starts[i + 1]",
            "columns": "const double *: (17, m) as `Evidence.columns`",
            "poses": "const int *: (m)",
            "pokes": "const int *: (m) their numbers",
            "slopes": "const double *: (m, 2, d) as in `RowTable`, as the next three",
            "misses": "const double *: (m, 2)",
            "whiten": "const double *: (m, 2, 2)",
            "normals": "const double *: (m, 3)",
            "trust": "const double *: (m)",
            "rules": "const SpreadRules *",
            "heights_by": "const HeightRules *: null: without a surface",
            "corrected": "Word: whether a correction moved the arm poses",
            "errors": "Word: k, of all pokes",
            "pose_errors": "Word: l, of the pokes in one arm pose",
            "alike": "const double *: (m, 2, k) metres",
            "of_pose": "const double *: (m, 2, l) metres",
            "given": "Word: whether the next two are given",
            "inverses": "double *: (b, d, d) of the information",
            "factors": "double *: (b) of the variance by the scene's noise",
            "added": "double *: (b, d, d) covariance of the unknowns by slow errors, the skin and errors of poses",
            "moves": "double *: (b, d, k) shifts of the unknowns",
            "heights": "double *: (b) metres^2",
        },
    ),
    Table(
        "Trusts",
        "Question of `trusts`: n pokes.",
        {
            "pokes": "Word",
            "squares": "const double *: (n) squared misses, in standard deviations",
            "trust": "double *: (n)",
        },
    ),
)
SHARED_TABLES = {table.name: table for table in _TABLES_IN_ORDER}
"""All tables by their names in C, each after those that it holds or points to."""
TABLE_OF_FUNCTION: dict[str, str] = {
    "solve": "Task",
    "carry": "Carry",
    "factor": "Systems",
    "nearest": "Search",
    "second": "Search",
    "walk": "Walks",
    "start_modules": "Starts",
    "place_modules": "Boards",
    "module_rows": "ModuleRows",
    "spread_taxels": "TaxelSpread",
    "spread_modules": "ModuleSpread",
    "trusts": "Trusts",
}
"""The functions of the solver with the tables of their questions."""


@cache
def layout_number() -> int:
    """Return the checksum of all fields and common numbers; a program that was built from others has another one."""
    lines = [f"{function} {table}" for function, table in TABLE_OF_FUNCTION.items()]
    lines += [f"{name} {value!r}" for name, value in SHARED_NUMBERS.items()]
    for table in SHARED_TABLES.values():
        lines += [f"{table.name} {field.declaration} {table.offsets[name]}" for name, field in table.fields.items()]
    return zlib.crc32("\n".join(lines).encode()) & 0x7FFFFFFF
