"""Upload of taxel positions to a running skinManager through its RPC port, one taxel after another.

`get skin` lists its parts, `get pose PART` returns x y z nx ny nz and a confidence for each taxel, `set pose PART TAXEL` and
six numbers changes one, `set position PART TAXEL x y z CONFIDENCE` also its confidence. The answer to a change is 0, or 1 and
a sentence; an unknown command is answered by a sentence alone. Source: robotology/icub-main (skinManager, compensator).
Versions differ in the form of a whole part's poses, not in these commands.

Only taxels with a position are sent, and only if the robot has them elsewhere. The old positions are in a file before the first
change, and the new ones are read again after the last.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np

from skincal.devices.link import LinkError
from skincal.files.atomic import write_atomically
from skincal.files.calibration import Calibration, placed_taxels
from skincal.files.icub import POSITION_DECIMAL_PLACES, SKIN_PARTS, has_comment, part_name, positions_text, read_icub, skin_part
from skincal.geometry import FloatArray
from skincal.model.errors import InputError, list_channels, plain_text, plural, shortened
from skincal.robot.yarp_rpc import YarpRpcClient, parse_rpc_address
from skincal.taxels.result import Method

Command: TypeAlias = "list[str | int | float]"

WAIT_FOR_ANSWER_MAX_S = 2.0
"""s. skinManager answers between two of its cycles, of 20 to 50 ms; while it calibrates it may take a cycle more."""
SAME_POSITION_MAX_DISTANCE_M = 2.0 * 10.0**-POSITION_DECIMAL_PLACES
"""m. Positions nearer than this are the same: a file has so many decimals."""
BACKUP_MARKER = "positions that skinManager had before others were applied"
"""Comment of a backup file. Its zeros are the robot's own values; in other files zeros mean an unknown position."""
NOTHING_CHANGED = "Nothing was changed."
ANSWER_VALUES_SHOWN, ANSWER_CHARS_SHOWN = 12, 120


@dataclass(frozen=True, slots=True, eq=False)
class Positions:
    """Taxel positions of one skin part for a robot."""

    part: str
    width: int
    """Channels of the part."""
    rows: Mapping[int, FloatArray]
    """By channel: (6,) float, metres, and a unit normal; zeros: no taxel."""

    @property
    def number(self) -> int:
        """Number of the part in the robot's programs."""
        return SKIN_PARTS.index(self.part) + 1

    def set_pose_command(self, channel: int) -> Command:
        """Build the command that sets position and normal of a taxel."""
        # Adding zero makes 0 of -0. Whole numbers would be taken for a taxel's number, so all of them are floats.
        numbers = [round(value, POSITION_DECIMAL_PLACES) + 0.0 for value in self.rows[channel].tolist()]
        return ["set", "pose", self.number, channel, *numbers]

    def set_confidence_command(self, channel: int) -> Command:
        """Build the command that says whether there is a taxel: confidence 1 or 0."""
        position = self.set_pose_command(channel)[4:7]
        return ["set", "position", self.number, channel, *position, float(self.has_taxel(channel))]

    def has_taxel(self, channel: int) -> bool:
        """Check whether the channel has a position."""
        return bool(self.rows[channel][:3].any())


def calibrated_positions(calibration: Calibration, method: Method, part: str | None) -> Positions:
    """Take the positions of a session by one method; `part` as for `skin_part`. Raises InputError."""
    taxels = placed_taxels(calibration.estimates_by(method))
    rows = np.hstack([taxels.positions, taxels.normals])
    return _positions(skin_part(calibration, part), calibration.scene.skin.channels, taxels.channels.tolist(), rows)


def file_positions(path: Path, part: str | None) -> Positions:
    """Read a file in the iCub's format. Rows of zeros are sent only from a backup. Raises InputError."""
    rows = read_icub(path)
    sent = np.arange(len(rows)) if has_comment(path, BACKUP_MARKER) else np.flatnonzero(rows[:, :3].any(axis=1))
    return _positions(part or part_name(path), len(rows), sent.tolist(), rows[sent])


