"""Import of recordings of other programs as sessions, and removal of a useless session."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from skincal.contacts.outcome import Contact, Rejection
from skincal.devices.pose_names import clash_in_scene
from skincal.journal import writer
from skincal.journal.lock import LOCK_NAME, describe_lock_holder
from skincal.model.actions import SetPose
from skincal.model.errors import InputError
from skincal.model.readings import Stream
from skincal.model.scene import Scene, load_scene
from skincal.model.skin_axes import AXES_PER_TAXEL
from skincal.part.part import anchor_findings, load_scene_surface
from skincal.session.landmark_pokes import can_be_at_landmark
from skincal.session.pipeline import Pipeline
from skincal.session.skin_findings import session_skin_sentences
from skincal.session.tool_streams import check_tool_streams
from skincal.streams.links import ITEMS_AT_ONCE, LinkSpec
from skincal.words.frame_words import frame_sentences
from skincal.words.layout_words import sheet_findings
from skincal.words.link_words import silent_links
from skincal.words.poke_words import (
    WHOLE_RECORDINGS,
    late_angles_sentence,
    no_poke_sentence,
    too_short_sentence,
    unnamed_landmarks_sentence,
)

if TYPE_CHECKING:
    # A live recording, and the window, do without the importers.
    from skincal.files.importers.preview import RecordingFiles
    from skincal.files.importers.registry import RecordedPlace
    from skincal.files.importers.timeline import OpenRecording


class KeptError(InputError):
    """An import failed, but the session keeps what was read before."""


@contextlib.contextmanager
def new_session(
    folder: Path,
    scene: Scene,
    links: Sequence[LinkSpec],
    tell: Callable[[str], object] = lambda _: None,
    *,
    copy: bool = False,
) -> Generator[Pipeline]:
    """Make a session in `folder` and yield its pipeline; on an `InputError` other than `KeptError` remove it again.

    Files of others in the folder stay.

    Parameters
    ----------
    tell : gets sentences about the mesh, the anchors on it and the kind of the skin
    copy : the session is made from a recording, and could be made again
    """
    missing = missing_folders(folder)
    journal = None
    try:
        surface, findings = load_scene_surface(scene)
        for finding in (*findings, *anchor_findings(scene, surface)):
            tell(f"{scene.surface.path.name if scene.surface else ''}: {finding}")
        for finding in sheet_findings(scene.skin.layout, is_on_mesh=surface is not None):
            tell(f"{scene.path.name}: {finding}")
        journal = writer.create_session(folder, scene, links, copy=copy)
        yield Pipeline(scene, links, surface, journal)
    except KeptError:
        raise
    except InputError:
        # Never remove another program's session.
        take_away(folder if journal is not None else None, missing)
        raise


def missing_folders(folder: Path) -> list[Path]:
    """List which of a folder and its parents do not exist yet, the innermost first: only these may be removed."""
    return [place for place in (folder, *folder.parents) if not place.exists()]


def take_away(session: Path | None, missing: Sequence[Path]) -> None:
    """Remove a session that was made here, and those of its folders that were `missing` before."""
    if session is not None:
        shutil.rmtree(session / writer.SCENE_FOLDER, ignore_errors=True)
        for ending in ("mcap", "jsonl"):
            for segment in session.glob(f"segment-[0-9][0-9][0-9][0-9].{ending}"):
                segment.unlink()
        if not describe_lock_holder(session):
            # Left by a killed process.
            (session / LOCK_NAME).unlink(missing_ok=True)
    for place in missing:
        # A folder with other files stays.
        with contextlib.suppress(OSError):
            place.rmdir()


def play_recording(
    pipeline: Pipeline, recording: OpenRecording, pose: str | None, go_on: Callable[[float], bool] = lambda _: True
) -> None:
    """Feed a recording to the pipeline of a new session, and close it.

    Parameters
    ----------
    pose : name of the arm pose, if joints were not recorded
    go_on : gets the finished share, 0 to 1, and says whether to continue; if not, a `StoppedError` follows

    Raises InputError: the names of the columns of the poses, or of a skin of three axes, contradict the scene.
    """
    from skincal.files.importers.registry import StoppedError
    from skincal.files.importers.timeline import SESSION_START_TIME_NS

    try:
        _check_pose_names(pipeline.scene, recording)
        _check_value_order(pipeline.scene, recording)
        if pose:
            pipeline.act(SetPose(pose), SESSION_START_TIME_NS)
        span_ns = max(recording.span_ns, 1)
        chunks = iter(recording.chunks())
        while not pipeline.journal_failure and (block := list(islice(chunks, ITEMS_AT_ONCE))):
            if not go_on(min(1.0, (block[0].host_ns - SESSION_START_TIME_NS) / span_ns)):
                raise StoppedError
            pipeline.feed_many(block)
    finally:
        pipeline.close()


def _check_pose_names(scene: Scene, recording: OpenRecording) -> None:
    """Compare what the columns of the poses of a recording name with `[tool]`. Raises InputError: they differ."""
    given = None if scene.tool is None else scene.tool.streamed_form
    clash = None if given is None else recording.pose_names.clash(*given)
    if clash is not None:
        raise InputError(f"The columns of the tool's poses name {clash_in_scene(clash, scene.path.name)}.")


def _check_value_order(scene: Scene, recording: OpenRecording) -> None:
    """Compare the axes that the columns of the skin name with `[skin]`. Raises InputError: they differ."""
    named, axes, file = recording.value_order, scene.skin.axes, scene.path.name
    if named is None or (axes is not None and axes.order is named):
        return
    if axes is None:
        taxels = scene.skin.frame_width // AXES_PER_TAXEL
        right = f'axes = 3, channels = {taxels} and order = "{named.value}"'
        raise InputError(f"The columns of the skin are x, y and z of {taxels} taxels; write {right} into [skin] of {file}.")
    raise InputError(
        f'The columns of the skin have the order "{named.value}", and the scene "{axes.order.value}"; write '
        f'order = "{named.value}" into [skin] of {file}.'
    )


def stream_findings(pipeline: Pipeline) -> list[str]:
    """List sentences on streams that paused or repeated one reading, and on faults of the skin, after the last reading."""
    outcomes = [record.outcome for record in pipeline.snapshot().pokes]
    late = late_angles_sentence([each for each in outcomes if isinstance(each, Rejection)])
    skin = session_skin_sentences(pipeline.snapshot(), pipeline.skin_condition, pipeline.scene)
    return [*([late] if late else []), *pipeline.freeze_findings(), *skin]


def unnamed_landmarks(pipeline: Pipeline, folder: Path) -> list[str]:
    """List the advice on landmarks without a poke: at most one sentence."""
    snapshot = pipeline.snapshot()
    named = set(snapshot.at_landmarks.values())
    free = [
        record.outcome
        for record in snapshot.pokes
        if isinstance(record.outcome, Rejection)
        and can_be_at_landmark(record.outcome)
        and record.outcome.poke not in snapshot.at_landmarks
    ]
    names = [landmark.name for landmark in snapshot.decisions.landmarks if landmark.name not in named]
    sentence = unnamed_landmarks_sentence(names, len(free), str(folder), is_placed=snapshot.is_placed)
    return [sentence] if sentence else []


def joint_columns(scene: Scene) -> tuple[str, ...]:
    """Name the columns of the scene's joint stream, empty for one that the arm does not need; empty if it names none."""
    robot = scene.robot
    if robot is None:
        return ()
    return tuple(name if column in robot.chain.joints else "" for column, name in enumerate(robot.columns))


