"""The engine's rig against statics, another nearest-point search, the friction cone and momentum."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from skincal.geometry import FloatArray
from skincal.mesh.load import load_surface
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.scene import Scene, load_scene, resource
from skincal.physics.effects import EFFECT_NAMES, Effects
from skincal.physics.engine import PERIOD_S, Touch, load_mujoco
from skincal.physics.mjcf import FOAM_STIFFNESS_N_PER_M, FOAM_THICKNESS_M, TIP_RADIUS_M
from skincal.physics.rig import SimulatedRobot
from skincal.physics.robots import make_robot
from skincal.physics.session import RobotSession, make_client
from skincal.physics.skin import Pads
from skincal.robot.target_lines import Answer, AnswerKind, PokeTarget, RobotLine

pytest.importorskip("mujoco")
GRAVITY = np.array([0.0, 0.0, -9.81])


@cache
def part() -> tuple[Scene, Surface]:
    scene = load_scene(resource("scenes/icub-forearm/scene.toml"))
    assert scene.surface is not None
    return scene, load_surface(scene.surface)[0]


def robot(*effects: str, seed: int = 1) -> SimulatedRobot:
    return make_robot(*part(), Effects.only(*effects), seed)


def go(arm: SimulatedRobot, row: int, tilt_deg: float, *moves: tuple[float, float, float]) -> None:
    """Go to heights over a taxel, metres, each with a speed and a time."""
    place, normal = arm.pads.places[row], arm.pads.normals[row]
    side = np.cross(normal, [0.0, 1.0, 0.0])
    push = -normal * np.cos(np.radians(tilt_deg)) + side / np.linalg.norm(side) * np.sin(np.radians(tilt_deg))
    for height, speed, seconds in moves:
        arm.command(place - height * push, push, speed)
        for _ in range(round(seconds / PERIOD_S)):
            arm.advance()


def press(arm: SimulatedRobot, tilt_deg: float = 0.0, row: int = 40, into_m: float = 0.003) -> Touch:
    """Press at a taxel until everything rests."""
    go(arm, row, tilt_deg, (0.05, 0.2, 5.0), (-into_m, 0.03, 4.0))
    touch = arm.engine.touch()
    assert touch is not None
    return touch


def test_the_sensor_reads_the_touch_and_the_weight() -> None:
    arm = robot("weight", "friction")
    touch = press(arm, 20.0)
    assert np.linalg.norm(touch.force) > 3.0
    sensor_from_link = np.linalg.inv(arm.link_from_sensor())
    turn, shift = sensor_from_link[:3, :3], sensor_from_link[:3, 3]
    _, world_from_part = arm.engine.part_pose()
    weight = world_from_part.T @ (arm.effects.weight * GRAVITY)
    low, high = part()[1].vertices.min(axis=0), part()[1].vertices.max(axis=0)
    wanted = np.zeros(6)
    for point, force in ((touch.point, touch.force), ((low + high) / 2, weight)):
        wanted += np.concatenate([turn @ force, np.cross(turn @ point + shift, turn @ force)])
    np.testing.assert_allclose(arm.engine.sensor_wrench(), wanted, atol=1e-6)
    assert np.linalg.norm(touch.force) == pytest.approx(FOAM_STIFFNESS_N_PER_M * touch.depth, rel=0.25)
    assert touch.force @ -touch.normal == pytest.approx(FOAM_STIFFNESS_N_PER_M * touch.depth, rel=1e-4)


@pytest.mark.parametrize("row", [0, 23, 61])
def test_the_touch_lies_where_the_engine_s_own_ray_meets_the_mesh(row: int) -> None:
    mujoco, surface = load_mujoco(), part()[1]
    touch = press(robot(), row=row)
    root = mujoco.MjSpec()
    root.add_mesh(name="part", uservert=surface.vertices.ravel(), userface=surface.triangles.ravel(), inertia=2)
    root.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="part")
    model = root.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    start = touch.point + 0.05 * touch.normal
    hit = mujoco.mj_ray(model, data, start, -touch.normal, None, 1, -1, np.zeros(1, dtype=np.int32))
    # The engine's point is half-way between the two faces that overlap.
    assert 0.05 + FOAM_THICKNESS_M - touch.depth / 2 == pytest.approx(hit, abs=2e-6)


def test_a_push_outside_the_friction_cone_slips() -> None:
    def tangential(touch: Touch) -> float:
        inward = touch.force @ -touch.normal
        return float(np.linalg.norm(touch.force + inward * touch.normal) / inward)

    stuck, slid = press(robot(), 50.0, into_m=0.002), press(robot("friction"), 50.0, into_m=0.002)
    assert tangential(stuck) > 0.65 > 0.6 + 1e-3 > tangential(slid)
    assert np.linalg.norm(stuck.point - slid.point) > 5e-4


def test_the_sensor_feels_the_inertia_of_a_trembling_part() -> None:
    arm = robot("weight", "vibration")
    read: list[FloatArray] = []
    for _ in range(500):
        arm.advance()
        read.append(arm.engine.sensor_wrench()[:3])
    forces = np.array(read)
    assert np.sqrt(np.mean(forces.var(axis=0))) == pytest.approx(arm.effects.vibration, rel=0.5)
    assert np.linalg.norm(forces.mean(axis=0)) == pytest.approx(9.81 * arm.effects.weight, rel=0.02)
    # Momentum: the sensor's force is that of the part's acceleration.
    turn = np.linalg.inv(arm.link_from_sensor())[:3, :3] @ arm.engine.part_pose()[1].T
    accelerations = np.array([arm_acceleration(arm) for _ in range(50)])
    assert np.ptp(accelerations[:, :3]) > 0.05
    wanted = arm.effects.weight * (GRAVITY - accelerations[:, :3]) @ turn.T
    np.testing.assert_allclose(wanted, accelerations[:, 3:], atol=0.02)


def arm_acceleration(arm: SimulatedRobot) -> FloatArray:
    """Acceleration of the part by differences of its velocity over one step of the engine, and the sensor's force there."""
    mujoco, data, model = load_mujoco(), arm.engine.data, arm.engine.model
    arm.advance()
    dofs = [model.joint(f"mount_{axis}").dofadr[0] for axis in "xyz"]
    mount = data.xmat[model.body("p0").id].reshape(3, 3)
    before = mount @ data.qvel[dofs]
    mujoco.mj_step(model, data)
    after = mount @ data.qvel[dofs]
    return np.concatenate([(after - before) / model.opt.timestep, arm.engine.sensor_wrench()[:3]])


