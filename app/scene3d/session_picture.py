"""A session's picture for the headless commands. Imports no Qt."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from app.scene3d.drawing_probe import choose_offscreen
from app.scene3d.offscreen import draw, make_plotter
from app.scene3d.scene_renderer import SceneRenderer
from app.scene3d.scene_state import LIGHT, StaticScene
from app.state.view_state import state_at_rest
from skincal.files.atomic import write_atomically
from skincal.part.part import Part
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Method


def picture(part: Part, snapshot: Snapshot, method: Method, path: Path, size: tuple[int, int] = (1280, 800)) -> None:
    """Draw what the window's 3D view shows of a session on a part, as a PNG file; `size` is in pixels.

    Raises
    ------
    InputError
        There is nothing to draw with here (names the packages), or the file cannot be written.
    """
    choose_offscreen()
    channels = np.array([estimate.channel for estimate in snapshot.estimates.get(method, ())], dtype=np.int64)
    plotter = make_plotter(size)
    renderer = SceneRenderer(plotter, StaticScene(replace(part, channels=channels)), LIGHT)
    try:
        renderer.show(state_at_rest(part.scene, snapshot, method))
        renderer.fit()
        content = io.BytesIO()
        Image.fromarray(draw(plotter)[::-1, :, :3]).save(content, "png")
        write_atomically(path, content.getvalue())
    finally:
        renderer.close()
        plotter.close()