def _positions(part: str, width: int, channels: Sequence[int], rows: FloatArray) -> Positions:
    if part not in SKIN_PARTS:
        raise InputError(f"the part is named {part!r}; expected one of {', '.join(SKIN_PARTS)} (`skincal apply --part`).")
    if not len(channels):
        raise InputError("no taxel has a position yet; poke first, or choose another method.")
    return Positions(part, width, dict(zip(channels, rows, strict=True)))


def command_text(command: Sequence[str | int | float]) -> str:
    """Write a command as one would type it."""
    return " ".join(f"{word:.{POSITION_DECIMAL_PLACES}f}" if isinstance(word, float) else str(word) for word in command)


def answer_text(answer: Sequence[float | str]) -> str:
    """Write a robot's answer on one line, shortened."""
    if len(answer) > ANSWER_VALUES_SHOWN:
        return plural(len(answer), "value")
    words = " ".join(word if isinstance(word, str) else f"{word:g}" for word in answer)
    return shortened(plain_text(words), ANSWER_CHARS_SHOWN) or "nothing"


@dataclass(slots=True)
class UploadResult:
    """Result of an upload."""

    answers: list[tuple[str, str]] = field(default_factory=list[tuple[str, str]])
    """Every command with its answer."""
    changed: int = 0
    same: int = 0
    """Taxels whose position the robot had already."""
    backup: Path | None = None
    """File with the positions that the robot had; `None` if nothing had to change."""


def result_text(result: UploadResult, part: str) -> str:
    """Describe an upload's result in one sentence."""
    if result.backup is None:
        return f"skinManager has all {result.same} positions of {part} already; nothing was changed"
    there = f", {result.same} were there already" if result.same else ""
    return f"{plural(result.changed, 'taxel')} of {part} changed, and read again{there}"


def check_port(address: str) -> None:
    """Raise InputError if an address is not a YARP port. Nothing is opened."""
    try:
        parse_rpc_address(address)
    except LinkError as failure:
        raise InputError(f"{failure} {NOTHING_CHANGED}") from failure


def apply_positions(
    address: str, positions: Positions, backup: Path, timeout_s: float, on_line: Callable[[str], object] = lambda _: None
) -> UploadResult:
    """Upload positions to the skinManager at an address.

    Parameters
    ----------
    backup : file for the positions that the robot has now; an older file is kept next to it
    on_line : gets every command with its answer, and the command that restores the old positions before anything is changed

    Raises
    ------
    InputError
        The robot has no such part, refuses, or gives another answer or none. The sentence says how many taxels were changed.
    """
    try:
        port = YarpRpcClient(address, timeout_s)
    except LinkError as failure:
        raise InputError(f"{failure} {NOTHING_CHANGED}") from failure
    try:
        return _Upload(port, positions, backup, on_line).run(address)
    finally:
        port.close()


