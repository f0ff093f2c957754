"""`import`: from other programs' recordings to a session.

A command that made no session of use takes its folder away again: with its input put right it then finds the folder free.
"""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skincal.cli.record import OutOption, SceneOption, check_pose, find_scene, finish, skipping_loaded_objects, stopping, warn
from skincal.cli.solve import Json
from skincal.cli.terminal import ProgressLine
from skincal.files.importers.registry import RECORDING_IMPORTERS, Importer, RecordedPlace, importer_of
from skincal.model.errors import InputError
from skincal.model.readings import Stream

if TYPE_CHECKING:
    from skincal.model.scene import Scene

_PoseOption = Annotated[str | None, typer.Option(help="Name of the arm pose, if the recording has no joints.")]


def add_to(app: typer.Typer) -> None:
    """Add the commands of this module."""
    importing = typer.Typer(
        help="Make a session from another program's recording.",
        no_args_is_help=True,
        epilog="Example: skincal import yarp --wrench log/ft --skin log/skin --pose 1 --scene icub-forearm --out monday",
    )
    for each in RECORDING_IMPORTERS:
        streams = "--wrench ft --skin skin" if each.one_stream else each.example
        example = f"Example: skincal import {each.name} {streams} --pose 1 --scene icub-forearm --out monday"
        purpose = f"Make a session of a recording: {each.title}."
        make = _files_command if each.one_stream else _arrays_command if each.name == "arrays" else _topics_command
        importing.command(each.name, help=purpose, epilog=example)(make(each))
    app.add_typer(importing, name="import")


def _files_command(importer: Importer) -> Callable[..., None]:
    """Make the command of an importer whose streams are files or folders."""

    def command(
        skin: Path, scene: SceneOption, out: OutOption, wrench: Path | None = None, joints: Path | None = None,
        tool: Path | None = None, pose: _PoseOption = None, as_json: Json = False,
    ) -> None:  # fmt: skip
        loaded = find_scene(scene)
        check_pose(loaded, pose, streamed=joints is not None)
        paths = {Stream.WRENCH: wrench, Stream.SKIN: skin, Stream.JOINTS: joints, Stream.TOOL: tool}
        places = {stream: RecordedPlace.parse(str(path)) for stream, path in paths.items() if path is not None}
        _import(importer, places, _Wanted(loaded, pose, out, as_json))

    help_of = {stream.value: typer.Option(help=text) for stream, text in importer.options.items()}
    # Typer reads the options from the annotations: each importer describes its own files.
    command.__annotations__ |= {name: Annotated[Path | None, help_of[name]] for name in help_of}
    command.__annotations__["skin"] = Annotated[Path, help_of["skin"]]
    return _without_tool(command, importer)


def _without_tool(command: Callable[..., None], importer: Importer) -> Callable[..., None]:
    """Leave out the option for the tool's poses of an importer that has none."""
    if Stream.TOOL not in importer.options:
        signature = inspect.signature(command, eval_str=True)  # typer evaluates no words of a signature that is given
        kept = [each for name, each in signature.parameters.items() if name != "tool"]
        command.__signature__ = signature.replace(parameters=kept)  # pyright: ignore[reportFunctionMemberAccess]
    return command


def _topics_command(importer: Importer) -> Callable[..., None]:
    """Make the command of an importer whose streams are topics of one file or folder."""

    def command(
        path: Annotated[Path, typer.Argument(help="File or folder of the recording.")], scene: SceneOption, out: OutOption,
        wrench: str | None = None, skin: str | None = None, joints: str | None = None, tool: str | None = None,
        pose: _PoseOption = None, as_json: Json = False,
    ) -> None:  # fmt: skip
        from skincal.session.importing import find_topics

        loaded = find_scene(scene)
        names = {Stream.WRENCH: wrench, Stream.SKIN: skin, Stream.JOINTS: joints, Stream.TOOL: tool}
        check_pose(loaded, pose, streamed=True)
        places, others = find_topics(path, {stream: name for stream, name in names.items() if name}, loaded, pose)
        check_pose(loaded, pose, streamed=Stream.JOINTS in places)
        _import(importer, places, _Wanted(loaded, pose, out, as_json), others)

    help_of = {stream.value: typer.Option(help=text) for stream, text in importer.options.items()}
    command.__annotations__ |= {name: Annotated[str | None, help_of[name]] for name in help_of}
    return command


