"""Corrections of the rig that the operator uses: checked, applied, and written as actions.

There are two kinds, one of each at most: of the sensor's frame, then of the rig's small errors. The second was found under that
frame, so it ends when the frame changes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.outcome import Progress
from skincal.geometry import FloatArray, axis_point, move_wrench
from skincal.model.actions import Correct, Uncorrect
from skincal.model.errors import InputError
from skincal.rig.correction import FRAME, MAX_ARM_POSES_WITH_UNCERTAINTY, RIG, Correction, UsedCorrection

if TYPE_CHECKING:
    from skincal.rig.correction_fit import RigAnswer
    from skincal.rig.frame_check import FrameDiagnosis

ROTATION_MATRIX_TOLERANCE = 1e-9
"""Largest error of a rotation's product with its transpose."""
CORRECTED_THINGS = {FRAME: "the sensor's frame", RIG: "the rig"}
"""Names for the operator of what each kind of correction is of."""


def with_correction(used: Mapping[str, UsedCorrection], action: Correct) -> dict[str, UsedCorrection]:
    """Use a correction, in place of one of its kind; InputError if it makes no sense or is in use already."""
    new = used_of(action)
    if action.of in used and _same(used[action.of].correction, new.correction):
        raise InputError(f"That correction of {CORRECTED_THINGS[action.of]} is in use already.")
    return {**_independent_of(used, action.of), action.of: new}


def without_correction(used: Mapping[str, UsedCorrection], action: Uncorrect) -> dict[str, UsedCorrection]:
    """Stop using a correction; InputError if none of its kind is in use."""
    if action.of not in used:
        raise InputError(f"No correction of {action.of!r} is in use; expected one of {', '.join(used) or 'none'}.")
    return _independent_of(used, action.of)


def _independent_of(used: Mapping[str, UsedCorrection], of: str) -> dict[str, UsedCorrection]:
    # The rig's correction was found under the frame that was in use, and holds under no other.
    return {FRAME: used[FRAME]} if of == RIG and FRAME in used else {}


def corrected_pose(link_from_sensor: FloatArray, name: str, used: Mapping[str, UsedCorrection]) -> FloatArray:
    """Correct a reported (4, 4) link_from_sensor."""
    for each in used.values():
        link_from_sensor = each.correction.pose(link_from_sensor, name)
    return link_from_sensor


def corrected_progress(
    progress: Progress, reported: FloatArray | None, name: str, used: Mapping[str, UsedCorrection]
) -> Progress:
    """Correct force and axis of a poke in progress.

    Parameters
    ----------
    reported : (4, 4) float, link_from_sensor of the arm pose `name`; `None` while unknown
    """
    force, point = progress.force, progress.axis_point
    if not used or reported is None or not np.isfinite(point).all() or not force.any():
        return progress
    # Back into the sensor's frame as reported, corrected there, and out by the pose as it truly is.
    force, moment = move_wrench(np.asarray(np.linalg.inv(reported), dtype=np.float64), force, np.cross(point, force))
    for each in used.values():
        force, moment = each.correction.wrench(force, moment)
    force, moment = move_wrench(corrected_pose(reported, name, used), force, moment)
    return replace(progress, force=force, axis_point=axis_point(force, moment))


def _same(first: Correction, second: Correction) -> bool:
    """Whether two corrections are the same, with their uncertainty."""
    rest = (np.array_equal(getattr(first, name), getattr(second, name)) for name in ("root", "quadratic"))
    return _numbers(first) == _numbers(second) and all(rest)


def used_of(action: Correct) -> UsedCorrection:
    """Make the correction of an action, with its evidence; `InputError` as for `correction_of`."""
    ratio = action.ratio or float("nan")
    correction = correction_of(action)
    return UsedCorrection(action.of, correction, action.before, action.after, action.pokes, ratio, action.noisier)


def correction_of(action: Correct) -> Correction:
    """Make the correction of an action.

    Raises
    ------
    InputError
        Its kind is unknown, numbers are missing or not finite, or its matrix is singular.
    """
    sizes = (len(action.matrix), len(action.everywhere), len(action.motions))
    wanted = (36, 16, 16 * len(action.poses))
    if action.of not in CORRECTED_THINGS or sizes != wanted:
        raise InputError(
            f"A correction of {action.of!r} with {sizes} numbers; expected {' or '.join(CORRECTED_THINGS)}, with {wanted}."
        )
    of_poses = 6 * len(action.poses) if len(action.poses) <= MAX_ARM_POSES_WITH_UNCERTAINTY else 0
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
    """Whether (4, 4) is a rotation and a shift, within rounding."""
    turn = matrix[:3, :3]
    square = np.allclose(turn @ turn.T, np.eye(3), rtol=0.0, atol=ROTATION_MATRIX_TOLERANCE) and np.linalg.det(turn) > 0
    return bool(square and np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]))


def offered(frame: FrameDiagnosis | None, rig: RigAnswer, pokes: int, used: Mapping[str, UsedCorrection]) -> Correct | None:
    """Choose the correction that landmark pokes offer; `None` without one.

    The sensor's frame comes first: other findings under a wrong frame are worthless. If no wrong frame explains the pokes, or
    it is not sure, the rig's correction comes first: it was tested on held-out pokes, and one wild poke does not bend it.

    Parameters
    ----------
    pokes : number of landmark pokes
    used : corrections that were in use at that time
    """
    if frame is not None and not frame.right and frame.wrench_frame:
        return None  # it would hide that the wrench is in another frame
    tried = rig.usable
    if frame is not None and not frame.right and frame.explained and (frame.sure or tried is None):
        found = frame.mistake.correction
        # It was found on top of the frame correction in use, and replaces it.
        whole = found.after(used[FRAME].correction) if FRAME in used else found
        return correct_action(UsedCorrection(FRAME, whole, frame.miss, frame.corrected_miss, pokes))
    if tried is None:
        return None
    return correct_action(UsedCorrection(RIG, tried, rig.before, rig.after, pokes, rig.ratio, rig.noisier))


def correct_action(used: UsedCorrection) -> Correct:
    """Make the action that uses a correction; see `Correct`."""
    correction, ratio = used.correction, 0.0 if np.isnan(used.ratio) else used.ratio
    spread = correction.root[np.triu_indices(len(correction.root))].tolist()
    # Six digits suffice for an uncertainty, and halve the file.
    root = tuple(float(f"{value:.6g}") for value in spread)
    quadratic = tuple(correction.quadratic.ravel().tolist())
    of_pokes = used.before, used.after, used.pokes
    return Correct(used.of, *_numbers(correction), *of_pokes, root, quadratic, ratio, used.noisier)


def _numbers(correction: Correction) -> tuple[tuple[float, ...], tuple[float, ...], tuple[str, ...], tuple[float, ...]]:
    """Flatten matrix, common motion, names of moved poses and their motions, as in `Correct`."""
    names = tuple(sorted(correction.motions))
    motions = (value for name in names for value in correction.motions[name].ravel().tolist())
    return tuple(correction.matrix.ravel().tolist()), tuple(correction.everywhere.ravel().tolist()), names, tuple(motions)
