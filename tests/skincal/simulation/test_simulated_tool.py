"""The simulated arm that holds a tool: its poses and wrenches by geometry written here, and a session that is calibrated."""

import json
import socket
import threading
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.contacts.outcome import Contact
from skincal.following.session_guide import SessionGuide
from skincal.geometry import inverse_pose
from skincal.model.readings import Stream
from skincal.part.part import lay_part
from skincal.robot.target_lines import PokeTarget
from skincal.simulation.device import DeviceSettings, DeviceTimeline
from skincal.simulation.operator import AutoOperator, GuidedOperator, Habits, HandPress
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.serve import Server
from skincal.simulation.simulated_rig import Rig
from skincal.simulation.simulated_tool import SimulatedTool
from skincal.simulation.virtual_session import simulate_session
from skincal.taxels.result import Method
from tests.skincal.sim_support import scene_and_surface

NAME = "cobot-forearm"
QUICK = DeviceSettings(wrench_hz=250.0, tool_hz=50.0, block_s=0.02)
NO_ERRORS = replace(RigErrors.none(), mount_shift=0.0, mount_turn=0.0)


def rig_of(errors=NO_ERRORS, seed=1):
    return Rig(*scene_and_surface(NAME), errors, np.random.default_rng(seed))


def timeline(rig, pokes=3):
    operator = AutoOperator(rig, Habits.careful().with_tool(), np.random.default_rng(2), pokes)
    line, presses = DeviceTimeline(rig, operator, np.random.default_rng(3), QUICK), []
    while not line.finished:
        line.advance_many(50)
        presses += [each for each in line._actions if isinstance(each, HandPress) and each not in presses]
    return line, presses


def tips(rig, reported):
    """End of the tip in the link, metres, by reported poses (n, 7)."""
    base_from_link = inverse_pose(rig.scene.tool.link_from_base)
    in_base = reported[:, :3] + Rotation.from_quat(reported[:, 3:]).apply(rig.scene.tool.tip)
    return (in_base - base_from_link[:3, 3]) @ base_from_link[:3, :3]


def pressed_s(press):
    return press.begin + press.ramp + 0.5 * press.hold


def test_a_pressing_tool_has_its_tip_at_the_pressed_point():
    rig = rig_of()
    _, presses = timeline(rig)
    assert len(presses) == 3
    for press in presses:
        press = replace(press, tremor=0.0)
        reported = rig.tool.reported(np.array([pressed_s(press)]), np.random.default_rng(1))
        np.testing.assert_allclose(tips(rig, reported)[0], press.pokes.points[0], atol=0.00005)
        axis = Rotation.from_quat(reported[0, 3:]).apply([0.0, 0.0, 1.0])
        np.testing.assert_allclose(
            axis @ inverse_pose(rig.scene.tool.link_from_base)[:3, :3], press.pokes.directions[0], atol=1e-9
        )


def test_the_tool_rests_above_the_skin_for_half_a_second_before_each_press():
    rig = rig_of()
    _, presses = timeline(rig)
    for press in presses:
        rest = rig.tool.reported(np.linspace(press.begin - 0.7, press.begin - 0.16, 8), np.random.default_rng(1))
        assert np.ptp(rest[:, :3], axis=0).max() < 1e-9
        above = (press.pokes.points[0] - tips(rig, rest)[0]) @ press.pokes.directions[0]
        assert above == pytest.approx(0.005, abs=1e-6)


def test_the_way_of_the_tool_has_no_jump():
    rig = rig_of()
    line, _ = timeline(rig)
    times = np.arange(0.0, line.now, 0.002)
    reported = rig.tool.reported(times, np.random.default_rng(1))
    steps = np.linalg.norm(np.diff(tips(rig, reported), axis=0), axis=1)
    assert steps.max() < 0.006  # 3 m/s: the first way, from the place where the tool waits
    turns = Rotation.from_quat(reported[:, 3:])
    assert (turns[:-1].inv() * turns[1:]).magnitude().max() < 0.05


def test_a_sensor_on_the_tool_feels_the_opposite_force_at_the_tip():
    rig = rig_of()
    _, presses = timeline(rig)
    sensor = rig.scene.tool.tool_from_sensor
    for press in presses:
        at = np.array([pressed_s(press)])
        force = press.load(at)[0] * press.pokes.forces[0] * press.pokes.directions[0]
        both = (
            rig.tool.wrenches(at, force[None], press.pokes.points)[0]
            - rig.tool.wrenches(at, np.zeros((1, 3)), np.zeros((1, 3)))[0]
        )
        # The push is along the tool's z axis: in the sensor's frame, turned as the tool, it is along z at the tip.
        np.testing.assert_allclose(both[:3], [0.0, 0.0, np.linalg.norm(force)], atol=1e-9)
        lever = rig.scene.tool.tip - sensor[:3, 3]
        np.testing.assert_allclose(both[3:], np.cross(lever, both[:3]), atol=5e-4)


def test_the_weight_of_the_tool_pulls_down_in_the_base():
    rig = rig_of()
    _, presses = timeline(rig)
    at = np.array([presses[1].begin - 0.3])
    reported = rig.tool.reported(at, np.random.default_rng(1))
    # The device reads the force on the tool: the opposite of what the scene's sign makes of it.
    felt = rig.scene.wrench_sign * rig.tool.wrenches(at, np.zeros((1, 3)), np.zeros((1, 3)))[0]
    np.testing.assert_allclose(Rotation.from_quat(reported[0, 3:]).apply(felt[:3]), [0.0, 0.0, -0.5 * 9.81], atol=1e-9)


