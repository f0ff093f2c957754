"""The picture of a part draft: the robot around it, its mesh, sensors, placed layout and landmarks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyvista as pv
from vtkmodules.vtkRenderingCore import vtkCellPicker

from app import theme
from app.scene3d.camera import facing, fit_from, place, pose_of
from app.scene3d.draft_state import NO_PLACES, ROBOT_STEPS, SENSOR_STEPS, DraftPicture, DraftStatic
from app.scene3d.hints import HintsLayer
from app.scene3d.lines import crosses, rings
from app.scene3d.mesh_actors import FRONT, PART, Dots, Label, Layer, Segments
from app.scene3d.part_layers import ModulesLayer, SurfaceLayer
from app.scene3d.robot_sides import SidesLayer, side_axes
from app.scene3d.scene_renderer import MIN_VIEW_HALF_HEIGHT_M, SceneRenderer
from app.scene3d.scene_state import StaticScene, rgb
from app.scene3d.turn_handle import TurnHandleLayer
from app.state.camera_pose import PLAIN_POSE, CameraPose
from skincal.geometry import FloatArray, inverse_pose
from skincal.mesh.lay import PlacedLayout
from skincal.mesh.search import nearest_points
from skincal.mesh.surface import Surface, make_surface
from skincal.model.skin import Layout
from skincal.part.draft_preview import FIRST_SIDE, PartPreview
from skincal.part.robot_shape import RobotShape

SENSOR_AXIS_LENGTH_OVER_PART_SIZE = 0.28  # Length of the chosen sensor's axes, of the part's longest side
MIN_DRAWN_AXIS_LENGTH_M = 0.03
OTHER_SENSORS_AXIS_LENGTH_RATIO = 0.4  # Of other sensors' axes, of the chosen one's
CHOSEN_AXES_PX, OTHER_AXES_PX = 4.0, 2.0  # Lines of the sensors' axes
COVERED_AXES_OPACITY = 0.45  # Of the axes where the part covers them
MARK_SIZE_OVER_PART_SIZE = 0.025  # Radius of landmarks and picked points, of the part's longest side
BOX_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
_GRID_WAYS = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], dtype=float)
AROUND_BALL = 1.12 * _GRID_WAYS / np.linalg.norm(_GRID_WAYS, axis=1, keepdims=True)
"""(26, 3) float: corners of a solid that holds a ball of radius 1."""
FIRST_VIEW = np.array(FIRST_SIDE)
"""Unit: from where a part or a robot is seen first, obliquely from above; its z axis is upright."""
ROOT_XY_MASK = np.array([1.0, 1.0, 0.0])
LABEL_MIN_DISTANCE_FROM_PART_AXIS_M = 0.02
MIN_SIN_VIEW_TO_UPRIGHT_AXIS = 0.3  # Seen more steeply from above, nothing is upright
MODULE_TO_LABEL_GAP_PX = 6.0
MIN_LABEL_FACING_COSINE = 0.05
_NO_MESH = make_surface(np.array([[0.0, 0, 0], [1e-3, 0, 0], [0, 1e-3, 0]]), np.array([[0, 1, 2]]))
"""Drawn, hidden, before there is a mesh."""


class LinksLayer(Layer):
    """The links of a robot, one actor each; the part's link is marked."""

    name = "links"

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene) -> None:
        super().__init__(plotter, static)
        self.shape: RobotShape | None = None
        self.actors: dict[str, pv.Actor] = {}
        self._key: object = None
        self._picture: DraftPicture | None = None

    def show_picture(self, picture: DraftPicture) -> None:
        """Show the picture of a step: the part, or the whole robot."""
        preview = picture.preview
        if preview.shape is not self.shape:
            self._replace(preview.shape)
        self._picture = picture
        for link, actor in self.actors.items():
            pose = preview.link_poses.get(link)
            if pose is not None:
                actor.user_matrix = pose
        self.draw()

    def _replace(self, shape: RobotShape | None) -> None:
        for actor in self.actors.values():
            self.plotter.renderers[PART].RemoveActor(actor)
        self.shape, self.actors = shape, {}
        if shape is None:
            return
        self.plotter.subplot(0, PART)
        for link in shape.links:
            mesh = pv.PolyData.from_regular_faces(link.vertices, link.triangles)
            self.actors[link.link] = self.plotter.add_mesh(
                mesh, ambient=0.3, diffuse=0.7, copy_mesh=False, reset_camera=False, render=False, show_scalar_bar=False
            )

    def draw(self) -> None:
        """Mark the part's link."""
        if self._picture is None:
            return
        step, chosen = self._picture.step, self._picture.preview.mesh_link
        for link, actor in self.actors.items():
            is_part = link == chosen
            actor.visibility = step in ROBOT_STEPS
            actor.prop.color = theme.module_hue(0) if is_part else self.colours.front

    @property
    def is_shown(self) -> bool:
        return any(actor.visibility for actor in self.actors.values())

    def pick(self, x: float, y: float) -> str | None:
        """Return the link at a pixel; `None` next to the robot."""
        picker = vtkCellPicker()
        picker.SetTolerance(0.0)
        picker.PickFromListOn()
        for actor in self.actors.values():
            if actor.visibility:
                picker.AddPickList(actor)
        if not picker.Pick(x, y, 0.0, self.plotter.renderers[PART]):
            return None
        found = picker.GetActor()
        return next((link for link, actor in self.actors.items() if actor is found), None)

    def extent(self, preview: PartPreview) -> FloatArray:
        """Return the corners of the links' boxes, (n, 3) float, metres, in the part's link."""
        corners = [NO_PLACES]
        for link in () if preview.shape is None else preview.shape.links:
            pose = preview.link_poses.get(link.link)
            if pose is not None:
                low, high = link.vertices.min(axis=0), link.vertices.max(axis=0)
                corners.append((low + BOX_CORNERS * (high - low)) @ pose[:3, :3].T + pose[:3, 3])
        return np.concatenate(corners)


