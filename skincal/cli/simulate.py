"""`simulate`: a simulated rig, recorded at once into a session or served live as devices."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Callable, Generator
from contextlib import closing, contextmanager
from enum import Enum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.record import MAX_REQUESTED_POKES, SceneOption, find_scene, finish, stopping
from skincal.cli.simulated_robot import open_robot, record_robot
from skincal.cli.solve import Json
from skincal.cli.terminal import say
from skincal.model.errors import CTRL_C_EXIT_CODE, InputError
from skincal.model.readings import SENSOR_STREAMS, Stream

if TYPE_CHECKING:
    import numpy as np

    from skincal.model.scene import Scene
    from skincal.session.pipeline import Pipeline
    from skincal.simulation.operator import AutoOperator, GuidedOperator, Habits, ScriptedOperator
    from skincal.simulation.serve import Server
    from skincal.simulation.simulated_rig import Rig

SERVED_MOMENT_NOISE_NM = 2e-6
"""N m. A served sensor without noise would look frozen: the last digits that most formats have."""
REST_BEFORE_FIRST_SERVED_POKE_S = 0.5
"""s of rest before the first poke: a host that connects at once gets its tare."""
DEFAULT_SESSION_POKES = 252
"""Pokes of a recorded session unless given: three for each taxel of the paper's forearm."""


class Errors(Enum):
    """Size of the simulated rig's errors."""

    NONE = "none"
    NOISE = "noise"
    PAPER = "paper"


class OperatorKind(Enum):
    """Who decides where to poke."""

    AUTO = "auto"
    TOLD = "told"
    GUIDED = "guided"


class Physics(Enum):
    """Physics engine that simulates a robot."""

    MUJOCO = "mujoco"


