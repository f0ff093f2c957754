"""What a poke ends as, a contact or a rejection with its reason, and how the poke in progress stands."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

from skincal.geometry import FloatArray, IntArray

RAW = "raw"
"""Unit of what a taxel answers: the device's own."""


class Reason(Enum):
    """Why a poke does not count; the value is the word the operator reads."""

    TOO_SOFT = "too soft"
    TOO_HARD = "too hard"
    NOT_STILL = "not still"
    SLID = "slid"
    TWO_CONTACTS = "two contacts or a torque"
    NO_TAXEL = "no taxel answered"
    TOO_MANY_TAXELS = "too many taxels"
    NOT_CONNECTED = "taxels far apart answered"
    SATURATED = "saturated"
    READINGS_LOST = "readings lost"
    NO_TARE = "no quiet time to tare"
    TARE_CHANGED = "tare changed"
    NO_POSE = "arm pose unknown"
    ARM_MOVED = "arm moved"


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """One accepted poke: the mean wrench of its still window and the taxels that answered.

    A poke may be given twice: at its release, tared by the quiet time before it, and again once the quiet time after
    it is known. The second replaces the first.
    """

    poke: int
    """Number of the poke in the session, from 1."""
    start_s: float
    end_s: float
    """Host's monotonic clock at the ends of the still window, seconds."""
    force: FloatArray
    """(3,) float, N, tared, sensor frame, force on the part."""
    moment: FloatArray
    """(3,) float, N m, tared, about the sensor's origin."""
    channels: IntArray
    """(k,) taxels that answered, ascending."""
    responses: FloatArray
    """(k,) float > 0, raw units above the baseline: t_j."""
    link_from_sensor: FloatArray
    """(4, 4) float, metres: pose of the arm during the poke."""
    pose: str
    """Name of the arm pose, or its angles in words; empty without an arm."""
    tare_change: float
    """N, difference of the tares before and after; NaN until the second is known."""
    final: bool
    """The tare after the poke is in, or will not come."""

    @property
    def strongest_channel(self) -> int:
        """The channel that answered most."""
        return int(self.channels[self.responses.argmax()])


@dataclass(frozen=True, slots=True, eq=False)
class Rejection:
    """One poke that does not count, with the number that decided and the limit it met."""

    poke: int
    start_s: float
    end_s: float
    reason: Reason
    value: float
    """The number that decided, in the unit of `limit`."""
    limit: float
    unit: str
    """SI unit of `value` and `limit`, such as `"N"`; `RAW` for a taxel's answer, empty for a count."""
    channels: IntArray
    """Taxels that answered, ascending; may be empty."""
    final: bool
    force: FloatArray | None = None
    """(3,) float, N, tared, sensor frame, force on the part; None without a still window or a known pose."""
    moment: FloatArray | None = None
    """(3,) float, N m, tared, about the sensor's origin; None as `force`."""
    link_from_sensor: FloatArray | None = None
    """(4, 4) float, metres: pose of the arm during the poke; None as `force`."""
    pose: str = ""
    """Name of the arm pose, as `Contact.pose`; empty without a still window."""


Outcome: TypeAlias = Contact | Rejection


class PressPhase(Enum):
    """Where the poke in progress stands."""

    NO_DATA = "no data"
    TARING = "keep hands off"
    READY = "ready"
    PRESSING = "pressing"
    STILL = "still"
    HELD = "held: release"


@dataclass(frozen=True, slots=True)
class BeforePokes:
    """What the samples until the first poke showed: where no poke comes at all, it says why."""

    samples: int
    """Skin frames with the wrench of their time."""
    seconds: float
    """s, from the first to the last."""
    tared: bool
    """The force rested long enough for a tare."""
    strongest: float
    """N, the largest force beside its rest."""
    answered: int
    """Taxels that answered..."""
    fell: int
    """...and those that fell as far below their rest."""


@dataclass(frozen=True, slots=True, eq=False)
class Progress:
    """The poke in progress, for the views."""

    phase: PressPhase
    force: FloatArray
    """(3,) float, N, tared, link frame; zeros when nothing presses."""
    axis_point: FloatArray
    """(3,) float, metres, link frame: a point of the force axis; meaningless unless pressing."""
    channels: IntArray
    responses: FloatArray
    still: float
    """Share of the still window that is filled, 0 to 1."""