def test_a_late_stream_reports_earlier_poses():
    rig, late = rig_of(), rig_of(replace(NO_ERRORS, tool_delay=0.04))
    (_, presses), _ = timeline(rig), timeline(late)
    times = presses[1].begin - np.linspace(1.2, 0.9, 10)
    now, then = (each.tool.reported(times - by, np.random.default_rng(1)) for each, by in ((rig, 0.04), (late, 0.0)))
    np.testing.assert_allclose(then, now, atol=1e-12)


def test_errors_of_the_arm_have_their_sizes():
    sizes = []
    for seed in range(30):
        rig = rig_of(replace(NO_ERRORS, tool_tip=0.001, tool_position=0.0005, tool_noise=0.0003), seed)
        _, presses = timeline(rig, 1)
        reported = rig.tool.reported(np.full(50, pressed_s(presses[0])), np.random.default_rng(seed))
        sizes.append(np.mean(np.sum((tips(rig, reported) - presses[0].pokes.points[0]) ** 2, axis=1)))
    # Independent errors of 1, 0.5 and 0.3 mm.
    assert np.sqrt(np.mean(sizes)) == pytest.approx(np.sqrt(1.34) * 1e-3, rel=0.25)


def test_a_part_without_a_pose_in_the_scene_lies_at_a_drawn_one():
    spec = replace(scene_and_surface(NAME)[0].tool, has_part_pose=False)
    drawn = [SimulatedTool(spec, NO_ERRORS, np.random.default_rng(seed)).base_from_link for seed in (1, 1, 2)]
    np.testing.assert_array_equal(drawn[0], drawn[1])
    assert np.linalg.norm(drawn[0] - drawn[2]) > 0.05


def test_a_simulated_session_is_calibrated_within_its_prediction(tmp_path):
    scene, surface = scene_and_surface(NAME)
    pipeline = simulate_session(
        scene, surface, tmp_path / "s", 20, 4, RigErrors.noise(), habits=Habits.careful().with_tool(), settings=QUICK
    )
    snapshot = pipeline.snapshot()
    contacts = [record.outcome for record in snapshot.pokes if isinstance(record.outcome, Contact)]
    assert len(contacts) >= 18  # a hand that aims between taxels is rejected
    truth = json.loads((tmp_path / "s" / "truth.json").read_text())
    places = {each["channel"]: np.array(each["position_m"]) for each in truth["taxels"]}
    misses = []
    for each in contacts:
        turn, origin = each.link_from_sensor[:3, :3], each.link_from_sensor[:3, 3]
        push = turn @ each.force / np.linalg.norm(each.force)
        point = turn @ (np.cross(each.force, each.moment) / (each.force @ each.force)) + origin
        misses.append(np.linalg.norm(np.cross(places[each.strongest_channel] - point, push)))
        tip = (each.link_from_sensor @ inverse_pose(scene.tool.tool_from_sensor))[:3] @ np.append(scene.tool.tip, 1.0)
        assert np.linalg.norm(tip - places[each.strongest_channel]) < 0.008
    assert np.median(misses) < 0.005
    assert {link.link for link in pipeline.live(0).links} == {"wrench", "skin", "tool"}
    # A tip that the scene gives places the pokes: errors of the sensor add nothing to the predicted ones.
    part = lay_part(scene, surface, ())
    assert SessionGuide(part).verdict(snapshot, Method.SURFACE).unchecked is None
    by_axes = replace(part, scene=replace(scene, tool=replace(scene.tool, tip=None)))
    assert SessionGuide(by_axes).verdict(snapshot, Method.SURFACE).unchecked > 0.005


def test_a_robot_that_is_told_late_still_has_the_time_to_go_there():
    rig = rig_of()
    hand = GuidedOperator(rig, Habits.careful().with_tool(), np.random.default_rng(1))
    target = PokeTarget(1, int(rig.channels[0]), rig.places[0], -rig.normals[0])
    hand.show(target)
    assert hand.next(5.0) is None
    press = hand.next(20.0)
    assert press.begin >= 20.0 + 1.3


def test_served_devices_send_poses_of_the_tool():
    rig = rig_of(RigErrors.noise())
    line = DeviceTimeline(
        rig, AutoOperator(rig, Habits.careful().with_tool(), np.random.default_rng(1)), np.random.default_rng(2)
    )
    server = Server(line, tcp=True)
    stop = threading.Event()
    worker = threading.Thread(target=server.run, args=(stop,))
    worker.start()
    try:
        links = {link.carries[0]: link for link in server.links}
        assert set(links) == {Stream.WRENCH, Stream.SKIN, Stream.TOOL}
        host, port = links[Stream.TOOL].address.removeprefix("socket://").split(":")
        with socket.create_connection((host, int(port)), timeout=20) as link:
            lines = link.makefile("rb")
            record = next(line for line in lines if line.startswith(b"P,"))
        assert len(record.split(b"*")[0].split(b",")) == 3 + 7
    finally:
        stop.set()
        worker.join()
        server.close()
