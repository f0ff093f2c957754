"""Make the scene `fingertip`: a dome with 49 taxels of three axes, by formulas.

The dome is a tube with an elliptic end, as fingertips of hands are: 16 mm wide, 7 mm high and 30 mm long. No maker's data is in
it. The rows of taxels are 3 mm apart along the finger, and the taxels 3 mm along the arc of each row.

    python -m tools.fingertip
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skincal.files.atomic import write_atomically
from skincal.files.layout_sources import kind_line
from skincal.files.paxini_points import flatten_points
from skincal.geometry import FloatArray
from skincal.model.skin import SkinKind

SCENE_FOLDER = Path(__file__).resolve().parent.parent / "resources" / "scenes" / "fingertip"
HALF_WIDTH_MM, HEIGHT_MM, BACK_MM = 8.0, 7.0, 4.0
ROOT_MM, STRAIGHT_END_MM, CAP_MM = -8.0, 12.0, 10.0
SPACING_MM = 3.0
ROW_PLACES_MM = (1.0, 4.0, 7.0, 10.0, 13.0, 16.0)
MAX_ANGLE = float(np.radians(55.0))
"""rad, of a taxel from the middle of its row."""
STRAIGHT_SECTIONS, CAP_SECTIONS, SECTION_CORNERS = 14, 14, 60


def _scale(y: float) -> float:
    """Size of the section at `y`, mm, over that of the straight part."""
    return 1.0 if y <= STRAIGHT_END_MM else float(np.sqrt(max(0.0, 1.0 - ((y - STRAIGHT_END_MM) / CAP_MM) ** 2)))


def _point(y: float, angle: float) -> tuple[float, float, float]:
    height = HEIGHT_MM if np.cos(angle) > 0 else BACK_MM
    return HALF_WIDTH_MM * _scale(y) * float(np.sin(angle)), y, height * _scale(y) * float(np.cos(angle))


def make_mesh() -> tuple[FloatArray, FloatArray]:
    """Make the closed dome: vertices (n, 3), mm, and triangles (m, 3), outward."""
    bend = np.sin(np.linspace(0.0, np.pi / 2.0, CAP_SECTIONS + 1))[1:-1]
    places = [*np.linspace(ROOT_MM, STRAIGHT_END_MM, STRAIGHT_SECTIONS).tolist(), *(STRAIGHT_END_MM + CAP_MM * bend).tolist()]
    angles = np.linspace(0.0, 2.0 * np.pi, SECTION_CORNERS, endpoint=False).tolist()
    vertices = [_point(y, angle) for y in places for angle in angles]
    vertices += [(0.0, ROOT_MM, 0.0), (0.0, STRAIGHT_END_MM + CAP_MM, 0.0)]
    first, last, count = len(vertices) - 2, len(vertices) - 1, SECTION_CORNERS
    triangles = list[tuple[int, int, int]]()
    for row in range(len(places) - 1):
        for here in range(count):
            a, b = row * count + here, row * count + (here + 1) % count
            triangles += [(a, b, b + count), (a, b + count, a + count)]
    top = (len(places) - 1) * count
    for here in range(count):
        after = (here + 1) % count
        triangles += [(first, after, here), (last, top + here, top + after)]
    return np.array(vertices), np.array(triangles)


def make_points() -> FloatArray:
    """Place the taxels (n, 3), mm, row by row."""
    found = list[tuple[float, float, float]]()
    for y in ROW_PLACES_MM:
        angles = np.linspace(-MAX_ANGLE, MAX_ANGLE, 400)
        curve = np.array([_point(y, angle) for angle in angles.tolist()])
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
        count = max(1, 1 + int(along[-1] / SPACING_MM))
        wanted = along[-1] / 2.0 + SPACING_MM * (np.arange(count) - (count - 1) / 2.0)
        found += [_point(y, angle) for angle in np.interp(wanted, along, angles).tolist()]
    return np.array(found)


def mesh_text() -> str:
    """Write the mesh as OBJ, mm."""
    vertices, triangles = make_mesh()
    lines = ["# The dome of a fingertip, by tools/fingertip.py; mm."]
    lines += [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in (vertices + 0.0).tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
    return "\n".join(lines) + "\n"


def layout_text() -> tuple[str, int]:
    """Write the flattened taxels as the layout of one module, and choose the taxel of the anchor."""
    points = make_points()
    flat = flatten_points(points * 1e-3) * 1e3
    middle = int((flat**2).sum(axis=1).argmin())
    rows = ", ".join(f"[{x:.3f}, {y:.3f}]" for x, y in (np.round(flat, 3) + 0.0).tolist())
    low, high = flat.min(axis=0) - 1.5, flat.max(axis=0) + 1.5
    outline = ", ".join(
        f"[{x:.2f}, {y:.2f}]" for x, y in ((low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1]))
    )
    text = f"# {len(points)} taxels on the dome of a fingertip, flattened, by tools/fingertip.py\n{kind_line(SkinKind.SHEET)}"
    text += f"[kinds.fingertip]\npads_mm = [{rows}]\noutline_mm = [{outline}]\ncentre_pad = {middle}\n"
    text += '\n[[modules]]\nid = 1\nkind = "fingertip"\nfirst_channel = 0\nplace_mm = [0, 0]\n'
    return text, middle


def scene_text(middle: int) -> str:
    """Write the scene; the layout's taxel `middle` lies where it is on the dome."""
    points = make_points()
    flat = flatten_points(points * 1e-3) * 1e3
    normal = points[middle] * np.array([HALF_WIDTH_MM**-2, 0.0, HEIGHT_MM**-2])
    normal /= np.linalg.norm(normal)
    across = np.array([normal[2], 0.0, -normal[0]])

    def row(values: FloatArray, digits: int) -> str:
        return ", ".join(f"{value:.{digits}f}" for value in (np.round(values, digits) + 0.0).tolist())

    return f"""# A fingertip on the last link of a finger: {len(points)} taxels that measure a force vector, 3 mm apart.
# Made by tools/fingertip.py.
name = "fingertip"
link = "distal"                        # y from the joint to the tip, z out of the pad

[skin]
channels = {len(points)}
axes = 3                               # x, y and z of each taxel: three values a channel
unit = "N"
polarity = "up"                        # values of z rise under a push
modules = "modules.toml"

[skin.anchor]
at_mm = [{row(flat[middle], 3)}]
point_mm = [{row(points[middle], 3)}]
x = [{row(across, 6)}]
normal = [{row(normal, 6)}]

[surface]
mesh = "fingertip.obj"
unit = "mm"

[sensor]                               # below the finger, which stands on it
pose = [[1, 0, 0, 0], [0, 1, 0, 0.007], [0, 0, 1, -0.03], [0, 0, 0, 1]]

[contacts]
taxels_max = 20                        # soft pads, 3 mm apart: a tip of 4 mm presses up to sixteen
response_min = 0.3                     # N, three steps of 0.1 N
"""


def main() -> None:
    """Write the files of the scene."""
    SCENE_FOLDER.mkdir(parents=True, exist_ok=True)
    layout, middle = layout_text()
    for name, text in (("fingertip.obj", mesh_text()), ("modules.toml", layout), ("scene.toml", scene_text(middle))):
        write_atomically(SCENE_FOLDER / name, text.encode())


if __name__ == "__main__":
    main()
