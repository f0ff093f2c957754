"""A calibration of a flat pad of three-axis taxels, each with its turn: z near the normal, any turn about it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from skincal.axes.taxel_frames import FrameState, TaxelFrame
from skincal.files.calibration import Calibration
from skincal.geometry import FloatArray
from skincal.model.scene import load_scene
from skincal.taxels.result import Method
from tests.skincal.files.files_support import READ_AXES, KnownAxes, estimate, make_calibration, make_part

ROWS, COLUMNS, SPACING_M = 3, 4, 0.003


def flat_calibration(folder: Path) -> tuple[Calibration, FloatArray]:
    """Give the calibration, and rotations (12, 3, 3)."""
    (folder / "pad.toml").write_text(f'name = "pad"\nlink = "tip"\n[skin]\nchannels = {ROWS * COLUMNS}\naxes = 3\nunit = "N"\n')
    scene, rng = load_scene(folder / "pad.toml"), np.random.default_rng(7)
    places = [SPACING_M * np.array([k % COLUMNS, k // COLUMNS, 4.0]) for k in range(ROWS * COLUMNS)]
    about = [Rotation.from_euler("xyz", [*rng.normal(0.0, 0.05, 2), rng.uniform(-np.pi, np.pi)]) for _ in places]
    frames = {k: TaxelFrame(k, FrameState.KNOWN, turn.as_matrix(), 1e-4 * np.eye(3), 9) for k, turn in enumerate(about)}
    found = tuple(estimate(k, Method.FREE, place, np.array([0.0, 0.0, 1.0])) for k, place in enumerate(places))
    made = replace(
        make_calibration(make_part(folder / "part")),
        scene=replace(scene, skin=replace(scene.skin, axes=READ_AXES)),
        channels=range(ROWS * COLUMNS),
        estimates={Method.FREE: found},
        contacts=(),
        mesh_sha256=None,
        axes=KnownAxes(frames),
    )
    return made, np.array([turn.as_matrix() for turn in about])
