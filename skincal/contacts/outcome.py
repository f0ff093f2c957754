"""Result of a poke, a contact or a rejection with its reason, and the state of the poke in progress."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import TypeAlias

from skincal.contacts.press import FinishedPress
from skincal.contacts.tare import Tare
from skincal.geometry import FloatArray, IntArray
from skincal.model.codec import OPTIONAL_FIELD

RAW_UNIT = "raw"
"""Unit of a taxel's response: the device's own."""
NOT_STORED = {"stored": False}
"""Metadata of a field that the journal leaves out, or writes in another form."""


class Reason(Enum):
    """Reason why a poke does not count. The value is its key in JSON; the journal stores the name. Words: `REASON_WORDS`."""

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


CROWDED_REASONS = (Reason.TOO_MANY_TAXELS, Reason.NOT_CONNECTED)
"""Reasons that can disappear when a channel is found to be dead."""
_THRESHOLD_OF_REASON = {
    Reason.TOO_SOFT: "force_min",
    Reason.TOO_HARD: "force_max",
    Reason.NOT_STILL: "still_change",
    Reason.SLID: "slide_max",
    Reason.TWO_CONTACTS: "pitch_max",
    Reason.TOO_MANY_TAXELS: "taxels_max",
    Reason.NOT_CONNECTED: "gap_factor",
    Reason.TARE_CHANGED: "tare_change_max",
    Reason.NO_TAXEL: "response_min",
}


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """One accepted poke: the mean wrench of its still window and the taxels that answered.

    A poke is reported twice: at its release, tared by the quiet time before it, and again with the quiet time after it.
    The second report replaces the first.
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
    """The tare after the poke is known, or will not come."""
    tip: FloatArray | None = field(default=None, metadata=OPTIONAL_FIELD)
    """(3,) float, metres, fixed frame: position of the tip; `None` without a tip stream."""
    clipped: IntArray | None = field(default=None, metadata=OPTIONAL_FIELD)
    """Those of `channels` at the end of the skin's range, so that their responses are lower bounds; `None` without any."""
    vectors: FloatArray | None = field(default=None, metadata=OPTIONAL_FIELD)
    """(k, 3) float, raw units above the baseline: readings of `channels` in the axes of each taxel, z out of the skin, force on
    the taxel. NaN if a value is at an end of the range; `None` for a skin of one axis."""
    rest_wrench: FloatArray | None = field(default=None, metadata=OPTIONAL_FIELD)
    """(6,) float, N and N m, sensor frame: the wrench without a touch that was subtracted, with the weight of a tool that
    carries the sensor; `None` for other rigs."""
    press: FinishedPress | None = field(default=None, repr=False, metadata=NOT_STORED)
    """The press, to judge it again with other dead channels. `None` if these cannot change the result."""
    tare_after: Tare | None = field(default=None, repr=False, metadata=NOT_STORED)
    """Tare after the press, for the same purpose; `None` without one."""

    @property
    def strongest_channel(self) -> int:
        """Channel with the largest response."""
        return int(self.channels[self.responses.argmax()])


@dataclass(frozen=True, slots=True, eq=False)
class Rejection:
    """One poke that does not count, with the number that decided and its limit."""

    poke: int
    start_s: float
    end_s: float
    reason: Reason
    value: float
    """The number that decided, in the unit of `limit`."""
    limit: float
    unit: str
    """SI unit of `value` and `limit`, such as `"N"`; `RAW_UNIT` for a taxel's response, empty for a count."""
    channels: IntArray
    """Taxels that answered, ascending; may be empty."""
    final: bool
    force: FloatArray | None = None
    """(3,) float, N, tared, sensor frame, force on the part; `None` without a still window or a known pose."""
    moment: FloatArray | None = None
    """(3,) float, N m, tared, about the sensor's origin; `None` as `force`."""
    link_from_sensor: FloatArray | None = None
    """(4, 4) float, metres: pose of the arm during the poke; `None` as `force`."""
    pose: str = ""
    """Name of the arm pose, as `Contact.pose`; empty without a still window."""
    press: FinishedPress | None = field(default=None, repr=False, metadata=NOT_STORED)
    """As in `Contact`."""
    tare_after: Tare | None = field(default=None, repr=False, metadata=NOT_STORED)

    @property
    def threshold(self) -> str:
        """Name of the threshold that decided, as in `ContactSettings`; empty if it was none of them."""
        is_short_press = self.reason is Reason.NOT_STILL and self.unit in ("s", "")
        return "still_s" if is_short_press else _THRESHOLD_OF_REASON.get(self.reason, "")


Outcome: TypeAlias = Contact | Rejection


class PressPhase(Enum):
    """State of the poke in progress."""

    NO_DATA = "no data"
    TARING = "keep hands off"
    READY = "ready"
    PRESSING = "pressing"
    STILL = "still"
    HELD = "held: release"


PRESSING_PHASES = (PressPhase.PRESSING, PressPhase.STILL, PressPhase.HELD)
"""Phases in which a tool presses."""


@dataclass(frozen=True, slots=True)
class BeforePokes:
    """Summary of the samples before the first poke: it explains why no poke was found."""

    samples: int
    """Skin frames that were paired with a wrench."""
    seconds: float
    """s, from the first to the last."""
    tared: bool
    """The force was quiet for long enough to tare."""
    strongest: float
    """N, largest tared force."""
    answered: int
    """Taxels that answered."""
    fell: int
    """Taxels whose values fell below the baseline by as much."""
    gaps: int = 0
    """Gaps between the samples. Each ends a quiet window."""
    longest_gap_s: float = 0.0


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
