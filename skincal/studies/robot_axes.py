"""Turns of a fingertip that a robot calibrates in the physics engine: errors of positions and turns against the truth.

The scene `fingertip` has 30 taxels on a dome, each with a turn of its own. A guided robot pokes it to *enough* with all its
imperfections: friction and slip, sag, a wrong base, noise and vibration. `skincal study axes` uses it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from skincal.geometry import rotation_vector
from skincal.mesh.load import load_surface
from skincal.model.scene import load_scene, resource
from skincal.physics.effects import Effects
from skincal.physics.layouts import poking_arm
from skincal.physics.rig import SimulatedRobot
from skincal.physics.session import RobotSession, make_client
from skincal.physics.vector_pads import VectorPadErrors
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Method

FINGERTIP_SCENE = "scenes/fingertip/scene.toml"
MAX_POKES = 300
CHI2_3DOF_95 = 7.815
"""95 % quantile of chi-square with 3 degrees of freedom."""


class RobotTask(NamedTuple):
    """One session of a robot."""

    is_bonded: bool
    """Taxels also feel the force through a bonded base; else they are bumps that stand apart."""
    seed: int


def poke_fingertip(task: RobotTask) -> dict[str, Any]:
    """Let a robot calibrate the fingertip: pokes, and errors of each taxel (positions in mm, turns in degrees)."""
    scene = load_scene(resource(FINGERTIP_SCENE))
    assert scene.surface is not None
    surface, _ = load_surface(scene.surface)
    errors = VectorPadErrors() if task.is_bonded else replace(VectorPadErrors(), coupling=0.0)
    layout = replace(poking_arm(scene, surface), skin_errors=errors)
    robot = SimulatedRobot(scene, surface, layout, Effects(), task.seed)
    session = RobotSession(scene, surface, robot)
    client = make_client(robot, surface, session.targets.answer)
    session.targets.answer(client.pace)
    while not (session.is_enough or session.targets.fault) and len(session.pipeline.snapshot().pokes) < MAX_POKES:
        while (line := session.targets.poll()) is not None:
            client.receive_line(line)
        client.run_period()
    session.close()
    snapshot = session.pipeline.snapshot()
    axes = robot.pads.axes
    assert axes is not None
    places = dict(zip(robot.pads.channels.tolist(), robot.pads.places, strict=True))
    true_axes = dict(zip(robot.pads.channels.tolist(), axes, strict=True))
    return {"pokes": len(snapshot.contacts), "enough": session.is_enough, **fingertip_errors(snapshot, places, true_axes)}


def fingertip_errors(
    snapshot: Snapshot, places: Mapping[int, Any], true_axes: Mapping[int, Any]
) -> dict[str, list[float] | list[bool]]:
    """Compare with the truth by channel: `position_mm`, `normal_deg`, `plane_deg`, and whether it is `inside` its region."""
    found: dict[str, list[Any]] = {"position_mm": [], "normal_deg": [], "plane_deg": [], "inside": []}
    turns = snapshot.turns
    assert turns is not None
    for estimate in snapshot.estimates[Method.MODULES]:
        channel = estimate.channel
        if estimate.position is not None and channel in places:
            found["position_mm"].append(float(np.linalg.norm(estimate.position - places[channel])) * 1e3)
        turn = turns.of_channel(channel)
        if turn is None or channel not in true_axes or not turn.is_in_plane_known:
            continue
        true = true_axes[channel]
        off = rotation_vector(turn.fit.rotation.T @ true)
        cosine = float(np.clip(turn.fit.rotation[:, 2] @ true[:, 2], -1.0, 1.0))
        found["normal_deg"].append(float(np.degrees(np.arccos(cosine))))
        found["plane_deg"].append(float(abs(np.degrees(off[2]))))
        found["inside"].append(bool(off @ np.linalg.solve(turn.fit.covariance[:3, :3], off) <= CHI2_3DOF_95))
    return found


def robot_row(is_bonded: bool, found: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Summarize sessions: medians and 95 % of the errors over all taxels, pokes, and the share inside the 95 % regions."""
    joined = {name: np.concatenate([each[name] for each in found]) for name in ("position_mm", "normal_deg", "plane_deg")}
    inside = np.concatenate([each["inside"] for each in found])
    return {
        "is_bonded": is_bonded,
        "sessions": len(found),
        "enough": float(np.mean([each["enough"] for each in found])),
        "pokes": float(np.median([each["pokes"] for each in found])),
        **{name: [float(np.quantile(values, q)) for q in (0.5, 0.95)] for name, values in joined.items()},
        "inside": float(inside.mean()),
        "taxels": len(inside),
    }


def robot_text(row: Mapping[str, Any]) -> str:
    """Describe a row."""
    skin = "bumps on a bonded base" if row["is_bonded"] else "bumps that stand apart"
    errors = "; ".join(
        "{} {:.2f}, {:.2f} {}".format(name, *row[key], unit)
        for name, key, unit in (
            ("position", "position_mm", "mm"),
            ("normal", "normal_deg", "deg"),
            ("turn in the plane", "plane_deg", "deg"),
        )
    )
    return (
        f"  robot in MuJoCo, fingertip, {skin}: {row['pokes']:.0f} pokes, {errors}; inside {row['inside']:.2f} of "
        f"{row['taxels']} turns; to enough in {row['enough']:.2f} of the sessions"
    )
