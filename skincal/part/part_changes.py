"""Changes of a part draft that other entries depend on: another file, another frame, another unit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from skincal.files.layout_sources import parse_layout
from skincal.geometry import FloatArray, inverse_pose
from skincal.mesh.readers import MESH_SUFFIXES
from skincal.model.skin import Anchor
from skincal.model.urdf import Robot, read_urdf
from skincal.part.layout_placing import with_module_anchor
from skincal.part.mesh_units import choose_unit, has_no_unit
from skincal.part.part_draft import (
    METRE_DIGITS,
    UNIT_DIGITS,
    AnchorDraft,
    LandmarkDraft,
    PartDraft,
    layout_file_of,
    pose_rows,
    rounded,
)
from skincal.part.robot_mesh import with_own_mesh


def with_part_file(draft: PartDraft, path: Path) -> PartDraft:
    """Take another mesh or URDF; everything that depended on the old one is dropped.

    Raises InputError: the file cannot be read.
    """
    fresh = without_places(
        replace(
            draft, urdf=None, mesh=None, is_unit_guessed=False, link="part", sensor="", joints=(), fixed=(), packages=(),
            mesh_pose=None, sensor_pose=None, has_dh_arm=False,
        )
    )  # fmt: skip
    if path.suffix.lower() in MESH_SUFFIXES:
        return replace(
            fresh, mesh=path, unit=choose_unit(path), is_unit_guessed=has_no_unit(path), name=draft.name or path.stem
        )
    robot = read_urdf(path)
    fresh = replace(fresh, urdf=path, link="")
    return with_link(fresh, robot, next(iter(robot.meshes))) if len(robot.meshes) == 1 else fresh


def with_unit(draft: PartDraft, unit: str) -> PartDraft:
    """Read the mesh in another unit; points that were clicked on it are dropped, and a sensor that was placed by them."""
    if unit == draft.unit:
        return replace(draft, is_unit_guessed=False)
    changed = replace(draft, unit=unit, is_unit_guessed=False)
    return without_places(replace(changed, sensor_pose=draft.sensor_pose if draft.urdf else None))


def with_link(draft: PartDraft, robot: Robot, link: str) -> PartDraft:
    """Choose another link, or another frame of the same one: then points on the part are converted, else dropped.

    The sensor nearest to the part is chosen, unless the present one is between part and base, too.
    """
    changed = replace(draft, link=link)
    if draft.mesh is not None:
        changed = with_own_mesh(changed, robot, draft.mesh, draft.unit)
    frames = robot.fixed_frames(draft.link) if draft.link in robot.links else {}
    if link not in frames:
        between = sensors_between(robot, link)
        sensor = draft.sensor if draft.sensor in between else next(iter(between), "")
        return without_places(replace(changed, joints=(), sensor=sensor))
    pose = inverse_pose(frames[link])
    text = draft.layout_text
    for module in parse_layout(text, layout_file_of(draft)).modules if text else ():
        if module.anchor is not None:
            text = with_module_anchor(text, module.id, _moved_anchor(module.anchor, pose))
    return replace(
        changed,
        mesh_pose=changed.mesh_pose if draft.mesh_pose is None else pose_rows(pose @ np.array(draft.mesh_pose)),
        anchor=None if draft.anchor is None else _moved_anchor(draft.anchor.anchor(), pose),
        layout_text=text,
        landmarks=tuple(_moved_landmark(mark, pose) for mark in draft.landmarks),
    )


def sensors_between(robot: Robot, link: str) -> list[str]:
    """List the force/torque sensors between a link and the robot's base, the nearest first: they feel pokes on the link."""
    path = [joint.name for joint in robot.path_to_root(link)]
    found = [sensor for sensor in robot.sensors if robot.feels(sensor, link)]
    places = {name: place for place, name in enumerate(path)}
    return [sensor.name for sensor in sorted(found, key=lambda sensor: places.get(sensor.joint, len(path)))]


def without_places(draft: PartDraft) -> PartDraft:
    """Drop the points on the part: anchors and landmarks."""
    text = draft.layout_text
    for module in parse_layout(text, layout_file_of(draft)).modules if text else ():
        if module.anchor is not None:
            text = with_module_anchor(text, module.id, None)
    return replace(draft, anchor=None, layout_text=text, landmarks=())


def _moved_anchor(anchor: Anchor, pose: FloatArray) -> AnchorDraft:
    turn = pose[:3, :3]
    point = turn @ anchor.point + pose[:3, 3]
    return AnchorDraft.from_anchor(Anchor(anchor.at, point, turn @ anchor.x, turn @ anchor.normal))


def _moved_landmark(mark: LandmarkDraft, pose: FloatArray) -> LandmarkDraft:
    turn = pose[:3, :3]
    return replace(
        mark,
        place=rounded(turn @ np.array(mark.place) + pose[:3, 3], METRE_DIGITS),
        normal=None if mark.normal is None else rounded(turn @ np.array(mark.normal), UNIT_DIGITS),
    )
