"""`simulate`: a simulated rig, recorded at once into a session or served live as devices."""

from __future__ import annotations

import json
import signal
import sys
import threading
from contextlib import closing
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.calibrate import Json
from skincal.cli.record import SceneOption, find_scene
from skincal.model.errors import InputError

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface
    from skincal.model.scene import Scene
    from skincal.simulate.device import DeviceSettings
    from skincal.simulate.faults import RigErrors
    from skincal.simulate.operator import Guided, Habits, Told
    from skincal.simulate.serve import Server

SESSION_POKES = 252
"""Pokes of a recorded session unless given: three for each taxel of the paper's forearm."""


class Errors(Enum):
    """How wrong the simulated rig is."""

    NONE = "none"
    NOISE = "noise"
    PAPER = "paper"


class OperatorKind(Enum):
    """Who decides where to poke."""

    AUTO = "auto"
    TOLD = "told"
    GUIDED = "guided"


class Wire(Enum):
    """What the simulated devices send."""

    SKB = "skb"
    SKT = "skt"
    TEXT = "text"


def add_to(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(
        epilog="Examples: skincal simulate --scene icub-forearm --pokes 252 --out trial; "
        "skincal simulate --scene icub-forearm --serve"
    )(simulate)


def simulate(
    scene: SceneOption,
    out: Annotated[Path | None, typer.Option(help="Folder of the new session; truth.json is written there too.")] = None,
    serve: Annotated[bool, typer.Option("--serve", help="Be the devices, in real time, until stdin closes or Ctrl-C.")] = False,
    pokes: Annotated[int | None, typer.Option(min=1, help="How many pokes; 252 for a session, no end when served.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same bytes.")] = 1,
    errors: Annotated[
        Errors, typer.Option(help="What is wrong with the rig: nothing, sensor noise, or what the paper's had.")
    ] = Errors.NOISE,
    poses: Annotated[str, typer.Option(help="Arm poses that share the pokes, by name, separated by commas.")] = "",
    operator: Annotated[
        OperatorKind,
        typer.Option(
            help="auto pokes by itself; told obeys stdin; guided follows the targets on stdin, and sometimes ignores them."
        ),
    ] = OperatorKind.AUTO,
    careful: Annotated[bool, typer.Option("--careful", help="An operator who neither slides nor touches two places.")] = False,
    pace: Annotated[
        float,
        typer.Option(min=0.1, max=4.0, help="How quick the operator's hand is between pokes; presses take as long as they do."),
    ] = 1.0,
    tcp: Annotated[bool, typer.Option("--tcp", help="Serve TCP ports instead of pseudo-terminals.")] = False,
    wire: Annotated[Wire, typer.Option(help="What the devices send: SKB/1, SKT/1 or plain text lines.")] = Wire.SKB,
    as_json: Json = False,
) -> None:
    """Poke a simulated rig: into a session (--out), or live over ports that a program takes for devices (--serve).

    Orders on stdin with --operator told: poke CHANNEL [TILT_DEG AZIMUTH_DEG FORCE_N], or pose NAME. With --operator guided:
    target CHANNEL|-|+ X_MM Y_MM Z_MM PUSH_X PUSH_Y PUSH_Z (what the guide shows, link frame; - is a place, + a known point
    of the part), wait (nothing is to be poked), or any (nobody guides); until the first of them it pokes as auto does.
    """
    from skincal.simulate.device import DeviceSettings
    from skincal.simulate.faults import RigErrors
    from skincal.simulate.operator import Habits

    loaded = find_scene(scene)
    if serve == (out is not None):
        raise InputError("simulate needs either --out FOLDER, to record a session, or --serve, to be the devices.")
    if not serve and (operator is not OperatorKind.AUTO or tcp):
        name = "--tcp" if operator is OperatorKind.AUTO else f"--operator {operator.value}"
        raise InputError(f"{name} is for --serve: a session is recorded at once, by an operator of its own.")
    play = _Play(
        scene=loaded,
        surface=_surface(loaded),
        pokes=pokes,
        seed=seed,
        errors={Errors.NONE: RigErrors.none, Errors.NOISE: RigErrors.noise, Errors.PAPER: RigErrors.paper}[errors](),
        poses=tuple(name.strip() for name in poses.split(",") if name.strip()),
        habits=(Habits.careful() if careful else Habits()).at_pace(pace),
        settings=DeviceSettings(format=wire.value),
    )
    if out is not None:
        _record(play, out, as_json)
    else:
        _serve(play, operator, tcp, as_json)


@dataclass(frozen=True, slots=True)
class _Play:
    """What is simulated."""

    scene: Scene
    surface: Surface | None
    pokes: int | None
    seed: int
    errors: RigErrors
    poses: tuple[str, ...]
    habits: Habits
    settings: DeviceSettings


def _surface(scene: Scene) -> Surface | None:
    if scene.surface is None:
        return None
    from skincal.mesh.load import load_surface

    return load_surface(scene.surface)[0]


def _record(play: _Play, out: Path, as_json: bool) -> None:
    from skincal.cli.record import finish
    from skincal.files.reference import TRUTH_NAME, read_reference
    from skincal.simulate.virtual_session import simulate_session

    pipeline = simulate_session(
        play.scene,
        play.surface,
        out,
        play.pokes or SESSION_POKES,
        play.seed,
        play.errors,
        poses=play.poses,
        habits=play.habits,
        settings=play.settings,
        progress=_show_progress if sys.stderr.isatty() else None,
    )
    finish(pipeline, out, as_json, reference=read_reference(out / TRUTH_NAME))


def _show_progress(pokes: int) -> None:
    typer.echo(f"\rpoke {pokes} ", err=True, nl=False)


def _serve(play: _Play, operator: OperatorKind, tcp: bool, with_truth: bool) -> None:
    import numpy as np

    from skincal.simulate.device import DeviceTimeline
    from skincal.simulate.operator import Auto, Guided, Told
    from skincal.simulate.serve import Server
    from skincal.simulate.simulated_rig import Rig

    # Streams of their own: another operator meets the same rig and the same devices.
    rig_rng, operator_rng, device_rng = np.random.default_rng(play.seed).spawn(3)
    rig = Rig(play.scene, play.surface, play.errors, rig_rng)
    if operator is OperatorKind.TOLD:
        hand: Auto | Told = Told(rig, play.habits, operator_rng)
    else:
        kind = Guided if operator is OperatorKind.GUIDED else Auto
        hand = kind(rig, play.habits, operator_rng, play.pokes, play.poses)
    line = DeviceTimeline(rig, hand, device_rng, play.settings)
    with closing(Server(line, tcp=tcp)) as server:
        _print_links(server, rig.truth() if with_truth else {})
        _run(server, hand if isinstance(hand, Told | Guided) else None)


def _print_links(server: Server, known: dict[str, Any]) -> None:
    """Say on one line where the links are; for a program (--json) also where the taxels really are."""
    links = [
        {"name": link.name, "address": link.address, "carries": [stream.value for stream in link.carries]}
        for link in server.links
    ]
    typer.echo(json.dumps({"links": links, **known}))
    sys.stdout.flush()


def _run(server: Server, listener: Told | Guided | None) -> None:
    """Serve until stdin closes, Ctrl-C or a termination signal."""
    stop = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:  # noqa: ARG001 - the signature of a handler
        stop.set()

    signal.signal(signal.SIGTERM, end)
    # A daemon: it waits in a read that nothing can interrupt.
    threading.Thread(target=_listen, args=(listener, stop), name="orders", daemon=True).start()
    try:
        server.run(stop)
    except KeyboardInterrupt:
        typer.echo("stopped", err=True)


def _listen(listener: Told | Guided | None, stop: threading.Event) -> None:
    """Take orders from stdin; its end is the end of the program that started this one."""
    from skincal.simulate.operator import read_order

    for line in sys.stdin:
        try:
            order = read_order(line)
            if order is not None and listener is not None:
                listener.accept(order)
        except InputError as error:
            typer.echo(f"skincal: {error}", err=True)
    stop.set()
