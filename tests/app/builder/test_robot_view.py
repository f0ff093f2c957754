"""The robot around a part: its base stays still, its sides are named, and so is the link under the pointer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from PySide6.QtCore import QPoint
from PySide6.QtGui import QCursor
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QToolTip

from app.scene3d import camera
from app.scene3d.robot_sides import side_axes
from skincal.part.robot_shape import left_of_robot
from tests.app.builder.test_builder_window import Builder
from tests.app.scene3d_support import project
from tests.app.whole_window import OPEN_MS

LINK = """<link name="{name}"><visual><geometry>
<mesh filename="{name}.stl" scale="0.001 0.001 0.001"/></geometry></visual></link>
"""
JOINT = """<joint name="{child}_joint" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{place}"/><axis xyz="1 0 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
"""
SENSOR = """<gazebo reference="{joint}"><sensor name="{joint}_ft" type="force_torque">
<force_torque><frame>sensor</frame><measure_direction>child_to_parent</measure_direction></force_torque></sensor></gazebo>
"""
BOXES_MM = {"torso": (200, 120, 400), "left_arm": (60, 60, 300), "right_arm": (60, 60, 300)}


@pytest.fixture
def robot(tmp_path):
    """A torso with two arms that hang at its sides; its left is along -x, so its front is along y."""
    for name, sides in BOXES_MM.items():
        box = trimesh.creation.box(sides)
        if name != "torso":
            box.apply_translation((0, 0, -150))
        box.export(tmp_path / f"{name}.stl")
    links = "".join(LINK.format(name=name) for name in BOXES_MM) + '<link name="mount"/>'
    joints = JOINT.format(child="right_arm", parent="mount", kind="revolute", place="0 0 0")
    joints += JOINT.format(child="mount", parent="torso", kind="fixed", place="0.14 0 0.15")
    joints += JOINT.format(child="left_arm", parent="torso", kind="revolute", place="-0.14 0 0.15")
    text = f'<robot name="two_arms">{links}{joints}{SENSOR.format(joint="mount_joint")}</robot>'
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    return path


@pytest.fixture
def build(bench, robot):
    build = Builder(bench, robot)
    build.page.change(replace(build.draft, link="right_arm", sensor="mount_joint_ft"))
    build.settle()
    return build


def renderer_of(build):
    return build.page.view._renderer


def pixels_of(build, link: str) -> np.ndarray:
    """Pixels of a link's corners."""
    preview, renderer = build.page.preview, renderer_of(build)
    shape = next(each for each in preview.shape.links if each.link == link)
    pose = preview.link_poses[link]
    return project(renderer.renderer, shape.vertices @ pose[:3, :3].T + pose[:3, 3])[:, :2]


def test_a_joint_moves_the_part_and_not_the_robot(build):
    build.open_step("joints")
    before = {link: pixels_of(build, link) for link in BOXES_MM}
    build.page.turn_joints({"right_arm_joint": 1.2})
    build.settle()
    for link in ("torso", "left_arm"):
        np.testing.assert_allclose(pixels_of(build, link), before[link], atol=1e-3)
    moved = np.linalg.norm(pixels_of(build, "right_arm") - before["right_arm"], axis=1).max()
    assert moved > 50.0
    # Wherever the joint turns, the part stays in the picture.
    for angle in np.linspace(-2.0, 2.0, 9):
        build.page.turn_joints({"right_arm_joint": float(angle)})
        build.settle()
        size = renderer_of(build).window.GetSize()
        at = pixels_of(build, "right_arm")
        assert (at >= 0.0).all()
        assert (at <= size).all()