class _Upload:
    """An upload in progress."""

    def __init__(self, port: YarpRpcClient, positions: Positions, backup: Path, on_line: Callable[[str], object]) -> None:
        self._port, self._positions, self._backup, self._on_line = port, positions, backup, on_line
        self._restore = f"{backup.name} brings the old positions again"
        self._result = UploadResult()

    def run(self, address: str) -> UploadResult:
        positions, result = self._positions, self._result
        self._check_part()
        old = self._read_poses(NOTHING_CHANGED)
        due = [channel for channel in positions.rows if self._differs(old[channel], channel)]
        result.same = len(positions.rows) - len(due)
        if not due:
            return result
        # Also if the same upload was begun before: an older backup is kept next to this one.
        write_atomically(self._backup, positions_text(positions.part, old[:, :6], BACKUP_MARKER).encode())
        result.backup = self._backup
        # The whole command, and before any change: after an upload that ends half way it can be copied.
        command = f"skincal apply {self._backup} --to {address}"
        self._on_line(f"the old positions are in {self._backup}: `{command}` brings them again")
        for channel in due:
            self._set(positions.set_pose_command(channel), len(due))
            if old.shape[1] == 7 and self._has_wrong_confidence(old[channel], channel):
                self._set(positions.set_confidence_command(channel), len(due))
            result.changed += 1
        self._check_new(due)
        return result

    def _ask(self, command: Command) -> list[float | str]:
        answer = self._port.ask(command)
        texts = command_text(command), answer_text(answer)
        self._result.answers.append(texts)
        self._on_line(": ".join(texts))
        return answer

    def _read(self, command: Command, so_far: str) -> list[float | str]:
        """Send a command that changes nothing; `so_far` is a sentence on what was changed before."""
        try:
            return self._ask(command)
        except LinkError as failure:
            raise InputError(f"{failure} Asked was {command_text(command)!r}. {so_far}") from failure

    def _check_part(self) -> None:
        names = [each for each in self._read(["get", "skin"], NOTHING_CHANGED) if isinstance(each, str) and each in SKIN_PARTS]
        # Older versions do not know the command.
        if names and self._positions.part not in names:
            raise InputError(
                f"this skinManager has {', '.join(names)}, and not {self._positions.part}: ask the one that runs this part, "
                f"or name another part (`skincal apply --part`). {NOTHING_CHANGED}"
            )

    def _read_poses(self, so_far: str) -> FloatArray:
        """Read the robot's poses: (width, 6) or, with confidences, (width, 7) float."""
        answer, width = self._read(["get", "pose", self._positions.number], so_far), self._positions.width
        numbers = [each for each in answer if isinstance(each, float)]
        if len(numbers) != len(answer) or len(answer) not in (6 * width, 7 * width) or not np.isfinite(numbers).all():
            expected = f"expected the {7 * width} numbers of {width} taxels of {self._positions.part}"
            raise InputError(f"skinManager answers {answer_text(answer)!r} to the request for its poses; {expected}. {so_far}")
        return np.array(numbers).reshape(width, -1)

    def _differs(self, old: FloatArray, channel: int) -> bool:
        distance = float(np.abs(old[:6] - self._positions.rows[channel]).max())
        return distance > SAME_POSITION_MAX_DISTANCE_M or (len(old) == 7 and self._has_wrong_confidence(old, channel))

    def _has_wrong_confidence(self, old: FloatArray, channel: int) -> bool:
        return bool(old[6] > 0) != self._positions.has_taxel(channel)

    def _set(self, command: Command, due: int) -> None:
        text = command_text(command)
        try:
            answer = self._ask(command)
        except LinkError as failure:
            raise InputError(f"{failure} {self._how_far(due, f', whether it did {text!r} is not known')}") from failure
        if answer[:1] not in ([0.0], ["ok"]):
            raise InputError(f"skinManager answers {answer_text(answer)!r} to {text!r}. {self._how_far(due)}")

    def _how_far(self, due: int, doubt: str = "") -> str:
        changed = self._result.changed
        return (
            f"{changed} of {due} taxels were changed before{doubt}; {self._restore}." if changed or doubt else NOTHING_CHANGED
        )

    def _check_new(self, due: Sequence[int]) -> None:
        """Read the poses again: the robot may have confirmed what it did not do."""
        new = self._read_poses(f"{plural(len(due), 'taxel')} were changed, and could not be read again; {self._restore}.")
        rows = self._positions.rows
        wrong = [
            channel for channel in due if float(np.abs(new[channel][:6] - rows[channel]).max()) > SAME_POSITION_MAX_DISTANCE_M
        ]
        if wrong:
            raise InputError(
                f"skinManager took every position, but has others at channels {list_channels(wrong)}; {self._restore}."
            )
