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
    REST_DELAY_S,
    TARGET_BALL_PX,
    AutoCamera,
    CameraPose,
    Framing,
    interpolate,
    interpolate_level,
    is_visible,
    place,
    pose_of,
    turned_back,
)  # fmt: skip
from app.scene3d.scene_state import ESTIMATE_BALL_DIAMETER_M
from skincal.contacts.outcome import PressPhase
from skincal.mesh.surface import make_surface
from skincal.taxels.result import Method
from tests.app.guide_support import target
from tests.app.scene3d_support import live, snapshot, tick_of

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


FRAMING = Framing(TUBE.vertices, UP)
BLOCK = np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.04, 0.04) for z in (-0.03, 0.06)])  # Not twice as long as wide
NARROW = 0.6


def turned(start: CameraPose, at, normal, framing: Framing = FRAMING, aspect: float = ASPECT) -> CameraPose:
    """The view of a point, with the whole part in the picture."""
    return framing.whole(framing.axes(turned_back(start, at, normal), aspect), at, aspect, 0.015)


def on_picture(pose: CameraPose, points, aspect: float):
    """Places of points in the picture by a plain perspective: -1 to 1 from edge to edge, (n, 2)."""
    seen = (points - pose.position) @ pose.axes.T
    slope = np.tan(np.radians(camera.CAMERA_VIEW_ANGLE_DEG / 2))
    return seen[:, :2] / -seen[:, 2:] / slope / [aspect, 1.0]


def random_ways(count: int = 60, seed: int = 0):
    ways = np.random.default_rng(seed).normal(size=(count, 3))
    return [*np.eye(3), *-np.eye(3), *(ways / np.linalg.norm(ways, axis=1, keepdims=True))]


@pytest.mark.parametrize("aspect", [2.5, ASPECT, 1.0, NARROW])
@pytest.mark.parametrize(
    "points", [TUBE.vertices, BLOCK, TUBE.vertices + np.array([0.3, -0.2, 0.5])], ids=["tube", "block", "far away"]
)
def test_the_part_fills_the_picture_with_equal_margins_from_every_side(points, aspect):
    framing = Framing(points, None)
    for back in random_ways():
        pose = camera.fit_from(points, framing.axes(back, aspect), aspect, 0.001)
        np.testing.assert_allclose(pose.axes @ pose.axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose.axes) == pytest.approx(1.0)
        np.testing.assert_allclose(pose.axes[2], back, atol=1e-12)
        seen = on_picture(pose, points, aspect)
        low, high = seen.min(axis=0), seen.max(axis=0)
        tight = int(high.argmax())
        assert high[tight] == pytest.approx(1.0 / camera.VIEW_SIZE_OVER_PART_SIZE)
        assert low[tight] == pytest.approx(-high[tight])
        np.testing.assert_allclose(low, -high, atol=1e-3)


def test_a_long_part_lies_along_the_long_side_of_the_picture_and_never_rolls():
    for aspect, row in ((ASPECT, 0), (NARROW, 1)):
        for back in random_ways():
            axes = FRAMING.axes(back, aspect)
            if abs(back @ X) < 0.9:
                assert abs(axes[1 - row] @ X) < 1e-9, "the part's axis is straight in the picture"
                assert axes[row] @ X > 0.0, "its ends never change sides"
    assert FRAMING.rest(ASPECT, 0.015, (-14.0, -10.0)).axes[1] @ X == pytest.approx(0.0, abs=1e-12)


def test_another_part_stands_upright():
    framing = Framing(BLOCK, X)
    for back in random_ways():
        if abs(back[2]) < 0.9:
            axes = framing.axes(back, ASPECT)
            assert axes[0] @ UP == pytest.approx(0.0, abs=1e-12)
            assert axes[1] @ UP > 0.0


@pytest.mark.parametrize("degrees", [60, 90, 120, 179, -75, -160])
def test_after_the_turn_the_target_is_visible(degrees):
    start, (at, normal) = above(), on_tube(degrees, 0.03)
    end = turned(start, at, normal)
    assert is_visible(end, at, normal, ASPECT)
    assert normal @ end.axes[2] == pytest.approx(np.cos(RESIDUAL_TILT))
    assert end.axes[0] @ X == pytest.approx(1.0, abs=1e-6)
    assert np.abs(on_picture(end, TUBE.vertices, ASPECT)).max() < 1.0


def test_from_wherever_to_wherever_the_way_is_finite():
    start = above()
    for normal in random_ways():
        end = turned(start, 0.01 * normal, normal)
        for share in (0.0, 0.4, 1.0):
            assert np.isfinite(interpolate(start, end, share).position).all()


def test_turns_one_after_another_leave_nothing_behind():
    """The picture of a direction is the same whatever was seen before: no roll, no shift, no zoom is left."""
    rng = np.random.default_rng(1)
    pose = above()
    for degrees, along in zip(rng.uniform(-180, 180, 60), rng.uniform(-0.08, 0.08, 60), strict=True):
        pose = turned(pose, *on_tube(float(degrees), float(along)))
        assert abs(pose.axes[0] @ X) > 0.999
        np.testing.assert_allclose(pose.position, camera.fit_from(TUBE.vertices, pose.axes, ASPECT, 0.015).position, atol=1e-9)


