"""Guess which stream each file of a recording holds, and preview the recording before a session is made of it."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skincal.devices.decoding import WRENCH_VALUES
from skincal.devices.pose_names import NO_POSE_NAMES
from skincal.files.importers.registry import (
    RANK_OF_GUESS_BY_CHANNELS,
    RECORDING_IMPORTERS,
    Importer,
    RecordedPlace,
    StreamGuess,
    find_recordings,
    importer_of,
)
from skincal.files.importers.timeline import SESSION_START_TIME_NS, OpenRecording, check_overlap, late_streams
from skincal.geometry import FloatArray
from skincal.model.errors import InputError, plural
from skincal.model.readings import Batch, Stream
from skincal.ros.proposals import is_command, name_rank
from skincal.streams.decoders.auto_detect import LinkDecoder
from skincal.streams.link_diagnosis import LinkMonitor
from skincal.words.link_words import BINARY_LEVELS, binary_skin, freeze_sentences

if TYPE_CHECKING:
    from skincal.model.pose_form import PoseForm
    from skincal.model.scene import Scene

PREVIEWED_TIME_S = 60.0
"""Length of the part that is decoded: several pokes, in a second or two."""
FORCE_CURVE_BIN_S = 0.1
"""The force curve has the largest force of each bin: a poke is longer."""
MAX_JOINTS_IN_UNNAMED_STREAM = 16
"""A row of unknown meaning with more values is a skin: arms have fewer joints, skins more taxels."""
OTHER_TOPICS_LISTED_MAX = 5
"""Topics that a sentence lists."""
MAX_FILES_TRIED = 2000
"""Each costs about a millisecond."""
FIRST_VALUES_SHOWN = 6
"""Values of the first row that are shown."""
_NAME_PATTERNS = (
    (Stream.SKIN, re.compile(r"skin|tactile|taxel|touch")),
    (Stream.JOINTS, re.compile(r"joint|state|encoder|angle")),
    (Stream.WRENCH, re.compile(r"(?<![a-z])ft(?![a-z])|f_t|wrench|force|torque|measures")),
)
"""Words in names of ports, topics, folders and files. The first match counts: a skin on a forearm has both names."""


@dataclass(frozen=True, slots=True)
class RecordingFiles:
    """Where each stream of a recording is; `None` while it is unknown."""

    wrench: RecordedPlace | None = None
    skin: RecordedPlace | None = None
    joints: RecordedPlace | None = None
    tool: RecordedPlace | None = None
    """Poses of the tool, for a scene with `[tool]`."""
    candidates: tuple[RecordedPlace, ...] = field(default=(), compare=False, kw_only=True)
    """All places in the recording that may hold a stream."""
    channels: int = field(default=0, compare=False, kw_only=True)
    """Of the skin, which a table must have; 0 if unknown, as in a preview."""
    has_wrench: bool = field(default=True, compare=False, kw_only=True)
    """Whether the rig has a force/torque sensor."""
    pose_form: tuple[PoseForm, float] | None = field(default=None, compare=False, kw_only=True)
    """Form of the tool's poses by the scene, and metres per unit of their lengths; `None` without one."""
    others: Mapping[Stream, tuple[RecordedPlace, ...]] = field(
        default_factory=dict[Stream, tuple[RecordedPlace, ...]], compare=False, kw_only=True
    )
    """Topics that may hold a stream, too, in the order of their likeliness."""
    tied: Mapping[Stream, tuple[RecordedPlace, ...]] = field(
        default_factory=dict[Stream, tuple[RecordedPlace, ...]], compare=False, kw_only=True
    )
    """Places that are equally likely, for an importer that leaves this choice to the operator."""

    @property
    def places(self) -> dict[Stream, RecordedPlace]:
        """Known places."""
        named = {
            Stream.WRENCH: self.wrench,
            Stream.SKIN: self.skin,
            Stream.JOINTS: self.joints,
            Stream.TOOL: self.tool,
        }
        return {stream: place for stream, place in named.items() if place is not None}

    def sentences_on_others(self, proposed: Collection[Stream]) -> list[str]:
        """Name the other topics of the streams for which a topic was proposed."""
        return [
            f"{stream.value}: {place.topic} was chosen; it could be {' or '.join(each.topic for each in others)}, too. "
            "If one of them is meant, name it."
            for stream, place in self.places.items()
            if stream in proposed and (others := self.others.get(stream, ())[:OTHER_TOPICS_LISTED_MAX])
        ]

    def check_tied(self, stream: Stream) -> None:
        """Raise InputError: two places are equally likely to be the stream, and the operator has to choose."""
        if names := [each.topic or str(each) for each in self.tied.get(stream, ())][:OTHER_TOPICS_LISTED_MAX]:
            raise InputError(f"The {stream.value} may be {' or '.join(names)}; name the one that is meant.")

    @property
    def importer(self) -> Importer:
        """Importer that reads the skin; other streams may be files of another kind.

        Raises InputError: sensor or skin are missing.
        """
        lacks_wrench = self.wrench is None and self.has_wrench
        if lacks_wrench or self.skin is None:
            self.check_tied(Stream.WRENCH if lacks_wrench else Stream.SKIN)
            missing = "the force/torque sensor" if lacks_wrench else "the skin"
            raise InputError(f"No recording of {missing} is named; name the file or folder that holds it.")
        return importer_of(self.skin.path)

    def open(self, joints: Sequence[str] = (), go_on: Callable[[float], bool] = lambda _: True) -> OpenRecording:
        """Read the recording through; the parameters are those of `Importer.open_recording`.

        Raises InputError: as for `importer`, or a file cannot be read.
        """
        _ = self.importer
        return open_places(self.places, joints, go_on, self.channels)


