"""The camera that turns to the target by itself: when, how far, how long, and never under a hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from vtkmodules.vtkRenderingCore import vtkCamera

from app.scene3d import camera
from app.scene3d.camera import (
    CAMERA_TURN_DURATION_S,
    MIN_BALL_PX,
    PAUSE_AFTER_MANUAL_MOVE_S,
    RESIDUAL_TILT,
    TARGET_BALL_PX,
    AutoCamera,
    CameraPose,
    interpolate,
    is_visible,
    place,
    pose_of,
    turn_to,
)  # fmt: skip
from app.scene3d.scene_state import ESTIMATE_BALL_DIAMETER_M, View3DState
from skincal.contacts.outcome import PressPhase
from skincal.mesh.surface import make_surface
from skincal.taxels.result import Method
from tests.app.guide_support import target
from tests.app.scene3d_support import live, snapshot

TICK = 1 / 30
SIZE = (900, 600)
ASPECT = 1.5
UP, X = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])


def tube(sides: int = 48, radius: float = 0.04, half: float = 0.1):
    """A tube along x, open at both ends, and its points."""
    turn = np.arange(sides) * 2 * np.pi / sides
    ring = np.stack([0 * turn, radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    vertices = np.concatenate([ring - half * X, ring + half * X])
    a, b = np.arange(sides), np.roll(np.arange(sides), -1)
    triangles = np.concatenate([np.stack([a, b, a + sides], axis=1), np.stack([b, b + sides, a + sides], axis=1)])
    made = make_surface(vertices, triangles)
    assert (np.sum(made.normals * made.corners.mean(axis=1), axis=1) > 0).all()
    return made


TUBE = tube()


def on_tube(degrees: float, along: float = 0.0):
    """A place on the tube and its normal; 0 degrees is up."""
    turn = np.radians(degrees)
    normal = np.array([0.0, np.sin(turn), np.cos(turn)])
    return 0.04 * normal + along * X, normal


def above(aspect: float = ASPECT) -> CameraPose:
    """The whole tube seen from above."""
    return camera.fit(TUBE.vertices, UP, aspect, 0.015)


@pytest.mark.parametrize(("degrees", "seen"), [(0, True), (40, True), (60, False), (-60, False), (120, False), (180, False)])
def test_skin_is_is_visible_where_it_faces_the_camera(degrees, seen):
    at, normal = on_tube(degrees)
    assert is_visible(above(), at, normal, ASPECT) is seen


def test_the_long_axis_of_a_long_part_is_level_and_no_other():
    level = camera.long_axis(TUBE.vertices)
    assert level is not None
    assert abs(level @ X) == pytest.approx(1.0)
    # A cap at one side moves the middle, not the axis.
    assert abs(camera.long_axis(TUBE.vertices[TUBE.vertices[:, 2] > -0.02]) @ X) > 0.99
    assert camera.long_axis(tube(half=0.03).vertices) is None
    assert camera.long_axis(np.zeros((1, 3))) is None


def test_what_is_outside_the_picture_is_not_seen():
    assert not is_visible(above(), *on_tube(0, 0.5), ASPECT)
    near = CameraPose(above().axes, above().focus, 0.1)
    assert is_visible(near, *on_tube(0), ASPECT)
    assert not is_visible(near, *on_tube(0, 0.06), ASPECT)


@pytest.mark.parametrize("level", [X, None])
@pytest.mark.parametrize("degrees", [60, 90, 120, 179, -75, -160])
def test_after_the_turn_the_target_is_is_visible_and_the_part_is_level(level, degrees):
    start, (at, normal) = above(), on_tube(degrees, 0.03)
    end = turn_to(start, at, normal, ASPECT, level)
    assert is_visible(end, at, normal, ASPECT)
    assert end.distance == start.distance
    np.testing.assert_allclose(end.axes @ end.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(end.axes) == pytest.approx(1.0)
    assert normal @ end.axes[2] == pytest.approx(np.cos(RESIDUAL_TILT))
    if level is not None:
        assert end.axes[0] @ X == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_array_equal(end.focus, start.focus)


@pytest.mark.parametrize("level", [X, UP, None])
def test_from_wherever_to_wherever_the_camera_stands_upright(level):
    start = above()
    for way in (*np.eye(3), *-np.eye(3), *np.random.default_rng(0).normal(size=(40, 3))):
        normal = way / np.linalg.norm(way)
        end = turn_to(start, 0.01 * normal, normal, ASPECT, level)
        np.testing.assert_allclose(end.axes @ end.axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(end.axes) == pytest.approx(1.0)
        for share in (0.0, 0.4, 1.0):
            assert np.isfinite(interpolate(start, end, share).position).all()


def test_turns_one_after_another_do_not_roll_the_picture():
    rng = np.random.default_rng(1)
    stand = above()
    for degrees, along in zip(rng.uniform(-180, 180, 60), rng.uniform(-0.08, 0.08, 60), strict=True):
        at, normal = on_tube(float(degrees), float(along))
        if not is_visible(stand, at, normal, ASPECT):
            stand = turn_to(stand, at, normal, ASPECT, X)
            assert is_visible(stand, at, normal, ASPECT)
        assert abs(stand.axes[0] @ X) > 0.999


def test_a_target_outside_the_picture_comes_into_its_middle():
    near = CameraPose(above().axes, above().focus, 0.1)
    at, normal = on_tube(0, 0.08)
    end = turn_to(near, at, normal, ASPECT, X)
    assert is_visible(end, at, normal, ASPECT)
    np.testing.assert_array_equal(end.axes, near.axes)
    assert end.distance == near.distance
    np.testing.assert_array_equal(end.focus, at)


def test_the_way_begins_and_ends_at_rest_and_goes_one_way():
    start = above()
    end = turn_to(start, *on_tube(150, 0.05), ASPECT, X)
    np.testing.assert_allclose(interpolate(start, end, 0.0).axes, start.axes, atol=1e-9)
    np.testing.assert_allclose(interpolate(start, end, 1.0).axes, end.axes, atol=1e-9)
    np.testing.assert_allclose(interpolate(start, end, 1.0).focus, end.focus, atol=1e-12)
    turned = []
    for share in np.linspace(0.0, 1.0, 41):
        axes = interpolate(start, end, float(share)).axes
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        turned.append(np.arccos(np.clip((np.trace(axes @ start.axes.T) - 1) / 2, -1, 1)))
    steps = np.diff(turned)
    assert (steps > 0).all()
    assert steps[0] < 0.2 * steps.max()
    assert steps[-1] < 0.2 * steps.max()


def test_a_camera_stands_where_it_was_put():
    made = vtkCamera()
    place(made, camera.fit(TUBE.vertices, UP, ASPECT, 0.015))
    camera.rotate(made, 30.0, -12.0)
    stand = pose_of(made)
    other = vtkCamera()
    place(other, stand)
    np.testing.assert_allclose(other.GetPosition(), made.GetPosition(), atol=1e-9)
    np.testing.assert_allclose(pose_of(other).axes, stand.axes, atol=1e-9)


class Turning:
    """A turner and its camera, tick after tick."""

    def __init__(self) -> None:
        self.camera = vtkCamera()
        place(self.camera, camera.fit(TUBE.vertices, UP, ASPECT, 0.015))
        self.auto_camera = AutoCamera(TUBE, X)
        self.now_s = 100.0
        self.at = None
        self.phase = PressPhase.READY

    def ask(self, degrees: float | None, along: float = 0.0) -> None:
        self.at = None
        if degrees is not None:
            place_, normal = on_tube(degrees, along)
            self.at = replace(target(3), place=place_, normal=normal, push=-normal)

    def tick(self) -> bool:
        """One tick; return whether the camera moved."""
        view = live()
        view = replace(view, progress=replace(view.progress, phase=self.phase))
        before = self.camera.GetPosition(), self.camera.GetViewUp(), self.camera.GetFocalPoint()
        reported = self.auto_camera.advance(
            self.camera, ASPECT, SIZE[1], View3DState(snapshot(1, {}), view, Method.FREE, None, target=self.at), self.now_s
        )
        self.now_s += TICK
        moved = not np.allclose(np.concatenate(before), np.concatenate([
            self.camera.GetPosition(), self.camera.GetViewUp(), self.camera.GetFocalPoint(),
        ]), atol=1e-12, rtol=0)  # fmt: skip
        assert reported or not moved, "what moves is drawn"
        return moved

    def run(self, seconds: float) -> int:
        """Tick for so long; return how often the camera moved."""
        return sum(self.tick() for _ in range(round(seconds / TICK)))

    def sees(self) -> bool:
        assert self.at is not None
        return is_visible(pose_of(self.camera), self.at.place, self.at.normal, ASPECT)


@pytest.fixture
def turning():
    return Turning()


def test_a_turn_is_over_within_04_s_of_ticks(turning):
    turning.ask(120)
    assert not turning.sees()
    assert turning.run(0.4) > 8
    assert turning.sees()
    assert turning.run(2.0) == 0
    assert CAMERA_TURN_DURATION_S + TICK <= 0.4
    turning.ask(130)
    assert turning.run(1.0) == 0, "it is visible already"
    turning.auto_camera.note_manual_move(turning.now_s)
    camera.rotate(turning.camera, 180.0, 0.0)
    turning.run(PAUSE_AFTER_MANUAL_MOVE_S + 1.0)
    assert not turning.sees()
    turning.ask(130)
    assert turning.run(5.0) == 0, "the same target turns the camera once"


@pytest.mark.parametrize("phase", [PressPhase.PRESSING, PressPhase.STILL, PressPhase.HELD])
def test_the_camera_never_moves_in_contact(turning, phase):
    turning.phase = phase
    turning.ask(120)
    assert turning.run(2.0) == 0
    # After the release it does.
    turning.phase = PressPhase.TARING
    assert turning.run(0.4) > 8
    assert turning.sees()


def test_a_poke_stops_a_turn_and_the_release_takes_it_up_again(turning):
    turning.ask(120)
    assert turning.run(0.2) > 3
    turning.phase = PressPhase.PRESSING
    assert turning.run(1.0) == 0
    turning.phase = PressPhase.READY
    assert turning.run(0.45) > 3
    assert turning.sees()


def test_a_hand_on_the_camera_is_left_alone(turning):
    turning.auto_camera.held = True
    turning.ask(120)
    assert turning.run(10.0) == 0
    turning.auto_camera.held = False
    turning.auto_camera.note_manual_move(turning.now_s)
    assert turning.run(PAUSE_AFTER_MANUAL_MOVE_S - 0.1) == 0
    assert turning.run(0.6) > 8
    assert turning.sees()


def test_a_hand_ends_a_turn_and_the_camera_stays_where_it_was_put(turning):
    turning.ask(120)
    turning.run(0.2)
    turning.auto_camera.note_manual_move(turning.now_s)
    camera.rotate(turning.camera, 40.0, 10.0)
    assert turning.run(20.0) == 0, "for this target nothing turns any more"
    turning.ask(-120)
    assert turning.run(0.4) > 8
    assert turning.sees()


def test_switched_off_it_turns_nothing(turning):
    turning.auto_camera.wanted = False
    turning.ask(120)
    assert turning.run(1.0) == 0
    turning.ask(None)
    turning.auto_camera.wanted = True
    assert turning.run(1.0) == 0
    turning.ask(120)
    assert turning.run(0.4) > 8


def test_where_a_taxel_would_be_a_dot_the_camera_goes_near_and_around_the_part(turning):
    body = tube(radius=0.2, half=0.4)
    place(turning.camera, camera.fit(body.vertices, UP, ASPECT, 0.015))
    turning.auto_camera = AutoCamera(body, X)
    slope = 2 * np.tan(np.radians(camera.CAMERA_VIEW_ANGLE_DEG / 2))
    for degrees, along in ((0.0, 0.1), (10.0, 0.1), (170.0, -0.2), (-90.0, 0.3)):
        turning.ask(degrees)
        normal = turning.at.normal
        turning.at = replace(turning.at, place=0.2 * normal + along * X)
        for _ in range(12):
            turning.tick()
            position = np.array(turning.camera.GetPosition())
            assert np.hypot(*position[1:]) > 0.2, "never through the part"
        stand = pose_of(turning.camera)
        assert is_visible(stand, turning.at.place, normal, ASPECT)
        pixels = ESTIMATE_BALL_DIAMETER_M * SIZE[1] / (slope * ((stand.position - turning.at.place) @ stand.axes[2]))
        assert MIN_BALL_PX < pixels < 1.3 * TARGET_BALL_PX
    turning.ask(-90.0)
    turning.at = replace(turning.at, place=0.2 * turning.at.normal + 0.302 * X)
    assert turning.run(1.0) == 0, "near as it is, the next taxel moves nothing"