def test_the_pads_carry_the_load() -> None:
    """Boussinesq's stress over a plane adds up to the force along its normal, and a wider patch spreads it."""
    scene, surface = part()
    pads = Pads(scene, surface, np.random.default_rng(0))
    grid = np.arange(-14.0, 14.1, 3.5449) * 1e-3  # squares of a pad's area
    x, y = np.meshgrid(grid, grid)
    pads.places = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    pads.normals = np.tile([0.0, 0.0, 1.0], (x.size, 1))
    pads._cells = pads.places[:, None] + (pads._cells[:1] - pads._cells[:1, :1]) @ _onto_z(pads)
    touch = Touch(np.array([0.0, 0.0, 0.003]), np.array([0.0, 0.0, 1.0]), np.array([3.0, 0.0, -8.0]), 0.001)
    _, loads = pads.loads(touch, 0.0)
    assert loads.sum() == pytest.approx(8.0, rel=0.1)
    assert pads.loads(touch, 1.0)[1].max() < loads.max()


def _onto_z(pads: Pads) -> FloatArray:
    cells = pads._cells[0] - pads._cells[0, 0]
    normal = np.cross(cells[1], cells[2])
    x = cells[1] / np.linalg.norm(cells[1])
    z = normal / np.linalg.norm(normal)
    return np.column_stack([x, np.cross(z, x), z])


def test_equal_seeds_give_equal_readings() -> None:
    def readings(seed: int) -> list[bytes]:
        arm = make_robot(*part(), Effects(), seed)
        press(arm, 15.0)
        return [arm.reading.tobytes(), arm.skin_frame().tobytes(), arm.engine.data.qpos.tobytes()]

    first = readings(3)
    assert first == readings(3)
    assert first != readings(4)