def add_to(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(
        epilog="Examples: skincal simulate --scene icub-forearm --pokes 252 --out trial; "
        "skincal simulate --scene icub-forearm --serve"
    )(simulate)


def simulate(
    scene: SceneOption,
    out: Annotated[Path | None, typer.Option(help="Folder of the new session; truth.json is written there too.")] = None,
    serve: Annotated[
        bool, typer.Option("--serve", help="Send the readings of simulated devices in real time, until stdin closes or Ctrl-C.")
    ] = False,
    pokes: Annotated[
        int | None,
        typer.Option(min=1, max=MAX_REQUESTED_POKES, help="Number of pokes. Default: 252 for a session, no end with --serve."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same bytes.")] = 1,
    errors: Annotated[
        Errors, typer.Option(help="Errors of the rig: none, sensor noise, or the errors of the paper's rig.")
    ] = Errors.NOISE,
    poses: Annotated[str, typer.Option(help="Arm poses that share the pokes, by name, separated by commas.")] = "",
    operator: Annotated[
        OperatorKind,
        typer.Option(
            help="auto chooses its own pokes; told follows orders on stdin; guided follows --targets, and "
            "sometimes ignores a target."
        ),
    ] = OperatorKind.AUTO,
    careful: Annotated[
        bool, typer.Option("--careful", help="The operator never slides and never touches two points at once.")
    ] = False,
    pace: Annotated[
        float,
        typer.Option(min=0.1, max=4.0, help="Speed factor of the hand between pokes; the presses keep their duration."),
    ] = 1.0,
    run: Annotated[int, typer.Option(min=0, help="Number of the run: the same rig with other noise and other pokes.")] = 0,
    tcp: Annotated[bool, typer.Option("--tcp", help="Serve TCP ports instead of pseudo-terminals.")] = False,
    speak_as: Annotated[
        str,
        typer.Option(
            "--as",
            help="Devices to simulate, by name, separated by commas: netft, bota, robotiq, robotiq-text, rtde, yarp, "
            "xela, papillarray, justfloat, flexitac, anyskin, leptrino, tsf85, inspire, paxini, paxini-module, ros2; for a "
            "tool also qtm, natnet, ndi. A simulated board sends the other streams.",
        ),
    ] = "",
    ros2: Annotated[
        bool,
        typer.Option("--ros2", help="Publish as a ROS 2 robot, in the domain of ROS_DOMAIN_ID: the same as --serve --as ros2."),
    ] = False,
    targets: Annotated[
        str | None,
        typer.Option(
            metavar="[HOST:]PORT",
            help="Port of the program that asks for pokes (`record --targets`, or the window), with --operator "
            "guided or --physics.",
        ),
    ] = None,
    physics: Annotated[
        Physics | None,
        typer.Option(help="Physics engine with a robot arm that pokes the guide's targets, in place of an operator."),
    ] = None,
    effects: Annotated[
        str,
        typer.Option(
            help="With --physics: imperfections of the robot and the rig, by name, separated by commas: noise, vibration, "
            "weight, friction, patch, overshoot, sag, low_pass, base, and of a cobot with [tool] scale, warp, tcp, late, "
            "bend; or all, or none (docs/robot.md)."
        ),
    ] = "all",
    as_json: Json = False,
) -> None:
    """Simulate a rig and its operator: record a session (--out), or send live readings like real devices (--serve).

    Orders on stdin with --operator told: poke CHANNEL [TILT_DEG AZIMUTH_DEG FORCE_N], or pose NAME; with --operator guided:
    pace FACTOR. With --targets it answers as a robot does (docs/wire.md).
    """
    from skincal.files.reference import RIG_KEY
    from skincal.part.part import load_scene_surface
    from skincal.simulation.device import DeviceSettings, DeviceTimeline
    from skincal.simulation.operator import Habits
    from skincal.simulation.rig_errors import RigErrors
    from skincal.simulation.rig_of_scene import make_rig
    from skincal.simulation.serve import Server

    loaded = find_scene(scene)
    if physics is not None:
        others = {
            "--errors": errors is not Errors.NOISE, "--poses": poses, "--careful": careful, "--pace": pace != 1.0, "--run": run,
            "--as": speak_as, "--ros2": ros2, "--tcp": tcp and not serve, "--pokes": serve and pokes,
        }  # fmt: skip
        _demand_sense_of_robot(serve, out, operator, targets, [name for name, is_used in others.items() if is_used])
        if out is not None:
            _record_robot(loaded, out, pokes, seed, effects, as_json)
        else:
            _serve_robot(loaded, targets, seed, effects, tcp=tcp, as_json=as_json)
        return
    serve, speak_as = serve or ros2, f"{speak_as},ros2".strip(",") if ros2 else speak_as
    _demand_sense(serve, out, operator, targets, other="--tcp" if tcp else "--as" if speak_as else "--run" if run else "")
    if effects != "all":
        raise InputError("--effects is for --physics; --errors are those of a simulated rig.")
    surface, wrong = load_scene_surface(loaded)[0], getattr(RigErrors, errors.value)()
    names = tuple(name.strip() for name in poses.split(",") if name.strip())
    habits = Habits.careful() if careful else Habits()
    habits = (habits if loaded.tool is None else habits.with_tool()).at_pace(pace)
    if out is not None:
        from skincal.simulation.virtual_session import simulate_session  # served devices need no session

        count = pokes or DEFAULT_SESSION_POKES
        _record(
            partial(simulate_session, loaded, surface, out, count, seed, wrong, poses=names, habits=habits), out, count, as_json
        )
        return
    # Streams of their own: another operator meets the same rig and the same devices.
    rig_rng, operator_rng, device_rng = _streams(seed, run)
    rig = make_rig(loaded, surface, wrong, rig_rng)
    hand = _make_operator(operator, rig, habits, operator_rng, (pokes, names))
    spoken = _speakers(speak_as, loaded)
    settings = DeviceSettings(emulated=spoken, flicker=SERVED_MOMENT_NOISE_NM, start_quiet_s=REST_BEFORE_FIRST_SERVED_POKE_S)
    with closing(Server(DeviceTimeline(rig, hand, device_rng, settings), tcp=tcp)) as server:
        known = {**rig.truth(), RIG_KEY: {"seed": seed, "errors": errors.value}}
        _print_links(server, known, loaded, as_json=as_json)
        with _target_client(hand, targets):
            _run(server, hand, operator, pokes)


def _record(simulate_session: Callable[..., Pipeline], out: Path, count: int, as_json: bool) -> None:
    """Record a session of `count` pokes in `out`; Ctrl-C ends it early, and what is there stays.

    Parameters
    ----------
    simulate_session : that of `skincal.simulation.virtual_session`; all it takes is given but `progress` and `go_on`
    """
    from skincal.files.reference import TRUTH_NAME, read_reference

    progress = PokeLine(count)
    with stopping() as stop:
        pipeline = simulate_session(progress=progress if sys.stderr.isatty() else None, go_on=lambda: not stop.is_set())
    if stop.is_set():
        progress.close()
        has = f"{len(pipeline.snapshot().pokes)} of {count} pokes"
        say(f"stopped: the session has {has}, and is kept; for all of them name another folder by --out.", err=True)
    finish(pipeline, out, as_json, reference=read_reference(out / TRUTH_NAME))
    if stop.is_set():
        raise typer.Exit(CTRL_C_EXIT_CODE)


def _record_robot(scene: Scene, out: Path, pokes: int | None, seed: int, effects: str, as_json: bool) -> None:
    """Record a session of a simulated robot in `out`; Ctrl-C ends it early, and what is there stays."""
    from skincal.files.reference import TRUTH_NAME, read_reference

    with stopping() as stop:
        pipeline, fault = record_robot(scene, out, pokes, seed, stop, effects)
    finish(pipeline, out, as_json, reference=read_reference(out / TRUTH_NAME))
    if fault:
        raise InputError(f"the robot has stopped: {fault}. The session is kept with its pokes so far.")
    if stop.is_set():
        raise typer.Exit(CTRL_C_EXIT_CODE)


def _serve_robot(scene: Scene, targets: str | None, seed: int, effects: str, *, tcp: bool, as_json: bool) -> None:
    """Serve the devices of a simulated robot until stdin closes, Ctrl-C or a termination signal."""
    from skincal.simulation.serve import Server

    with (
        closing(open_robot(scene, targets, seed, effects)) as devices,
        closing(Server(devices, tcp=tcp)) as server,
        stopping() as stop,
    ):
        _print_links(server, devices.truth(), scene, as_json=as_json)
        threading.Thread(target=_listen, args=(None, threading.Event(), stop), name="orders", daemon=True).start()
        server.run(stop)


def _demand_sense(serve: bool, out: Path | None, operator: OperatorKind, targets: str | None, other: str) -> None:
    """Refuse contradictory options; `other` names a used option that needs `--serve`."""
    if serve == (out is not None):
        raise InputError("simulate needs either --out FOLDER, to record a session, or --serve, to be the devices.")
    name = f"--operator {operator.value}" if operator is not OperatorKind.AUTO else other
    if not serve and name:
        raise InputError(f"{name} is for --serve: a session is recorded at once, by an operator of its own.")
    if (targets is None) is (operator is OperatorKind.GUIDED):
        raise InputError("--operator guided and --targets [HOST:]PORT need each other: the targets are what it pokes.")


def _demand_sense_of_robot(
    serve: bool, out: Path | None, operator: OperatorKind, targets: str | None, unused: list[str]
) -> None:
    """Refuse options that contradict `--physics`, or are `unused` by it."""
    if serve == (out is not None) or (out is not None and targets is not None) or operator is not OperatorKind.AUTO:
        raise InputError("--physics needs --out FOLDER, or --serve and --targets PORT, and no --operator: a robot pokes.")
    if unused:
        raise InputError(f"{unused[0]} has no effect with --physics {'--serve' if serve else '--out'}: leave it out.")


def _streams(seed: int, run: int) -> list[np.random.Generator]:
    """Return the random numbers of rig, operator and devices; those of the rig are the same in every run."""
    import numpy as np

    rig, *others = np.random.default_rng(seed).spawn(3)
    return [rig, *(np.random.default_rng((seed, run)).spawn(2) if run else others)]


def _make_operator(
    kind: OperatorKind, rig: Rig, habits: Habits, rng: np.random.Generator, course: tuple[int | None, tuple[str, ...]]
) -> AutoOperator | ScriptedOperator:
    from skincal.simulation.operator import AutoOperator, GuidedOperator, ScriptedOperator

    if kind is OperatorKind.TOLD:
        return ScriptedOperator(rig, habits, rng)
    return (GuidedOperator if kind is OperatorKind.GUIDED else AutoOperator)(rig, habits, rng, *course)


@contextmanager
def _target_client(hand: AutoOperator | ScriptedOperator, targets: str | None) -> Generator[None]:
    """Have a simulated hand poke the targets of a port, if one is named."""
    from skincal.robot.target_client import TargetClient
    from skincal.robot.target_lines import NoTarget
    from skincal.robot.target_server import parse_port
    from skincal.simulation.operator import GuidedOperator

    if targets is None or not isinstance(hand, GuidedOperator):
        yield
        return
    hand.show(NoTarget.WAIT)  # until it hears of something
    with closing(TargetClient(*parse_port(targets), hand.show)) as client:
        hand.answered = client.say
        yield


def _speakers(named: str, scene: Scene) -> dict[Stream, str]:
    """Choose the maker's device that sends each stream of the scene."""
    if not named:
        return {}
    from skincal.simulation.emulated_devices import assign_devices

    has = {Stream.WRENCH: scene.has_sensor, Stream.JOINTS: scene.arm is not None}
    streams = tuple(stream for stream in SENSOR_STREAMS if has.get(stream, True))
    streams += () if scene.tool is None else (Stream.TOOL,)
    return assign_devices(tuple(name.strip() for name in named.split(",")), streams)


class PokeLine:
    """Terminal line with the number of the current poke, updated in place.

    Parameters
    ----------
    count : of all pokes; None where there is no end
    """

    def __init__(self, count: int | None) -> None:
        self._count, self._said = count, 0

    def __call__(self, pokes: int) -> None:
        """Print the number of pokes that began, if it changed; the last one ends the line."""
        if pokes == self._said:
            return
        self._said = pokes
        of = "" if self._count is None else f" of {self._count}"
        typer.echo(f"\rpoke {pokes}{of} ", err=True, nl=pokes == self._count)  # noqa: TID251 - stays on its line

    def close(self) -> None:
        """End the line where it is open."""
        if self._said not in (0, self._count):
            say("", err=True)


STDIN_HELP = {
    OperatorKind.AUTO: "Standard input is read for its end alone",
    OperatorKind.TOLD: "Standard input takes orders, one a line: poke CHANNEL [TILT_DEG AZIMUTH_DEG FORCE_N], or pose NAME",
    OperatorKind.GUIDED: "Pokes what --targets asks for; standard input takes pace TIMES",
}
"""Printed on a terminal: the words that may be typed there."""
SERVING_NOTICE = "The devices are served until it ends ({key}) or Ctrl-C."
STDIN_ENDED = "Standard input ended, and so did the devices."


def _print_links(server: Server, known: dict[str, Any], scene: Scene, *, as_json: bool) -> None:
    """Print the links' addresses: for a program as JSON on one line, with --json also the true positions; else in words."""
    links = [
        {"name": link.name, "address": link.address, "carries": [stream.value for stream in link.carries]}
        for link in server.links
    ]
    if as_json or not sys.stdout.isatty():
        say(json.dumps({"links": links, **(known if as_json else {})}))
    else:
        for line in link_lines({link.carries[0].value: link.address for link in server.links}, scene.path):
            say(line)
    # A pipe holds lines back, and who started this waits for this one.
    sys.stdout.flush()


def link_lines(addresses: dict[str, str], scene: Path) -> list[str]:
    """Write the addresses of served devices, by stream, and the commands that read them."""
    from skincal.words.link_words import STREAM_NAMES

    options = " ".join(f"--{stream} {address}" for stream, address in addresses.items())
    return [
        *(f"{STREAM_NAMES[Stream(stream)]:<20} {address}" for stream, address in addresses.items()),
        "Type these addresses into the window (Ctrl+N), or give them to a command in another terminal:",
        f"  skincal --scene {scene} {options}",
        f"  skincal record --scene {scene} {options} --out FOLDER",
    ]


def _run(server: Server, hand: AutoOperator | ScriptedOperator, operator: OperatorKind, pokes: int | None) -> None:
    """Serve devices until stdin closes, Ctrl-C or a termination signal; on a terminal print usage and poke number."""
    from skincal.simulation.operator import GuidedOperator, ScriptedOperator

    listener = hand if isinstance(hand, ScriptedOperator | GuidedOperator) else None
    terminal, progress = sys.stderr.isatty(), PokeLine(pokes)
    if terminal:
        say(f"{STDIN_HELP[operator]}. {SERVING_NOTICE.format(key='Ctrl-Z' if sys.platform == 'win32' else 'Ctrl-D')}", err=True)
    ended = threading.Event()
    with stopping() as stop:
        # A daemon: it waits in a read that nothing can interrupt.
        threading.Thread(target=_listen, args=(listener, ended, stop), name="orders", daemon=True).start()
        server.run(stop, (lambda: progress(hand.begun)) if terminal else lambda: None)
    progress.close()
    if terminal and ended.is_set():
        say(STDIN_ENDED, err=True)


def _listen(listener: ScriptedOperator | GuidedOperator | None, ended: threading.Event, stop: threading.Event) -> None:
    """Read orders from stdin until it closes: then the program that started this one has ended."""
    from skincal.simulation.operator import read_order

    for line in sys.stdin:
        try:
            order = read_order(line)
            if order is not None and listener is not None:
                listener.accept(order)
        except InputError as error:
            say(f"skincal: {error}", err=True)
    ended.set()
    stop.set()
