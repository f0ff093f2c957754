"""`record`: from devices to a session. Its parts also serve `import` and `simulate`.

A command that made no session of use takes its folder away again: with its input put right it then finds the folder free.
"""

from __future__ import annotations

import contextlib
import gc
import math
import queue
import signal
import sys
import threading
import time
from collections.abc import Collection, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from io import FileIO
from itertools import groupby
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.solve import Json
from skincal.cli.stop_event import StopEvent
from skincal.cli.terminal import say
from skincal.model.errors import InputError, plural
from skincal.model.given import parse_json
from skincal.model.readings import LINK_SILENT_AFTER_S, Chunk, LinkAnswer, LinkEvent, LinkHealth, LinkState, Stream
from skincal.taxels.result import Method

if TYPE_CHECKING:
    from skincal.following.guided_session import RobotGuide
    from skincal.geometry import FloatArray
    from skincal.model.scene import Scene
    from skincal.robot.targets import OpenTargets
    from skincal.session.pipeline import Pipeline
    from skincal.streams.links import ChunkQueue, Reader


SceneOption = Annotated[
    Path, typer.Option(help="Scene file (*.toml), or the name of one that ships: icub-forearm, flat-patch, ...")
]
OutOption = Annotated[Path, typer.Option(help="Folder of the new session.")]
LinkOption = Annotated[
    str,
    typer.Option(help="Port (/dev/ttyUSB0, COM3), socket://HOST:PORT, a file, a device (docs/devices.md) or run:COMMAND."),
]
ORDER_MAX_BYTES = 1 << 16
"""Of a line on standard input; a longer one is no order."""
SHOWN_ORDER_MAX_BYTES = 200
MAX_REQUESTED_POKES = 100_000
"""Largest allowed number of pokes: more than twenty for each taxel of a whole body. More is a slip, and would fill the disk."""
READINGS_TOGETHER_S, READINGS_TOGETHER_WITH_ROBOT_S = 0.1, 0.02
"""s of readings that are processed together while no poke waits to become final, which takes a longer quiet time. A robot is
answered as often as the guide looks."""
SAMPLE_WAIT_MAX_S = 0.02
"""s that readings wait for a skin frame, without which they are no sample."""
READING_WAIT_TIMEOUT_S = 0.05
"""s. How long the loop waits for the next reading; short enough to look at the clock 20 times a second."""
REPORT_UNOPENED_LINK_AFTER_NS = 1_500_000_000
"""A link that is not open after this time, such as a host whose name is unknown, is reported."""
LINK_CHECK_PERIOD_NS = 250_000_000
"""Time between two checks of the links."""
LATE_CHECK_NS = 1_000_000_000
"""A check that comes so late is no sign of silence: the machine gave no time to the program, nor to the threads that read."""


