"""What a recording of another program is taken for, and a look at it before anything is made of it."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skincal.devices.decoding import WRENCH_WIDTH
from skincal.files.importers.csv_log import guess_csv, open_csv
from skincal.files.importers.recorded_lines import START_NS, OpenRecording
from skincal.files.importers.yarp_folder import DATA, guess_yarp, open_yarp
from skincal.geometry import FloatArray
from skincal.model.errors import InputError, plural
from skincal.model.readings import Batch, Stream
from skincal.streams.decoders.auto_detect import LinkDecoder

if TYPE_CHECKING:
    from skincal.model.scene import Scene

TABLE_SUFFIXES = (".csv", ".tsv", ".txt")
"""Endings of what is read as a table; all else is a log of `yarpdatadumper`, or none."""
LOOK_S = 60.0
"""s. Length of a recording that is decoded for its preview: several pokes, in a second or two."""
BIN_S = 0.1
"""s. The curve of the force has its largest of each: a poke is longer."""
JOINTS_MOST = 16
"""Values of a row that nothing else is known of: arms have fewer joints, skins more taxels."""
MAX_FILES_TRIED = 2000
"""Files of a folder whose stream is guessed: each costs about a millisecond."""
SHOWN_VALUES = 6
"""Values of the first row that are shown."""
_NAMES = (
    (Stream.SKIN, re.compile(r"skin|tactile|taxel|touch")),
    (Stream.JOINTS, re.compile(r"joint|state|encoder|angle")),
    (Stream.WRENCH, re.compile(r"(?<![a-z])ft(?![a-z])|f_t|wrench|force|torque|measures")),
)
"""What the names of ports, folders and files say. The first that fits: a forearm's skin has both names."""


class RecordingKind(Enum):
    """What a recording is taken for; the value is the name of the command's import."""

    YARP = "yarp"
    CSV = "csv"


@dataclass(frozen=True, slots=True)
class RecordingFiles:
    """File or folder of each stream; `None` while it is unknown."""

    wrench: Path | None = None
    skin: Path | None = None
    joints: Path | None = None

    @property
    def kind(self) -> RecordingKind:
        """What they are taken for.

        Raises InputError: sensor or skin are missing, or they are of two kinds.
        """
        if self.wrench is None or self.skin is None:
            missing = "the force/torque sensor" if self.wrench is None else "the skin"
            raise InputError(f"No recording of {missing} is named; name the file or folder that holds it.")
        places = [place for place in (self.wrench, self.skin, self.joints) if place is not None]
        kinds = {RecordingKind.CSV if is_table(place) else RecordingKind.YARP for place in places}
        if len(kinds) > 1:
            raise InputError("The files are tables and logs of yarpdatadumper; expected one kind of recording.")
        return kinds.pop()

    def open(self) -> OpenRecording:
        """Read the recording through.

        Raises InputError: as for `kind`, `open_csv` and `open_yarp`.
        """
        opening = open_csv if self.kind is RecordingKind.CSV else open_yarp
        assert self.wrench is not None
        assert self.skin is not None
        return opening(self.wrench, self.skin, self.joints)


def is_table(path: Path) -> bool:
    """Return whether a path is taken for a table, by its name."""
    return path.suffix.lower() in TABLE_SUFFIXES


def guess_streams(paths: Sequence[Path]) -> RecordingFiles:
    """Assign files, or those of a folder, to streams by their names and first lines.

    Raises InputError: none of them is a recording.
    """
    places = _places(paths)
    guesses = {place: guess for place in places[:MAX_FILES_TRIED] if (guess := _guess(place)) is not None}
    if len(places) > MAX_FILES_TRIED:
        raise InputError(
            f"{paths[0]}: holds {len(places)} recordings; expected at most {MAX_FILES_TRIED}: name the files instead."
        )
    if not guesses:
        names = ", ".join(str(path) for path in paths)
        raise InputError(
            f"{names}: no recording was found; expected folders of yarpdatadumper, or CSV files, of sensor and skin."
        )
    widest = sorted(guesses, key=lambda place: (-guesses[place][1], place))
    found: dict[Stream, Path] = {}
    for place in widest:
        found.setdefault(guesses[place][0], place)
    return RecordingFiles(found.get(Stream.WRENCH), found.get(Stream.SKIN), found.get(Stream.JOINTS))


def _places(paths: Sequence[Path]) -> list[Path]:
    if len(paths) != 1 or not paths[0].is_dir():
        return [path for path in paths if path.exists()]
    folder = paths[0]
    # A port has a folder; the recording of a port alone lies beside those of the others.
    for place, patterns in ((folder, (f"*/{DATA}", f"*/*/{DATA}")), (folder.parent, (f"*/{DATA}",))):
        logs = sorted({log.parent for pattern in patterns for log in place.glob(pattern)})
        if logs and (place is folder or (folder / DATA).is_file()):
            return logs
    return sorted(path for path in folder.iterdir() if is_table(path) and path.is_file())


def _guess(place: Path) -> tuple[Stream, int] | None:
    """Guess the stream of a file or folder and count the values of a row; `None` if it is no recording."""
    try:
        said, width = (guess_csv if is_table(place) else guess_yarp)(place)
    except InputError:
        return None
    named = next((stream for stream, words in _NAMES if words.search(_name(place))), None)
    # Six values are a wrench unless something else is said; a name says more than a number.
    by_width = Stream.WRENCH if width == WRENCH_WIDTH else Stream.JOINTS if width <= JOINTS_MOST else Stream.SKIN
    return said if said in (Stream.WRENCH, Stream.JOINTS) else named or said or by_width, width