class SensorsLayer(Layer):
    """Axes of the force/torque sensors and of the part's frame, with their names."""

    name = "sensors"

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene) -> None:
        super().__init__(plotter, static)
        # The part covers what is behind it; a faint line shows where that goes on.
        self.chosen, self.others = Segments(plotter, PART, CHOSEN_AXES_PX), Segments(plotter, PART, OTHER_AXES_PX)
        self.hidden_axes = Segments(plotter, FRONT, OTHER_AXES_PX, opacity=COVERED_AXES_OPACITY)
        self._picture: DraftPicture | None = None
        self.size = MIN_DRAWN_AXIS_LENGTH_M

    def show_picture(self, picture: DraftPicture) -> None:
        self._picture = picture
        self.draw()

    def draw(self) -> None:
        picture = self._picture
        if picture is None or picture.step not in SENSOR_STEPS:
            for actor in (self.chosen, self.others, self.hidden_axes):
                actor.show(NO_PLACES, self.colours.ink)
            self.labels = ()
            return
        preview = picture.preview
        hues = np.array([rgb(axis) for axis in self.colours.window.axes], dtype=np.uint8)
        chosen = [] if preview.sensor_pose is None else [(preview.draft.sensor or "sensor", preview.sensor_pose)]
        others = [("part", np.eye(4))]
        if picture.step == "sensor":
            others += [(name, pose) for name, pose in preview.sensors.items() if name != preview.draft.sensor]
        for actor, frames, size in (
            (self.chosen, chosen, self.size), (self.others, others, OTHER_SENSORS_AXIS_LENGTH_RATIO * self.size),
        ):  # fmt: skip
            ends = [np.stack([pose[:3, 3], pose[:3, 3] + size * pose[:3, axis]]) for _, pose in frames for axis in range(3)]
            points, colours = np.array(ends).reshape(-1, 3), np.tile(hues.repeat(2, axis=0), (len(frames), 1))
            actor.show(points, colours)
            if actor is self.chosen:
                self.hidden_axes.show(points, colours)
        self.labels = [Label(name, pose[:3, 3], MODULE_TO_LABEL_GAP_PX, 2.0) for name, pose in (*chosen, *others)]
        if chosen:
            pose = chosen[0][1]
            tips = pose[:3, 3] + 1.12 * self.size * pose[:3, :3].T
            self.labels += [Label(letter, tip, 0.0, 3.0) for letter, tip in zip("xyz", tips, strict=True)]


