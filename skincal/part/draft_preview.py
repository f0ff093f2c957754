"""Preview of a draft: mesh, sensor, joints and placed layout, and sentences about missing or wrong things.

`PartPreviewer` keeps what it read, so that a change costs only what depends on it. It is used in one thread.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from skincal.files.layout_sources import parse_layout
from skincal.geometry import Arm, FloatArray
from skincal.mesh.findings import FindingKind
from skincal.mesh.laid_check import LaidFindings, examine_layout, landmark_findings
from skincal.mesh.lay import PlacedLayout, anchor_remarks, place_layout
from skincal.mesh.load import MeshSizeError, load_surface
from skincal.mesh.surface import Surface, entry_points
from skincal.model.errors import InputError
from skincal.model.length_units import METRES_PER_UNIT
from skincal.model.scene import ContactSettings, SurfaceSpec, load_scene
from skincal.model.skin import Anchor, Layout
from skincal.model.urdf import Robot, read_urdf
from skincal.model.urdf_chain import TURNING_JOINT_KINDS, UrdfChain
from skincal.part.layout_placing import anchor_at
from skincal.part.part_draft import PartDraft, layout_file_of
from skincal.part.robot_copy import RobotFiles, list_robot_files
from skincal.part.robot_mesh import describe_shapes, find_part_mesh, offer_collision_mesh, with_offer
from skincal.part.robot_shape import RobotShape, link_poses, load_robot_shape, middle_angles, missing_packages
from skincal.part.tool_draft import Rig, tool_problem
from skincal.words.robot_words import replaced_mesh_findings, sensor_findings

KeptResult = TypeVar("KeptResult")
UNREPORTED_FINDINGS = (FindingKind.SIZE, FindingKind.MERGED, FindingKind.SLIVERS)
"""Findings about a mesh that change nothing for the person: the size is shown anyway."""
NOT_PLACED = "The layout is shown on the part, but not placed yet: click where its middle lies, or drag it."
OTHER_UNIT = "Choose another unit in the list Unit."
OTHER_MESH = "Correct its scale in the URDF, or name a copy of it in the field Mesh and choose the unit in the list Unit."
FIRST_SIDE = (0.83, 0.42, 0.36)
"""Unit, link frame: the side of a part that is seen first."""
FIRST_SIDE_BONUS = 0.05
"""Added to a side's share of the largest area, per cosine to `FIRST_SIDE`: it decides between faces of about equal size."""
MIDDLE_MIN_GAP_SHARE = 0.5
"""The middle of a part is taken if it is at least this share as far from the border as the best point."""
INNER_POINT_MAX_TRIANGLES = 400
"""Triangles that are looked through for a point far from the border of a face."""
FREE_FACE_MIN_COSINE = 0.7
"""A triangle belongs to a side towards which it faces within 45 degrees."""
WARN_OF_SENSOR_TILT_FROM_DEG = 0.5
"""Of a sensor against the axes of the part: most flanges are parallel to one."""
CACHED_RESULTS_PER_KIND = 8
"""Kept results of each kind of work."""


@dataclass(frozen=True, slots=True)
class JointState:
    """A moving joint between sensor and part."""

    name: str
    column: int
    """Of the joint stream."""
    angle: float
    """rad, shown now."""
    limits: tuple[float, float] | None
    """rad; `None` if it turns without end, or its limits are unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class PartPreview:
    """What the builder shows of a draft: mesh, sensor pose, placed layout and findings."""

    draft: PartDraft
    robot: Robot | None = None
    shape: RobotShape | None = None
    link_poses: Mapping[str, FloatArray] = field(default_factory=dict[str, FloatArray])
    """(4, 4) float, metres: all links in the part's link."""
    robot_files: RobotFiles | None = None
    """Files that a copy of the robot has."""
    missing_packages: tuple[str, ...] = ()
    """ROS packages whose meshes are not found."""
    mesh_link: str = ""
    """Link of the URDF whose mesh the part has."""
    is_meshless: bool = False
    """Neither the link nor one that is fixed to it has a mesh."""
    surface: Surface | None = None
    size_mm: tuple[float, float, float] | None = None
    """Sides of the mesh's box."""
    sensors: Mapping[str, FloatArray] = field(default_factory=dict[str, FloatArray])
    """(4, 4) float, metres: the URDF's force/torque sensors in the part's link."""
    sensor_pose: FloatArray | None = None
    """(4, 4) float, metres: the chosen sensor in the part's link; `None` while it is unknown."""
    sign: int | None = None
    """Of the wrench, by the URDF; `None` if it does not say."""
    joints: tuple[JointState, ...] = ()
    layout: Layout | None = None
    laid: PlacedLayout | None = None
    proposed_anchor: Anchor | None = None
    """Where the layout is shown while the draft does not place it; `None` if it does."""
    laid_findings: LaidFindings | None = None
    problems: Mapping[str, str] = field(default_factory=dict[str, str])
    """Sentence about what cannot be used, by the step that mends it: part, sensor, joints, skin, place."""
    findings: Mapping[str, tuple[str, ...]] = field(default_factory=dict[str, tuple[str, ...]])
    """Remarks, by step."""


