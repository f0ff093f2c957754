"""The unit of a mesh file: named by the file, or guessed from its size."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skincal.geometry import FloatArray
from skincal.mesh.readers import SUFFIXES_WITH_UNIT, read_mesh
from skincal.model.errors import InputError
from skincal.model.given import MAX_MESH_BYTES, read_regular
from skincal.model.length_units import METRES_PER_UNIT

PREFERRED_DIAGONAL_M = (0.04, 2.0)
"""m. Most parts with skin are between a finger and a torso; the unit of a mesh is guessed by it."""
UNIT_ORDER = ("mm", "m", "cm", "in")
UNIT_MAX_RELATIVE_DIFFERENCE = 1e-6
"""Of metres per unit from those of a unit with a name: scales are written with a few digits."""


def guess_unit(sides: FloatArray) -> str:
    """Guess the unit of a mesh from the sides of its box, (3,), in its own unit."""
    diagonal = float(np.linalg.norm(sides))
    low, high = PREFERRED_DIAGONAL_M
    return next((unit for unit in UNIT_ORDER if low <= diagonal * METRES_PER_UNIT[unit] <= high), "mm")


def name_unit(metres: float) -> str:
    """Name the unit of a length; empty if it is none."""
    return next((name for name, unit in METRES_PER_UNIT.items() if abs(metres / unit - 1.0) < UNIT_MAX_RELATIVE_DIFFERENCE), "")


def choose_unit(path: Path) -> str:
    """Choose the unit of a mesh file: its own, or the one that its size suggests.

    Raises InputError: it cannot be read or is empty, or its own unit has no name here.
    """
    mesh = read_mesh(path, read_regular(path, MAX_MESH_BYTES, what="mesh file"))
    if not len(mesh.triangles) or not np.isfinite(mesh.vertices).all():
        raise InputError(f"{path}: the mesh is empty or not finite; export the part again.")
    if mesh.unit is None:
        return guess_unit(np.ptp(mesh.vertices[mesh.triangles.ravel()], axis=0))
    name = name_unit(mesh.unit)
    if not name:
        raise InputError(
            f"{path}: its unit is {mesh.unit:g} m; expected m, cm, mm or in: export the part in one of them, or choose the "
            "unit of its numbers (--unit)."
        )
    return name


def has_no_unit(path: Path) -> bool:
    """Whether files of this format name no unit."""
    return path.suffix.lower() not in SUFFIXES_WITH_UNIT


def unit_without_option(path: Path | None) -> str:
    """Choose the unit of a mesh that is named without one: that of the file, or millimetres."""
    return "mm" if path is None or has_no_unit(path) else choose_unit(path)


def metres_of_file_unit(path: Path) -> float:
    """Metres per unit that a mesh file names; 1 for formats without a unit."""
    if has_no_unit(path):
        return 1.0
    return read_mesh(path, read_regular(path, MAX_MESH_BYTES, what="mesh file")).unit or 1.0