@dataclass(frozen=True, slots=True)
class ImportRequest:
    """A recording to import, and where to."""

    files: RecordingFiles
    scene: Path
    pose: str
    """Name of the arm pose; empty with recorded joints or without an arm."""
    folder: Path


@dataclass(frozen=True, slots=True)
class Imported:
    """Result of an import."""

    folder: Path
    pokes: int
    accepted: int
    unpoked: str = ""
    """A sentence why there is no poke; empty with pokes."""
    findings: tuple[str, ...] = ()
    """Sentences on the readings, such as a sensor that stopped."""


def import_recording(request: ImportRequest, go_on: Callable[[float], bool] = lambda _: True) -> Imported:
    """Make a session of a recording; `go_on` is as for `play_recording`.

    Raises
    ------
    InputError
        The recording or the scene cannot be read, the folder cannot be written, or a file has no usable reading. No file is
        left.
    """
    scene, read_share = load_scene(request.scene), request.files.importer.reading_share
    files = of_scene(request.files, scene)
    check_recorded_tool(scene, files.places)
    recording = files.open(joint_columns(scene), lambda share: go_on(read_share * share))
    with new_session(request.folder, scene, recording.links, copy=True) as pipeline:
        play_recording(pipeline, recording, request.pose or None, lambda share: go_on(read_share + (1 - read_share) * share))
        outcomes = [record.outcome for record in pipeline.snapshot().pokes]
        links = pipeline.live(0).links
        silent = silent_links(links)
        if pipeline.journal_failure:
            raise InputError(pipeline.journal_failure)
        accepted = sum(isinstance(outcome, Contact) for outcome in outcomes)
        if silent and (not accepted or any(link.is_mixture for link in links)):
            raise InputError(f"{silent} No session was made.")
        too_short = ""
        if not outcomes:
            too_short = too_short_sentence(pipeline.before_pokes, scene.contacts, links, has_sensor=scene.has_sensor)
        if too_short:
            raise InputError(f"{too_short} {WHOLE_RECORDINGS} No session was made.")
        unpoked = (
            "" if outcomes else no_poke_sentence(pipeline.before_pokes, scene.contacts, links, has_sensor=scene.has_sensor)
        )
        warnings = [f"{link.link}: {link.warning}" for link in links if link.warning]
        frames = frame_sentences(pipeline.session.wrench_frames, pipeline.session.contacts)
        findings = (*frames, *stream_findings(pipeline), *warnings, *unnamed_landmarks(pipeline, request.folder))
    return Imported(request.folder, len(outcomes), accepted, unpoked, findings)


