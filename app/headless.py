"""The window's first session where there is no display: to a calibration file and a picture of it. Imports no Qt."""

from __future__ import annotations

import sys
from pathlib import Path

from skincal.files.export import write_calibration
from skincal.files.reference import error_summary, read_reference
from skincal.following.results import SessionResults
from skincal.model.errors import InputError
from skincal.session.pipeline import Pipeline
from skincal.taxels.result import Method

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
    pipeline = _simulate(scene_path, out)
    results = SessionResults(pipeline)
    calibration, method = results.calibration(), results.leading or Method.FREE
    positions = out / "positions.txt"
    _say(f"{method.value} predicts the smallest error, and is written and drawn")
    _say(f"{calibration.verdicts[method]}.")
    for finding in write_calibration(calibration, "icub", positions, method):
        _say(finding)
    truth = read_reference(out / "truth.json")
    for name, estimates in calibration.estimates.items():
        error = error_summary(estimates, truth)
        if error is not None:
            _say(f"{name.value}: {error.taxels} taxels, {error.mean * 1e3:.1f} mm mean error, {error.max * 1e3:.1f} mm largest")
    _say(f"calibration file: {positions}")
    _say(f"picture: {_draw(pipeline, method, out / 'picture.png')}")
    return 0


def _simulate(scene_path: Path, out: Path) -> Pipeline:
    from skincal.mesh.load import load_surface
    from skincal.model.scene import load_scene
    from skincal.simulation.rig_errors import RigErrors
    from skincal.simulation.virtual_session import simulate_session

    scene = load_scene(scene_path)
    surface = None if scene.surface is None else load_surface(scene.surface)[0]
    return simulate_session(
        scene, surface, out, SIMULATED_POKE_COUNT, SIMULATED_RIG_RANDOM_SEED, RigErrors.noise(), progress=_show_progress
    )


def _draw(pipeline: Pipeline, method: Method, path: Path) -> Path:
    from app.scene3d.drawing_probe import choose_offscreen

    # Before VTK is imported: on a machine without OpenGL that may fail, too.
    choose_offscreen()
    from app.scene3d.offscreen import picture
    from skincal.mesh.lay import place_layout

    skin = pipeline.scene.skin
    laid = None if skin.layout is None else place_layout(skin.layout, skin.anchor, pipeline.session.surface)
    picture(pipeline.scene, pipeline.session.surface, laid, pipeline.snapshot(), method, path)
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
