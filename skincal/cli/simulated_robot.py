"""The robot of `simulate --physics`: served live, it pokes the targets of a port."""

from __future__ import annotations

import threading
from contextlib import closing

from skincal.model.errors import InputError
from skincal.model.scene import Scene


def serve_robot(scene: Scene, targets: str | None, seed: int, *, tcp: bool, as_json: bool) -> None:
    """Serve the devices of a simulated robot until stdin closes, Ctrl-C or a termination signal.

    Raises InputError: no target server is named, the part has no mesh, or the physics engine is missing.
    """
    from skincal.cli.record import stopping
    from skincal.cli.simulate import print_links, wait_for_input
    from skincal.physics.effects import Effects
    from skincal.physics.layouts import make_robot
    from skincal.physics.serving import PokingDevices
    from skincal.robot.target_server import parse_port
    from skincal.session.part import load_scene_surface
    from skincal.simulate.serve import Server

    if targets is None:
        raise InputError("--physics without --targets has nothing to poke; expected --targets [HOST:]PORT of a recording.")
    surface = load_scene_surface(scene)[0]
    if surface is None:
        raise InputError(f"{scene.name} has no mesh, which the arm presses; expected a scene with [surface].")
    robot = make_robot(scene, surface, Effects(), seed)
    with (
        closing(PokingDevices(robot, surface, *parse_port(targets))) as devices,
        closing(Server(devices, tcp=tcp)) as server,
        stopping() as stop,
    ):
        print_links(server, robot.truth() if as_json else {})
        threading.Thread(target=wait_for_input, args=(None, threading.Event(), stop), name="orders", daemon=True).start()
        server.run(stop)