def test_a_servo_overshoots_its_goal_and_comes_back_to_it() -> None:
    def heights(*effects: str) -> FloatArray:
        """Heights of the tip over its goal while it moves there by 20 mm, millimetres."""
        arm = robot(*effects)
        place, normal = arm.pads.places[40], arm.pads.normals[40]
        go(arm, 40, 0.0, (0.05, 0.2, 5.0))
        arm.command(place + 0.03 * normal, -normal, 0.2)
        seen: list[float] = []
        for _ in range(500):
            arm.advance()
            seen.append(1e3 * float((arm.engine.tip_in_part()[0] - place) @ normal) - 30.0)
        return np.array(seen)

    ideal, loose = heights(), heights("overshoot")
    assert ideal.min() > -0.05
    # Of the speed at which the goal stops, not of a step: less than 25 % of 20 mm.
    assert -5.0 < loose.min() < -0.3
    assert abs(loose[-1]) < 0.02
    assert abs(ideal[-1]) < 0.02


def test_the_arm_s_weight_and_the_noise_are_seen() -> None:
    ideal, sagging, noisy = robot(), robot("sag"), robot("noise")
    for arm in (ideal, sagging, noisy):
        go(arm, 40, 0.0, (0.05, 0.2, 5.0))
    drop = [float(arm.engine.tip_in_part()[0][2] - arm.read_tip().position[2]) for arm in (ideal, sagging)]
    assert abs(drop[0]) < 1e-5
    assert drop[1] < -1e-3
    forces = np.array([noisy.reading[:3] for _ in range(500) if noisy.advance() is None])
    assert forces.std() == pytest.approx(noisy.effects.noise, rel=0.1)


def test_a_filtered_sensor_is_late() -> None:
    def rise(*effects: str) -> float:
        """Time at which the reading passes 2 N in a press."""
        arm = robot(*effects)
        read = arm.reading
        place, push = arm.pads.places[40], -arm.pads.normals[40]
        arm.command(place - 0.02 * push, push, 0.3)
        while np.linalg.norm(arm.reading - read) < 2.0:
            if arm.time_s > 4.0:
                arm.command(place + 0.004 * push, push, 0.03)
            arm.advance()
            assert arm.time_s < 12.0
        return arm.time_s

    assert rise("low_pass") - rise() == pytest.approx(0.020 + 1 / (2 * np.pi * 50), abs=0.005)


def test_where_mujoco_is_missing_a_sentence_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Any:
        raise ImportError(name)

    monkeypatch.setattr("skincal.physics.engine.import_module", missing)
    with pytest.raises(InputError, match=r"pip install 'skincal\[physics\]'"):
        robot()


def test_effects_are_named_one_by_one() -> None:
    assert all(getattr(Effects(), name) > 0 and getattr(Effects.none(), name) == 0 for name in EFFECT_NAMES)
    with pytest.raises(InputError, match="no effect 'wind'; expected some of noise, vibration"):
        Effects.only("wind")


def test_the_arm_goes_where_it_is_told_in_the_frame_it_believes() -> None:
    arm = robot("base")
    go(arm, 40, 0.0, (0.02, 0.2, 6.0))
    position, direction = arm.engine.tip_in_part()
    believed = arm.read_tip()
    assert 1e-4 < np.linalg.norm(position - believed.position) < 0.02
    exact = robot()
    go(exact, 40, 0.0, (0.02, 0.2, 6.0))
    np.testing.assert_allclose(exact.engine.tip_in_part()[0], believed.position, atol=2e-5)
    assert not arm.is_reachable(np.array([2.0, 0.0, 0.0]), direction)
    assert arm.tip_radius_m == TIP_RADIUS_M


@pytest.mark.parametrize("frame", ["r_forearm_dh_frame", "", "r_hand"])
def test_its_client_pokes_in_the_frame_of_its_part_alone(frame: str) -> None:
    arm, answers = robot(), list[RobotLine]()
    client = make_client(arm, part()[1], answers.append)
    client.receive_line(PokeTarget(1, 3, arm.pads.places[40], -arm.pads.normals[40], frame=frame))
    client.run_period()
    faults = [line.number for line in answers if isinstance(line, Answer) and line.kind is AnswerKind.FAULT]
    assert faults == ([1] if frame == "r_hand" else [])


def test_an_impossible_answer_ends_a_session_of_a_simulated_robot() -> None:
    arm = robot()
    session = RobotSession(*part(), arm)
    session.targets.answer(Answer(AnswerKind.SKIP, 99))
    while not session.targets.fault and arm.time_s < 1.0:
        arm.advance()
    assert session.targets.fault == "it answers 'skip 99', and was asked 0 at most."
