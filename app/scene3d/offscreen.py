"""A picture of a session without a window: for the headless commands. Imports no Qt."""

from __future__ import annotations

from pathlib import Path

from app.scene3d.graphics import choose_offscreen
from app.scene3d.ground import Frame, Ground
from app.scene3d.looks import LIGHT
from skincal.mesh.lay import LaidSkin
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.scene import Scene
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Method


def picture(
    scene: Scene,
    surface: Surface | None,
    laid: LaidSkin | None,
    snapshot: Snapshot,
    method: Method,
    path: Path,
    size: tuple[int, int] = (1280, 800),
) -> None:
    """Draw what the window's 3D view shows of a session, as a PNG file.

    Parameters
    ----------
    size : width and height, pixels

    Raises
    ------
    InputError
        There is nothing to draw with here (names the packages), or the file cannot be written.
    """
    choose_offscreen()
    # Only now: these load VTK, which ends the process where it cannot draw.
    from app.scene3d.stage import Stage
    from app.scene3d.window import HiddenWindow

    channels = [estimate.channel for estimate in snapshot.estimates.get(method, ())]
    window = HiddenWindow(size)
    stage = Stage(window.renderer, Ground(scene, surface, laid, channels), LIGHT)
    try:
        stage.show(Frame(snapshot, None, method, None))
        stage.fit()
        path.write_bytes(window.png())
    except OSError as error:
        raise InputError(f"{path}: the picture cannot be written ({error.strerror}); choose another place.") from None
    finally:
        stage.close()
        window.close()
