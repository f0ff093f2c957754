"""The pokes as the rig reported them, the corrections of the rig that the operator uses, and what these make of a poke.

There are two kinds, one of each at most: of the sensor's frame, then of the rig's small errors, which was found under that
frame and therefore goes where the frame is changed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.outcome import Outcome, Progress
from skincal.geometry import FloatArray, axis_point, move_wrench
from skincal.model.actions import Correct, Uncorrect
from skincal.model.errors import InputError
from skincal.rig.correction import FRAME, POSES_KEPT, RIG, Correction, UsedCorrection
from skincal.rig.frame_check import frame_correction
from skincal.session.undo import Step

if TYPE_CHECKING:
    from skincal.rig.correction_fit import RigAnswer
    from skincal.rig.frame_check import FrameDiagnosis

ROUNDING = 1e-9
"""How far a rotation's product with itself may be from one."""
KINDS = {FRAME: "the sensor's frame", RIG: "the rig"}


class Corrections:
    """Those in use, and the pokes as reported.

    Parameters
    ----------
    changed : called where pokes are to be corrected anew
    """

    def __init__(self, changed: Callable[[], None]) -> None:
        self._changed = changed
        self.used: Mapping[str, UsedCorrection] = {}
        """Those in use, by what they are of."""
        self.reported: dict[int, Outcome] = {}
        """Every poke as the rig reported it, by its number."""
        self.framed: dict[int, Outcome] = {}
        """The same in the right frame, with the rig's small errors: what these are found from."""

    def act(self, action: Correct | Uncorrect) -> Step:
        """Use a correction, or use it no more; see `use` and `drop`."""
        return self.use(action) if isinstance(action, Correct) else self.drop(action)

    def use(self, action: Correct) -> Step:
        """Use a correction; return how it is taken back.

        Raises
        ------
        InputError
            It is none.
        """
        used = used_of(action)
        if action.of in self.used and _same(self.used[action.of].correction, used.correction):
            raise InputError(f"That correction of {KINDS[action.of]} is in use already.")
        return self._set({**self._kept_beside(action.of), action.of: used}, f"correction of {KINDS[action.of]}")

    def drop(self, action: Uncorrect) -> Step:
        """Use a correction no more; return how that is taken back.

        Raises
        ------
        InputError
            None of that kind is in use.
        """
        if action.of not in self.used:
            raise InputError(f"No correction of {action.of!r} is in use; expected one of {', '.join(self.used) or 'none'}.")
        return self._set(self._kept_beside(action.of), f"end of the correction of {KINDS[action.of]}")

    def _kept_beside(self, of: str) -> dict[str, UsedCorrection]:
        # The rig's correction was found under the frame that was in use, and holds under no other.
        return {FRAME: self.used[FRAME]} if of == RIG and FRAME in self.used else {}

    def _set(self, used: Mapping[str, UsedCorrection], words: str) -> Step:
        before = self.used
        self._put(used)
        return Step(words, lambda: self._put(before))

    def _put(self, used: Mapping[str, UsedCorrection]) -> None:
        reframed = used.get(FRAME) is not self.used.get(FRAME)
        self.used = used
        if reframed:
            for reported in self.reported.values():
                self._frame(reported)
        self._changed()

    def take(self, poke: Outcome) -> Outcome:
        """Keep a poke as reported, in place of one with its number; return it as a right rig would have reported it."""
        self.reported[poke.poke] = poke
        self._frame(poke)
        return self.corrected(poke.poke)

    def _frame(self, reported: Outcome) -> None:
        self.framed[reported.poke] = self.used[FRAME].correction.corrected(reported) if FRAME in self.used else reported

    def corrected(self, number: int) -> Outcome:
        """Return a poke as a right rig would have reported it."""
        poke = self.framed[number]
        return self.used[RIG].correction.corrected(poke) if RIG in self.used else poke

    def pose(self, link_from_sensor: FloatArray, name: str) -> FloatArray:
        """Return the true (4, 4) link_from_sensor of a reported one."""
        for used in self.used.values():
            link_from_sensor = used.correction.pose(link_from_sensor, name)
        return link_from_sensor

    def of_progress(self, progress: Progress, reported: FloatArray | None, name: str) -> tuple[FloatArray, FloatArray]:
        """Return force (3,), N, and a point of the axis (3,), metres, link frame, of a poke in progress.

        Parameters
        ----------
        reported : (4, 4) float, link_from_sensor of the arm pose of that name; None while unknown
        """
        force, point = progress.force, progress.axis_point
        if not self.used or reported is None or not np.isfinite(point).all() or not force.any():
            return force, point
        # Back into the sensor's frame as reported, corrected there, and out by the pose as it truly is.
        force, moment = move_wrench(np.asarray(np.linalg.inv(reported), dtype=np.float64), force, np.cross(point, force))
        for used in self.used.values():
            force, moment = used.correction.wrench(force, moment)
        force, moment = move_wrench(self.pose(reported, name), force, moment)
        return force, axis_point(force, moment)


def _same(first: Correction, second: Correction) -> bool:
    """Return whether two corrections are the same, with what they do not know."""
    rest = (np.array_equal(getattr(first, name), getattr(second, name)) for name in ("root", "quadratic"))
    return _numbers(first) == _numbers(second) and all(rest)