def _name(place: Path) -> str:
    return (place.parent.name if place.name == DATA else place.name).lower()


@dataclass(frozen=True, slots=True)
class StreamPreview:
    """One stream of a recording."""

    stream: Stream
    path: str
    rows: int
    rate: float
    """Rows a second; 0 where it is not known."""
    seconds: float
    """From the first row to the last."""
    width: int
    """Values of a row; 0 where none could be read."""
    first: tuple[float, ...]
    """The first of them in the first row; joints are degrees."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordingPreview:
    """What a recording holds."""

    kind: RecordingKind
    streams: tuple[StreamPreview, ...]
    findings: tuple[str, ...]
    """Sentences on times and losses."""
    times: FloatArray
    """(n,) float, s from its beginning, of its first `LOOK_S`, every `BIN_S`..."""
    force: FloatArray
    """(n,) float, N: largest deviation of the force from its median in each bin; NaN without a reading."""

    def misfits(self, scene: Scene, pose: str) -> tuple[str, ...]:
        """Return why a session cannot be made of it for a scene, in sentences.

        Parameters
        ----------
        pose : name of the arm pose that was chosen; empty where none was
        """
        widths = {stream.stream: stream.width for stream in self.streams}
        skin, joints = widths[Stream.SKIN], widths.get(Stream.JOINTS)
        found: list[str] = []
        if skin != scene.skin.channels:
            found.append(
                f"A row of the skin has {plural(skin, 'value')}, and the scene {scene.name} has "
                f"{plural(scene.skin.channels, 'channel')}; choose the scene that it was recorded on."
            )
        if widths[Stream.WRENCH] != WRENCH_WIDTH:
            found.append("No row of the force/torque recording has fx fy fz mx my mz; choose another file.")
        if scene.arm is not None and joints is None and pose not in scene.arm.poses:
            found.append("The scene has an arm; name the recording of its joints, or choose the arm pose.")
        if scene.arm is not None and joints is not None and joints <= max(scene.arm.arm.joints):
            number = plural(max(scene.arm.arm.joints) + 1, "joint")
            found.append(f"A row of the joints has {plural(joints, 'value')}; the scene's arm needs {number} or more.")
        return tuple(found)


def preview_recording(files: RecordingFiles, wanted: Callable[[], bool] = lambda: True) -> RecordingPreview:
    """Look at a recording: all its times, and the readings of its first `LOOK_S`; nothing is written.

    Parameters
    ----------
    wanted : whether to go on

    Raises InputError: it cannot be read as a recording.
    """
    kind, opened = files.kind, files.open()
    decoders = {link.name: LinkDecoder(link.format, None, link.carries) for link in opened.links}
    readings: dict[str, list[Batch]] = defaultdict(list)
    for chunk in opened.chunks():
        if chunk.host_ns > START_NS + LOOK_S * 1e9 or not wanted():
            break
        readings[chunk.link] += [batch for _, batch in decoders[chunk.link].feed(chunk.data, chunk.host_ns)]
    streams: list[StreamPreview] = []
    for link, timeline in zip(opened.links, opened.timelines, strict=True):
        values = _values(readings[link.name])
        rate = 1.0 / timeline.interval if timeline.interval else 0.0
        first = tuple(values[0, :SHOWN_VALUES].tolist()) if len(values) else ()
        seconds = timeline.last - timeline.first
        path = link.address.removeprefix("file:")
        streams.append(StreamPreview(link.carries[0], path, timeline.lines, rate, seconds, values.shape[1], first))
    lost = [
        f"{name}: {count} of the first {LOOK_S:.0f} s: {loss.value}."
        for name, decoder in decoders.items()
        for loss, count in decoder.current.counts.items()
    ]
    # The first sentence on each file says what stands in `streams`.
    known = {timeline.sentences()[0] for timeline in opened.timelines}
    findings = [finding for finding in opened.findings if finding not in known] + lost
    return RecordingPreview(kind, tuple(streams), tuple(findings), *_force_curve(readings[Stream.WRENCH.value]))


def _values(batches: Iterable[Batch]) -> FloatArray:
    """Return the rows (n, values) of a stream, in display units of a log: joints are degrees."""
    rows = [np.degrees(each.values) if each.stream is Stream.JOINTS else each.values for each in batches]
    return np.concatenate(rows) if rows else np.empty((0, 0))


def _force_curve(batches: Sequence[Batch]) -> tuple[FloatArray, FloatArray]:
    """Return times and largest forces of the bins, (n,) s and N."""
    if not batches:
        return np.empty(0), np.empty(0)
    force = _values(batches)[:, :3]
    seconds = np.concatenate([batch.device_s for batch in batches])
    size = np.linalg.norm(force - np.nanmedian(force, axis=0), axis=1)
    at = np.floor((seconds - seconds.min()) / BIN_S).astype(np.int64)
    # A clock that leaps would make a curve of years.
    inside = (at < LOOK_S / BIN_S) & np.isfinite(size)
    largest = np.full(int(at[inside].max(initial=-1)) + 1, -np.inf)
    np.maximum.at(largest, at[inside], size[inside])
    largest[np.isinf(largest)] = np.nan
    return BIN_S * np.arange(len(largest), dtype=np.float64), largest
