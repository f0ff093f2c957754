"""What is kept of the part while the camera stands still: the pixels are those of a picture that draws everything."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from vtkmodules.vtkRenderingOpenGL2 import vtkOpenGLFramebufferObject

from app.scene3d import kept_part
from app.scene3d.camera import rotate
from app.scene3d.kept_part import KeptPart
from app.scene3d.offscreen import draw
from app.scene3d.scene_renderer import SceneRenderer
from app.scene3d.scene_state import DARK, LIGHT, StaticScene
from app.state.view_state import ViewState
from skincal.guide.guidance import Target
from skincal.part.part import Part
from skincal.taxels.result import Method
from tests.app.scene3d_support import box, contact, estimate, laid, layout, live, scene, snapshot, tick_of
from tests.app.view3d_on_screen import make_plotter

PLAN = layout()
POKES = [contact(poke, 3, (1e-3 * poke, 0.0, 0.0), (0.3 * poke, 1.0, -8.0)) for poke in range(5)]
PLACES = laid(PLAN).places - 2e-3 * laid(PLAN).normals
ESTIMATED = snapshot(1, {channel: estimate(channel, PLACES[channel]) for channel in range(24)}, pokes=POKES)
MOVED = snapshot(2, {channel: estimate(channel, PLACES[channel] + 3e-3 * (channel == 5)) for channel in range(24)}, pokes=POKES)
UP = np.array([0.0, 0.0, 1.0])
TARGET = Target(15, PLACES[15], UP, -UP, 0.0, np.inf, 0.0)


class Camera:
    """A renderer of the box; `keeps` is whether it keeps the drawn part."""

    def __init__(self, *, keeps: bool) -> None:
        self.plotter, self.keeps = make_plotter(), keeps
        self.renderer = SceneRenderer(self.plotter, StaticScene(Part(scene(PLAN), box(), laid(PLAN), np.arange(24), ())), DARK)
        self.renderer.fit()

    def picture(self, state: ViewState) -> np.ndarray:
        self.renderer.show(state)
        if not self.keeps:
            # A camera that seems to have moved makes everything be drawn.
            self.kept._viewpoint = None
        return draw(self.plotter)[..., :3].astype(int)

    @property
    def kept(self):
        assert self.renderer.kept_part is not None
        return self.renderer.kept_part

    def close(self) -> None:
        self.renderer.close()
        self.plotter.close()


@pytest.fixture
def cameras():
    with closing(Camera(keeps=True)) as keeping, closing(Camera(keeps=False)) as drawing:
        yield keeping, drawing


def presses() -> list[ViewState]:
    """States while a tool presses from changing sides at changing places, with and without a selected taxel."""
    forces = [(0.0, 0.0, -8.0), (2.0, 0.0, -8.0), (4.0, 3.0, -8.0), (-6.0, 1.0, -5.0)]
    at = [(0.0, 0.0, 0.0), (0.01, 0.005, -0.002), (-0.03, 0.02, 0.0), (0.038, -0.038, 0.0)]
    states = [tick_of(ESTIMATED, live(place, force)) for place, force in zip(at, forces, strict=True)]
    selected = [replace(state, selected=3) for state in states]
    released = [tick_of(ESTIMATED), tick_of(MOVED), tick_of(MOVED, None, Method.FREE, 3, TARGET)]
    return [tick_of(ESTIMATED), *states, *selected, states[2], *released, tick_of(MOVED, live(*at[:1]), Method.FREE, 3, TARGET)]


@pytest.mark.pixels
def test_pictures_of_a_press_are_those_of_a_part_that_is_drawn_each_time(cameras):
    keeping, drawing = cameras
    for state in (presses()[0], *presses()):
        np.testing.assert_array_equal(keeping.picture(state), drawing.picture(state))
    kept = keeping.kept
    assert 2 < kept.drawn_parts < kept.drawn_labels < len(presses()), "labels are drawn again where an axis meets them"
    assert len({keeping.picture(state).tobytes() for state in presses()[:5]}) == 5, "each of them differs"


def test_a_press_draws_the_part_only_until_it_is_kept(cameras):
    keeping, _ = cameras
    for tilt in np.linspace(0.0, 1.0, 20):
        keeping.picture(tick_of(ESTIMATED, live((0.01, 0.01, 0.0), (tilt, 0.0, -8.0))))
    assert keeping.kept.drawn_parts == keeping.kept.drawn_fronts == keeping.kept.drawn_labels == 2


def test_camera_colours_layers_and_size_make_the_part_be_drawn_again(cameras):
    keeping, drawing = cameras
    state = presses()[2]

    def change(camera: Camera, of: str) -> None:
        renderer = camera.renderer
        match of:
            case "camera":
                rotate(renderer.camera, 7.0, 3.0)
            case "colours":
                renderer.set_colours(LIGHT)
            case "no surface":
                renderer.hide(frozenset({"surface"}))
            case "no axes":
                renderer.hide(frozenset({"axes"}))
            case "size":
                camera.plotter.window_size = [500, 400]

    seen = {keeping.picture(state).tobytes()}
    for of in ("camera", "colours", "no surface", "no axes", "size"):
        for camera in cameras:
            change(camera, of)
        for _ in range(3):
            np.testing.assert_array_equal(keeping.picture(state), drawing.picture(state), of)
        seen.add(keeping.picture(state).tobytes())
    assert len(seen) == 6


@pytest.mark.parametrize("missing", ["buffers", "copies"])
def test_without_buffers_or_copies_each_picture_draws_everything(monkeypatch, missing):
    if missing == "buffers":

        class NoBuffer(vtkOpenGLFramebufferObject):
            def PopulateFramebuffer(self, *_: object) -> bool:  # noqa: N802 - VTK's name
                return False

        monkeypatch.setattr(kept_part, "vtkOpenGLFramebufferObject", NoBuffer)
    else:
        # As after an error of `glBlitFramebuffer`: nothing is copied.
        monkeypatch.setattr(KeptPart, "_copy", lambda *_: None)
    states = [*presses()[:1] * 3, *presses()[1:5]]
    with closing(Camera(keeps=True)) as keeping, closing(Camera(keeps=False)) as drawing:
        for state in states:
            np.testing.assert_array_equal(keeping.picture(state), drawing.picture(state))
        assert keeping.kept.drawn_parts == keeping.kept.drawn_labels == len(states)