def joints_in_order(chain: UrdfChain) -> list[str]:
    """List the joints whose angles are needed from the sensor to the part; a mimic joint needs that of its leader."""
    moving = {joint.name for joint in chain.moving}
    return list(dict.fromkeys(step.driver for step in reversed(chain.steps) if step.driver in moving))


class PartPreviewer:
    """Makes previews of drafts, one after another.

    Parameters
    ----------
    has_lists : advice names the lists and fields of the window, not the options of a command
    """

    def __init__(self, *, has_lists: bool = True) -> None:
        self.has_lists = has_lists
        self._kept: dict[Callable[..., Any], dict[Hashable, Any]] = {}

    def preview(self, draft: PartDraft, angles: Mapping[str, float]) -> PartPreview:
        """Make the preview of a draft.

        Parameters
        ----------
        angles : rad, shown angles of joints, by name; others are at 0 or their nearest limit
        """
        # With a tool no sensor of the URDF is below the part.
        work = _Work(self, draft if draft.rig is Rig.BELOW else replace(draft, sensor="", joints=(), fixed=()), angles)
        for step in (work.read_part, work.find_sensor, work.lay_skin, work.check_landmarks):
            step()
        return PartPreview(draft, problems=work.problems, findings=work.findings, **work.values)

    def once(self, make: Callable[..., KeptResult], *key: Hashable) -> KeptResult:
        """Call `make(*key)`, or return the result of an earlier call."""
        kept = self._kept.setdefault(make, {})
        if key not in kept:
            while len(kept) >= CACHED_RESULTS_PER_KIND:
                del kept[next(iter(kept))]
            kept[key] = make(*key)
        return kept[key]


