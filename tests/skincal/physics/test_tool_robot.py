"""The cobot in the engine: its sensor feels the reaction, its poses say where the tip is, and the part is where it is told."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.geometry import FloatArray, inverse_pose
from skincal.mesh.load import load_surface
from skincal.mesh.surface import Surface
from skincal.model.readings import Stream
from skincal.model.scene import Scene, load_scene, resource
from skincal.physics.devices import RobotDevices
from skincal.physics.effects import Effects
from skincal.physics.engine import PERIOD_S
from skincal.physics.robots import make_robot
from skincal.physics.session import make_client
from skincal.physics.tool_robot import ToolRobot
from skincal.robot.target_lines import PokeTarget

pytest.importorskip("mujoco")


@cache
def part(name: str = "cobot-wrist") -> tuple[Scene, Surface]:
    scene = load_scene(resource(f"scenes/{name}/scene.toml"))
    assert scene.surface is not None
    return scene, load_surface(scene.surface)[0]


def cobot(effects: Effects | None = None, name: str = "cobot-wrist") -> ToolRobot:
    made = make_robot(*part(name), effects or Effects.none(), 1)
    assert isinstance(made, ToolRobot)
    return made


def press(arm: ToolRobot, row: int = 40, into_m: float = 0.0) -> FloatArray:
    """Press at a taxel until everything rests; return the change of the reading from above it, (6,)."""
    place, push = arm.pads.places[row], -arm.pads.normals[row]
    readings = list[FloatArray]()
    for height, speed, seconds in ((0.05, 0.2, 3.0), (0.01, 0.1, 1.0), (-into_m, 0.03, 1.5)):
        arm.command(place - height * push, push, speed)
        for _ in range(round(seconds / PERIOD_S)):
            arm.advance()
        readings.append(arm.reading)
    return np.subtract(readings[-1], readings[-2], dtype=np.float64)


def flange_of(record: FloatArray) -> FloatArray:
    pose = np.eye(4)
    pose[:3, 3], pose[:3, :3] = record[:3], Rotation.from_quat(record[3:]).as_matrix()
    return pose


def test_the_sensor_reports_the_force_on_the_tool_and_the_pose_places_the_tip() -> None:
    arm = cobot()
    scene = arm.scene
    assert scene.tool is not None
    assert scene.tool.tip is not None
    felt = press(arm)
    touch = arm.engine.touch()
    assert touch is not None
    sensor_in_part = arm.link_from_sensor()
    # By the scene the sign is -1: the reading is the force on the tool, in the axes of the sensor.
    on_part = -(sensor_in_part[:3, :3] @ felt[:3])
    assert np.linalg.norm(touch.force) > 3.0
    np.testing.assert_allclose(on_part, touch.force, atol=0.1)
    # The axis of the reading passes the tip: moment = tip x force about the sensor.
    tip = scene.tool.tip_in_sensor
    assert tip is not None
    np.testing.assert_allclose(felt[3:], np.cross(tip, felt[:3]), atol=0.02)
    arm.command(arm.pads.places[40] + 0.01 * arm.pads.normals[40], -arm.pads.normals[40], 0.1)
    for _ in range(round(1.0 / PERIOD_S)):
        arm.advance()
    by_pose = inverse_pose(arm.base_from_part()) @ flange_of(arm.pose_record()) @ np.append(scene.tool.tip, 1.0)
    np.testing.assert_allclose(by_pose[:3], arm.engine.tip_in_part()[0], atol=1e-4)


def test_a_part_that_is_located_moves_in_the_arms_belief_and_the_arm_stays() -> None:
    arm = cobot(replace(Effects.none(), base=0.004))
    place, push = arm.pads.places[40], -arm.pads.normals[40]
    above = place - 0.03 * push

    def miss() -> float:
        """Distance of the tip from the point above the taxel that it goes to, metres."""
        arm.command(above, push, 0.2)
        for _ in range(round(3.0 / PERIOD_S)):
            arm.advance()
        return float(np.linalg.norm(arm.engine.tip_in_part()[0] - above))

    assert miss() > 0.002, "the arm knows the part roughly"
    before, angles = arm.read_tip(), arm.engine.data.qpos.copy()
    arm.locate_part(arm.base_from_part())
    assert np.linalg.norm(arm.read_tip().position - before.position) > 0.002
    arm.advance()
    np.testing.assert_allclose(arm.engine.data.qpos, angles, atol=1e-4)
    assert miss() < 0.0005


def test_a_hand_guides_the_tip_to_a_landmark_wherever_the_arm_believes_it_to_be() -> None:
    arm = cobot(replace(Effects.none(), base=0.004, tcp=0.002))
    place, push = arm.pads.places[40], -arm.pads.normals[40]
    above = place - 0.02 * push

    def miss(*, known: bool) -> float:
        """Distance of the tip from the point above the place that it goes to, metres."""
        arm.prepare_for(PokeTarget(1, None, place, push, known))
        for _ in range(round(4.0 / PERIOD_S)):
            arm.command(above, push, 0.2)
            arm.advance()
        return float(np.linalg.norm(arm.engine.tip_in_part()[0] - above))

    assert miss(known=False) > 0.002
    assert miss(known=True) < 0.0003
    assert np.linalg.norm(arm.read_tip().position - above) < 0.0003
    assert miss(known=False) > 0.002


def test_poses_are_late_and_wrong_by_the_effects_alone() -> None:
    exact, wrong = cobot(), cobot(replace(Effects.none(), scale=0.002, warp=0.0005, late=0.02))
    for arm in (exact, wrong):
        arm.advance()
    off = np.linalg.norm(exact.pose_record()[:3] - wrong.pose_record()[:3])
    assert 1e-4 < off < 0.006
    first = wrong.pose_record()
    start = wrong.read_tip()
    wrong.command(start.position + np.array([0.0, 0.0, 0.05]), start.direction, 0.2)
    for _ in range(4):
        wrong.advance()
    np.testing.assert_allclose(wrong.pose_record(), first, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "streams"),
    [("cobot-wrist", {Stream.WRENCH, Stream.SKIN, Stream.TOOL}), ("cobot-tip", {Stream.SKIN, Stream.TOOL})],
)
def test_the_devices_are_those_of_the_rig(name: str, streams: set[Stream]) -> None:
    arm = cobot(name=name)
    devices = RobotDevices(arm)
    for _ in range(5):
        arm.advance()
    sent = devices.advance()
    assert set(devices.links.values()) == streams
    (poses,) = [data for _, link, data in sent if link == "tool"]
    assert poses.count(b"\nP,") + poses.startswith(b"P,") >= 2, "125 a second, in lines of SKT/1"


def test_a_cobot_without_a_sensor_waits_less_for_the_word_that_a_landmark_never_gets() -> None:
    without = make_client(cobot(name="cobot-tip"), part("cobot-tip")[1], lambda _: None).settings
    with_sensor = make_client(cobot(), part()[1], lambda _: None).settings
    assert with_sensor.held_wait_s > without.held_wait_s
