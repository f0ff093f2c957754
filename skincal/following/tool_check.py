"""The check of a scene with a tool: mistakes that pokes at planned taxels show, then those that touches of the tip show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skincal.geometry import inverse_pose
from skincal.mesh.lay import PlacedLayout
from skincal.mesh.surface import Surface
from skincal.model.pose_form import PoseForm, RotationForm
from skincal.model.scene import Scene
from skincal.model.wrench_frames import WrenchFrame
from skincal.rig.correction import FRAME, rigid_motion
from skincal.rig.push_side import find_side_mistake
from skincal.rig.scene_mistakes import Mistake, MistakeKind
from skincal.rig.setup_check import SetupDiagnosis, check_setup
from skincal.rig.touch_mistakes import (
    LANDMARK_TOUCH_SD_M,
    PLANNED_TOUCH_SD_M,
    TouchedPlaces,
    find_touch_mistake,
)
from skincal.session.snapshot import Snapshot


def check_tool_setup(
    snapshot: Snapshot,
    scene: Scene,
    laid: PlacedLayout | None,
    surface: Surface | None,
    frames: Sequence[WrenchFrame] = (),
) -> SetupDiagnosis | None:
    """Look for mistakes of a scene, with `[tool]` or without; `None` if nothing can be checked.

    Parameters
    ----------
    scene : as its file says
    laid : the scene's layout on the part
    frames : that the messages of the wrench name
    """
    found = None
    if snapshot.is_placed:
        found = check_setup(snapshot.contacts, snapshot.placed_scene(scene), laid, surface, frames)
        side = find_side_mistake(snapshot.contacts, scene, laid, is_pose_found=snapshot.part_pose is not None)
        if side is not None and (found is None or not found.mistakes or found.mistakes[0].is_reaction):
            return SetupDiagnosis(len(snapshot.contacts), 0.0, (side,), of_touches=True)
    is_named = found is not None and any(each.kind is not MistakeKind.TOOL_UNEXPLAINED for each in found.mistakes)
    if scene.tool is None or is_named:
        return found
    touched = touched_places(snapshot, scene, laid)
    by_touches = None if touched is None else find_touch_mistake(touched)
    turned = None if by_touches is not None else find_turned_sensor(snapshot, scene)
    if turned is not None:
        return SetupDiagnosis(len(snapshot.contacts), 0.0, (turned,), of_touches=True)
    if touched is None or by_touches is None:
        misfit = snapshot.part_misfit
        mistake = None if misfit is None else misfit.explain()
        if misfit is None or mistake is None:
            return found
        return SetupDiagnosis(len(misfit.pokes), 0.0, (mistake,), of_touches=True)
    return SetupDiagnosis(len(touched.number), by_touches.miss, (by_touches.mistake,), of_touches=True)


def find_turned_sensor(snapshot: Snapshot, scene: Scene) -> Mistake | None:
    """Find a sensor that is turned on the flange, by the weight of the tool; `None` without, and under a correction."""
    tool, part = scene.tool, snapshot.part_pose
    if tool is None or not tool.has_sensor or FRAME in snapshot.decisions.corrections:
        return None
    known = [(each.link_from_sensor, each.rest_wrench) for each in snapshot.contacts if each.rest_wrench is not None]
    if not known:
        return None
    from skincal.rig.sensor_turn import find_sensor_turn  # other rigs do without

    is_carried = part is not None and part.is_known
    into_base = inverse_pose(part.link_from_base if part is not None and is_carried else tool.link_from_base)
    found = find_sensor_turn(
        np.array([(into_base @ pose)[:3, :3] for pose, _ in known]), np.array([wrench[:3] for _, wrench in known])
    )
    if found is None:
        return None
    return Mistake(MistakeKind.TOOL_SENSOR_TURNED, motion=rigid_motion(found.turn, np.zeros(3)))


def touched_places(snapshot: Snapshot, scene: Scene, laid: PlacedLayout | None) -> TouchedPlaces | None:
    """Gather touches of landmarks and of planned taxels, in the base; `None` without a tip."""
    tool, part, marked = scene.tool, snapshot.part_pose, snapshot.counting_landmark_pokes
    if tool is None or tool.tip is None:
        return None
    is_carried = part is not None and part.is_known
    into_base = inverse_pose(part.link_from_base if part is not None and is_carried else tool.link_from_base)
    into_tool = inverse_pose(tool.tool_from_sensor)
    every = [(int(poke), pose, place, LANDMARK_TOUCH_SD_M) for poke, pose, place in zip(
        marked.number.tolist(), marked.link_from_sensor, marked.place, strict=True
    )]  # fmt: skip
    for contact in snapshot.contacts:
        place = None if laid is None else laid.places[contact.strongest_channel]
        if place is not None and np.isfinite(place).all() and contact.poke not in snapshot.at_landmarks:
            every.append((contact.poke, contact.link_from_sensor, place, PLANNED_TOUCH_SD_M))
    if not every:
        return None
    numbers, poses, places, sds = zip(*sorted(every, key=lambda each: each[0]), strict=True)
    return TouchedPlaces(
        np.array(numbers, dtype=np.int64),
        np.array([into_base @ pose @ into_tool for pose in poses]),
        np.array(places, dtype=np.float64),
        np.array(sds, dtype=np.float64),
        tool.tip,
        tool.form or PoseForm(RotationForm.QUATERNION_XYZW),
    )
