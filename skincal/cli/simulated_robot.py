"""The robot of `simulate --physics`: live devices of a robot that pokes the targets of a port, or a session that it records."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import TYPE_CHECKING

from skincal.model.errors import InputError
from skincal.model.readings import Stream

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface
    from skincal.model.scene import Scene
    from skincal.physics.rig import SimulatedRobot
    from skincal.physics.serving import PokingDevices
    from skincal.session.pipeline import Pipeline


def open_robot(scene: Scene, targets: str | None, seed: int, effects: str) -> PokingDevices:
    """Make a simulated robot with its devices, which pokes the targets of a port until it is closed.

    Raises InputError: no port is named, the part has no mesh, or the physics engine is missing.
    """
    from skincal.physics.serving import PokingDevices
    from skincal.robot.target_server import parse_port

    if targets is None:
        raise InputError("--physics with --serve has nothing to poke; expected --targets [HOST:]PORT of a recording.")
    robot, surface = _make_robot(scene, seed, effects)
    return PokingDevices(robot, surface, *parse_port(targets))


def record_robot(
    scene: Scene, out: Path, pokes: int | None, seed: int, stop: threading.Event, effects: str
) -> tuple[Pipeline, str]:
    """Record a session of a simulated robot: to *enough*, to `pokes`, to `stop`, or to a fault of the robot.

    Returns
    -------
    Its pipeline, closed, and the reason of the fault, empty without one

    Raises InputError: the part has no mesh, the physics engine is missing, or the folder cannot be used.
    """
    from skincal.files.atomic import write_atomically
    from skincal.files.reference import TRUTH_NAME
    from skincal.journal.writer import create_session
    from skincal.physics.session import RobotSession, make_client
    from skincal.streams.links import SIMULATED_ADDRESS, LinkSpec

    robot, surface = _make_robot(scene, seed, effects)
    streams = (
        *((Stream.WRENCH,) if scene.has_sensor else ()),
        Stream.SKIN,
        *((Stream.JOINTS,) if scene.arm is not None else ()),
        *((Stream.TOOL,) if scene.tool is not None else ()),
    )
    links = [LinkSpec(stream.value, f"{SIMULATED_ADDRESS}{stream.value}", (stream,)) for stream in streams]
    session = RobotSession(scene, surface, robot, create_session(out, scene, links))
    try:
        write_atomically(out / TRUTH_NAME, json.dumps(robot.truth(), indent=1).encode() + b"\n")
        client = make_client(robot, surface, session.targets.answer)
        session.targets.answer(client.pace)
        while not (
            stop.is_set()
            or session.is_enough
            or session.targets.fault
            or _count_pokes(session.pipeline) >= (pokes or float("inf"))
        ):
            while (line := session.targets.poll()) is not None:
                client.receive_line(line)
            client.run_period()
    finally:
        session.close()
    return session.pipeline, session.targets.fault


def _count_pokes(pipeline: Pipeline) -> int:
    return sum(record.outcome.final for record in pipeline.snapshot().pokes)


def _make_robot(scene: Scene, seed: int, effects: str) -> tuple[SimulatedRobot, Surface]:
    from skincal.part.part import load_scene_surface
    from skincal.physics.effects import TOOL_EFFECTS, Effects
    from skincal.physics.robots import make_robot

    surface = load_scene_surface(scene)[0]
    if surface is None:
        raise InputError(f"{scene.name} has no mesh, which the arm presses; expected a scene with [surface].")
    chosen = Effects.named(effects)
    for name in (word.strip() for word in effects.split(",")):
        if name in TOOL_EFFECTS and scene.tool is None:
            raise InputError(f"--effects {name} is of a cobot, and {scene.name} has no [tool]: leave it out.")
        if name == "sag" and scene.tool is not None:
            raise InputError(f"--effects sag does nothing with [tool], which {scene.name} has: use bend.")
    return make_robot(scene, surface, chosen, seed), surface