class _Work:
    """Computation of one preview of a draft."""

    def __init__(self, previewer: PartPreviewer, draft: PartDraft, angles: Mapping[str, float]) -> None:
        self.once, self.draft, self.angles, self._has_lists = previewer.once, draft, angles, previewer.has_lists
        self.values: dict[str, Any] = {}
        self.problems: dict[str, str] = {}
        self.findings: dict[str, tuple[str, ...]] = {}

    def read_part(self) -> None:
        """Read the URDF with its shape, and the mesh of the part."""
        draft = self.draft
        try:
            if draft.urdf is not None:
                self._read_robot(draft.urdf)
            elif draft.mesh is not None:
                pose = np.eye(4) if draft.mesh_pose is None else np.array(draft.mesh_pose)
                self._load_mesh(SurfaceSpec(draft.mesh, METRES_PER_UNIT[draft.unit or "mm"], pose, replaces_unit=True))
        except InputError as error:
            self.problems["part"] = str(error)

    def _read_robot(self, path: Path) -> None:
        draft, packages = self.draft, dict(self.draft.packages)
        robot = self.once(_read_robot, path)
        shape = self.once(_load_shape, path, self.draft.packages)
        files = self.once(_list_files, path, self.draft.packages)
        self.values |= {"robot": robot, "shape": shape, "robot_files": files}
        self.values["missing_packages"] = tuple(missing_packages(robot, packages))
        self._find_joints(robot)
        angles = {**middle_angles(robot), **self.angles}
        root = draft.link if draft.link in robot.links else robot.links[0]
        self.values["link_poses"] = link_poses(robot, angles, root)
        self.findings["part"] = shape.findings
        if draft.link not in robot.links:
            self.problems["part"] = "Choose the link that carries the skin: click it, or choose it in the list."
            return
        try:
            found = find_part_mesh(robot, draft)
            if found is None:
                joint = robot.sensor_named(draft.sensor, "").joint if draft.sensor else ""
                seen = describe_shapes(robot, draft.link, joint)
                self.values["is_meshless"] = True
                self.problems["part"] = f"No mesh: {seen}. Choose another link, or the file of its mesh."
                return
            spec, self.values["mesh_link"] = found
            self._load_mesh(spec)
            if spec.replaces_unit and self.values["mesh_link"]:
                words = replaced_mesh_findings(robot.meshes[self.values["mesh_link"]], spec.path)
                self.findings["part"] += tuple(f"{each[0].upper()}{each[1:]}." for each in words)
        except InputError as error:
            offer = "" if draft.mesh is not None else offer_collision_mesh(robot, draft)
            raise with_offer(error, offer) from None

    def _load_mesh(self, spec: SurfaceSpec) -> None:
        rows = tuple(tuple(float(value) for value in row) for row in spec.link_from_mesh)
        try:
            surface, findings = self.once(_load_surface, spec.path, spec.scale, rows, spec.replaces_unit)
        except MeshSizeError as error:
            if not self._has_lists:
                raise
            advice = OTHER_UNIT if self.draft.mesh is not None else OTHER_MESH
            raise with_offer(InputError(error.seen), f" {advice}") from None
        self.values["surface"] = surface
        self.values["size_mm"] = tuple(float(side) for side in np.ptp(surface.vertices, axis=0) * 1e3)
        self.findings["part"] = (*self.findings.get("part", ()), *findings)

    def _find_joints(self, robot: Robot) -> None:
        """Find the chain between part and sensor, and the poses of all sensors."""
        draft = self.draft
        if draft.link not in robot.links:
            return
        every = [
            joint.name
            for joint in robot.joints.values()
            if joint.kind in TURNING_JOINT_KINDS and (joint.mimic is None or joint.name in draft.joints)
        ]
        sensors: dict[str, FloatArray] = {}
        names = [sensor.name for sensor in robot.sensors]
        for name in [*names, *([draft.sensor] if draft.sensor and draft.sensor not in names else [])]:
            try:
                chain, sign = robot.chain(draft.link, name, every, {}, str(draft.urdf))
            except InputError as error:
                if name == draft.sensor:
                    self.problems["sensor"] = str(error)
                continue
            angles = np.array([self._angle(robot, joint.name) for joint in chain.moving])
            sensors[name] = chain.link_from_sensor(angles)
            if name == draft.sensor:
                self.values["sign"] = sign
                self._follow_chain(robot, chain)
        self.values["sensors"] = sensors

    def _follow_chain(self, robot: Robot, chain: UrdfChain) -> None:
        draft, fixed = self.draft, dict(self.draft.fixed)
        self.findings["sensor"] = tuple(
            f"{words[0].upper()}{words[1:]}." for words in sensor_findings(robot, draft.sensor, draft.link)
        )
        needed = [name for name in joints_in_order(chain) if name not in fixed]
        columns = list(draft.joints) or needed
        self.values["joints"] = tuple(
            JointState(
                name, columns.index(name) if name in columns else -1, self._angle(robot, name), robot.joints[name].limits
            )
            for name in needed
        )
        missing = [name for name in needed if name not in columns]
        if missing:
            self.problems["joints"] = (
                f"Joint {missing[0]} lies between sensor and part, or a joint there follows it, and no column of the joint "
                "stream has its name: add it, or give it a fixed angle."
            )
            return
        try:
            angles = {name: float(np.radians(angle)) for name, angle in fixed.items()}
            robot.chain(draft.link, draft.sensor, columns, angles, str(draft.urdf))
        except InputError as error:
            self.problems["joints"] = str(error)

    def _angle(self, robot: Robot, name: str) -> float:
        """Angle of a joint, radians: fixed, shown, or in the middle."""
        fixed = dict(self.draft.fixed)
        if name in fixed:
            return float(np.radians(fixed[name]))
        limits = robot.joints[name].limits
        return self.angles.get(name, 0.0 if limits is None else float(np.clip(0.0, *limits)))

    def find_sensor(self) -> None:
        """Compute the pose of the chosen sensor; with a tool it has another one at each poke."""
        draft = self.draft
        if draft.rig is not Rig.BELOW:
            problem = tool_problem(draft.rig, draft.tool, has_arm=draft.has_dh_arm)
            if problem:
                self.problems["sensor"] = problem
            return
        if draft.urdf is not None:
            self.values["sensor_pose"] = self.values.get("sensors", {}).get(draft.sensor)
        elif draft.has_dh_arm and draft.source is not None:
            self._follow_dh_arm(draft.source)
        elif draft.sensor_pose is not None:
            pose = self.values["sensor_pose"] = np.array(draft.sensor_pose)
            tilt = float(np.degrees(np.arccos(min(1.0, np.abs(pose[:3, 2]).max()))))
            if tilt > WARN_OF_SENSOR_TILT_FROM_DEG:
                self.findings["sensor"] = (
                    f"The sensor's z axis is {tilt:.0f} degrees off the nearest axis of the part. If its flange is not tilted, "
                    "pick the points again or type the direction.",
                )
        if self.values.get("sensor_pose") is None and "sensor" not in self.problems:
            self.problems["sensor"] = _sensor_advice(self.values.get("robot"))

    def _follow_dh_arm(self, source: Path) -> None:
        spec = self.once(load_scene, source).arm
        if spec is None or not isinstance(spec.arm, Arm):
            return
        names = [f"column {column}" for column in spec.arm.joints]
        first = next(iter(spec.poses.values()), np.zeros(len(names)))
        angles = np.array([self.angles.get(name, float(angle)) for name, angle in zip(names, first, strict=True)])
        self.values["sensor_pose"] = spec.arm.link_from_sensor(angles)
        self.values["joints"] = tuple(
            JointState(name, column, float(angle), None)
            for name, column, angle in zip(names, spec.arm.joints, angles, strict=True)
        )

    def check_landmarks(self) -> None:
        """Compare the landmarks with the mesh."""
        places = {mark.name: np.array(mark.place) for mark in self.draft.landmarks}
        self.findings["check"] = landmark_findings(places, self.values.get("surface"))

    def lay_skin(self) -> None:
        """Read the layout and place it."""
        draft, surface = self.draft, self.values.get("surface")
        if not draft.layout_text:
            if draft.channels is None:
                self.problems["skin"] = "Choose a layout, or type how many values a frame of the skin has."
            return
        try:
            layout = self.once(parse_layout, draft.layout_text, layout_file_of(draft))
        except InputError as error:
            self.problems["skin"] = str(error)
            return
        self.values["layout"] = layout
        if draft.channels is not None and draft.channels < layout.width:
            self.problems["skin"] = (
                f"The layout uses channels up to {layout.width - 1}, and a skin frame has {draft.channels} values; "
                f"expected at least {layout.width}."
            )
        anchor = None if draft.anchor is None else draft.anchor.anchor()
        pose = self.values.get("sensor_pose")
        sensor = None if pose is None else pose[:3, 3]
        if anchor is None and all(module.anchor is None for module in layout.modules):
            self.problems["place"] = NOT_PLACED
            anchor = self.values["proposed_anchor"] = propose_anchor(layout, surface, sensor)
        try:
            laid = place_layout(layout, anchor, surface)
            remarks = anchor_remarks(layout, anchor, surface)
            found = examine_layout(layout, anchor, laid, surface, sensor)
        except InputError as error:
            self.problems.setdefault("place", str(error))
            return
        self.values |= {"laid": laid, "laid_findings": found}
        self.findings["place"] = (*found.sentences, *remarks)


