"""A new scene by one command: it completes the draft of a part, and writes it.

The window's page for parts makes the same file step by step (`part_draft.py`).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from skincal.geometry import FloatArray
from skincal.mesh.lay import ANCHOR_TO_SURFACE_MAX_M
from skincal.model.errors import InputError
from skincal.model.scene import Scene, load_scene
from skincal.model.tool_rig import BASE_LINK
from skincal.model.urdf import Robot, read_urdf
from skincal.part.draft_preview import PartPreview, PartPreviewer, completed_draft, propose_anchor
from skincal.part.layout_placing import anchor_at
from skincal.part.mesh_units import unit_without_option
from skincal.part.part_draft import AnchorDraft, PartDraft, save_draft
from skincal.part.robot_mesh import with_own_mesh
from skincal.part.tool_draft import Rig
from skincal.words.units import millimetres

PROPOSED_POINT = "position of the layout: the middle of the largest face{away}; move it"
UNKNOWN_SIGN = "the URDF does not say; -1 if the sensor reports the reaction force"


def write_scene(draft: PartDraft, out: Path, anchor_mm: FloatArray | None = None) -> Scene:
    """Write the scene file of a new part, with its layout and its robot; return the scene as it reads.

    Parameters
    ----------
    draft : without an anchor; `unit` is what the user typed, or empty
    anchor_mm : (3,) mm, link frame: position of the layout's middle; `None` for that of `propose_anchor`

    Raises
    ------
    InputError
        A file cannot be read or written, a file is there already, or a name is missing or not in the URDF.
    """
    _check_sources(draft, out)
    robot = None if draft.urdf is None else read_urdf(draft.urdf)
    if robot is None and not draft.unit and draft.mesh is not None:
        draft = replace(draft, unit=unit_without_option(draft.mesh))
    is_below = draft.rig is Rig.BELOW
    if robot is not None:
        _check_names(draft, robot)
        draft = with_own_mesh(draft, robot, draft.mesh, draft.unit)
    _check_skin_and_tip(draft, out)
    preview = PartPreviewer(has_lists=False).preview(replace(draft, name=out.resolve().parent.name or draft.link), {})
    if "part" in preview.problems and not preview.is_meshless:
        raise InputError(preview.problems["part"])
    if "skin" in preview.problems:
        raise InputError(preview.problems["skin"])
    if not is_below and "sensor" in preview.problems:
        raise InputError(f"{out}: {preview.problems['sensor']}")
    if not (
        is_below or draft.link == BASE_LINK or preview.surface is not None or (draft.layout_text and anchor_mm is not None)
    ):
        raise InputError(
            f"{out}: nothing shows the pose of the part; name its mesh (--mesh) or the place of the layout (--anchor-mm), or "
            f"write --link {BASE_LINK} for positions in the base of the tool's poses."
        )
    part, comments = completed_draft(preview), dict[tuple[str, ...], str]()
    if robot is not None and is_below:
        fixed = {name: float(np.radians(degrees)) for name, degrees in part.fixed}
        robot.chain(part.link, part.sensor, part.joints, fixed, str(robot.path))
    if preview.layout is not None and (preview.surface is not None or anchor_mm is not None):
        part = replace(part, anchor=_anchor(preview, anchor_mm))
        if anchor_mm is None:
            comments["skin", "anchor"] = PROPOSED_POINT.format(away=" away from the sensor" if is_below else "")
    if draft.urdf is not None and is_below and part.sign is None and preview.sign is None:
        part = replace(part, sign=1)
        comments["wrench", "sign"] = UNKNOWN_SIGN
    save_draft(part, out, comments)
    return load_scene(out)


def _anchor(preview: PartPreview, point_mm: FloatArray | None) -> AnchorDraft:
    """Place the layout's middle at a point, (3,) mm; without one as the window proposes it."""
    surface, layout, pose = preview.surface, preview.layout, preview.sensor_pose
    assert layout is not None
    if point_mm is None:
        return AnchorDraft.from_anchor(propose_anchor(layout, surface, None if pose is None else pose[:3, 3]))
    point = point_mm * 1e-3
    anchor = anchor_at(surface, layout, point, None)
    gap = float(np.linalg.norm(anchor.point - point))
    if gap > ANCHOR_TO_SURFACE_MAX_M:
        most = ANCHOR_TO_SURFACE_MAX_M * 1e3
        raise InputError(
            f"--anchor-mm is {millimetres(gap)} from the mesh; at most {most:.0f} mm was expected: check point, frame and "
            "the mesh's unit."
        )
    return AnchorDraft.from_anchor(anchor)


def _check_sources(draft: PartDraft, out: Path) -> None:
    """Raise InputError: an option needs a URDF or a mesh that is not named."""
    of_urdf = {"--sensor": draft.sensor, "--joints": draft.joints, "--fixed": draft.fixed, "--package": draft.packages}
    given = next((option for option, value in of_urdf.items() if value and draft.urdf is None), None)
    if given is not None:
        raise InputError(f"{out}: {given} is of a robot's URDF; name it by --urdf, or leave {given} out.")
    if draft.unit and draft.urdf is None and draft.mesh is None:
        raise InputError(f"{out}: --unit is of a mesh; name it by --mesh, or leave --unit out.")


def _check_skin_and_tip(draft: PartDraft, out: Path) -> None:
    """Raise InputError: the width of a skin frame, or the tip of a rig without a sensor, is missing."""
    if not draft.layout_text and draft.channels is None:
        raise InputError(f"{out}: say how many values a frame of the skin has (--channels), or name its layout.")
    if draft.rig is Rig.NONE and draft.tool.tip_mm is None:
        raise InputError(
            f"{out}: --sensor none has no --tip, which alone says where a poke is without a force sensor; add --tip X,Y,Z, mm "
            "in the frame of the poses (`skincal tool` finds it from touches of one point)."
        )


def _check_names(draft: PartDraft, robot: Robot) -> None:
    """Raise InputError: the sensor is missing, or a name is not in the URDF."""
    is_below = draft.rig is Rig.BELOW
    if is_below and not draft.sensor:
        raise InputError(
            f"{robot.path}: name the force/torque sensor (--sensor); {_list_sensors(robot)}. If it is on the tool that pokes, "
            "write --sensor tool, and for a rig without one --sensor none."
        )
    robot.require_link(draft.link, str(robot.path))
    if is_below:
        robot.sensor_named(draft.sensor, str(robot.path))
    _require_joints(robot, [name for name, _ in draft.fixed])


def _require_joints(robot: Robot, fixed: list[str]) -> None:
    unknown = next((name for name in fixed if name not in robot.joints), None)
    if unknown is not None:
        raise InputError(f"--fixed {unknown}: {robot.path.name} has no joint {unknown!r}; expected joints of the URDF.")


def _list_sensors(robot: Robot) -> str:
    names = [sensor.name for sensor in robot.sensors]
    return f"it has {', '.join(names)}" if names else "it has none: name a joint or a link at the sensor"