def add_to(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command(
        epilog="Example: skincal record --wrench /dev/ttyUSB0 --skin /dev/ttyACM0 --pose 1 --scene icub-forearm --out monday"
    )(record)


def find_scene(path: Path) -> Scene:
    """Load a scene file, or by name one that ships with skincal."""
    from skincal.model.scene import load_scene, scene_file

    return load_scene(scene_file(path))


def record(
    skin: LinkOption,
    scene: SceneOption,
    out: OutOption,
    wrench: Annotated[
        str | None,
        typer.Option(help="Link of the force/torque sensor, as --skin; leave it out if the rig has none (docs/tool.md)."),
    ] = None,
    joints: Annotated[str | None, typer.Option(help="Link of the joint angles, if they are streamed.")] = None,
    tip: Annotated[
        str | None,
        typer.Option(help="Link of the tip's position: lines x y z in m, in a fixed frame, or targets:/tip (docs/tip.md)."),
    ] = None,
    tool: Annotated[
        str | None,
        typer.Option(help="Link of the tool's poses, if the scene has [tool]: a sensor on it, or none (docs/tool.md)."),
    ] = None,
    pose: Annotated[str | None, typer.Option(help="Name of the arm pose, if joints are not streamed.")] = None,
    seconds: Annotated[
        float | None, typer.Option(min=0.0, help="Stop after this time, in seconds; default: at Ctrl-C.")
    ] = None,
    pokes: Annotated[int | None, typer.Option(min=1, max=MAX_REQUESTED_POKES, help="Stop after this many pokes.")] = None,
    orders: Annotated[bool, typer.Option("--orders", help="Read orders from stdin, one JSON object a line.")] = False,
    targets: Annotated[
        str | None,
        typer.Option(
            metavar="[HOST:]PORT|ros2:",
            help="Ask a robot for the guide's pokes, by TCP (docs/wire.md) or ROS topics (docs/ros.md), until no "
            "more are needed.",
        ),
    ] = None,
    method: Annotated[
        Method | None, typer.Option(help="Method whose needs the guide follows, with --targets.", show_default=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """Record devices into a session, until Ctrl-C, and estimate the taxels.

    With --targets the recording ends when no more pokes are needed.

    Orders on stdin with --orders: {"do": "ask_landmark", "name": "wrist, top"} for the next pokes,
    {"do": "exclude", "poke": 7}, {"do": "undo"}, {"do": "set_pose", "name": "2"}, and the other actions of a session's journal.
    """
    from skincal.model.actions import SetPose
    from skincal.session.importing import new_session, unnamed_landmarks
    from skincal.session.tool_streams import check_tool_streams
    from skincal.streams.links import ChunkQueue, Reader, describe_links

    loaded = find_scene(scene)
    check_pose(loaded, pose, streamed=joints is not None)
    check_tool_streams(loaded, {Stream.WRENCH: wrench, Stream.JOINTS: joints, Stream.TIP: tip, Stream.TOOL: tool})
    if method is not None and targets is None:
        raise InputError("--method says whose needs a robot is asked to meet; expected --targets PORT with it.")
    named = {Stream.WRENCH: wrench, Stream.SKIN: skin, Stream.JOINTS: joints, Stream.TIP: tip, Stream.TOOL: tool}
    links = describe_links(named)
    items = ChunkQueue()
    with stopping() as stop, _asking(targets) as server, new_session(out, loaded, links, warn) as pipeline:
        if orders:
            # A daemon, since nothing can interrupt its read.
            threading.Thread(target=_read_orders, args=(sys.stdin.fileno(), items), name="orders", daemon=True).start()
        readers = {link.name: Reader(link, items) for link in links}
        try:
            robot = None if server is None else _guide_of(pipeline, server, method)
            if pose is not None:
                pipeline.act(SetPose(pose), time.monotonic_ns())
            for reader in readers.values():
                reader.start()
            with skipping_loaded_objects():
                _loop(pipeline, items, readers, (seconds, pokes), stop, robot)
        finally:
            _record_the_rest(pipeline, items, readers)
            pipeline.close()
        with _ending_solve(out, pipeline) if stop.is_set() else contextlib.nullcontext():
            finish(pipeline, out, as_json, unnamed_landmarks(pipeline, out))


def _guide_of(pipeline: Pipeline, server: OpenTargets, method: Method | None) -> RobotGuide:
    from skincal.following.guided_session import RobotGuide  # a recording without a robot does without

    return RobotGuide(pipeline, server, method)


@contextlib.contextmanager
def _ending_solve(out: Path, pipeline: Pipeline) -> Generator[None]:
    """Announce the estimates of a stopped recording, and let a second Ctrl-C end them; `typer.Exit` with 130 then.

    The journal is closed: the recording is complete.
    """
    pokes = plural(pipeline.session.last_poke, "poke")
    later = f"`skincal solve {out}` does it later"
    say(f"stopped; solving {pokes}. Ctrl-C again ends this: {later}." if pipeline.session.last_poke else "stopped", err=True)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    except KeyboardInterrupt:
        say(f"not solved; the recording is in {out}: {later}", err=True)
        raise typer.Exit(130) from None
    finally:
        signal.signal(signal.SIGINT, before)


def _record_the_rest(pipeline: Pipeline, items: ChunkQueue, readers: Mapping[str, Reader]) -> None:
    """Stop the readers, and record what they still read."""
    # Stopped before the queue is emptied: then nothing comes any more, and nothing that came is lost.
    for reader in readers.values():
        reader.stop()
    items.finish()
    while not items.empty():
        _handle_items(pipeline, items.get_many(READING_WAIT_TIMEOUT_S))


@contextlib.contextmanager
def _asking(targets: str | None) -> Generator[OpenTargets | None]:
    """Open the connection to a robot that pokes, and yield it; `None` without `--targets`."""
    if targets is None:
        yield None
        return
    from skincal.robot.targets import open_targets

    with contextlib.closing(open_targets(targets)) as server:
        say(f"targets: a robot is asked at {server.place}", err=True)
        yield server


@contextlib.contextmanager
def skipping_loaded_objects() -> Generator[None]:
    """Leave what is loaded now out of Python's garbage collections: it lives as long as a recording."""
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


@contextlib.contextmanager
def stopping() -> Generator[threading.Event]:
    """Yield an event that Ctrl-C or a termination signal sets: an exception might strike while a file is written."""
    stop = StopEvent()

    def end(number: int, frame: FrameType | None) -> None:  # noqa: ARG001 - the signature of a handler
        stop.set()

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@dataclass(frozen=True, slots=True)
class OrderLine:
    """A line that was typed, and when: host's monotonic clock, nanoseconds."""

    host_ns: int
    text: bytes


def _read_orders(file: int, items: ChunkQueue) -> None:
    """Read the lines of an open file, stamp each with its time, and queue it."""
    # Unbuffered: a buffer's lock, held by a thread that waits for a line, would break the end of the program.
    for line in iter(partial(FileIO(file, closefd=False).readline, ORDER_MAX_BYTES), b""):
        items.put(OrderLine(time.monotonic_ns(), line))


def _next_items(pipeline: Pipeline, items: ChunkQueue, *, for_robot: bool) -> list[Chunk | LinkEvent | OrderLine]:
    """Wait for items, before an outcome that is reported for those that complete a sample; `queue.Empty` if none come.

    A robot needs every outcome, an operator the final ones.
    """
    if pipeline.awaits_outcome(final=not for_robot):
        if not pipeline.is_frame_waiting:
            items.wait_for_others(pipeline.links_without_skin, SAMPLE_WAIT_MAX_S)
    elif not items.is_full:
        quiet_s = pipeline.session.decisions.thresholds.quiet_s
        time.sleep(READINGS_TOGETHER_WITH_ROBOT_S if for_robot else min(READINGS_TOGETHER_S, quiet_s / 2.0))
    return items.get_many(READING_WAIT_TIMEOUT_S)


def _handle_items(
    pipeline: Pipeline, items: Sequence[Chunk | LinkEvent | OrderLine], states: dict[str, LinkState] | None = None
) -> None:
    """Hand items to the pipeline, readings together; report orders that cannot be done, and events of links with `states`."""
    for kind, run in groupby(items, type):
        if kind is Chunk:
            pipeline.feed_many([item for item in run if isinstance(item, Chunk)])
            continue
        for item in run:
            if isinstance(item, OrderLine):
                _follow_order(pipeline, item)
            elif isinstance(item, LinkEvent):
                if states is not None:
                    say(f"{item.link}: {item.state.value}" + (f": {item.text}" if item.text else ""), err=True)
                    states[item.link] = item.state
                pipeline.feed(item)


def _follow_order(pipeline: Pipeline, order: OrderLine) -> None:
    """Hand an order to the pipeline; report one that cannot be done and skip it."""
    from skincal.model.actions import action_from_json

    try:
        pipeline.act(action_from_json(parse_json(order.text)), order.host_ns)
    except (InputError, ValueError, AttributeError) as error:
        say(f"order {order.text[:SHOWN_ORDER_MAX_BYTES].decode(errors='replace').strip()}: not done. {error}", err=True)


def check_pose(scene: Scene, pose: str | None, *, streamed: bool) -> None:
    """Refuse a pose that the scene does not have, or an arm without one, before anything is made."""
    known = [] if scene.arm is None else list(scene.arm.poses)
    if scene.arm is not None and pose is None and not streamed:
        table = "arm" if scene.robot is None else "robot"
        named = f"--pose with one of {', '.join(known)}" if known else f"name one in [{table}.poses] of the scene for --pose"
        raise InputError(f"{scene.name} has an arm, and no pose of it was given; add --joints, or {named}.")
    if pose is not None and pose not in known:
        raise InputError(f"--pose is {pose!r}; the scene has {', '.join(known) or 'no named poses'}.")


def _loop(
    pipeline: Pipeline,
    items: ChunkQueue,
    readers: Mapping[str, Reader],
    until: tuple[float | None, int | None],
    stop: threading.Event,
    robot: RobotGuide | None = None,
) -> None:
    """Process items until `stop`, the seconds or pokes of `until`, the end of every link, or a finished session."""
    seconds, pokes = until
    end = math.inf if seconds is None else time.monotonic() + seconds
    reported, next_check_ns, reached_ns = 0, 0, 0
    states: dict[str, LinkState] = {}
    reports = LinkReports(time.monotonic_ns())
    while not stop.is_set() and time.monotonic() < end and not pipeline.journal_failure:
        now_ns = time.monotonic_ns()
        # Readings that wait came later than those that were processed: a link is silent by its arrivals alone.
        seen_ns = reached_ns if reached_ns and not items.empty() else now_ns
        sentences: list[str] = [] if robot is None else robot.guide_robot(now_ns, seen_ns)
        if now_ns >= next_check_ns:
            is_late = 0 < next_check_ns < now_ns - LATE_CHECK_NS and seen_ns == now_ns
            sentences += [] if is_late else reports.new(pipeline.live(seen_ns).links, states, seen_ns)
            next_check_ns = now_ns + LINK_CHECK_PERIOD_NS
        for sentence in sentences:
            say(sentence, err=True)
        try:
            arrived = _next_items(pipeline, items, for_robot=robot is not None)
        except queue.Empty:
            pipeline.tick(time.monotonic_ns())
            over = [states.get(name) for name, reader in readers.items() if not reader.running]
            if LinkState.FAILED in over or len(over) == len(readers):
                return
            continue
        _handle_items(pipeline, arrived, states)
        reached_ns = arrived[-1].host_ns
        pipeline.tick(reached_ns)
        reported = _report_new_pokes(pipeline, reported)
        if (pokes is not None and reported >= pokes) or (robot is not None and robot.enough):
            return


class LinkReports:
    """Reports each problem of a link once, and when the link sends again.

    Parameters
    ----------
    begin_ns : since when the links are being opened, host's monotonic clock
    """

    def __init__(self, begin_ns: int) -> None:
        self._begin_ns = begin_ns
        self._reported: dict[str, str] = {}

    def new(self, links: Sequence[LinkHealth], events: Collection[str], now_ns: int) -> list[str]:
        """List new sentences about the device connections; `events` names those whose state was printed already."""
        new: list[str] = []
        for link in links:
            problem, before = self._problem(link, events, now_ns), self._reported.get(link.link, "")
            if problem is None or problem == before:
                continue
            self._reported[link.link] = problem
            if problem or link.state is LinkState.OPEN:
                new.append(f"{link.link}: {problem or 'sends again'}")
        return new

    def _problem(self, link: LinkHealth, events: Collection[str], now_ns: int) -> str | None:
        """Describe the fault of a link; empty without one, `None` while that is not clear."""
        from skincal.words.link_words import link_verdict_words

        if link.state is not LinkState.OPEN:
            waits = link.link not in events and now_ns - self._begin_ns >= REPORT_UNOPENED_LINK_AFTER_NS
            return "is not open yet, and gives no reason; check its address and the network. Trying on." if waits else ""
        if link.verdict.answer is LinkAnswer.LISTENING:
            return None
        if link.verdict.answer is LinkAnswer.NO_ANSWER:
            return (
                f"is open but silent for {LINK_SILENT_AFTER_S:g} s; check the device's power, its cable, its baud rate "
                "and that it was started."
            )
        return "" if link.verdict.answer is LinkAnswer.GOOD else link_verdict_words(link.verdict)


def _report_new_pokes(pipeline: Pipeline, reported: int) -> int:
    """Print each poke's outcome once it is final; return the number of the last one printed."""
    session = pipeline.session
    while (outcome := session.corrected_outcome(reported + 1)) is not None and outcome.final:
        from skincal.contacts.outcome import Contact
        from skincal.words.poke_words import missed_words, rejection_words

        landmark = session.decisions.landmark_of_poke.get(outcome.poke)
        there = f"at landmark {landmark}" if landmark else ""
        if isinstance(outcome, Contact):
            words = f"accepted, channels {', '.join(map(str, outcome.channels))}" + (f"; {there}" if there else "")
        else:
            words = there or f"rejected, {rejection_words(outcome)}"
        say(f"poke {outcome.poke}: {words}", err=True)
        missed = session.decisions.missed_landmarks
        if outcome.poke in missed:
            say(f"poke {outcome.poke}: {missed_words(missed[outcome.poke])}", err=True)
        reported += 1
    return reported


def finish(
    pipeline: Pipeline,
    out: Path,
    as_json: bool,
    findings: Iterable[str] = (),
    reference: Mapping[int, FloatArray] | None = None,
    *,
    imported: bool = False,
) -> None:
    """Print a recording's result; with `reference` also the error against the known positions.

    Where it was `imported` the readings are kept elsewhere, and a session of no use need not be.

    Raises
    ------
    InputError
        A link gave nothing, so the session holds no usable data.
    KeptError
        Not everything could be recorded, or a link gave nothing that could be used.
    """
    from skincal.cli import output
    from skincal.session.importing import KeptError, stream_findings, unnamed_landmarks
    from skincal.words.frame_words import frame_sentences
    from skincal.words.link_words import silent_links
    from skincal.words.poke_words import WHOLE_RECORDINGS

    snapshot, links = pipeline.snapshot(), pipeline.live(0).links
    silent, too_short, unpoked = silent_links(links), "", ""
    if not (snapshot.pokes or silent):
        too_short, unpoked = _explain_no_poke(pipeline, imported=imported)
    uncompared = output.uncompared_findings(snapshot, reference)
    found = [*frame_sentences(pipeline.session.wrench_frames, snapshot.contacts), *([unpoked] if unpoked else [])]
    found += [*uncompared, *findings, *stream_findings(pipeline), *output.link_notes(links)]
    found += unnamed_landmarks(pipeline, out) if imported else []
    useless = too_short or (silent and _is_of_no_use(pipeline, imported=imported))
    kept = (bool(pipeline.journal_failure) or not useless) and out.exists()
    summary, lines = _summarize(pipeline, None if uncompared else reference)
    text = [*found, *lines, *output.loss_lines(links), *([f"session {out}"] if kept else [])]
    output.print_result({"session": out if kept else None, **summary, "findings": found}, text, as_json)
    trouble = pipeline.journal_failure or silent or (too_short and f"{too_short} {WHOLE_RECORDINGS}")
    if trouble:
        raise KeptError(trouble) if kept or pipeline.journal_failure else InputError(f"{trouble} No session was made.")


def _explain_no_poke(pipeline: Pipeline, *, imported: bool) -> tuple[str, str]:
    """Explain why no poke was found, by one of two sentences: the recording is too short for one, or what a poke needs."""
    from skincal.words.poke_words import no_poke_sentence, too_short_sentence

    asked = pipeline.before_pokes, pipeline.snapshot().decisions.thresholds, pipeline.live(0).links
    has_sensor = pipeline.scene.has_sensor
    too_short = too_short_sentence(*asked, has_sensor=has_sensor) if imported else ""
    return too_short, "" if too_short else no_poke_sentence(*asked, has_sensor=has_sensor)


def _is_of_no_use(pipeline: Pipeline, *, imported: bool) -> bool:
    """Whether a session with a silent link need not be kept."""
    from skincal.cli import output

    links, snapshot = pipeline.live(0).links, pipeline.snapshot()
    if not imported:
        # Without a byte of one of its devices no poke can ever be found in a recording.
        return not snapshot.pokes and not all(link.last_host_ns for link in links)
    return any(link.is_mixture for link in links) or not output.poke_counts(snapshot)["accepted"]


def _summarize(pipeline: Pipeline, known: Mapping[int, FloatArray] | None) -> tuple[dict[str, Any], list[str]]:
    """Summarize pokes, methods, turns, setup and losses, as JSON and in lines; with `known` also the error against it."""
    from skincal.cli import output
    from skincal.following.results import SessionResults
    from skincal.words.mistake_words import setup_sentences

    snapshot, live, results = pipeline.snapshot(), pipeline.live(0), SessionResults(pipeline)
    counts = output.poke_counts(snapshot)
    methods = output.method_summaries(snapshot.estimates, known, pipeline.scene.skin.layout, snapshot.part_size)
    turns, turn_lines = output.turn_result(results) if snapshot.pokes else ({}, [])
    losses = output.loss_counts(live.links, live.losses_unpaired)
    summary = {**counts, "methods": methods, **losses, **({"turns": turns} if turns else {})}
    return summary, [
        *output.poke_lines(counts, pipeline.scene),
        *(output.method_line(name, method) for name, method in methods.items()),
        *results.tool,
        *setup_sentences(results.setup),
        *turn_lines,
    ]


def warn(sentence: str) -> None:
    """Print a finding on stderr."""
    say(sentence, err=True)
