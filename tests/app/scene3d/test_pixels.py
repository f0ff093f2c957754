"""What software OpenGL must show on any processor: `check.py` runs this file under several sets of its instructions.

Mesa compiles its shaders for the processor it finds, or for what `GALLIUM_OVERRIDE_CPU_CAPS` says of it.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from app.scene3d.camera import approach, orbit, project
from app.scene3d.scene_state import DARK, HUES, Cloud, Comparison, StaticScene, Tint, View3DState
from skincal.guide.guidance import Target
from skincal.mesh.surface import Surface
from skincal.model.scene import Landmark
from skincal.taxels.result import Method
from tests.app.scene3d_support import box, estimate, laid, layout, scene, snapshot

pytestmark = pytest.mark.pixels

PLAN = layout()
UP = np.array([0.0, 0.0, 1.0])
LEANING = np.array([np.sin(0.2), 0.0, np.cos(0.2)])
PLACES = laid(PLAN).places + 5e-4 * UP
SCREW = Landmark("screw", np.array([0.0, -0.03, 0.0]), UP)
CENTRE_CHANNEL = 3


class Pictures:
    """A stage in a window that is never on a screen."""

    def __init__(self, surface: Surface | None) -> None:
        from app.scene3d.offscreen import choose_offscreen

        choose_offscreen()
        from app.scene3d.offscreen import HiddenWindow
        from app.scene3d.stage import Stage

        self.window = HiddenWindow((640, 480))
        self.stage = Stage(self.window.renderer, StaticScene(scene(PLAN), surface, laid(PLAN), range(24)), DARK)
        self.stage.fit()

    def of(self, frame: View3DState) -> np.ndarray:
        """(480, 640, 3) int, first row lowest: the picture of a moment."""
        self.stage.show(frame)
        return self.window.draw()[..., :3].astype(int)

    def around(self, picture: np.ndarray, place: np.ndarray, reach: int = 2) -> np.ndarray:
        """(n, 3) int: the pixels around a place of the part."""
        x, y, _ = project(self.stage.renderer, place[None])[0].round().astype(int)
        return picture[y - reach : y + reach + 1, x - reach : x + reach + 1].reshape(-1, 3)

    def close(self) -> None:
        self.stage.close()
        self.window.close()


@pytest.fixture
def pictures():
    with closing(Pictures(box())) as made:
        yield made


def moment(method: Method) -> View3DState:
    """An estimate of every taxel, by one method only."""
    known = {channel: estimate(channel, PLACES[channel], method) for channel in range(24)}
    made = snapshot(1, {}, {})
    return View3DState(replace(made, estimates={method: tuple(known.values())}, landmarks=(SCREW,)), None, method, None)


def asked_for() -> Target:
    """Its normal leans, so that one side of the ring lies a millimetre below the skin."""
    return Target(CENTRE_CHANNEL, PLACES[CENTRE_CHANNEL] * [1, 1, 0], LEANING, -UP, 0.0, np.inf, 0.0)


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
    for step in ring_steps():
        ring = pictures.around(shown, asked_for().place + step, 4)
        assert (ring.min(axis=1) > 230).sum() > 10, "white upon"
        assert (ring.max(axis=1) < 25).sum() > 10, "black"
    cross = pictures.around(shown, SCREW.place)
    assert (np.abs(cross - DARK.ink).max(axis=1) < 25).sum() > 5

    compared = pictures.of(replace(frame, comparison=comparison()))
    for channel in range(24):
        for tint, place in ((Tint.FROM, PLACES[channel]), (Tint.TO, PLACES[channel] - 8e-3 * UP)):
            dot = pictures.around(compared, place, 1)
            assert (np.abs(dot - DARK.tints[tint]).max(axis=1) < 60).sum() >= 5, f"{tint} of channel {channel}"

    np.testing.assert_array_equal(pictures.of(frame), shown)


def ring_steps() -> np.ndarray:
    """(3, 3) float, metres: from the middle of the ring to where neither arrow nor cone lies; the last is below the skin."""
    from app.scene3d.target import RING

    return RING * np.array([(0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (np.cos(0.2), 0.0, -np.sin(0.2))])


def test_what_is_brought_before_a_flat_part_seen_straight_from_afar_is_not_cut_off():
    with closing(Pictures(None)) as pictures:
        from app.scene3d.stage import LEAN_DEG

        camera = pictures.stage.renderer.GetActiveCamera()
        orbit(camera, -LEAN_DEG[0], -LEAN_DEG[1])
        approach(camera, 0.05)
        dots = Comparison((Cloud(Tint.TO, PLACES),), np.full((24, 2, 3), np.nan))
        compared = pictures.of(replace(moment(Method.FREE), comparison=dots))
        for place in PLACES:
            assert (np.abs(pictures.around(compared, place, 1) - DARK.tints[Tint.TO]).max(axis=1) < 60).sum() >= 5


def test_no_layer_asks_for_a_polygon_offset(pictures):
    """VTK has one switch of it for all layers, and with it reads a ball's depth before that is written."""
    from vtkmodules.vtkRenderingCore import vtkMapper

    pictures.of(replace(moment(Method.FREE), target=asked_for(), comparison=comparison()))
    assert vtkMapper.GetResolveCoincidentTopology() == 0
