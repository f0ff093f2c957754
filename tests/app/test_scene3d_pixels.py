"""What software OpenGL must show on any processor: `check.py` runs this file under several sets of its instructions.

Mesa compiles its shaders for the processor it finds, or for what `GALLIUM_OVERRIDE_CPU_CAPS` says of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scene3d_support import box, estimate, laid, layout, scene, snapshot

from app.scene3d.ground import Cloud, Comparison, Frame, Ground
from app.scene3d.looks import DARK, HUES, Tint
from app.scene3d.picking import project
from skincal.guide.guidance import Target
from skincal.model.scene import Landmark
from skincal.taxels.result import Method

pytestmark = pytest.mark.pixels

PLAN = layout()
UP = np.array([0.0, 0.0, 1.0])
PLACES = laid(PLAN).places + 5e-4 * UP
SCREW = Landmark("screw", np.array([0.0, -0.03, 0.0]), UP)
CENTRE_CHANNEL = 3


class Pictures:
    """A stage in a window that is never on a screen."""

    def __init__(self) -> None:
        from app.scene3d.graphics import choose_offscreen

        choose_offscreen()
        from app.scene3d.stage import Stage
        from app.scene3d.window import HiddenWindow

        self.window = HiddenWindow((640, 480))
        self.stage = Stage(self.window.renderer, Ground(scene(PLAN), box(), laid(PLAN), range(24)), DARK)
        self.stage.fit()

    def of(self, frame: Frame) -> np.ndarray:
        """(480, 640, 3) int, first row lowest: the picture of a moment."""
        self.stage.show(frame)
        return self.window.draw()[..., :3].astype(int)

    def around(self, picture: np.ndarray, place: np.ndarray, reach: int = 2) -> np.ndarray:
        """(n, 3) int: the pixels around a place of the part."""
        x, y, _ = project(self.stage.renderer, place[None])[0].round().astype(int)
        return picture[y - reach : y + reach + 1, x - reach : x + reach + 1].reshape(-1, 3)


@pytest.fixture
def pictures():
    made = Pictures()
    yield made
    made.stage.close()
    made.window.close()


def moment(method: Method) -> Frame:
    """An estimate of every taxel, by one method only."""
    known = {channel: estimate(channel, PLACES[channel], method) for channel in range(24)}
    made = snapshot(1, {}, {})
    return Frame(replace(made, estimates={method: tuple(known.values())}, landmarks=(SCREW,)), None, method, None)


def asked_for() -> Target:
    return Target(CENTRE_CHANNEL, PLACES[CENTRE_CHANNEL] * [1, 1, 0], UP, -UP, 0.0, np.inf, 0.0)


def comparison() -> Comparison:
    """Each taxel by the plan, and 8 mm below that inside the part."""
    below = PLACES - 8e-3 * UP
    return Comparison((Cloud(Tint.FROM, PLACES), Cloud(Tint.TO, below)), np.stack([PLACES, below], axis=1))


@pytest.mark.parametrize("method", list(Method))
def test_all_that_is_drawn_is_seen_with_target_landmark_and_comparison(pictures, method):
    frame = replace(moment(method), target=asked_for())
    shown = pictures.of(frame)
    away = np.linalg.norm(PLACES - PLACES[CENTRE_CHANNEL], axis=1)
    for channel in np.flatnonzero(away > 7e-3):  # what is nearer lies under the target's ring and arrow
        ball = pictures.around(shown, PLACES[channel])
        assert np.abs(ball - HUES[channel // 12]).max() < 80, f"the ball of channel {channel}"
    ring = np.concatenate([pictures.around(shown, asked_for().place + step, 4) for step in ring_steps()])
    assert (ring.min(axis=1) > 230).sum() > 10
    assert (ring.max(axis=1) < 25).sum() > 10
    cross = pictures.around(shown, SCREW.place)
    assert (np.abs(cross - DARK.ink).max(axis=1) < 25).sum() > 5

    compared = pictures.of(replace(frame, comparison=comparison()))
    for channel in range(24):
        for tint, place in ((Tint.FROM, PLACES[channel]), (Tint.TO, PLACES[channel] - 8e-3 * UP)):
            dot = pictures.around(compared, place, 1)
            assert (np.abs(dot - DARK.tints[tint]).max(axis=1) < 60).sum() >= 5, f"{tint} of channel {channel}"

    np.testing.assert_array_equal(pictures.of(frame), shown)


def ring_steps() -> np.ndarray:
    from app.scene3d.target import RING

    return RING * np.array([(0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)])


def test_no_layer_asks_for_a_polygon_offset(pictures):
    """VTK has one switch of it for all layers, and with it reads a ball's depth before that is written."""
    from vtkmodules.vtkRenderingCore import vtkMapper

    pictures.of(replace(moment(Method.FREE), target=asked_for(), comparison=comparison()))
    assert vtkMapper.GetResolveCoincidentTopology() == 0
