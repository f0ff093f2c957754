"""A surface in the compiled solver's memory, with its search tree: written once, and gone with the surface."""

from __future__ import annotations

import ctypes
import threading
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np

from skincal.solver.machine import Machine

if TYPE_CHECKING:
    from skincal.surface.mesh import Surface

LEVELS = 16
"""Levels of a tree for which there is room: eight children a node make 16 enough for any mesh."""


class Layout(ctypes.Structure):
    """`Surface` of `skincal/solver/source/search.h`."""

    _fields_ = (
        ("triangle_count", ctypes.c_uint32),
        ("level_count", ctypes.c_uint32),
        ("levels", ctypes.c_uint32 * LEVELS),
        ("node_counts", ctypes.c_uint32 * LEVELS),
        ("order", ctypes.c_uint32),
        ("places", ctypes.c_uint32),
        ("corners", ctypes.c_uint32),
        ("vertices", ctypes.c_uint32),
        ("triangles", ctypes.c_uint32),
        ("normals", ctypes.c_uint32),
        ("slim", ctypes.c_uint32),
        ("fan_starts", ctypes.c_uint32),
        ("fans", ctypes.c_uint32),
        ("walked", ctypes.c_uint32),
        ("lowest", ctypes.c_uint32),
        ("lowest_stamp", ctypes.c_uint32),
        ("stamp", ctypes.c_int32),
        ("origin", ctypes.c_double * 3),
        ("extent", ctypes.c_double),
    )


_residents: WeakKeyDictionary[Surface, tuple[Machine, int]] = WeakKeyDictionary()
_lock = threading.Lock()


def resident(surface: Surface) -> tuple[Machine, int]:
    """Return the machine that holds `surface`, and its place there."""
    with _lock:
        found = _residents.get(surface)
        if found is None:
            found = _residents[surface] = _moved_in(surface)
        return found


def _moved_in(surface: Surface) -> tuple[Machine, int]:
    machine, tree, fans = Machine(), surface.tree, surface.fans
    layout = Layout(
        triangle_count=len(surface.triangles),
        level_count=len(tree.levels),
        stamp=0,
        extent=tree.extent,
        origin=tuple(tree.origin),
    )
    for i, level in enumerate(tree.levels):
        layout.levels[i], layout.node_counts[i] = machine.keep(level), level.size // 8
    for name, numbers in (("order", tree.order), ("places", tree.places), ("triangles", surface.triangles)):
        setattr(layout, name, machine.keep(numbers.astype(np.int32)))
    layout.fan_starts, layout.fans = machine.keep(fans.starts.astype(np.int32)), machine.keep(fans.triangles.astype(np.int32))
    for name, lengths in (("corners", tree.corners), ("vertices", surface.vertices), ("normals", surface.normals)):
        setattr(layout, name, machine.keep(lengths))
    layout.slim = machine.keep(surface.slim.astype(np.uint8))
    layout.walked = machine.keep(np.zeros(len(surface.triangles), dtype=np.int32))
    layout.lowest = machine.keep(np.zeros(len(surface.vertices)))
    layout.lowest_stamp = machine.keep(np.zeros(len(surface.vertices), dtype=np.int32))
    return machine, machine.keep(np.frombuffer(bytes(layout), dtype=np.uint8))