class MarksLayer(Layer):
    """Landmarks with their names, picked points, wrong or answering taxels, and the module that moves alone."""

    name = "marks"

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene) -> None:
        super().__init__(plotter, static)
        self.lines, self.module = Segments(plotter, FRONT, 2.5), Segments(plotter, FRONT, 4.0)
        self.wrong, self.answered = Dots(plotter, FRONT, 9.0), Dots(plotter, FRONT, 11.0)
        self._picture: DraftPicture | None = None
        self._normals = NO_PLACES
        self.size = MIN_DRAWN_AXIS_LENGTH_M

    def show_picture(self, picture: DraftPicture) -> None:
        self._picture = picture
        preview, laid = picture.preview, picture.preview.laid
        places = np.array([mark.place for mark in preview.draft.landmarks]).reshape(-1, 3)
        self._normals = np.tile([0.0, 0.0, 1.0], (len(places), 1))
        if preview.surface is not None and len(places):
            self._normals = preview.surface.normals[nearest_points(preview.surface, places)[1]]
        colours = self.colours.window
        found = preview.laid_findings
        wrong = None if found is None else np.union1d(found.off_channels, found.folded_channels)
        self._show_channels(self.wrong, laid, wrong, colours.bad)
        self._show_channels(self.answered, laid, picture.answered, colours.accent)
        lines = NO_PLACES
        if picture.module is not None and preview.layout is not None and laid is not None:
            outline = laid.outlines[picture.module]
            lines = np.stack([outline, np.roll(outline, -1, axis=0)], axis=1).reshape(-1, 3) if len(outline) else NO_PLACES
        self.module.show(lines, self.colours.ink)
        self.draw()

    def _show_channels(self, dots: Dots, laid: PlacedLayout | None, channels: Any, colour: str) -> None:
        places = NO_PLACES if laid is None or channels is None else laid.places[channels[channels < len(laid.places)]]
        dots.show(places[np.isfinite(places[:, 0])], rgb(colour))

    def draw(self) -> None:
        picture = self._picture
        if picture is None or self.viewpoint is None:
            return
        marks = picture.preview.draft.landmarks if picture.step == "check" else ()
        places = np.array([mark.place for mark in marks]).reshape(-1, 3)
        radius = MARK_SIZE_OVER_PART_SIZE * self.size / SENSOR_AXIS_LENGTH_OVER_PART_SIZE
        normals = self._normals[: len(places)]
        position = self.viewpoint.pose.position
        seen = facing(normals, places, position) >= MIN_LABEL_FACING_COSINE if len(places) else np.empty(0, bool)
        diamonds = rings(places[seen], normals[seen], radius, sides=4).reshape(-1, 3)
        towards = position - picture.points
        towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
        points = np.concatenate([
            rings(picture.points, towards, radius).reshape(-1, 3), crosses(picture.points, towards, 0.6 * radius).reshape(-1, 3)
        ])  # fmt: skip
        self.lines.show(np.concatenate([diamonds, points]), self.colours.ink)
        gap = radius / self.viewpoint.pixel + MODULE_TO_LABEL_GAP_PX
        self.labels = [
            Label(mark.name, np.array(mark.place), gap, 2.0) for mark, is_seen in zip(marks, seen, strict=True) if is_seen
        ]
        self.labels += [Label(str(number), at, gap, 2.0) for number, at in enumerate(picture.points, start=1)]


class DraftModulesLayer(ModulesLayer):
    """The layout that is being placed: its taxels are the subject, not a plan behind estimates."""

    dot_px = 6.0
    hue_share = 1.0

    def _set_modules(self, layout: Layout, laid: PlacedLayout) -> None:
        """Show the channels of a single module's corners, so that a layout that is turned or mirrored is seen."""
        super()._set_modules(layout, laid)
        if len(layout.modules) != 1:
            return
        self._numbers = [
            (Label(f"channel {channel}", laid.places[channel], MODULE_TO_LABEL_GAP_PX, 3.0), laid.normals[channel])
            for channel in corner_channels(layout)
            if np.isfinite(laid.places[channel]).all()
        ]