def open_places(
    places: Mapping[Stream, RecordedPlace],
    joints: Sequence[str] = (),
    go_on: Callable[[float], bool] = lambda _: True,
    channels: int = 0,
    importer: Importer | None = None,
) -> OpenRecording:
    """Read the places of one recording through, each by the importer of its file.

    Parameters
    ----------
    joints, go_on, channels : as of `Importer.open_recording`
    importer : of every file that no other importer claims; `None` to choose by each file

    Raises InputError: a place cannot be read, or the streams do not fit together.
    """
    kinds: dict[str, dict[Stream, RecordedPlace]] = {}
    for stream, place in places.items():
        chosen = importer or importer_of(place.path)
        kinds.setdefault(chosen.name, {})[stream] = place
    by_name = {each.name: each for each in RECORDING_IMPORTERS}
    opened = [by_name[name].open_recording(each, joints, go_on, channels) for name, each in kinds.items()]
    if len(opened) == 1:
        return opened[0]
    timelines = tuple(each for one in opened for each in one.timelines)
    check_overlap(timelines)
    titles = " and ".join(by_name[name].title for name in kinds)
    return OpenRecording(
        tuple(each for one in opened for each in one.links),
        timelines,
        tuple(each for one in opened for each in one.sources),
        (
            *(each for one in opened for each in one.findings),
            *late_streams(timelines),
            f"The files are of two kinds ({titles}): their clocks must agree, since readings are paired by their times.",
        ),
        next((one.frame_shape for one in opened if one.frame_shape), ()),
        next((one.pose_names for one in opened if one.pose_names != NO_POSE_NAMES), NO_POSE_NAMES),
        next((one.value_order for one in opened if one.value_order is not None), None),
    )


def guess_streams(paths: Sequence[Path], channels: int = 0, joints: Sequence[str] = ()) -> RecordingFiles:
    """Assign files, or those of a folder, to streams by their names and first lines.

    Parameters
    ----------
    channels : of the skin; 0 if unknown
    joints : names of the scene's joints, if they are known

    Raises InputError: none of them is a recording.
    """
    files = find_recordings(paths[0]) if len(paths) == 1 and paths[0].is_dir() else [path for path in paths if path.exists()]
    if len(files) > MAX_FILES_TRIED:
        raise InputError(
            f"{paths[0]}: holds {len(files)} recordings; expected at most {MAX_FILES_TRIED}: name the files instead."
        )
    # The sentence on a single file says more.
    guesses = (
        list(importer_of(files[0]).guess_streams(files[0]))
        if _has_topics(files) or (len(paths) == 1 and files == [paths[0]] and paths[0].is_file())
        else [guess for path in files for guess in _guesses(path)]
    )
    if not guesses:
        names = ", ".join(str(path) for path in paths)
        raise InputError(
            f"{names}: no recording was found; expected sensor and skin in yarpdatadumper folders, CSV files, arrays or a bag "
            "of ROS."
        )
    likely = dict[Stream, list[RecordedPlace]]()
    likeliness = dict[Stream, list[object]]()
    wanted = set(filter(None, joints))
    for guess in sorted(dict.fromkeys(guesses), key=lambda guess: _order(guess, channels, wanted)):
        if guess.rank < RANK_OF_GUESS_BY_CHANNELS or guess.width == channels:
            stream = _likely_stream(guess, channels)
            likely.setdefault(stream, []).append(guess.place)
            likeliness.setdefault(stream, []).append(_order(guess, channels, wanted)[:-2])
    # Nothing has measured a command.
    found = {stream: next((each for each in places if not is_command(each.topic)), None) for stream, places in likely.items()}
    candidates = tuple(sorted(guess.place for guess in guesses))
    others = {
        stream: tuple(each for each in places if each.topic and each != found[stream]) for stream, places in likely.items()
    }
    tied = dict[Stream, tuple[RecordedPlace, ...]]()
    for stream, places in likely.items():
        equal = [place for place, each in zip(places, likeliness[stream], strict=True) if each == likeliness[stream][0]]
        if len(equal) > 1 and all(importer_of(place.path).asks_if_tied for place in equal):
            tied[stream], found[stream] = tuple(equal), None
    return RecordingFiles(
        found.get(Stream.WRENCH), found.get(Stream.SKIN), found.get(Stream.JOINTS), found.get(Stream.TOOL),
        candidates=candidates, others=others, tied=tied,
    )  # fmt: skip


