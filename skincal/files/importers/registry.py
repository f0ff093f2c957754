"""Registry of importers, which read recordings of other programs.

It imports nothing heavy, since the commands' help must answer at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skincal.model.errors import InputError
from skincal.model.readings import Stream

if TYPE_CHECKING:
    from skincal.files.importers.timeline import OpenRecording


@dataclass(frozen=True, slots=True, order=True)
class RecordedPlace:
    """File or folder that holds a recorded stream."""

    path: Path
    topic: str = ""
    """Name of the stream in a file that holds several; empty if it holds one."""

    def __str__(self) -> str:
        """Return the path, and after `::` the topic."""
        return f"{self.path}::{self.topic}" if self.topic else str(self.path)

    @classmethod
    def parse(cls, text: str) -> RecordedPlace:
        """Read what `str` returns."""
        path, _, topic = text.partition("::")
        return cls(Path(path), topic)


RANK_OF_GUESS_BY_CHANNELS = 3
"""Rank of a guess that counts only if the skin has as many channels."""


@dataclass(frozen=True, slots=True)
class StreamGuess:
    """A place in a recording and its likely stream."""

    place: RecordedPlace
    stream: Stream | None
    """`None` if its content does not tell."""
    width: int
    """Values of a row."""
    joints: tuple[str, ...] = ()
    """Names of its joints, if it has some."""
    rank: int = 0
    """0 for a likely stream; a constant or slow one, or a guess that needs the number of channels, has a larger one."""


class StoppedError(InputError):
    """The operator stopped the import."""

    def __init__(self, sentence: str = "The import was stopped; nothing was left behind.") -> None:
        super().__init__(sentence)


@dataclass(frozen=True, slots=True)
class Importer:
    """Reader of the recordings of one program.

    Its module has `guess_streams(path)`, which returns a `StreamGuess` for each stream in a file or folder, and
    `open_recording(places)`, which returns an `OpenRecording` of the places by stream. Both raise InputError if a path is no
    such recording. The streams of one recording may be in several files, or in one file by topic. In the latter case
    `open_recording` also gets `joints` and `go_on` of the method here; with `knows_channels` it gets `channels`.
    """

    name: str
    """In the command `import NAME`."""
    title: str
    """For the operator."""
    suffixes: tuple[str, ...]
    """Of its files."""
    module: str
    options: Mapping[Stream, str]
    """Help of the command's option for each stream."""
    marker: str = ""
    """Name of the file that makes a folder a stream of its recordings; empty if it reads files alone."""
    folder_patterns: tuple[str, ...] = ()
    """Patterns of the files that make a folder a whole recording with several streams."""
    example: str = ""
    """Arguments of the command in its help, if a file holds several streams."""
    reading_share: float = 0.0
    """Share of the time of an import in which `open_recording` reads, before the session begins."""
    one_stream: bool = True
    """Whether a file or folder holds one stream, so that those beside it belong to the same recording."""
    knows_channels: bool = False
    """Whether the number of channels decides which columns of a file are the skin."""
    claims_suffixes: tuple[str, ...] = ()
    """Of other importers' files that are its own by their content, as `claims(path)` of its module says."""
    asks_if_tied: bool = False
    """Whether the operator chooses between two places that are as likely."""

    @property
    def guess_streams(self) -> Callable[[Path], Sequence[StreamGuess]]:
        """Function of the module."""
        return self._function("guess_streams")

    @property
    def claims(self) -> Callable[[Path], bool]:
        """Function of the module."""
        return self._function("claims")

    def open_recording(
        self,
        places: Mapping[Stream, RecordedPlace],
        joints: Sequence[str] = (),
        go_on: Callable[[float], bool] = lambda _: True,
        channels: int = 0,
    ) -> OpenRecording:
        """Read the places of one recording through.

        Parameters
        ----------
        joints : names of the joint stream's columns, empty for an unused column; only topics name their joints
        go_on : gets the finished share, 0 to 1, and says whether to continue; single streams are read at once
        channels : of the skin; 0 if unknown

        Raises
        ------
        InputError
            A place cannot be read, or the streams do not fit together.
        StoppedError
            `go_on` said no.
        """
        read = self._function("open_recording")
        if self.knows_channels and self.one_stream:
            return read(places, channels)
        if self.knows_channels:
            return read(places, joints, go_on, channels)
        return read(places) if self.one_stream else read(places, joints, go_on)

    def _function(self, name: str) -> Any:
        return getattr(import_module(f"skincal.files.importers.{self.module}"), name)


