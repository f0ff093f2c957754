"""What software OpenGL must show on any processor: `check.py` runs what is marked under several sets of its instructions.

Mesa compiles its shaders for the processor it finds, or for what `GALLIUM_OVERRIDE_CPU_CAPS` says of it. Every shader is in a
marked test; the free method has balls at all depths, so the other methods, which have the same shaders, run once.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy import ndimage

from app.scene3d.camera import VIEW_SLOPE, facing, pose_of, rotate, zoom
from app.scene3d.canvas import Canvas
from app.scene3d.offscreen import draw
from app.scene3d.scene_renderer import SceneRenderer
from app.scene3d.scene_state import DARK, LIGHT, MODULE_RGB, Comparison, StaticScene
from app.scene3d.view import View3D
from app.state.view_state import ViewState
from skincal.guide.guidance import Target
from skincal.mesh.lay import PlacedLayout
from skincal.mesh.surface import Surface, make_surface
from skincal.model.scene import Landmark
from skincal.part.part import Part
from skincal.taxels.result import Method
from tests.app.scene3d_support import box, decided, estimate, guidance_to, laid, layout, project, scene, snapshot, tick_of
from tests.app.view3d_on_screen import KEPT, make_plotter, pixels, renderer_of, turn, view_of
from tests.app.window_support import contrast

METHODS = [
    pytest.param(method, marks=pytest.mark.pixels) if method is Method.FREE else pytest.param(method) for method in Method
]
PLAN = layout()
UP = np.array([0.0, 0.0, 1.0])
LEANING = np.array([np.sin(0.2), 0.0, np.cos(0.2)])
PLACES = laid(PLAN).places + 5e-4 * UP
SCREW = Landmark("screw", np.array([0.0, -0.03, 0.0]), UP)
CENTRE_CHANNEL = 3


class Pictures:
    """A stage in a window that is never on a screen."""

    def __init__(self, surface: Surface | None) -> None:
        self.plotter = make_plotter()
        self.renderer = SceneRenderer(
            self.plotter, StaticScene(Part(scene(PLAN), surface, laid(PLAN), np.arange(24), ())), DARK
        )
        self.renderer.fit()

    def of(self, frame: ViewState, compared: Comparison | None = None) -> np.ndarray:
        """(480, 640, 3) int, first row lowest: the picture of a moment."""
        self.renderer.lay_over(compared, difference=False)
        self.renderer.show(frame)
        return draw(self.plotter)[..., :3].astype(int)

    def around(self, picture: np.ndarray, place: np.ndarray, reach: int = 2) -> np.ndarray:
        """(n, 3) int: the pixels around a place of the part."""
        x, y, _ = project(self.renderer.renderer, place[None])[0].round().astype(int)
        return picture[y - reach : y + reach + 1, x - reach : x + reach + 1].reshape(-1, 3)

    def close(self) -> None:
        self.renderer.close()
        self.plotter.close()


@pytest.fixture(autouse=True)
def _windows():
    yield
    KEPT.clear()


@pytest.fixture
def pictures():
    with closing(Pictures(box())) as made:
        yield made


def moment(method: Method) -> ViewState:
    """An estimate of every taxel, by one method only."""
    known = {channel: estimate(channel, PLACES[channel], method) for channel in range(24)}
    made = snapshot(1, {}, {})
    return tick_of(decided(replace(made, estimates={method: tuple(known.values())}), landmarks=(SCREW,)), None, method, None)


def asked_for() -> Target:
    """Its normal leans, so that one side of the ring lies a millimetre below the skin."""
    return Target(CENTRE_CHANNEL, PLACES[CENTRE_CHANNEL] * [1, 1, 0], LEANING, -UP, 0.0, np.inf, 0.0)


def comparison() -> Comparison:
    """Each taxel by the plan, and 8 mm below that inside the part."""
    below = PLACES - 8e-3 * UP
    return Comparison({"from": PLACES, "to": below}, np.stack([PLACES, below], axis=1))


@pytest.mark.pixels
def test_each_face_of_a_box_has_one_shade(pictures):
    renderer = pictures.renderer
    renderer.hide(frozenset(name for name in renderer.list_layers() if name != "surface"))
    rotate(renderer.camera, 35.0, 25.0)
    shades, sizes = np.unique(draw(pictures.plotter)[..., :3].reshape(-1, 3).astype(int), axis=0, return_counts=True)
    faces = shades[(sizes > 1000) & (np.abs(shades - DARK.background).max(axis=1) > 20)]
    assert sizes[(np.abs(shades[:, None] - [*faces, DARK.background]).max(axis=2) <= 1).any(axis=1)].sum() > 0.99 * sizes.sum()
    assert np.ptp(faces.max(axis=1)) > 20, "the faces differ"


@pytest.mark.parametrize("method", METHODS)
def test_all_that_is_drawn_is_seen_with_target_landmark_and_comparison(pictures, method):
    frame = replace(moment(method), guidance=guidance_to(asked_for()))
    shown = pictures.of(frame)
    away = np.linalg.norm(PLACES - PLACES[CENTRE_CHANNEL], axis=1)
    for channel in np.flatnonzero(away > 7e-3):  # what is nearer lies under the target's ring and arrow
        ball = pictures.around(shown, PLACES[channel])
        assert np.abs(ball - MODULE_RGB[channel // 12]).max() < 80, f"the ball of channel {channel}"
    for step in ring_steps():
        ring = pictures.around(shown, asked_for().place + step, 4)
        assert (ring.min(axis=1) > 230).sum() > 10, "white upon"
        assert (ring.max(axis=1) < 25).sum() > 10, "black"
    cross = pictures.around(shown, SCREW.place)
    assert (np.abs(cross - DARK.ink).max(axis=1) < 25).sum() > 5

    compared = pictures.of(replace(frame, guidance=None), comparison())
    for channel in range(24):
        for tint, place in (("from", PLACES[channel]), ("to", PLACES[channel] - 8e-3 * UP)):
            dot = pictures.around(compared, place, 1)
            assert (np.abs(dot - DARK.tints[tint]).max(axis=1) < 60).sum() >= 5, f"{tint} of channel {channel}"

    np.testing.assert_array_equal(pictures.of(frame), shown)


def ring_steps() -> np.ndarray:
    """(3, 3) float, metres: from the middle of the ring to where neither arrow nor cone lies; the last is below the skin."""
    from app.scene3d.target import TARGET_RING_RADIUS_M as RING

    return RING * np.array([(0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (np.cos(0.2), 0.0, -np.sin(0.2))])


RADIUS = 0.04  # m, of a ball with skin all around: half of its taxels are turned away from any camera
DEEP = {Method.FREE: (0.0, -1e-3, 1e-3, 3e-3, 8e-3), Method.SURFACE: (0.0,), Method.MODULES: (1.5e-3, 2.5e-3)}
"""m. How far below the skin the estimates of each method lie, in turn."""


def around_the_ball() -> np.ndarray:
    """(24, 3) unit vectors, evenly spread."""
    turn, height = np.arange(24) * np.pi * (3 - 5**0.5), 1 - (2 * np.arange(24) + 1) / 24
    return np.stack([(1 - height**2) ** 0.5 * np.cos(turn), (1 - height**2) ** 0.5 * np.sin(turn), height], axis=1)


def view_of_ball(qtbot, canvas: Canvas) -> View3D:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    skin = PlacedLayout(RADIUS * around_the_ball(), around_the_ball(), (np.empty((0, 3)),) * 2)
    view = view_of(qtbot, canvas, scene(PLAN), make_surface(ball.vertices, ball.faces), skin)
    view.set_turning(False)
    return view


def spots(picture: np.ndarray, hue: np.ndarray, least: float) -> int:
    """How many spots of a hue there are, lit or not, of so many pixels at least."""
    # What light takes from a colour it takes from all of it.
    share = picture / np.maximum(picture.sum(axis=-1, keepdims=True), 1)
    like = (np.abs(share - hue / hue.sum()).max(axis=-1) < 0.06) & (picture.max(axis=-1) > 60)
    numbered, count = ndimage.label(like, np.ones((3, 3)))
    return int((np.bincount(numbered.ravel(), minlength=count + 1)[1:] >= least).sum())


@pytest.mark.parametrize("canvas", list(Canvas))
@pytest.mark.parametrize("method", METHODS)
def test_as_many_balls_are_seen_as_taxels_face_the_camera_however_deep_they_lie(qtbot, method, canvas):
    view = view_of_ball(qtbot, canvas)
    out = around_the_ball()
    deep = np.resize(DEEP[method], 24)
    places = (RADIUS - deep)[:, None] * out
    known = tuple(estimate(channel, places[channel], method, sd=1e-5) for channel in range(24))
    # Between the taxels, on the side that is seen.
    screw = Landmark("screw", RADIUS * unit_of(out[4] + out[7] + out[9]), unit_of(out[4] + out[7] + out[9]))
    side = unit_of(out[12] + out[9] + out[14])
    target = Target(None, RADIUS * side, side, -side, 0.0, np.inf, 0.0)
    shown = decided(replace(snapshot(1, {}, {}), estimates={method: known}), landmarks=(screw,))
    for turned in (0.0, 70.0, 200.0):
        view.reset_camera()
        turn(view, turned, 0.3 * turned)
        view.show_state(tick_of(shown, None, method, None, target))
        picture, pose = pixels(view).astype(float), pose_of(renderer_of(view).camera)
        cosines = facing(out, places, pose.position)
        size = 3.2e-3 * view.height() / (2 * VIEW_SLOPE * pose.distance)
        for module, hue in enumerate(MODULE_RGB[:2]):
            own = cosines[12 * module : 12 * module + 12]
            assert np.abs(own).min() > 0.02, "none on the edge, where half a ball would count"
            assert spots(picture, hue.astype(float), 0.3 * size**2) == (own > 0).sum(), f"turned by {turned}"
        view.set_comparison(Comparison({"to": places}, np.full((24, 2, 3), np.nan)))
        dots = spots(pixels(view).astype(float), np.array(DARK.tints["to"], float), 12)
        assert dots == (cosines > 0).sum()
        view.set_comparison(None)


def unit_of(ways: np.ndarray) -> np.ndarray:
    return ways / np.linalg.norm(ways, axis=-1, keepdims=True)


@pytest.mark.pixels
def test_what_is_brought_before_a_flat_part_seen_straight_from_afar_is_not_cut_off():
    with closing(Pictures(None)) as pictures:
        from app.scene3d.scene_renderer import FIRST_LEAN_DEG

        camera = pictures.renderer.camera
        rotate(camera, -FIRST_LEAN_DEG[0], -FIRST_LEAN_DEG[1])
        zoom(camera, 0.05)
        dots = Comparison({"to": PLACES}, np.full((24, 2, 3), np.nan))
        compared = pictures.of(moment(Method.FREE), dots)
        for place in PLACES:
            assert (np.abs(pictures.around(compared, place, 1) - DARK.tints["to"]).max(axis=1) < 60).sum() >= 5


def test_no_layer_asks_for_a_polygon_offset(pictures):
    """VTK has one switch of it for all layers, and with it reads a ball's depth before that is written."""
    from vtkmodules.vtkRenderingCore import vtkMapper

    pictures.of(replace(moment(Method.FREE), guidance=guidance_to(asked_for())), comparison())
    assert vtkMapper.GetResolveCoincidentTopology() == 0