def _order(guess: StreamGuess, channels: int, joints: set[str]) -> tuple[object, ...]:
    """Key that sorts guesses by their likeliness; width and place, the last two, only break ties."""
    stream = _likely_stream(guess, channels)
    lacking = len(joints) - len(joints & set(guess.joints)) if stream is Stream.JOINTS else 0
    name = name_rank(guess.place.topic, stream) if guess.place.topic else 0
    return guess.width != channels, lacking, guess.rank, name, -guess.width, guess.place


def _has_topics(files: Sequence[Path]) -> bool:
    return len(files) == 1 and not importer_of(files[0]).one_stream


def _guesses(path: Path) -> Sequence[StreamGuess]:
    try:
        return importer_of(path).guess_streams(path)
    except InputError:
        return ()


def _likely_stream(guess: StreamGuess, channels: int) -> Stream:
    """Choose a stream by the columns if they tell, else by the name, else by the number of values."""
    path = guess.place.path
    name = (guess.place.topic or (path.parent.name if path.name == importer_of(path).marker else path.name)).lower()
    named = next((stream for stream, words in _NAME_PATTERNS if words.search(name)), None)
    by_width = Stream.SKIN
    if guess.width != channels and guess.width <= MAX_JOINTS_IN_UNNAMED_STREAM:
        by_width = Stream.WRENCH if guess.width == WRENCH_VALUES else Stream.JOINTS
    is_sure = guess.stream in (Stream.WRENCH, Stream.JOINTS, Stream.TOOL) or (guess.stream is not None and guess.place.topic)
    return guess.stream if guess.stream is not None and is_sure else named or guess.stream or by_width