def test_left_right_and_front_are_named_by_the_links_and_seen_from_the_front(build):
    renderer, preview = renderer_of(build), build.page.preview
    axes = side_axes(preview)
    assert axes is not None
    np.testing.assert_allclose(axes, [[-1, 0, 0], [0, 1, 0], [0, 0, 1]], atol=1e-12)
    labels = {label.text: label.at for label in renderer.sides.labels}
    assert labels.keys() == {"left", "right", "front"}
    root = preview.link_poses["torso"]
    there = {word: np.linalg.inv(root) @ [*at, 1.0] for word, at in labels.items()}
    assert there["left"][0] < -0.17
    assert there["right"][0] > 0.17
    assert there["front"][1] > 0.06
    back = root[:3, :3].T @ camera.pose_of(renderer.camera).axes[2]
    assert back[1] > 0.5, "the camera is in front of it"
    assert back[0] > 0.0, "and at the side of the part"
    assert camera.pose_of(renderer.camera).axes[0] @ root[:3, 2] == pytest.approx(0.0, abs=1e-9), "upright"
    build.page.change(replace(build.draft, link=""))
    build.settle()
    assert renderer.hints.frame == "torso"
    build.page.change(replace(build.draft, link="left_arm"))
    build.settle()
    assert renderer.hints.frame == "left_arm"
    assert any(label.text == "left_arm" for label in renderer.hints.labels), "the name of the frame whose axes are drawn"


@pytest.mark.parametrize(
    ("names", "has_sides"),
    [
        (("l_hand", "r_hand"), True), (("arm_left", "arm_right"), True), (("LeftHand", "RightHand"), True),
        (("LF-foot.left", "RF-foot.right"), True), (("lidar", "rail"), False), (("base", "tool0"), False),
        (("l_hand", "base"), False),
    ],
)  # fmt: skip
def test_sides_are_told_by_the_names_of_links(names, has_sides):
    poses = {name: np.eye(4) for name in names}
    poses[names[0]][:3, 3] = (0.1, 0.4, 0.2)
    left = left_of_robot(poses)
    assert (left is not None) == has_sides
    if left is not None:
        np.testing.assert_allclose(left, np.array([0.1, 0.4, 0.0]) / np.hypot(0.1, 0.4))
    poses[names[0]][:3, 3] = (0.0, 0.01, 0.9)
    assert left_of_robot(poses) is None, "above each other they are no sides"


def point_at(build, x: float, y: float) -> QPoint:
    """Bring the pointer to a pixel of the picture, counted from the lower left; return its place on the screen."""
    canvas = build.page.view.canvas
    place = QPoint(round(x), round(canvas.height() - y))
    at = canvas.mapToGlobal(place)
    QCursor.setPos(at)
    QTest.mouseMove(canvas, place)
    return at


def until_named(build, link: str) -> None:
    build.bench.until(lambda: QToolTip.text() == f"<p>{link}</p>", OPEN_MS)


def test_the_link_under_the_pointer_is_named(build):
    for link in BOXES_MM:
        corners, middle = pixels_of(build, link), pixels_of(build, "torso").mean(axis=0)
        # The torso covers half of an arm.
        at = corners.mean(axis=0) + 0.25 * np.sign(corners.mean(axis=0) - middle) * [np.ptp(corners[:, 0]), 0.0]
        point_at(build, *at)
        until_named(build, link)
    QToolTip.hideText()


def test_a_link_is_named_when_the_tooltip_over_it_is_gone(build):
    canvas = build.page.view.canvas
    at = pixels_of(build, "torso").mean(axis=0)
    place = point_at(build, *at)
    until_named(build, "torso")
    # At the lower right of a place: so it covers the middle.
    QToolTip.showText(place - QPoint(40, 40), "covers the torso " * 5, canvas)
    build.bench.until(lambda: not canvas.underMouse())
    # The pointer moves over the tooltip to the middle, and rests.
    point_at(build, at[0] + 1.0, at[1])
    until_named(build, "torso")
    QToolTip.hideText()


def test_the_part_covers_the_sensor_axes_behind_it(build):
    build.open_step("sensor")
    renderer = renderer_of(build)
    assert renderer.sensors.chosen.actor in renderer.plotter.renderers[0].actors.values()
    assert not renderer.sensors.chosen.is_empty
    np.testing.assert_array_equal(renderer.sensors.hidden_axes.mesh.points, renderer.sensors.chosen.mesh.points)
    assert renderer.sensors.hidden_axes.actor.prop.opacity < 0.6


def test_words_keep_off_the_scale_bar(build):
    renderer = renderer_of(build)
    obstacles = renderer._viewpoint.on_screen(renderer.hints.obstacles())
    size = np.array(renderer.window.GetSize())
    bar = obstacles[(obstacles[:, 0] > 0.0)]
    assert len(bar) >= 8
    assert (bar[:, 1] < -size[1] / 2 + 40).all()
    assert bar[:, 0].max() > size[0] / 2 - 40
