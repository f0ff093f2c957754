"""Estimate of one taxel by one method, with its state and the reason for it. Sentences are made in `skincal.words`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    # The commands' help names methods, and numpy takes a quarter of its time.
    from skincal.geometry import FloatArray

POSITION_MAX_SD_M = 0.030
"""m. Largest standard deviation of a position in its worst direction: the side of a whole module."""
FORCE_AXIS_MAX_MISS_M = 0.050
"""m. Axes at a larger distance (weighted rms) from a taxel are of another part, frame or unit: no rig error is as large."""


class Method(Enum):
    """Method of estimation; the value is its name in files."""

    FREE = "free"
    SURFACE = "surface"
    MODULES = "modules"


PER_TAXEL = (Method.FREE, Method.SURFACE)
"""The paper's methods, which estimate a taxel from its own contacts alone."""


class State(Enum):
    """State of a taxel; the value is its word on the screen, in the report and in every file."""

    TOUCHED = "touched"
    """It has a position and accepted contacts of its own that are no outliers."""
    INFERRED = "inferred"
    """It has a position and no contact, or outliers alone: its module, or its neighbours, place it."""
    BLIND = "undetermined"
    """Contacts do not determine its position, or contradict it: see `Estimate.reason`."""
    UNSEEN = "untouched"
    """It has no contact and no position."""
    DEAD = "disabled"
    """Stuck or always on: its answers are not used."""


STATES_WITH_POSITION = (State.TOUCHED, State.INFERRED)
"""States of taxels with a position."""


MIN_TRUST_OF_A_TOUCH = 0.5
"""Trust below which a contact is an outlier that does not touch its taxel; 99 of 100 good pokes have more."""


def has_touch(contacts: int, doubted: Mapping[int, float]) -> bool:
    """Whether one of a taxel's own accepted contacts is no outlier; `doubted` has the trust of those below 1 by their poke."""
    return contacts > 0 if not doubted else contacts > sum(trust < MIN_TRUST_OF_A_TOUCH for trust in doubted.values())


def placed_state(contacts: int, doubted: Mapping[int, float]) -> State:
    """State of a taxel with a position, by its own accepted contacts; see `has_touch`."""
    return State.TOUCHED if has_touch(contacts, doubted) else State.INFERRED


class Cause(Enum):
    """Reason for a taxel's state; `STATE_SENTENCES` has its sentence."""

    UNPOKED = "unpoked"
    ONE_AXIS = "one axis"
    ALIKE_AXES = "alike axes"
    AXES_APART = "axes apart"
    OPPOSED = "opposed"
    NO_TRIANGLE = "no triangle"
    OFF_SURFACE = "off surface"
    GRAZING = "grazing"
    MODULE_UNPOKED = "module unpoked"
    MODULE_UNPLACED = "module unplaced"
    MODULE_OFF = "module off"
    MODULE_MOVING = "module moving"
    MODULE_BEHIND = "module behind"
    MODULE_ONE_POKE = "module one poke"
    MODULE_LOOSE = "module loose"
    BY_MODULE = "by module"
    CONTRADICTED = "contradicted"
    CLAIMED = "claimed"
    SHARED_ERRORS = "shared errors"
    PART_UNPLACED = "part unplaced"
    MEAN_OF_POSES = "mean of poses"
    BLIND_IN_POSES = "blind in poses"
    EXTERNAL_TEXT = "external text"


@dataclass(frozen=True, slots=True)
class StateReason:
    """Cause of a taxel's state, with the numbers that decided."""

    cause: Cause
    count: int = 0
    """Pokes, axes or arm poses; `CLAIMED`: the other channel."""
    blind: int = 0
    """`MEAN_OF_POSES`: arm poses left out because the taxel is blind in them."""
    size: float | None = None
    """m: distance of the axes, movement of a pose, miss of a place, or a standard deviation; `None` if it is not determined."""
    angle: float = 0.0
    """rad, `ALIKE_AXES`: largest angle of an axis to one direction."""
    inner: StateReason | None = None
    """`BLIND_IN_POSES`: reason in the arm pose with most pokes."""
    text: str = ""
    """`EXTERNAL_TEXT`: the sentence."""


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """Another position on the surface that fits the same contacts nearly as well."""

    position: FloatArray
    """(3,) float, metres, link frame."""
    triangle: int
    odds: float
    """>= 1: how many times less likely it is than the estimate, by the rig's noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Estimate of one taxel by one method, link frame, metres.

    The uncertainty contains the rig's noise (force, moment, position of the contact) and, under a correction of the rig, the
    uncertainty of the correction. It leaves out a wrong mesh and, without a correction, errors of the F/T matrix and of the
    arm, which shift all taxels together.
    """

    channel: int
    method: Method
    state: State
    contacts: int
    """Contacts that the taxel answered and that count; 0 is possible by the modules method."""
    position: FloatArray | None = None
    """(3,) float; `None` unless the state is one of `STATES_WITH_POSITION`."""
    normal: FloatArray | None = None
    """(3,) float, unit, outward: of the surface, or against the mean push for the free method."""
    covariance: FloatArray | None = None
    """(3, 3) float, m^2; `None` without a position."""
    worst_direction: FloatArray | None = None
    """(3,) float, unit: direction of the largest uncertainty; also for `BLIND` with at least one axis."""
    sd: float | None = None
    """m, standard deviation along `worst_direction`; `None` if it is not determined."""
    rms: float | None = None
    """m, square root of the covariance's trace: the predicted error."""
    triangle: int | None = None
    """Index of the surface's triangle that carries the position; `None` for the free method."""
    reason: StateReason | None = None
    """Reason for the state, if there is one."""
    line_point: FloatArray | None = None
    """(3,) float: if the free method determines only a line, along `worst_direction`, its point nearest to the link's
    origin."""
    rival: Rival | None = None
    """Surface method: the taxel may lie there as well."""
    moved: FloatArray | None = None
    """(3, n) float, metres: shift by each of n errors that all taxels share, in its standard deviations; part of the
    covariance. `None` without a correction of the rig (`skincal.taxels.shared_errors`), except on soft sheets."""
    doubted: Mapping[int, float] = field(default_factory=dict[int, float])
    """Outliers: number of the poke to trust, 0 to less than 1."""
    normal_sd: float | None = None
    """rad, standard deviation of the normal's angle; `None` where it is a triangle's own (`skincal.mesh.smooth_normals`)."""
    contradicted_place: FloatArray | None = None
    """(3,) float, metres: the place that its module gives it and pokes contradict; `None` without a contradiction."""

    def with_covariance(
        self, covariance: FloatArray, worst_direction: FloatArray, sd: float, rms: float, moved: FloatArray | None
    ) -> Estimate:
        """Copy with another covariance and what follows from it: `dataclasses.replace` takes ten times as long."""
        return Estimate(
            self.channel, self.method, self.state, self.contacts, self.position, self.normal, covariance, worst_direction, sd,
            rms, self.triangle, self.reason, self.line_point, self.rival, moved, self.doubted, self.normal_sd,
            self.contradicted_place,
        )  # fmt: skip

    @property
    def is_contradicted(self) -> bool:
        """Whether pokes contradict the place that its module gives it (`skincal.modules.contradictions`)."""
        return self.contradicted_place is not None
