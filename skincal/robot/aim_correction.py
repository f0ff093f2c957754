"""Correction of a robot's aim by the force axes of its own pokes.

The force axis of a poke passes its contact. If it misses the tip's place by the joints, the robot's base or tip is wrong. The
small motion of the tip (six unknowns) is the least-squares fit of all pokes so far, with a prior. It is constant in the room,
even if the part turns.
"""

from __future__ import annotations

import numpy as np

from skincal.geometry import FloatArray, axis_point, cross_matrix, crossed, length_of

SHIFT_SD_M, TURN_SD = 0.010, float(np.radians(1.0))
"""Prior sd of the motion, along and about each axis of the room."""
FORCE_AXIS_TO_CONTACT_SD_M = 0.002
"""m, sd of the distance between a force axis and the true contact: sensor noise, and the tip's radius under friction."""
FORCE_AXIS_MAX_DISTANCE_FROM_TIP_M = 0.020
"""m. An axis that passes farther from the tip has another cause, such as a second contact: it is not used."""


class AimCorrection:
    """Motion from the position of the tip that the robot believes to the true one, in the room.

    `room_from_part` (4, 4), metres, is the pose of the part as the robot believes it.
    """

    def __init__(self) -> None:
        self._information: FloatArray = np.diag(np.repeat([SHIFT_SD_M, TURN_SD], 3) ** -2.0)
        self._sum = np.zeros(6)
        self._motion: FloatArray = np.zeros(6)

    def shift_at(self, place: FloatArray, room_from_part: FloatArray) -> FloatArray:
        """Compute the true less the believed position of the tip at `place`, (3,) each, metres, in the part's frame."""
        turn = room_from_part[:3, :3]
        return turn.T @ (self._motion[:3] + crossed(self._motion[3:], turn @ place + room_from_part[:3, 3]))

    def add_poke(self, contact: FloatArray, force: FloatArray, moment: FloatArray, room_from_part: FloatArray) -> None:
        """Learn from a poke: believed contact (3,), metres; tared force (3,), N, and moment (3,), N m, part's frame."""
        turn = room_from_part[:3, :3]
        across = cross_matrix(turn @ force / length_of(force))
        miss = across @ turn @ (axis_point(force, moment) - contact)
        contact = turn @ contact + room_from_part[:3, 3]
        if length_of(miss) > FORCE_AXIS_MAX_DISTANCE_FROM_TIP_M:
            return
        rows = np.hstack([across, -across @ cross_matrix(contact)]) / FORCE_AXIS_TO_CONTACT_SD_M
        self._information += rows.T @ rows
        self._sum += rows.T @ miss / FORCE_AXIS_TO_CONTACT_SD_M
        self._motion = np.asarray(np.linalg.solve(self._information, self._sum), dtype=np.float64)