@dataclass(frozen=True, slots=True)
class StreamPreview:
    """One stream of a recording."""

    stream: Stream
    path: str
    rows: int
    rate: float
    """Rows a second; 0 if unknown."""
    seconds: float
    """From the first row to the last."""
    width: int
    """Values of a row; 0 if none could be read."""
    first: tuple[float, ...]
    """First values of the first row; joints are degrees."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordingPreview:
    """What a recording holds."""

    importer: Importer
    streams: tuple[StreamPreview, ...]
    findings: tuple[str, ...]
    """Sentences on times and losses."""
    times: FloatArray
    """(n,) float, s from the beginning: every `FORCE_CURVE_BIN_S` of the first `PREVIEWED_TIME_S`..."""
    force: FloatArray
    """(n,) float, N: largest deviation of the force from its median in each bin; NaN without a reading."""
    frame: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    """(rows, columns) float: mean frame of the skin; one row if the recording states no shape, empty without readings."""

    def misfits(self, scene: Scene, pose: str) -> tuple[str, ...]:
        """Say why a session cannot be made of it for a scene, in sentences.

        Parameters
        ----------
        pose : name of the chosen arm pose, or empty
        """
        widths = {stream.stream: stream.width for stream in self.streams}
        skin, joints = widths[Stream.SKIN], widths.get(Stream.JOINTS)
        found: list[str] = []
        if skin != scene.skin.frame_width:
            found.append(
                f"A row of the skin has {plural(skin, 'value')}, and the scene {scene.name} has "
                f"{_expected_values(scene)}; choose the scene that it was recorded on."
            )
        if scene.has_sensor and widths.get(Stream.WRENCH) != WRENCH_VALUES:
            found.append("No row of the force/torque recording has fx fy fz mx my mz; choose another file.")
        if scene.arm is not None and joints is None and pose not in scene.arm.poses:
            found.append("The scene has an arm; name the recording of its joints, or choose the arm pose.")
        if scene.tool is not None and Stream.TOOL not in widths:
            found.append("The scene has a tool; name the recording of its poses.")
        # Topics name their joints: then the import finds those of a robot by their names.
        has_columns = self.importer.one_stream or scene.robot is None
        if has_columns and scene.arm is not None and joints is not None and joints <= max(scene.arm.arm.joints):
            number = plural(max(scene.arm.arm.joints) + 1, "joint")
            found.append(f"A row of the joints has {plural(joints, 'value')}; the scene's arm needs {number} or more.")
        return tuple(found)


def _expected_values(scene: Scene) -> str:
    channels = plural(scene.skin.channels, "channel")
    return channels if scene.skin.axes is None else f"{channels} of three axes, {plural(scene.skin.frame_width, 'value')}"


def preview_recording(files: RecordingFiles, wanted: Callable[[], bool] = lambda: True) -> RecordingPreview:
    """Read all times of a recording, and decode the readings of its first `PREVIEWED_TIME_S`; nothing is written.

    Parameters
    ----------
    wanted : whether to go on

    Raises InputError: it cannot be read as a recording.
    """
    importer, opened = files.importer, files.open()
    decoders = {link.name: LinkDecoder(link.format, None, link.carries) for link in opened.links}
    if files.pose_form is not None:
        for decoder in decoders.values():
            decoder.current.set_pose_form(*files.pose_form)
    monitors = {link.name: LinkMonitor(link.carries, {}, None) for link in opened.links}
    readings: dict[str, list[Batch]] = defaultdict(list)
    for chunk in opened.chunks():
        if chunk.host_ns > SESSION_START_TIME_NS + PREVIEWED_TIME_S * 1e9 or not wanted():
            break
        batches = [batch for _, batch in decoders[chunk.link].feed(chunk.data, chunk.host_ns)]
        monitors[chunk.link].on_data(chunk.data, chunk.host_ns, batches)
        readings[chunk.link] += batches
    streams: list[StreamPreview] = []
    for link, timeline in zip(opened.links, opened.timelines, strict=True):
        values = _values(readings[link.name])
        rate = 1.0 / timeline.interval if timeline.interval else 0.0
        first = tuple(values[0, :FIRST_VALUES_SHOWN].tolist()) if len(values) else ()
        seconds = timeline.last - timeline.first
        path = link.address.removeprefix("file:")
        streams.append(StreamPreview(link.carries[0], path, timeline.lines, rate, seconds, values.shape[1], first))
    lost = [
        f"{name}: {count} of the first {PREVIEWED_TIME_S:.0f} s: {loss.value}."
        for name, decoder in decoders.items()
        for loss, count in decoder.current.counts.items()
    ]
    # `streams` has the size of each file already.
    sizes = {timeline.sentences()[0] for timeline in opened.timelines}
    findings = [finding for finding in opened.findings if finding not in sizes] + lost
    for name, monitor in monitors.items():
        findings += freeze_sentences(monitor.freezes, SESSION_START_TIME_NS)
        findings += [f"{name}: {binary_skin(monitor.levels)}"] if monitor.levels in BINARY_LEVELS else []
    findings += files.sentences_on_others(files.others.keys())
    curve = _force_curve(readings.get(Stream.WRENCH.value, ()))
    frame = _mean_frame(_values(readings[Stream.SKIN.value]), opened.frame_shape)
    return RecordingPreview(importer, tuple(streams), tuple(findings), *curve, frame)


def _mean_frame(values: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Average (n, channels) readings to the picture of a frame; a channel without a reading is NaN."""
    if not values.size:
        return np.empty((0, 0))
    counts = np.isfinite(values).sum(axis=0)
    mean = np.where(np.isfinite(values), values, 0.0).sum(axis=0) / np.where(counts, counts, np.nan)
    return mean.reshape(shape if len(shape) == 2 and shape[0] * shape[1] == len(mean) else (1, -1))


def _values(batches: Sequence[Batch]) -> FloatArray:
    """Gather the rows (n, values) of a stream; joints are degrees."""
    rows = [np.degrees(each.values) if each.stream is Stream.JOINTS else each.values for each in batches]
    return np.concatenate(rows) if rows else np.empty((0, 0))


def _force_curve(batches: Sequence[Batch]) -> tuple[FloatArray, FloatArray]:
    """Compute times and largest forces of the bins, (n,) s and N."""
    if not batches:
        return np.empty(0), np.empty(0)
    force = _values(batches)[:, :3]
    seconds = np.concatenate([batch.device_s for batch in batches])
    size = np.linalg.norm(force - np.nanmedian(force, axis=0), axis=1)
    at = np.floor((seconds - seconds.min()) / FORCE_CURVE_BIN_S).astype(np.int64)
    # A clock that jumps would make a curve of years.
    inside = (at < PREVIEWED_TIME_S / FORCE_CURVE_BIN_S) & np.isfinite(size)
    largest = np.full(int(at[inside].max(initial=-1)) + 1, -np.inf)
    np.maximum.at(largest, at[inside], size[inside])
    largest[np.isinf(largest)] = np.nan
    return FORCE_CURVE_BIN_S * np.arange(len(largest), dtype=np.float64), largest
