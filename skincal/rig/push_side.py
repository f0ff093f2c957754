"""Side of the skin from which a tool pushes: an inverted sign of the wrench, and the mirror image of a flat layout.

While the pokes show the part's pose, a flat layout and its mirror image fit the same pokes: the pose of the image is upside
down, and all pushes come from inside. A wrench with the wrong sign looks the same. A tool cannot pull, so the taxels lie ahead
of its sensor along the true push. That tells the two apart, also where both hide each other and everything seems to fit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.mesh.lay import PlacedLayout
from skincal.model.scene import Scene
from skincal.pokes import Pokes
from skincal.rig.scene_mistakes import Mistake, MistakeKind
from skincal.rig.setup_check import FORCE_BY_SIGN, SETUP_CHECK_MIN_POKES

MIN_SHARE_OF_POKES = 0.8
"""Share of the pokes on one side: a push past a rim may seem to come from inside."""
MIN_LEVER_M = 0.02
"""m along the push between a tool's sensor and the taxels, from which on the sensor is certainly behind or ahead of them."""


def find_side_mistake(
    contacts: Sequence[Contact], scene: Scene, laid: PlacedLayout | None, *, is_pose_found: bool
) -> Mistake | None:
    """Find the mistake that the side of the tool shows; `None` without a tool, or if the pushes are right or undecided.

    Parameters
    ----------
    contacts : in the frame of the link
    laid : the layout on the part
    is_pose_found : whether the pokes show the part's pose: that of a mirrored layout is upside down then
    """
    if scene.tool is None or laid is None:
        return None
    planned = [each for each in contacts if np.isfinite(laid.places[each.strongest_channel]).all()]
    if len(planned) < SETUP_CHECK_MIN_POKES:
        return None
    pokes, channels = Pokes.collect(planned), [each.strongest_channel for each in planned]
    push = pokes.direction
    if scene.has_sensor:
        ahead = np.sum(push * (laid.places[channels] - pokes.link_from_sensor[:, :3, 3]), axis=1)
        if np.mean(ahead < -MIN_LEVER_M) >= MIN_SHARE_OF_POKES:
            return Mistake(MistakeKind.AXES, axes=-np.eye(3), names=FORCE_BY_SIGN[:: scene.wrench_sign])
        if np.mean(ahead > MIN_LEVER_M) < MIN_SHARE_OF_POKES:
            return None
    is_from_inside = np.sum(push * laid.normals[channels], axis=1) > 0.0
    if is_pose_found and np.mean(is_from_inside) >= MIN_SHARE_OF_POKES:
        return Mistake(MistakeKind.LAYOUT, mirrored=True)
    return None