@pytest.mark.parametrize("zoom", [1.0, 6.0], ids=["beside the part", "on the part"])
@pytest.mark.parametrize("look", [pytest.param(DARK, marks=pytest.mark.pixels), LIGHT], ids=["dark", "light"])
def test_the_lines_of_axes_and_scale_are_seen(pictures, look, zoom):
    pictures.renderer.set_colours(look)
    camera = pictures.renderer.camera
    camera.SetPosition(*(np.array(camera.GetFocalPoint()) + np.subtract(camera.GetPosition(), camera.GetFocalPoint()) / zoom))
    shown = pictures.of(tick_of(snapshot(1, {}), None, Method.FREE, None))
    hints = next(layer for layer in pictures.renderer.layers if layer.name == "hints")
    ends = project(pictures.renderer.renderer, hints.lines.mesh.points)[:, :2].reshape(-1, 2, 2)
    for start, end in ends[np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > 8]:
        along = (end - start) / np.linalg.norm(end - start)
        x, y = (0.5 * (start + end)).round().astype(int)
        strip = [shown[y + int(step * along[0]), x - int(step * along[1])] for step in range(-4, 5)]
        line = min(strip, key=lambda colour: np.abs(colour - look.ink).max())
        assert max(contrast(line, np.array(beside)) for beside in strip) >= 3.0
