"""The 3D view's geometry, its picture without a window, and what it imports; none of it needs a display."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from app import theme
from app.scene3d.scene_state import LIGHT, MODULE_RGB, StaticScene, module_hues
from skincal.mesh.surface import contact_point, entry_points, make_surface
from skincal.model.skin import MODULE_KINDS, Layout, Module
from skincal.palette import METHODS
from skincal.part.part import Part
from skincal.taxels.result import Method
from tests.app.scene3d_support import box, estimate, laid, layout, scene


def test_a_line_enters_a_ball_where_the_pencil_says():
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.05)
    surface = make_surface(ball.vertices, ball.faces)
    direction = np.array([0.6, 0.0, 0.8])
    offset = np.array([0.0, 0.02, 0.0])
    (entry,) = entry_points(surface, offset + 0.3 * direction, direction)
    expected = offset - direction * np.sqrt(0.05**2 - 0.02**2)
    # The facets of the ball lie inside it by up to 0.1 mm.
    np.testing.assert_allclose(entry, expected, atol=2e-4)
    (other,) = entry_points(surface, offset, -direction)
    np.testing.assert_allclose(other, offset + direction * np.sqrt(0.05**2 - 0.02**2), atol=2e-4)
    assert len(entry_points(surface, np.array([0.0, 0.0501, 0.0]), np.array([1.0, 0.0, 0.0]))) == 0


def test_entries_agree_with_triangles_solved_one_by_one(rng):
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    vertices = np.concatenate([ball.vertices, ball.vertices + np.array([0.12, 0.0, 0.0])])
    surface = make_surface(vertices, np.concatenate([ball.faces, ball.faces + len(ball.vertices)]))
    most = 0
    for _ in range(30):
        direction = rng.normal(size=3) * [1.0, 0.1, 0.1]
        direction /= np.linalg.norm(direction)
        through = rng.uniform(-0.04, 0.04, 3)
        found = entry_points(surface, through, direction)
        np.testing.assert_allclose(found, _entries_one_by_one(surface, through, direction), atol=1e-9)
        most = max(most, len(found))
    assert most == 2, "some lines go through both balls"


def _entries_one_by_one(surface, point, direction):
    """p + s d = a + u (b - a) + v (c - a), solved for each triangle."""
    entries = []
    for (a, b, c), normal in zip(surface.vertices[surface.triangles], surface.normals, strict=True):
        s, u, v = np.linalg.solve(np.stack([-direction, b - a, c - a], axis=1), point - a)
        if u >= 0 and v >= 0 and u + v <= 1 and normal @ direction < 0:
            entries.append((s, point + s * direction))
    return np.array([at for _, at in sorted(entries, key=lambda entry: entry[0])]).reshape(-1, 3)


def test_the_contact_is_the_entry_near_the_taxels_or_else_the_axis_itself():
    surface = box()
    down = np.array([0.0, 0.0, -1.0])
    entered = contact_point(surface, np.array([0.01, 0.02, 0.3]), down, np.zeros(3))
    np.testing.assert_allclose(entered, [0.01, 0.02, 0.0], atol=1e-12)
    beside = contact_point(surface, np.array([0.06, 0.0, 0.3]), down, np.array([0.04, 0.0, -0.005]))
    np.testing.assert_allclose(beside, [0.06, 0.0, -0.005], atol=1e-12)
    np.testing.assert_allclose(contact_point(None, np.array([0.01, 0.0, 0.3]), down, np.zeros(3)), [0.01, 0.0, 0.0], atol=1e-12)


def test_an_ellipsoid_is_drawn_where_chi_square_says(rng):
    from app.scene3d.estimates import region

    root = rng.normal(size=(3, 3)) * 1e-3
    covariance = root @ root.T
    about = estimate(3, (0.01, 0.02, 0.03))
    drawn = region(_with(about, covariance, Method.FREE), 0.1).reshape(-1, 3) - about.position
    squares = np.einsum("ix,xy,iy->i", drawn, np.linalg.inv(covariance), drawn)
    np.testing.assert_allclose(squares, chi2(3).ppf(0.95), rtol=2e-3)


def test_on_a_surface_the_region_is_a_disc_across_the_normal(rng):
    from app.scene3d.estimates import region

    normal = np.array([0.0, 0.6, 0.8])
    flat = np.eye(3) - np.outer(normal, normal)
    root = flat @ rng.normal(size=(3, 3)) * 1e-3
    about = _with(estimate(3, (0.01, 0.02, 0.03)), root @ root.T, Method.SURFACE, normal)
    drawn = region(about, 0.1).reshape(-1, 3) - about.position
    np.testing.assert_allclose(drawn @ normal, 0.0, atol=1e-9)
    squares = np.einsum("ix,xy,iy->i", drawn, np.linalg.pinv(root @ root.T), drawn)
    np.testing.assert_allclose(squares, chi2(2).ppf(0.95), rtol=2e-3)


def test_a_region_is_not_longer_than_the_part():
    from app.scene3d.estimates import region

    about = _with(estimate(3, (0.01, 0.02, 0.03)), np.diag([0.01, 0.001, 0.03]) ** 2, Method.FREE)
    drawn = region(about, 0.04).reshape(-1, 3) - about.position
    np.testing.assert_allclose(np.ptp(drawn, axis=0), [0.04, 2 * 2.7955e-3, 0.04], rtol=1e-3)


def _with(about, covariance, method, normal=None):
    return type(about)(
        about.channel, method, about.state, about.contacts, about.position, normal, covariance, None, about.sd, about.rms
    )


@given(st.floats(1e-4, 1e5))
def test_a_scale_bar_has_a_round_length_and_fills_its_place(value):
    from app.scene3d.hints import round_below

    length = round_below(value)
    assert value / 2.5 < length <= value * (1 + 1e-9)
    digits = f"{length:.6e}"
    assert digits[0] in "125"
    assert float(digits[: digits.index("e")]) in (1.0, 2.0, 5.0)


def test_seven_modules_have_seven_hues_and_the_eighth_repeats_the_first():
    modules = tuple(Module(i, MODULE_KINDS["triangle_12"], 12 * i, np.zeros(2), 0.0, False) for i in range(8))
    hues = module_hues(Layout(modules, 96), np.arange(0, 96, 12))
    assert len({tuple(hue) for hue in hues[:7].tolist()}) == 7
    np.testing.assert_array_equal(hues[7], hues[0])


def test_a_method_has_one_colour_in_window_3d_view_and_figures():
    for method in Method:
        hue = theme.LIGHT.methods[method.value]
        assert METHODS[method.value] == hue
        assert "#{:02X}{:02X}{:02X}".format(*LIGHT.tints[method.value]) == hue


def test_importing_the_view_loads_no_drawing_library():
    script = (
        "import sys, app.scene3d.view, app.headless\n"
        "print([n for n in ('vtkmodules', 'vtk', 'pyvista', 'pyvistaqt') if n in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


PICTURE = """
import sys
from pathlib import Path
sys.path[:0] = {path!r}
from tests.app.scene3d_support import box, estimate, laid, layout, scene, snapshot
from app.scene3d.session_picture import picture
from skincal.palette import METHODS
from skincal.part.part import Part
from skincal.taxels.result import Method
plan = layout()
session = snapshot(1, {{3: estimate(3, (-0.018, 0.02, 0.01))}})
surface = box() if {surface} else None
part = Part(scene(plan), surface, laid(plan), plan.channels, ())
picture(part, session, Method.FREE, Path({out!r}), (400, 300))
print([n for n in ("PySide6", "pyvistaqt", "matplotlib.pyplot", "matplotlib.figure") if n in sys.modules])
"""


@pytest.mark.parametrize("surface", [True, False])
def test_a_picture_is_drawn_without_display_qt_or_figures_of_matplotlib(tmp_path: Path, surface: bool):
    if not sys.platform.startswith("linux"):
        pytest.skip("without a display: a matter of Linux")
    out = tmp_path / "picture.png"
    script = PICTURE.format(path=[str(Path(__file__).parents[3])], out=str(out), surface=surface)
    environment = {"PATH": "/usr/bin:/bin"}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment, check=True)
    assert done.stdout.strip() == "[]"
    pixels = _read_png(out)
    assert pixels.shape == (300, 400, 3)
    np.testing.assert_array_equal(pixels[0, 0], LIGHT.background)
    for hue in MODULE_RGB[:2]:
        assert (pixels == hue).all(axis=-1).sum() > 60, "the outline of a module has its hue"
    assert not (pixels == MODULE_RGB[2]).all(axis=-1).any()
    grey = (np.ptp(pixels.astype(int), axis=-1) < 12) & (pixels.max(axis=-1) < 220)
    assert (grey.sum() > 20_000) == surface


LATE_FIGURES = """
from app.scene3d.pyvista_import import import_plotter
import_plotter()
import pyvista as pv
import sys
assert not {"matplotlib", "matplotlib.colors", "pooch"} & set(sys.modules)
assert not isinstance("viridis", pv.plotting.colors.colors.Colormap)
chart = pv.ChartMPL()
from matplotlib.backends.backend_agg import FigureCanvasAgg
import matplotlib.pyplot as plt
import matplotlib
assert isinstance(pv.LookupTable("magma").cmap, matplotlib.colors.Colormap)
assert isinstance(matplotlib.colormaps["plasma"], pv.plotting.colors.colors.Colormap)
assert pv.plotting.colors.get_cmap_safe(["red", "blue"]).N == 2
try:
    pv.plotting.colors.get_cmap_safe("nonsense")
