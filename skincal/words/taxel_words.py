"""Sentences on the estimates of taxels and their expected errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from skincal.model.errors import plural
from skincal.taxels.result import MISS_MAX, SD_MAX, Cause, StateReason
from skincal.taxels.shared_errors import PredictedError

if TYPE_CHECKING:
    pass


_STATES = {
    Cause.UNPOKED: "No accepted poke touched this taxel.",
    Cause.ONE_AXIS: "One axis only: the depth along it is unknown. Poke once more with another tilt.",
    Cause.ALIKE_AXES: (
        "All {count} axes lie within {degrees:.1f} degrees of one direction: the depth along it {depth} (limit {sd_max}). "
        "Poke with another tilt."
    ),
    Cause.AXES_APART: (
        "The axes pass each other at {mm:.0f} mm from their middle (limit {miss_max}): check the arm poses, or exclude the "
        "wrong pokes."
    ),
    Cause.OPPOSED: "The {count} pokes push from opposite sides: exclude the wrong ones.",
    Cause.NO_TRIANGLE: (
        "No triangle of the surface faces the pokes: check that its normals point outward and the wrench's sign."
    ),
    Cause.OFF_SURFACE: "The axes pass the surface at {mm:.0f} mm (limit {miss_max}): check the mesh's unit and pose.",
    Cause.GRAZING: "The pokes graze the surface, so that their axes do not fix a point on it to {sd_max}: poke steeper.",
    Cause.MODULE_UNPOKED: "No accepted poke touched its module.",
    Cause.MODULE_UNPLACED: (
        "Its module answered only beside others, or the plan does not say where it is: poke its own taxels."
    ),
    Cause.MODULE_OFF: (
        "The axes pass its module at {mm:.0f} mm (limit {miss_max}): check the mesh's unit and pose, the arm poses, and which "
        "channels the module has."
    ),
    Cause.MODULE_MOVING: (
        "Where its module lies does not settle (to {mm:.1f} mm): poke taxels farther apart, with other tilts."
    ),
    Cause.MODULE_BEHIND: "The pokes push its module from behind: check the wrench's sign and the surface's normals.",
    Cause.MODULE_ONE_POKE: "One poke on its module does not tell how that is turned. Poke another of its taxels.",
    Cause.MODULE_LOOSE: ("The {count} pokes on its module {tell} how that lies: poke taxels farther apart, with other tilts."),
    Cause.BY_MODULE: "Not poked itself; known by its module.",
    Cause.SHARED_ERRORS: (
        "With the errors that its pokes share, slow ones and the rig's, it {depth} (limit {sd_max}): poke with other tilts, "
        "and more landmarks."
    ),
    Cause.MEAN_OF_POSES: "Mean of {count} poses{left_out}.",
    Cause.BLIND_IN_POSES: "Blind in each of its {count} poses. In the one with most pokes: {inner}",
    Cause.GIVEN: "{text}",
}
"""Sentences on a taxel's state, filled in by `state_sentence`."""


def state_sentence(reason: StateReason | None) -> str:
    """Return why a taxel's state is what it is; empty for None."""
    if reason is None:
        return ""
    size = reason.size
    return _STATES[reason.cause].format(
        count=reason.count,
        mm=0.0 if size is None else size * 1e3,
        degrees=max(float(np.degrees(reason.angle)), 0.1),
        depth="is unknown" if size is None else f"is known to {_coarse(size)} only",
        tell="do not tell" if size is None else f"tell it to worse than {SD_MAX * 1e3:.0f} mm",
        left_out=f"; {reason.blind} are blind and left out" if reason.blind else "",
        inner=state_sentence(reason.inner),
        text=reason.text,
        miss_max=f"{MISS_MAX * 1e3:.0f} mm",
        sd_max=f"{SD_MAX * 1e3:.0f} mm",
    )


def _coarse(metres: float) -> str:
    return f"{metres * 1e3:.0f} mm" if metres < 1.0 else "over 1 m"


def predicted_words(found: PredictedError, *, apart: bool = True) -> str:
    """Return the predicted error of a skin: `"1.1 mm mean, 1.7 mm worst"`.

    Parameters
    ----------
    apart : also what of it the whole skin and taxels among each other have, where errors are known that all share
    """
    words = f"{found.mean * 1e3:.1f} mm mean, {found.worst * 1e3:.1f} mm worst"
    if not apart or not found.whole:
        return words
    return (
        f"{words}: the whole skin may be off by {found.whole * 1e3:.1f} mm, "
        f"taxels among each other by {found.among * 1e3:.1f} mm"
    )


def error_words(found: PredictedError | None, off: float | None) -> str:
    """Return the predicted error of a skin and what it leaves out; no full stop, since files put it into comments.

    Parameters
    ----------
    found : None where no taxel is known
    off : m, by how much an ordinary rig's own errors move the taxels besides; None where they are predicted, too
    """
    if found is None:
        return "no taxel is known"
    if off is None:
        return predicted_words(found)
    return f"{predicted_words(found, apart=False)}, for a right rig; an ordinary one's own errors add about {off * 1e3:.1f} mm"


def unchecked_sentence(off: float, landmark_pokes: int) -> str:
    """Return by how much the errors of a rig that is not corrected may move the taxels, `off` metres, root mean square.

    `landmark_pokes` is how many were made, which `off` knows of.
    """
    leave = "leaves" if landmark_pokes == 1 else "leave"
    tell = f"{plural(landmark_pokes, 'poke')} at landmarks {leave} that open." if landmark_pokes else "Pokes at landmarks tell."
    return (
        f"The rig's own errors are not in the predicted ones: an ordinary rig's move the taxels by about {off * 1e3:.1f} mm, "
        f"most of it alike. {tell}"
    )
