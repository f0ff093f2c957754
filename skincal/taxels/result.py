"""What a method says about one taxel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from skincal.geometry.arrays import FloatArray

SD_MAX = 0.030
"""m. A position whose standard deviation in its worst direction exceeds this is none: it is the side of a whole module."""
MISS_MAX = 0.050
"""m. Axes that pass a taxel at more than this (weighted rms) are of another part, frame or unit: no error of a rig is as
large."""


class Method(Enum):
    """A way to estimate a taxel's position; the value is its name in files."""

    FREE = "free"
    SURFACE = "surface"
    MODULES = "modules"


PER_TAXEL = (Method.FREE, Method.SURFACE)
"""The paper's methods, which know a taxel by its own contacts alone."""


class State(Enum):
    """What is known of a taxel."""

    UNSEEN = "unseen"
    """No accepted contact touched it."""
    BLIND = "blind"
    """Contacts do not determine its position: see `Estimate.reason`."""
    ESTIMATED = "estimated"
    DEAD = "dead"
    """Stuck or always on: its answers are not used."""


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """Another place on the surface that fits the same contacts nearly as well."""

    position: FloatArray
    """(3,) float, metres, link frame."""
    triangle: int
    odds: float
    """>= 1: how many times less likely it is than the estimate, by the rig's noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """One taxel by one method, link frame, metres.

    The uncertainty carries the rig's noise (force, moment, place of the contact); it leaves out wrong frames, a wrong
    arm chain, a wrong mesh and errors of the F/T matrix, which shift all taxels together.
    """

    channel: int
    method: Method
    state: State
    contacts: int
    """Contacts in which the taxel answered and that are not excluded; the modules method may know one that has none."""
    position: FloatArray | None = None
    """(3,) float, metres, link frame; None unless `ESTIMATED`."""
    normal: FloatArray | None = None
    """(3,) float, unit, outward: of the surface, or against the mean push for the free method; None where unknown."""
    covariance: FloatArray | None = None
    """(3, 3) float, m^2; None unless `ESTIMATED`."""
    weakest: FloatArray | None = None
    """(3,) float, unit: the direction that is known worst; also for `BLIND` with at least one axis."""
    sd: float | None = None
    """m, standard deviation along `weakest`; None where it is not determined."""
    rms: float | None = None
    """m, square root of the covariance's trace: the predicted error."""
    triangle: int | None = None
    """Index of the surface's triangle that carries the position; None without one, and for the free method."""
    reason: str = ""
    """A sentence: why the state is what it is."""
    foot: FloatArray | None = None
    """(3,) float, metres: for a taxel that the free method knows as a line only, the line's point nearest to the link's
    origin, that is the solution of smallest norm; the line runs along `weakest`. None otherwise."""
    rival: Rival | None = None
    """Surface method: the taxel may lie there as well. None where no other place is within the noise."""
    doubted: Mapping[int, float] = field(default_factory=dict[int, float])
    """Pokes that count less than fully for this taxel: number to trust, 0 to less than 1."""