except ValueError:
    print(type(chart._canvas) is FigureCanvasAgg, chart.figure is plt.gcf(), plt is sys.modules["matplotlib.pyplot"])
"""


MESH_WITH_OWN_COLOURS = """
from app.scene3d.offscreen import make_plotter
import sys
import numpy as np
import pyvista as pv
plotter, mesh = make_plotter((20, 20)), pv.Plane()
mesh["rgb"] = np.full((mesh.n_points, 3), 7, np.uint8)
plotter.add_mesh(mesh, scalars="rgb", rgb=True)
print({"matplotlib", "pyparsing", "unittest"} & set(sys.modules))
"""


def test_a_mesh_with_its_own_colours_needs_no_colour_map():
    done = subprocess.run([sys.executable, "-c", MESH_WITH_OWN_COLOURS], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_a_chart_of_pyvista_finds_the_figures_that_were_not_imported_with_it():
    # Without a display: matplotlib would ask Qt for one.
    environment = {**os.environ, "MPLBACKEND": "Agg"}
    done = subprocess.run([sys.executable, "-c", LATE_FIGURES], capture_output=True, text=True, env=environment, check=True)
    assert done.stdout.split() == ["True", "True", "True"]


def _read_png(path: Path) -> np.ndarray:
    from PySide6.QtGui import QImage

    image = QImage(str(path)).convertToFormat(QImage.Format.Format_RGB888)
    rows = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), image.bytesPerLine())
    return rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).copy()


def test_skin_has_a_far_side_only_where_it_is_laid_on_a_surface():
    plan = layout()
    on_part, flat, unlaid = (
        StaticScene(Part(scene(plan), surface, skin, np.arange(3), ()))
        for surface, skin in ((box(), laid(plan)), (None, laid(plan)), (box(), None))
    )
    assert (on_part.skin_normals == on_part.normals).all()
    assert np.isnan(flat.skin_normals).all()
    assert np.isnan(unlaid.skin_normals).all()