def used_of(action: Correct) -> UsedCorrection:
    """Return the correction that an action uses, with what speaks for it; InputError as for `correction_of`."""
    ratio = action.ratio or float("nan")
    correction = correction_of(action)
    return UsedCorrection(action.of, correction, action.before, action.after, action.pokes, ratio, action.noisier)


def correction_of(action: Correct) -> Correction:
    """Return the correction that an action names.

    Raises
    ------
    InputError
        Its kind is not known, its numbers are too few or not finite, or its matrix is not regular.
    """
    sizes = (len(action.matrix), len(action.everywhere), len(action.motions))
    wanted = (36, 16, 16 * len(action.poses))
    if action.of not in KINDS or sizes != wanted:
        raise InputError(f"A correction of {action.of!r} with {sizes} numbers; expected {' or '.join(KINDS)}, with {wanted}.")
    of_poses = 6 * len(action.poses) if len(action.poses) <= POSES_KEPT else 0
    size = 36 + len(action.quadratic) + of_poses if action.spread else 0
    if len(action.quadratic) not in (0, 126) or len(action.spread) != size * (size + 1) // 2:
        numbers = f"{len(action.quadratic)} numbers of what is not linear and {len(action.spread)} of its uncertainty"
        raise InputError(f"A correction of {len(action.poses)} arm poses with {numbers}; expected as many as skincal writes.")
    root = np.zeros((size, size))
    root[np.triu_indices(size)] = action.spread
    matrix, everywhere = np.reshape(action.matrix, (6, 6)), np.reshape(action.everywhere, (4, 4))
    motions, quadratic = np.reshape(action.motions, (-1, 4, 4)), np.reshape(action.quadratic, (6, -1))
    misses = np.array([action.before, action.after, action.ratio, action.noisier])
    numbers = (matrix, everywhere, motions, root, quadratic, misses)
    if (
        not all(np.isfinite(values).all() for values in numbers)
        or not abs(np.linalg.det(matrix)) > 0
        or min(action.pokes, action.ratio) < 0
        or action.noisier < 1
    ):
        raise InputError("A correction of the rig is no map of wrenches and poses; expected finite numbers, a regular matrix.")
    if not all(_is_motion(motion) for motion in (everywhere, *motions)):
        raise InputError("A correction of the rig moves a pose by what is no rigid motion; expected a rotation and a shift.")
    return Correction(matrix, everywhere, dict(zip(action.poses, motions, strict=True)), root, quadratic)


def _is_motion(matrix: FloatArray) -> bool:
    """Return whether (4, 4) is a rotation and a shift, within rounding."""
    turn = matrix[:3, :3]
    square = np.allclose(turn @ turn.T, np.eye(3), rtol=0.0, atol=ROUNDING) and np.linalg.det(turn) > 0
    return bool(square and np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]))


def offered(frame: FrameDiagnosis | None, rig: RigAnswer, pokes: int, used: Mapping[str, UsedCorrection]) -> Correct | None:
    """Return the action that uses what landmark pokes offer; None where they offer nothing.

    The sensor's frame comes first: what else was found under a wrong one is worth nothing. Where no wrong frame explains the
    pokes, or it is not sure, the rig's correction comes before: one wild poke does not bend it, and held-out pokes tried it.

    Parameters
    ----------
    pokes : how many landmark pokes there are
    used : corrections that were in use when that was found
    """
    tried = rig.correction if rig.used else None
    if frame is not None and not frame.right and frame.explained and (frame.sure or tried is None):
        found = frame_correction(frame.correction)
        # It was found in the frame that is in use, and takes its place.
        whole = found.after(used[FRAME].correction) if FRAME in used else found
        return correct_action(FRAME, whole, frame.miss, frame.corrected_miss, pokes)
    if tried is None:
        return None
    ratio = 0.0 if np.isnan(rig.ratio) else rig.ratio
    return correct_action(RIG, tried, rig.before, rig.after, pokes, ratio, rig.noisier)


def correct_action(
    of: str, correction: Correction, before: float, after: float, pokes: int, ratio: float = 0.0, noisier: float = 1.0
) -> Correct:
    """Return the action that uses a correction; see `Correct` for the rest."""
    spread = correction.root[np.triu_indices(len(correction.root))].tolist()
    # Six digits of an uncertainty are more than anyone knows, and half of the file.
    root = tuple(float(f"{value:.6g}") for value in spread)
    quadratic = tuple(correction.quadratic.ravel().tolist())
    return Correct(of, *_numbers(correction), before, after, pokes, root, quadratic, ratio, noisier)


def _numbers(correction: Correction) -> tuple[tuple[float, ...], tuple[float, ...], tuple[str, ...], tuple[float, ...]]:
    """Return matrix, motion everywhere, names of the poses that are moved, and their motions, as `Correct` has them."""
    names = tuple(sorted(correction.motions))
    motions = (value for name in names for value in correction.motions[name].ravel().tolist())
    return tuple(correction.matrix.ravel().tolist()), tuple(correction.everywhere.ravel().tolist()), names, tuple(motions)
