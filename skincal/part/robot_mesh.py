"""The mesh of a part whose scene has a URDF: that of the URDF, another file in its place, or a file of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from skincal.geometry import FloatArray
from skincal.mesh.readers import read_mesh
from skincal.model.errors import ERROR_SENTENCE_MAX_CHARS, InputError, shortened
from skincal.model.given import MAX_MESH_BYTES, read_regular
from skincal.model.length_units import METRES_PER_UNIT
from skincal.model.mesh_lookup import find_mesh
from skincal.model.scene import SurfaceSpec
from skincal.model.urdf import LinkMesh, Robot
from skincal.part.mesh_units import metres_of_file_unit, name_unit, unit_without_option
from skincal.part.part_draft import IDENTITY_POSE, PartDraft, pose_rows

COLLISION_OFFER_MAX_CHARS = 200
"""The rest of a sentence is for the error."""
VISUAL_MESH_ADVICE = "leave its unit (--unit) out, or save it in its true shape under another name, and give its unit"
COLLISION_MESH_ADVICE = (
    "leave the mesh (--mesh) out, and put it with its <origin> in place of the link's visual shapes, in a copy of the URDF"
)
"""A file under another name would lie where the visual mesh does."""


def find_part_mesh(robot: Robot, draft: PartDraft) -> tuple[SurfaceSpec, str] | None:
    """Find the mesh of a draft with a URDF, and the link whose mesh it is or replaces, empty for a file of its own.

    `None` without a mesh. Raises InputError: the file that the URDF names is not found.
    """
    if draft.mesh is not None and draft.mesh_pose is not None:
        return SurfaceSpec(draft.mesh, METRES_PER_UNIT[draft.unit or "mm"], np.array(draft.mesh_pose), replaces_unit=True), ""
    found = robot.mesh_for(draft.link, _sensor_joint(robot, draft))
    if found is None:
        return None
    mesh, pose = found
    path = draft.mesh or find_mesh(robot, mesh, dict(draft.packages))
    is_own_unit = draft.mesh is not None and draft.unit
    scale, pose = (METRES_PER_UNIT[draft.unit], pose) if is_own_unit else mesh.scale_and_pose(pose, str(robot.path))
    return SurfaceSpec(path, scale, pose, replaces_unit=bool(is_own_unit)), mesh.link


def with_own_mesh(draft: PartDraft, robot: Robot, mesh: Path | None, unit: str, default_unit: str = "") -> PartDraft:
    """Take a mesh file in place of that of the URDF, at its pose; a link without a mesh gets it at the identity.

    A file that the URDF itself names for the link lies where the URDF says.

    Parameters
    ----------
    mesh : `None` for that of the URDF, whose file is taken if a unit is given
    unit : of its numbers; if empty, the URDF's for a file that it names, else `default_unit`, the file's or mm

    Raises
    ------
    InputError
        The URDF mirrors or stretches this very file, and a unit is given or it is the collision mesh; or a unit is given and
        there is no mesh.
    """
    joint = _sensor_joint(robot, draft)
    if mesh is None and unit:
        mesh = _visual_mesh_file(robot, draft, joint)
    if mesh is None:
        return replace(draft, mesh=None, mesh_pose=None, unit="mm")
    for is_collision in (False, True):
        found = robot.mesh_for(draft.link, joint, is_collision=is_collision)
        if found is not None and _is_file_of(robot, found[0], mesh, dict(draft.packages)):
            return _as_in_urdf(draft, *found, mesh, unit, is_collision=is_collision)
    has_place = robot.mesh_for(draft.link, joint) is not None
    return replace(
        draft, mesh=mesh, unit=unit or default_unit or unit_without_option(mesh), mesh_pose=None if has_place else IDENTITY_POSE
    )


def _visual_mesh_file(robot: Robot, draft: PartDraft, sensor_joint: str) -> Path:
    """Find the file of the link's visual mesh, to give it a unit. Raises InputError: there is none, or it is not found."""
    found = robot.mesh_for(draft.link, sensor_joint)
    if found is None:
        raise InputError(
            f"The unit (--unit) is that of a mesh, and {describe_shapes(robot, draft.link, sensor_joint)}; leave it out, or "
            "name the part's mesh (--mesh FILE)."
        )
    return find_mesh(robot, found[0], dict(draft.packages))


def _as_in_urdf(draft: PartDraft, shape: LinkMesh, pose: FloatArray, mesh: Path, unit: str, *, is_collision: bool) -> PartDraft:
    if not is_collision and not unit:
        return replace(draft, mesh=None, mesh_pose=None, unit="mm")
    own = unit or unit_of(shape, mesh)
    if not shape.is_uniform or not own:
        raise InputError(
            f"{mesh}: is the {'collision' if is_collision else 'visual'} mesh of link {shape.link}, and the URDF scales it by "
            f"{shape.scales.tolist()}; {COLLISION_MESH_ADVICE if is_collision else VISUAL_MESH_ADVICE}."
        )
    return replace(draft, mesh=mesh, unit=own, mesh_pose=pose_rows(pose) if is_collision else None)


def unit_of(shape: LinkMesh, file: Path) -> str:
    """Name the unit that a URDF's scale means for a file; empty if it is none."""
    return name_unit(float(shape.scales[0]) * metres_of_file_unit(file))


def offer_collision_mesh(robot: Robot, draft: PartDraft) -> str:
    """Offer the collision mesh in place of a visual mesh that cannot be used, as a sentence; empty if it is no better."""
    found = robot.mesh_for(draft.link, _sensor_joint(robot, draft), is_collision=True)
    if found is None or not found[0].is_uniform:
        return ""
    try:
        path = find_mesh(robot, found[0], dict(draft.packages))
        read_mesh(path, read_regular(path, MAX_MESH_BYTES, what="mesh file"))
        if not unit_of(found[0], path):
            return ""
    except InputError:
        return ""
    named = f'"{path}"' if " " in str(path) else str(path)
    offer = f" Or use the collision mesh of link {found[0].link} as the part's mesh: --mesh {named}"
    return (
        offer
        if len(offer) <= COLLISION_OFFER_MAX_CHARS
        else f" Or use the link's collision mesh, {path.name}, as the part's mesh: --mesh FILE"
    )


def with_offer(error: InputError, offer: str) -> InputError:
    """Add an offer to the sentence of an error, which is shortened so that the offer stays whole."""
    return InputError(shortened(str(error), ERROR_SENTENCE_MAX_CHARS - len(offer)) + offer)


def describe_shapes(robot: Robot, link: str, sensor_joint: str) -> str:
    """Describe the shapes of a link and of links that are fixed to it, such as `link forearm has visual cylinder`."""
    frames = robot.fixed_frames(link, sensor_joint)
    words = [f"link {name} has {', '.join(robot.shapes[name])}" for name in frames if name in robot.shapes]
    return "; ".join(words) or f"link {link} has no shape"


def _is_file_of(robot: Robot, shape: LinkMesh, mesh: Path, packages: Mapping[str, Path]) -> bool:
    try:
        return find_mesh(robot, shape, packages).resolve() == mesh.resolve()
    except InputError:
        return False


def _sensor_joint(robot: Robot, draft: PartDraft) -> str:
    return robot.sensor_named(draft.sensor, str(robot.path)).joint if draft.sensor else ""
