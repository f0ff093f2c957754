"""Interface of an arm that pokes: simulated, or a real robot behind a driver.

Positions and directions are in the frame of the part (the scene's link), as the robot believes them. They contain the error of
its base frame, which is the same for all of them. The tip may move, or the part may move against a fixed tip: both have the
same interface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from skincal.geometry import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class TipCentre:
    """Centre of the spherical tip, and its direction. `target_lines.TipPose` is the end of the tip."""

    position: FloatArray
    """(3,) float, metres: centre of the spherical tip."""
    direction: FloatArray
    """(3,) float, unit: from the arm to the tip, the direction of a push."""


@dataclass(frozen=True, slots=True, eq=False)
class WrenchReading:
    """A reading of the force/torque sensor, not tared: weight of the part and offset of the sensor are in it."""

    time_s: float
    """s, on the arm's clock (`PokingArm.time_s`): time at which the reading arrived."""
    force: FloatArray
    """(3,) float, N, force on the part, part's frame."""
    moment: FloatArray
    """(3,) float, N m, about the sensor's origin, part's frame."""


class PokingArm(Protocol):
    """An arm with a tip, and the sensor below the part.

    A caller loops: read, `command`, `advance`. The last command holds until the next one.
    """

    tip_radius_m: float
    period_s: float
    """s, time of one `advance`."""

    @property
    def time_s(self) -> float:
        """Time, seconds: simulated, or a monotonic clock."""
        ...

    def read_tip(self) -> TipCentre:
        """Read the tip from the arm's joints."""
        ...

    def read_wrench(self) -> WrenchReading | None:
        """Read the newest wrench; `None` before the first one. An old time means that the sensor is silent."""
        ...

    def link_from_sensor(self) -> FloatArray:
        """Read the pose (4, 4) of the sensor in the part's frame, metres, as the joints report it."""
        ...

    def room_from_part(self) -> FloatArray:
        """Read the pose (4, 4) of the part in the frame in which the base is fixed, metres; identity if the part rests."""
        ...

    def is_reachable(self, position: FloatArray, direction: FloatArray) -> bool:
        """Whether the tip's centre gets to `position` (3,), metres, with the unit `direction` (3,), within the joint limits."""
        ...

    def command(self, position: FloatArray, direction: FloatArray, speed_m_s: float) -> None:
        """Move the tip's centre straight to `position` (3,), metres, at most at `speed_m_s`, and turn it to `direction` (3,).

        The servo presses with the force that its stiffness gives: a goal inside the part is allowed.
        """
        ...

    def stop(self) -> None:
        """Stop at once and hold the present pose."""
        ...

    def advance(self) -> None:
        """Advance by `period_s`: simulate it, or wait for it."""
        ...
