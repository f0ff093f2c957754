"""Differences between two sets of taxel turns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from skincal.axes.session_turns import ShownTurn
from skincal.geometry import FloatArray, rotation_vector


@dataclass(frozen=True, slots=True, eq=False)
class TurnDifferences:
    """Angles between the turns of taxels that both sets know."""

    channels: tuple[int, ...]
    """n taxels whose z is known in both, ascending."""
    normals: FloatArray
    """(n,) float, rad: between the z axes."""
    in_plane: FloatArray
    """(n,) float, rad: size of the part about z of the rotation vector between them; NaN if x and y are unknown in one."""


def compare_turns(first: Mapping[int, FloatArray], second: Mapping[int, FloatArray]) -> TurnDifferences:
    """Compare axes by channel, (3, 3) float, in columns; unknown columns are NaN."""
    channels, normals, in_plane = list[int](), list[float](), list[float]()
    for channel in sorted(first.keys() & second.keys()):
        here, there = first[channel], second[channel]
        cosine = float(here[:, 2] @ there[:, 2])
        if not np.isfinite(cosine):
            continue
        between = here.T @ there
        # Axes of opposite hands have no rotation between them.
        is_rotation = bool(np.isfinite(between).all()) and np.linalg.det(between) > 0
        channels.append(channel)
        normals.append(float(np.arccos(np.clip(cosine, -1.0, 1.0))))
        in_plane.append(abs(float(rotation_vector(between)[2])) if is_rotation else float("nan"))
    return TurnDifferences(tuple(channels), np.array(normals), np.array(in_plane))


def axes_of_turns(turns: Mapping[int, ShownTurn]) -> dict[int, FloatArray]:
    """Gather the known axes of taxels by channel, (3, 3) float in columns, frame of the part; x and y are NaN while unknown."""
    found: dict[int, FloatArray] = {}
    for channel, turn in turns.items():
        found[channel] = axes = turn.axes.copy()
        if not turn.is_in_plane_known:
            axes[:, :2] = np.nan
    return found