def of_scene(files: RecordingFiles, scene: Scene) -> RecordingFiles:
    """Leave out the streams that a scene has no use for, and add what it says of the others."""
    form = None if scene.tool is None else scene.tool.streamed_form
    return replace(
        files,
        wrench=files.wrench if scene.has_sensor else None,
        joints=files.joints if scene.tool is None else None,
        tool=None if scene.tool is None else files.tool,
        channels=scene.skin.frame_width,
        has_wrench=scene.has_sensor,
        pose_form=form,
    )


def check_recorded_tool(scene: Scene, places: Mapping[Stream, RecordedPlace]) -> None:
    """Refuse streams that do not fit the sensor of a scene, and poses whose form nothing defines.

    Raises InputError: a stream is missing or has no use, or a table holds poses and `[tool]` does not say their form.
    """
    addresses = {stream: str(places[stream]) if stream in places else None for stream in Stream}
    check_tool_streams(scene, addresses)
    place = places.get(Stream.TOOL)
    if place is None or scene.tool is None or scene.tool.streamed_form is not None:
        return
    from skincal.files.importers.registry import importer_of

    if importer_of(place.path).name != "rosbag":
        raise InputError(
            f"{place}: numbers do not say the form of a pose; set rotation and unit in [tool] of {scene.path.name}: "
            "`skincal tool` finds the form (docs/tool.md)."
        )


def find_topics(
    path: Path, named: Mapping[Stream, str], scene: Scene, pose: str | None
) -> tuple[dict[Stream, RecordedPlace], list[str]]:
    """Complete the named topics by likely ones; name the other likely ones in sentences.

    A stream without a likely topic gets an empty one, which the importer refuses with the topics that there are. Joints are
    read only where the scene has an arm and no pose is given.
    """
    from skincal.files.importers.preview import guess_streams
    from skincal.files.importers.registry import RecordedPlace

    wanted = {Stream.SKIN, *named}
    wanted |= {Stream.WRENCH} if scene.has_sensor else set[Stream]()
    wanted |= set[Stream]() if scene.tool is None else {Stream.TOOL}
    needs_joints = scene.arm is not None and pose is None
    guessed, others = dict[Stream, RecordedPlace](), list[str]()
    if wanted - named.keys() or (needs_joints and Stream.JOINTS not in named):
        found = guess_streams([path], scene.skin.frame_width, joint_columns(scene))
        guessed = found.places
        for stream in (each for each in Stream if each in wanted - named.keys()):
            found.check_tied(stream)
        if needs_joints and Stream.JOINTS in guessed:
            wanted.add(Stream.JOINTS)
        others = found.sentences_on_others(wanted - named.keys())
    return {
        stream: RecordedPlace(path, named[stream]) if stream in named else guessed.get(stream, RecordedPlace(path))
        for stream in Stream
        if stream in wanted
    }, others
