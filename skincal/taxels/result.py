"""The result of an estimate: what a method says about one taxel, and why. Sentences on it are made elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    # The commands' help names methods, and numpy takes a quarter of its time.
    from skincal.geometry import FloatArray

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


class Cause(Enum):
    """Why a taxel's state is what it is; the value is short, the sentence is made by `skincal.words`."""

    UNPOKED = "no accepted poke touched it"
    ONE_AXIS = "one axis: the depth along it is unknown"
    ALIKE_AXES = "axes nearly along one direction"
    AXES_APART = "axes pass each other too far off"
    OPPOSED = "pokes push from opposite sides"
    NO_TRIANGLE = "no triangle of the surface faces the pokes"
    OFF_SURFACE = "axes pass the surface too far off"
    GRAZING = "pokes graze the surface"
    MODULE_UNPOKED = "no accepted poke touched its module"
    MODULE_UNPLACED = "neither pokes nor plan say where its module is"
    MODULE_OFF = "axes pass its module too far off"
    MODULE_MOVING = "its module's pose does not settle"
    MODULE_BEHIND = "pokes push its module from behind"
    MODULE_ONE_POKE = "one poke does not determine its module's turn"
    MODULE_LOOSE = "pokes do not determine how its module lies"
    BY_MODULE = "known by its module alone"
    SHARED_ERRORS = "errors that its pokes share leave it unknown"
    MEAN_OF_POSES = "mean over arm poses"
    BLIND_IN_POSES = "blind in each arm pose"
    GIVEN = "in the words of another: of the channel's health, or of a file"


@dataclass(frozen=True, slots=True)
class StateReason:
    """A cause with its numbers; those that a cause does not name have no meaning."""

    cause: Cause
    count: int = 0
    """Pokes, axes or arm poses."""
    blind: int = 0
    """`MEAN_OF_POSES`: arm poses that are left out, since the taxel is blind in them."""
    size: float | None = None
    """m: how far axes pass, how far a pose moves, or a standard deviation; None where it is not determined at all."""
    angle: float = 0.0
    """rad, `ALIKE_AXES`: the axes lie within it of one direction."""
    inner: StateReason | None = None
    """`BLIND_IN_POSES`: why the taxel is blind in the arm pose with most pokes."""
    text: str = ""
    """`GIVEN`: the sentence."""


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

    The uncertainty carries the rig's noise (force, moment, place of the contact) and, where a correction of the rig is in use,
    what that does not know. It leaves out a wrong mesh and, without a correction, errors of the F/T matrix and of the arm,
    which shift all taxels together.
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
    worst_direction: FloatArray | None = None
    """(3,) float, unit: the direction that is known worst; also for `BLIND` with at least one axis."""
    sd: float | None = None
    """m, standard deviation along `worst_direction`; None where it is not determined."""
    rms: float | None = None
    """m, square root of the covariance's trace: the predicted error."""
    triangle: int | None = None
    """Index of the surface's triangle that carries the position; None without one, and for the free method."""
    reason: StateReason | None = None
    """Why the state is what it is; None where there is nothing to say."""
    line_point: FloatArray | None = None
    """(3,) float, metres: for a taxel that the free method knows as a line only, the line's point nearest to the link's
    origin, that is the solution of smallest norm; the line runs along `worst_direction`. None otherwise."""
    rival: Rival | None = None
    """Surface method: the taxel may lie there as well. None where no other place is within the noise."""
    moved: FloatArray | None = None
    """(3, n) float, metres: how far each of n errors that all taxels share moves the position, in its standard deviations; in
    the covariance. None where no correction of the rig is in use (`skincal.taxels.shared_errors`)."""
    doubted: Mapping[int, float] = field(default_factory=dict[int, float])
    """Pokes that count less than fully for this taxel: number to trust, 0 to less than 1."""