def test_a_zoomed_picture_keeps_its_distance_and_shows_target_and_part():
    axes = above().axes
    for along in (-0.1, -0.07, 0.0, 0.09):
        at, _ = on_tube(0, along)
        pose = FRAMING.at_distance(axes, at, 0.15, ASPECT)
        assert (pose.position - at) @ pose.axes[2] == pytest.approx(0.15)
        target_seen = on_picture(pose, at[None], ASPECT)[0]
        assert np.abs(target_seen).max() <= 0.951
        left, right = on_picture(pose, np.array([[-0.1, 0, 0.04], [0.1, 0, 0.04]]), ASPECT)[:, 0]
        assert left < -0.9 or right > 0.9, "one end is outside"
        assert left < -0.9, "no empty half at the left"
        assert right > 0.9, "and none at the right"


def test_the_way_begins_and_ends_at_rest_and_goes_one_way():
    start = above()
    end = turned(start, *on_tube(150, 0.05))
    np.testing.assert_allclose(interpolate(start, end, 0.0).axes, start.axes, atol=1e-9)
    np.testing.assert_allclose(interpolate(start, end, 1.0).axes, end.axes, atol=1e-9)
    np.testing.assert_allclose(interpolate(start, end, 1.0).focus, end.focus, atol=1e-12)
    angles = []
    for share in np.linspace(0.0, 1.0, 41):
        axes = interpolate(start, end, float(share)).axes
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        angles.append(np.arccos(np.clip((np.trace(axes @ start.axes.T) - 1) / 2, -1, 1)))
    steps = np.diff(angles)
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
        self.auto_camera = AutoCamera(TUBE, FRAMING, 0.015)
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
            self.camera, ASPECT, SIZE[1], tick_of(snapshot(1, {}), view, Method.FREE, None, target=self.at), self.now_s
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
    turning.auto_camera = AutoCamera(body, Framing(body.vertices, UP), 0.015)
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


@pytest.mark.parametrize("points", [TUBE.vertices, BLOCK], ids=["tube", "block"])
def test_on_the_way_there_is_no_roll_either(points):
    framing = Framing(points, UP if points is TUBE.vertices else X)
    level = X if points is TUBE.vertices else None
    rng = np.random.default_rng(5)
    for _ in range(60):
        ends = [np.array([0.25 * along, np.sin(turn), np.cos(turn)]) for along, turn in rng.uniform(-3, 3, (2, 2))]
        if level is None:
            ends = [end[[1, 2, 0]] for end in ends]  # Around the upright axis
        start, end = (CameraPose(framing.axes(b / np.linalg.norm(b), ASPECT), np.zeros(3), 1.0) for b in ends)
        for share in (0.0, 0.2, 0.5, 0.7, 1.0):
            axes = interpolate_level(start, end, share, framing, ASPECT).axes
            np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
            across = axes[1] @ X if level is not None else axes[0] @ UP
            assert abs(across) < 1e-9
        np.testing.assert_allclose(interpolate_level(start, end, 1.0, framing, ASPECT).axes, end.axes, atol=1e-9)


def test_without_a_target_the_camera_returns_to_its_first_view(turning):
    rest = pose_of(turning.camera)
    turning.ask(120, 0.09)
    turning.run(1.0)
    assert not np.allclose(pose_of(turning.camera).axes, rest.axes, atol=0.1)
    turning.ask(None)
    assert turning.run(REST_DELAY_S - 0.1) == 0, "the next target may come"
    assert turning.run(1.0) > 8
    np.testing.assert_allclose(pose_of(turning.camera).position, rest.position, atol=1e-6)
    np.testing.assert_allclose(pose_of(turning.camera).axes, rest.axes, atol=1e-6)
    assert turning.run(5.0) == 0
    # A target that comes in time keeps the camera where it is.
    turning.ask(120)
    turning.run(1.0)
    turning.ask(None)
    turning.run(0.5)
    turning.ask(121)
    assert turning.run(5.0) == 0


def test_a_hand_that_zoomed_keeps_its_distance_until_the_whole_part_is_shown(turning):
    camera.zoom(turning.camera, 2.5)
    turning.auto_camera.note_manual_move(turning.now_s, keeps_distance=True)
    distance = pose_of(turning.camera).distance
    turning.run(PAUSE_AFTER_MANUAL_MOVE_S)
    turning.ask(100, 0.09)
    assert turning.run(1.0) > 8
    assert turning.sees()
    at = turning.at.place
    assert (pose_of(turning.camera).position - at) @ pose_of(turning.camera).axes[2] == pytest.approx(distance, rel=1e-2)
    turning.ask(None)
    assert turning.run(10.0) == 0, "it stays where the hand wants to look"
    place(turning.camera, turning.auto_camera.rest(ASPECT))
    turning.ask(100, 0.09)
    turning.run(1.0)
    assert np.abs(on_picture(pose_of(turning.camera), TUBE.vertices, ASPECT)).max() == pytest.approx(0.926, abs=1e-3)


def test_a_drag_that_rolled_the_picture_is_levelled_with_the_next_target(turning):
    for _ in range(5):
        camera.rotate(turning.camera, 30.0, 25.0)
        camera.rotate(turning.camera, -30.0, 25.0)
    turning.auto_camera.note_manual_move(turning.now_s)
    assert abs(pose_of(turning.camera).axes[1] @ X) > 0.1
    turning.run(PAUSE_AFTER_MANUAL_MOVE_S)
    turning.ask(40)
    turning.run(1.0)
    assert turning.sees()
    assert abs(pose_of(turning.camera).axes[1] @ X) < 1e-6
