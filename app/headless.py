"""The window's first session where there is no display: to a calibration file and a picture of it. Imports no Qt."""

from __future__ import annotations

import sys
from pathlib import Path

from skincal.interface.scene import Scene
from skincal.interface.session import Session, simulate
from skincal.model.errors import InputError
from skincal.taxels.result import Method
from skincal.words.units import millimetres

SIMULATED_POKE_COUNT = 168
"""Two for each taxel of the paper's forearm: every taxel gets an estimate, in about half a minute of computing."""
SIMULATED_RIG_RANDOM_SEED = 1
DEFAULT_FOLDER = "skincal-headless"


def run_headless(scene_path: Path, folder: Path | None, why: str) -> int:
    """Poke the simulated rig of a scene, write the calibration file and draw it; return the exit code.

    Raises
    ------
    InputError
        The scene, the folder or the graphics are at fault.
    """
    out = folder or _unused(Path(DEFAULT_FOLDER))
    _say(
        f"{why}\nThe same session runs without it: {SIMULATED_POKE_COUNT} pokes on the simulated "
        f"{scene_path.parent.name}, in {out}"
    )
    scene = Scene.load(scene_path)
    session = simulate(scene, SIMULATED_POKE_COUNT, SIMULATED_RIG_RANDOM_SEED, folder=out, progress=_show_progress)
    method, positions = session.method, out / "positions.txt"
    _say(f"{method} predicts the smallest error, and is written and drawn")
    _say(f"{session.verdict(method)}")
    for finding in session.export(positions, "icub", method):
        _say(finding)
    for name in scene.methods:
        if session.truth is not None and (error := session.taxels(name).compare(session.truth)).worst_channel is not None:
            words = f"{millimetres(error.mean)} mean error, {millimetres(error.worst)} largest"
            _say(f"{name}: {len(error.channel)} taxels, {words}")
    _say(f"calibration file: {positions}")
    _say(f"picture: {_draw(session, method, out / 'picture.png')}")
    return 0


def _draw(session: Session, method: str, path: Path) -> Path:
    from app.scene3d.drawing_probe import choose_offscreen

    # Before VTK is imported: on a machine without OpenGL that may fail, too.
    choose_offscreen()
    from app.scene3d.session_picture import picture

    picture(session.scene.part, session.results.snapshot, Method(method), path)
    return path


def _unused(folder: Path) -> Path:
    """Return `folder`, or `folder` with the first number appended that is unused."""
    candidate, number = folder, 1
    while candidate.exists():
        number += 1
        candidate = folder.with_name(f"{folder.name}-{number}")
    if not candidate.absolute().parent.is_dir():
        raise InputError(f"{candidate}: its folder does not exist; choose another with --new.")
    return candidate


def _show_progress(pokes: int) -> None:
    if pokes % 42 == 0:
        _say(f"{pokes} of {SIMULATED_POKE_COUNT} pokes")


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()