def _sensor_advice(robot: Robot | None) -> str:
    if robot is None:
        return "Say where the force/torque sensor is: press one of the buttons, or type its position."
    if robot.sensors:
        return "Choose the force/torque sensor, or the joint at which it is mounted."
    return "The URDF describes no force/torque sensor: choose the joint at which it is mounted."


def propose_anchor(layout: Layout, surface: Surface | None, sensor: FloatArray | None) -> Anchor:
    """Choose a place for a layout: in the middle of the part's largest free face; in the origin without a mesh."""
    if surface is None:
        return anchor_at(None, layout, np.zeros(3), None)
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    middle, side = (low + high) / 2.0, free_side(surface, sensor)
    entries = entry_points(surface, middle, -side)
    inner, points = _inner_point(surface, side), entries[:1]
    # A ring or an L has no middle, and a notch may reach it.
    if len(points):
        gaps = _gaps_to_border(surface, side, np.stack([points[0], inner]))
        points = points if gaps[0] >= MIDDLE_MIN_GAP_SHARE * gaps[1] else points[:0]
    return anchor_at(surface, layout, points[0] if len(points) else inner, None)


def _inner_point(surface: Surface, side: FloatArray) -> FloatArray:
    """Find the point of the faces towards a side that is farthest from their border, (3,) metres, among evenly chosen ones."""
    corners = surface.corners[surface.normals @ side > FREE_FACE_MIN_COSINE]
    corners = corners[:: max(1, len(corners) // INNER_POINT_MAX_TRIANGLES)]
    # Large triangles get several points each.
    steps = min(12, 2 + int(np.sqrt(INNER_POINT_MAX_TRIANGLES / len(corners))))
    weights = np.array([(i, j, steps - i - j) for i in range(1, steps) for j in range(1, steps - i)], dtype=float) / steps
    weights = weights if len(weights) else np.full((1, 3), 1.0 / 3.0)
    points = np.einsum("wk,tkd->twd", weights, corners).reshape(-1, 3)
    return points[int(np.argmax(_gaps_to_border(surface, side, points)))]


def _gaps_to_border(surface: Surface, side: FloatArray, points: FloatArray) -> FloatArray:
    """Compute (n,) distances, metres, of points (n, 3) to the border of the faces towards a side; infinite without a border."""
    triangles = surface.triangles[surface.normals @ side > FREE_FACE_MIN_COSINE]
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    shared, count = np.unique(edges, axis=0, return_counts=True)
    gaps = np.full(len(points), np.inf)
    for origin, end in surface.vertices[shared[count == 1]]:
        way = end - origin
        share = np.clip((points - origin) @ way / max(float(way @ way), 1e-30), 0.0, 1.0)
        gaps = np.minimum(gaps, np.linalg.norm(points - origin - share[:, None] * way, axis=1))
    return gaps


def free_side(surface: Surface, sensor: FloatArray | None) -> FloatArray:
    """Choose the side of a part on which a skin most likely lies: (3,) float, unit, an axis of the link.

    The face with the largest area towards that side wins; of equal ones that which is seen first. A face towards the sensor
    near the part is chosen last: the part stands on it.

    Parameters
    ----------
    sensor : (3,) metres, link frame: the sensor's origin; `None` if it is unknown
    """
    sides = np.concatenate([np.eye(3), -np.eye(3)])
    corners = surface.corners
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2.0
    facing = surface.normals @ sides.T
    size = areas @ np.where(facing > FREE_FACE_MIN_COSINE, facing, 0.0)
    share = np.array([round(float(each), 1) for each in size / size.max()])
    scores = share + FIRST_SIDE_BONUS * (sides @ np.array(FIRST_SIDE))
    if sensor is not None:
        low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
        offset = sensor - (low + high) / 2.0
        distance = float(np.linalg.norm(offset))
        if 0.0 < distance <= np.linalg.norm(high - low):
            scores -= (sides @ offset / distance > FREE_FACE_MIN_COSINE).astype(float)
    return sides[int(np.argmax(scores))]


def _read_robot(path: Path) -> Robot:
    return read_urdf(path)


def _load_shape(path: Path, packages: tuple[tuple[str, Path], ...]) -> RobotShape:
    return load_robot_shape(read_urdf(path), dict(packages))


def _list_files(path: Path, packages: tuple[tuple[str, Path], ...]) -> RobotFiles:
    return list_robot_files(read_urdf(path), dict(packages))


def _load_surface(
    path: Path, scale: float, pose: tuple[tuple[float, ...], ...], replaces_unit: bool
) -> tuple[Surface, tuple[str, ...]]:
    surface, findings = load_surface(SurfaceSpec(path, scale, np.array(pose), replaces_unit))
    return surface, tuple(finding.sentence for finding in findings if finding.kind not in UNREPORTED_FINDINGS)


TIP_REACH_M = 0.0065
"""m, from the middle of a tip of 4 mm radius to the last taxel that answers: the tip, and `NoiseSettings.reach` of its foam."""
MORE_TAXELS_THAN_IN_MEAN = 1.35
"""Largest number of taxels in that circle over the mean: up to 20 of those 3 mm apart, and up to 12 of those 4 mm apart."""


def taxels_under_tip(spacing: float) -> int:
    """Count the most taxels, `spacing` (m) apart, that answer a poke; `MORE_TAXELS_THAN_IN_MEAN` covers the middle of a gap."""
    return math.ceil(MORE_TAXELS_THAN_IN_MEAN * math.pi * TIP_REACH_M**2 / spacing**2)


def completed_draft(preview: PartPreview) -> PartDraft:
    """Fill in what follows from the rest: columns of the joint stream, channels, name, and taxels that a poke may press."""
    draft, layout = preview.draft, preview.layout
    if draft.urdf is not None and not draft.joints:
        draft = replace(draft, joints=tuple(joint.name for joint in preview.joints))
    if draft.channels is None and layout is not None:
        draft = replace(draft, channels=layout.width)
    if draft.source is None and draft.axes != 1 and draft.taxels_max is None and layout is not None:
        most = taxels_under_tip(layout.spacing)
        draft = replace(draft, taxels_max=most if most > ContactSettings().taxels_max else None)
    if not draft.name:
        draft = replace(draft, name=draft.link if draft.urdf is not None or draft.mesh is None else draft.mesh.stem)
    return draft