def corner_channels(layout: Layout) -> list[int]:
    """List the taxels at the corners of a layout's plane: the same ones at each place on the part."""
    x, y = layout.places[layout.channels].T
    rows = (np.argmin(x + y), np.argmax(x - y), np.argmin(x - y), np.argmax(x + y))
    return sorted({int(layout.channels[row]) for row in rows})


class DraftRenderer(SceneRenderer):
    """Layers, light and camera of the builder's 3D view; they follow every change of the draft."""

    first_lean_deg = (0.0, 0.0)

    def build_layers(self) -> tuple[Layer, ...]:
        """Make all layers, empty."""
        plotter, static = self.plotter, DraftStatic()
        layout, laid = Layout((), 0), PlacedLayout(NO_PLACES, NO_PLACES, ())
        self.surface_layer = SurfaceLayer(plotter, static, _NO_MESH)
        self.links, self.sensors = LinksLayer(plotter, static), SensorsLayer(plotter, static)
        self.marks = MarksLayer(plotter, static)
        self.modules = DraftModulesLayer(plotter, static, layout, laid)
        self.handle, self.sides = TurnHandleLayer(plotter, static), SidesLayer(plotter, static)
        self.hints = HintsLayer(plotter, static)
        self._fitted: object = None
        self._surface: Surface | None = None
        self._picture: DraftPicture | None = None
        return (
            self.links, self.surface_layer, self.modules, self.sensors, self.marks, self.handle, self.sides, self.hints,
        )  # fmt: skip

    def show(self, state: Any) -> bool:
        picture: DraftPicture = state
        before, self._picture = self._picture, picture
        preview, is_new = picture.preview, before is None or before.preview.laid is not picture.preview.laid
        if preview.surface is not None and preview.surface is not self._surface:
            self.surface_layer.set_surface(preview.surface)
            self._surface = preview.surface
        # Its mesh is that of a link of the robot.
        is_shown = preview.surface is not None and not (picture.step in ROBOT_STEPS and preview.shape is not None)
        self.surface_layer.inside.visibility = self.surface_layer.outside.visibility = is_shown
        if is_new or self.static.surface is not preview.surface:
            self.static = DraftStatic(preview.surface, preview.layout, preview.laid)
        self._show_layout(picture)
        longest = 0.0 if preview.size_mm is None else max(preview.size_mm) * 1e-3
        self.sensors.size = self.marks.size = max(MIN_DRAWN_AXIS_LENGTH_M, SENSOR_AXIS_LENGTH_OVER_PART_SIZE * longest)
        for layer in (self.links, self.sensors, self.marks, self.handle):
            layer.show_picture(picture)
        self.sides.show_picture(picture, self.links.extent(preview))
        root = None if preview.robot is None else preview.robot.root
        self.hints.frame = (preview.draft.link or root or "part") if preview.robot is not None else "part"
        self.hints.draw()
        self._keep_base_still(None if before is None else before.preview, preview)
        key = (
            preview.size_mm, () if preview.shape is None else (preview.draft.link, *preview.link_poses), _view_of(picture),
            preview.sensor_pose is None,
        )  # fmt: skip
        if key != self._fitted:
            self._fitted = key
            self.fit()
        return True

    def _keep_base_still(self, before: PartPreview | None, now: PartPreview) -> None:
        """Move the camera with the robot's base, which moves in the part's link as a joint turns: the part moves instead."""
        if before is None or before.robot is None or before.robot is not now.robot or before.draft.link != now.draft.link:
            return
        old, new = before.link_poses[before.robot.root], now.link_poses[before.robot.root]
        if not np.array_equal(old, new):
            move, pose = new @ inverse_pose(old), pose_of(self.camera)
            place(self.camera, CameraPose(pose.axes @ move[:3, :3].T, move[:3, :3] @ pose.focus + move[:3, 3], pose.distance))

    def _show_layout(self, picture: DraftPicture) -> None:
        preview = picture.preview
        is_shown = preview.laid is not None and preview.layout is not None and picture.step not in ROBOT_STEPS
        if is_shown and self.modules.static is not self.static:
            assert preview.layout is not None
            assert preview.laid is not None
            self.modules.set_layout(self.static, preview.layout, preview.laid)
        for actor in (self.modules.outlines, self.modules.dots):
            actor.hidden = not is_shown
            actor.update_visibility()
        if not is_shown:
            self.modules.labels = ()
            self.modules.static = DraftStatic()

    def turn(self, state: Any, now_s: float) -> bool:  # noqa: ARG002
        """Keep the camera: nothing turns it in the builder."""
        return False

    def fitted_pose(self) -> CameraPose:
        """Return the camera pose that shows what the step is about."""
        picture = self._picture
        if picture is None:
            return PLAIN_POSE
        preview, aspect = picture.preview, self.aspect()
        eye = turn = np.eye(3)
        points, view = self.static.extent, FIRST_VIEW
        if picture.step in ROBOT_STEPS and preview.robot is not None:
            turn, extent = preview.link_poses[preview.robot.root][:3, :3], self.links.extent(preview)
            view = self._first_side(preview, extent, turn)
            points = extent if _view_of(picture) == "robot" else points
        if picture.step in SENSOR_STEPS[:2]:
            chosen = [] if preview.sensor_pose is None else [preview.sensor_pose]
            tips = [pose[:3, 3] + self.sensors.size * pose[:3, :3].T for pose in chosen or preview.sensors.values()]
            points = np.concatenate([points, *tips, *([_reach(preview)] if picture.step == "joints" else [])])
        if not len(points):
            return PLAIN_POSE
        back = turn @ view if self.static.facing is None or turn is not eye else self.static.facing
        right = np.cross(turn[:, 2], back)
        right = right / np.linalg.norm(right) if np.linalg.norm(right) > MIN_SIN_VIEW_TO_UPRIGHT_AXIS else turn[:, 0]
        axes = np.stack([right, np.cross(back, right), back])
        return fit_from(points, axes, aspect, MIN_VIEW_HALF_HEIGHT_M)

    def _first_side(self, preview: PartPreview, extent: FloatArray, turn: FloatArray) -> FloatArray:
        """Return the side from which the robot is seen first, (3,) float, unit, in its root's frame: its front, if known."""
        sides = side_axes(preview)
        if preview.surface is None or not len(extent):
            return FIRST_VIEW if sides is None else FIRST_VIEW[[1, 0, 2]] @ sides
        # From the side of the robot on which the part is.
        offset = turn.T @ (preview.surface.vertices.mean(axis=0) - (extent.min(axis=0) + extent.max(axis=0)) / 2.0)
        if sides is not None:
            is_right = float(sides[0] @ offset) < -LABEL_MIN_DISTANCE_FROM_PART_AXIS_M
            return (FIRST_VIEW[[1, 0, 2]] * ([-1.0, 1.0, 1.0] if is_right else [1.0, 1.0, 1.0])) @ sides
        return np.where(offset * ROOT_XY_MASK < -LABEL_MIN_DISTANCE_FROM_PART_AXIS_M, -1.0, 1.0) * FIRST_VIEW

    def pick(self, x: float, y: float) -> int | None:  # noqa: ARG002
        """Return `None`: a draft has no estimates."""
        return None


def _reach(preview: PartPreview) -> FloatArray:
    """Return the corners of the space that the part reaches as its joints turn, (n, 3) float, metres; empty without joints."""
    robot, surface = preview.robot, preview.surface
    if robot is None or surface is None or not preview.joints:
        return NO_PLACES
    names = {joint.name for joint in preview.joints}
    chain = [joint for joint in reversed(robot.path_to_root(preview.draft.link)) if joint.name in names]
    if not chain:
        return NO_PLACES
    places = np.array([preview.link_poses[joint.child][:3, 3] for joint in chain])
    arm = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
    arm += float(np.linalg.norm(surface.vertices - places[-1], axis=1).max())
    return places[0] + arm * AROUND_BALL


def _view_of(picture: DraftPicture) -> str:
    """Name what the camera shows in a step."""
    if picture.step == "part" and picture.preview.shape is not None:
        return "robot"
    return picture.step if picture.step in SENSOR_STEPS[:2] else "part"