RECORDING_IMPORTERS = (
    Importer(
        "csv",
        "CSV tables",
        (".csv", ".tsv", ".txt", ".lvm", ".xlsx", ".xlsm", ".xls"),
        "csv_log",
        {
            Stream.WRENCH: "CSV file: time and fx fy fz mx my mz. FILE::NAME takes the columns whose names begin so.",
            Stream.SKIN: "CSV file: time and one column a channel.",
            Stream.JOINTS: "CSV file: time and one column a joint.",
            Stream.TOOL: "CSV file: time and a pose of the tool a row, in the form of [tool]; needs a scene with [tool].",
        },
        knows_channels=True,
    ),
    Importer(
        "rosbag",
        "Bags of ROS",
        (".bag", ".active", ".mcap", ".db3", ".zstd", ".zst"),
        "rosbag",
        {
            Stream.WRENCH: "Topic of the force/torque sensor. Default: a likely one.",
            Stream.SKIN: "Topic of the skin, or A+B for patches in this order; TOPIC?field=PATH, TOPIC?msg=FILE.",
            Stream.JOINTS: "Topic of the joint states. Default: a likely one; none with --pose.",
            Stream.TOOL: "Topic of the tool's poses, or /tf?frame=tool0&base=base. Default: one that moves, with [tool].",
        },
        folder_patterns=("metadata.yaml", "*.mcap", "*.db3", "*.zstd", "*.zst"),
        example="monday_bag --wrench /ft/wrench --skin /skin/taxels",
        reading_share=0.7,
        one_stream=False,
    ),
    Importer(
        "robometry",
        "Logs of robometry",
        (".mat",),
        "robometry",
        {
            Stream.WRENCH: "Channel of the force/torque sensor, such as FTs::l_arm_ft_sensor. Default: a likely one.",
            Stream.SKIN: "Channel of the skin. Default: a likely one.",
            Stream.JOINTS: "Channel of the joint angles. Default: joints_state::positions; none with --pose.",
            Stream.TOOL: "Channel of the tool's poses, in the form of [tool]. Default: a likely one, with [tool].",
        },
        example="robot_logger_device.mat --wrench FTs::l_arm_ft_sensor --skin skins::l_forearm",
        one_stream=False,
    ),
    Importer(
        "arrays",
        "Named arrays",
        (".npz", ".npy", ".h5", ".hdf5", ".mat", ".parquet", ".asf", ".pkl", ".pickle"),
        "arrays",
        {
            Stream.WRENCH: "Array of the force/torque sensor: NAME, NAME[0:6], FORCE+TORQUE, NAME:N,Nmm, or FILE::NAME.",
            Stream.SKIN: "Array of the skin: NAME, NAME[6:22], A+B for patches; NAME?order=columns counts down the columns.",
            Stream.JOINTS: "Array of the joint angles: NAME:rad or NAME:deg. Default: a likely one; none with --pose.",
            Stream.TOOL: "Array of the tool's poses, in the form of [tool]: (n, 7), (n, 4, 4), ... Default: a likely one.",
        },
        folder_patterns=("meta/info.json", "*.npy"),
        example="log.h5 --wrench ft/wrench --skin tactile --time t",
        one_stream=False,
        knows_channels=True,
        claims_suffixes=(".mat", ".txt", ".csv", ".tsv", ".asc"),
        asks_if_tied=True,
    ),
    Importer(
        "yarp",
        "Logs of yarpdatadumper",
        (".log",),
        "yarp_folder",
        {
            Stream.WRENCH: "yarpdatadumper folder of the force/torque port.",
            Stream.SKIN: "yarpdatadumper folder of the skin port.",
            Stream.JOINTS: "yarpdatadumper folder of the arm's state port.",
            Stream.TOOL: "yarpdatadumper folder of the port with the tool's poses, in the form of [tool].",
        },
        marker="data.log",
    ),
)


def importer_of(path: Path) -> Importer:
    """Choose the importer of a file or folder by its name, or by the files in it; `yarp` if nothing tells."""
    suffix = path.suffix.lower()
    claiming = [each for each in RECORDING_IMPORTERS if suffix in each.claims_suffixes and path.is_file()]
    if claimed := next((each for each in claiming if each.claims(path)), None):
        return claimed
    named = (each for each in RECORDING_IMPORTERS if suffix in each.suffixes)
    marked = (each for each in RECORDING_IMPORTERS if each.marker and (path / each.marker).is_file())
    whole = (each for each in RECORDING_IMPORTERS if _is_whole_recording(path, each))
    return next(named, None) or next(marked, None) or next(whole, RECORDING_IMPORTERS[-1])


def _is_whole_recording(folder: Path, importer: Importer) -> bool:
    # A session of this program has MCAP files, too, and a folder with its scene.
    return not (folder / "scene").is_dir() and any(next(folder.glob(pattern), None) for pattern in importer.folder_patterns)


def find_recordings(folder: Path) -> list[Path]:
    """List the recordings in a folder, no deeper than two folders, since it may be a whole disk: folders first, else files."""
    if any(_is_whole_recording(folder, each) for each in RECORDING_IMPORTERS):
        return [folder]
    for each in (each for each in RECORDING_IMPORTERS if each.marker):
        # Recordings of single streams are in one folder.
        inside = (folder / each.marker).is_file()
        start, patterns = (folder.parent, ("*/",)) if inside else (folder, ("*/", "*/*/"))
        if found := sorted({path.parent for pattern in patterns for path in start.glob(pattern + each.marker)}):
            return found
    inner = (path for path in folder.iterdir() if path.is_dir())
    if found := sorted(path for path in inner if any(_is_whole_recording(path, each) for each in RECORDING_IMPORTERS)):
        return found
    single = [each for each in RECORDING_IMPORTERS if not each.marker]
    suffixes = {suffix for each in single for suffix in each.suffixes if f"*{suffix}" not in each.folder_patterns}
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in suffixes and path.is_file())


def is_recording(path: Path) -> bool:
    """Return whether a path is named like a recording, or is a folder with some."""
    if path.is_dir():
        return bool(find_recordings(path))
    return path.is_file() and any(path.suffix.lower() in each.suffixes for each in RECORDING_IMPORTERS)