def _arrays_command(importer: Importer) -> Callable[..., None]:
    """Make the command of the importer of arrays, which also states their times."""

    def command(
        path: Annotated[Path, typer.Argument(help="File with arrays: .npz, .h5, .mat, .parquet, text frames; or a folder.")],
        scene: SceneOption, out: OutOption, wrench: str | None = None, skin: str | None = None, joints: str | None = None,
        tool: str | None = None,
        time: Annotated[
            str | None,
            typer.Option(help="Array of the times, such as t or t:ms, or the rows a second. Default: a likely array."),
        ] = None,
        episode: Annotated[int | None, typer.Option(help="Episode of a LeRobot data set. Default: all, in turn.")] = None,
        pose: _PoseOption = None, as_json: Json = False,
    ) -> None:  # fmt: skip
        from skincal.session.importing import find_topics

        loaded = find_scene(scene)
        check_pose(loaded, pose, streamed=True)
        texts = {Stream.WRENCH: wrench, Stream.SKIN: skin, Stream.JOINTS: joints, Stream.TOOL: tool}
        named = {stream: _array_place(path, text) for stream, text in texts.items() if text}
        topics = {stream: place.topic for stream, place in named.items()}
        places, others = find_topics(path, topics, loaded, pose)
        check_pose(loaded, pose, streamed=Stream.JOINTS in places)
        options = [f"time={time}"] if time else []
        options += [f"episode={episode}"] if episode is not None else []
        places = {stream: _with_options(named.get(stream, place), path, options) for stream, place in places.items()}
        _import(importer, places, _Wanted(loaded, pose, out, as_json), others)

    help_of = {stream.value: typer.Option(help=text) for stream, text in importer.options.items()}
    command.__annotations__ |= {name: Annotated[str | None, help_of[name]] for name in help_of}
    return command


def _array_place(path: Path, text: str) -> RecordedPlace:
    """Read the name of an array, or `FILE::NAME` of another file, or another file alone."""
    if Path(text).is_file():
        return RecordedPlace(Path(text))
    file, separator, _ = text.partition("::")
    return RecordedPlace.parse(text) if separator and Path(file).exists() else RecordedPlace(path, text)


def _with_options(place: RecordedPlace, path: Path, options: Sequence[str]) -> RecordedPlace:
    """Append options to the name of an array in `path`; its own ones stay."""
    if options and place.path == path and not importer_of(path).asks_if_tied:
        raise InputError(f"{path}: is a table, whose columns name their times; leave out --{options[0].partition('=')[0]}.")
    own = place.topic.partition("?")[2]
    names = {each.partition("=")[0] for each in own.split("&")}
    added = [each for each in options if each.partition("=")[0] not in names]
    if place.path != path or not place.topic or not added:
        return place
    return RecordedPlace(path, f"{place.topic}{'&' if own else '?'}{'&'.join(added)}")


@dataclass(frozen=True, slots=True)
class _Wanted:
    """Session that a recording becomes."""

    scene: Scene
    pose: str | None
    """Name of the arm pose; `None` with recorded joints or without an arm."""
    out: Path
    as_json: bool


def _import(importer: Importer, places: Mapping[Stream, RecordedPlace], wanted: _Wanted, findings: Sequence[str] = ()) -> None:
    scene, out = wanted.scene, wanted.out
    from skincal.files.importers.preview import open_places
    from skincal.session.importing import check_recorded_tool, joint_columns, new_session, play_recording

    check_recorded_tool(scene, places)
    read_share = importer.reading_share
    with _progress() as go_on:
        others = {importer_of(place.path).name for place in places.values()} - {importer.name}
        recording = open_places(
            places,
            joint_columns(scene),
            lambda share: go_on(read_share * share),
            scene.skin.frame_width,
            None if others and importer.asks_if_tied else importer,
        )
        # Modules live as long as the command: looking through them for garbage takes a tenth of the time.
        with skipping_loaded_objects(), new_session(out, scene, recording.links, warn, copy=True) as pipeline:
            play_recording(pipeline, recording, wanted.pose, lambda share: go_on(read_share + (1 - read_share) * share))
            finish(pipeline, out, wanted.as_json, (*findings, *recording.findings), imported=True)


@contextlib.contextmanager
def _progress() -> Generator[Callable[[float], bool]]:
    """Yield a function that shows the finished share, 0 to 1, and says whether to continue: not after Ctrl-C."""
    line = ProgressLine("import")
    with stopping() as stop:

        def go_on(share: float) -> bool:
            line.show(share)
            if share >= 1 or stop.is_set():
                line.clear()
            return not stop.is_set()

        try:
            yield go_on
        finally:
            line.clear()
