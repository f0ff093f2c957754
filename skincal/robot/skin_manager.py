"""Positions to a running skinManager, by the questions that its RPC port takes, one taxel after another.

`get skin` lists its parts, `get pose PART` tells x y z nx ny nz and a confidence for each taxel, `set pose PART TAXEL` and six
numbers changes one, `set position PART TAXEL x y z CONFIDENCE` its confidence, too. A change is answered by 0, or by 1 and a
sentence; what is not understood by a sentence alone. Source: robotology/icub-main `skinManager.cpp`, `compensator.cpp`.
Versions differ in what a whole part's poses look like, not in these.

Only taxels with a position are sent, and of these only those that the robot has elsewhere: the others stay as they are.
The old positions are in a file before the first is sent, and are read again after the last.
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
from skincal.files.icub import POSITION_DECIMALS, SKIN_PARTS, has_comment, part_name, positions_text, read_icub, skin_part
from skincal.geometry import FloatArray
from skincal.model.errors import InputError, list_channels, plain_text, plural, shortened
from skincal.robot.yarp_rpc import YarpRpcClient, parse_rpc_address
from skincal.taxels.result import Method

Question: TypeAlias = "list[str | int | float]"
Ask: TypeAlias = Callable[[Sequence[str | int | float]], list[float | str]]

ANSWER_S = 2.0
"""s. skinManager answers between two of its cycles, of 20 to 50 ms; while it calibrates it may take a cycle more."""
SAME = 2.0 * 10.0**-POSITION_DECIMALS
"""m. Positions nearer than this are the same: a file has so many decimals."""
HAD = "positions that skinManager had before others were applied"
"""By this line a file says that its zeros are what the robot had; in every other zeros say that no position is known."""
UNCHANGED = "Nothing was changed."
FEW = 12
"""Values of an answer that are shown."""
ANSWER_SHOWN = 120
"""Characters of an answer in a sentence."""


@dataclass(frozen=True, slots=True, eq=False)
class Positions:
    """What a robot is to have of one skin part."""

    part: str
    width: int
    """Channels of the part."""
    rows: Mapping[int, FloatArray]
    """Of each channel that is sent (6,) float: metres, and a unit normal; zeros: no taxel."""

    @property
    def number(self) -> int:
        """By which the robot's programs know the part."""
        return SKIN_PARTS.index(self.part) + 1

    def question(self, channel: int) -> Question:
        """Return what sets one taxel."""
        # Adding zero makes 0 of -0. Whole numbers would be taken for a taxel's number, so all of them are floats.
        return [
            "set",
            "pose",
            self.number,
            channel,
            *(round(value, POSITION_DECIMALS) + 0.0 for value in self.rows[channel].tolist()),
        ]

    def trust(self, channel: int) -> Question:
        """Return what tells the robot whether there is a taxel, as it takes it from a file."""
        place = self.question(channel)[4:7]
        return ["set", "position", self.number, channel, *place, float(self.rows[channel][:3].any())]


def calibrated_positions(calibration: Calibration, method: Method, part: str | None) -> Positions:
    """Return the positions of a session by one method; `part` as for `skin_part`. Raises InputError."""
    taxels = placed_taxels(calibration.estimates_by(method))
    rows = np.hstack([taxels.positions, taxels.normals])
    return _positions(skin_part(calibration, part), calibration.scene.skin.channels, taxels.channels.tolist(), rows)


def file_positions(path: Path, part: str | None) -> Positions:
    """Return the positions of a file in the iCub's format; rows of zeros only of one that brings back what the robot had.

    Raises InputError.
    """
    rows = read_icub(path)
    sent = np.arange(len(rows)) if has_comment(path, HAD) else np.flatnonzero(rows[:, :3].any(axis=1))
    return _positions(part or part_name(path), len(rows), sent.tolist(), rows[sent])


def _positions(part: str, width: int, channels: Sequence[int], rows: FloatArray) -> Positions:
    if part not in SKIN_PARTS:
        raise InputError(f"the part is named {part!r}; expected --part with one of {', '.join(SKIN_PARTS)}.")
    if not len(channels):
        raise InputError("no taxel has a position yet; poke first, or choose another method.")
    return Positions(part, width, dict(zip(channels, rows, strict=True)))


def question_words(question: Sequence[str | int | float]) -> str:
    """Return a question as one would type it."""
    return " ".join(f"{word:.{POSITION_DECIMALS}f}" if isinstance(word, float) else str(word) for word in question)


def answer_words(answer: Sequence[float | str]) -> str:
    """Return what a robot answered, short, on one line."""
    if len(answer) > FEW:
        return plural(len(answer), "value")
    words = " ".join(word if isinstance(word, str) else f"{word:g}" for word in answer)
    return shortened(plain_text(words), ANSWER_SHOWN) or "nothing"


@dataclass(slots=True)
class Applied:
    """What became of it."""

    asked: list[tuple[str, str]] = field(default_factory=list[tuple[str, str]])
    """Every question with its answer, in words."""
    changed: int = 0
    same: int = 0
    """Taxels that the robot had there already."""
    before: Path | None = None
    """File with the positions that it had; None where nothing was to be changed."""


def applied_words(applied: Applied, part: str) -> str:
    """Return what became of it."""
    if applied.before is None:
        return f"skinManager has all {applied.same} positions of {part} already; nothing was changed"
    there = f", {applied.same} were there already" if applied.same else ""
    return f"{plural(applied.changed, 'taxel')} of {part} changed, and read again{there}"


def check_port(address: str) -> None:
    """Raise InputError where an address is of no port that could be asked; nothing is opened."""
    try:
        parse_rpc_address(address)
    except LinkError as failure:
        raise InputError(f"{failure} {UNCHANGED}") from failure


def apply_positions(
    address: str, positions: Positions, before: Path, timeout_s: float, heard: Callable[[str], object] | None = None
) -> Applied:
    """Bring positions to the skinManager at an address; see `Application`. Raises InputError."""
    try:
        port = YarpRpcClient(address, timeout_s)
    except LinkError as failure:
        raise InputError(f"{failure} {UNCHANGED}") from failure
    try:
        return Application(port.ask, positions, before, f"skincal apply {before} --to {address}", heard).run()
    finally:
        port.close()


class Application:
    """Brings positions to a robot.

    Parameters
    ----------
    ask : puts one question; raises LinkError
    before : file for the positions that the robot has now; an older one is kept beside it
    back : command that brings them again
    heard : is told every question with its answer, and the command before anything is changed
    """

    def __init__(
        self, ask: Ask, positions: Positions, before: Path, back: str, heard: Callable[[str], object] | None = None
    ) -> None:
        self._ask, self._positions, self._before, self._heard = ask, positions, before, heard
        self._command, self._back = back, f"{before.name} brings the old positions again"
        self.applied = Applied()

    def run(self) -> Applied:
        """Do all of it.

        Raises
        ------
        InputError
            The robot has no such part, refuses, answers otherwise or not at all; the sentence says how far it came.
        """
        positions, applied = self._positions, self.applied
        self._demand_part()
        had = self._poses(UNCHANGED)
        due = [channel for channel in positions.rows if self._differs(had[channel], channel)]
        applied.same = len(positions.rows) - len(due)
        if not due:
            return applied
        # Also where the same was begun before: what it left of the older positions is kept beside it.
        write_atomically(self._before, positions_text(positions.part, had[:, :6], HAD).encode())
        applied.before = self._before
        # Whole, and first: where it ends half way one has it to copy.
        self._tell(f"the old positions are in {self._before}: `{self._command}` brings them again")
        for channel in due:
            self._set(positions.question(channel), len(due))
            if had.shape[1] == 7 and self._doubted(had[channel], channel):
                self._set(positions.trust(channel), len(due))
            applied.changed += 1
        self._check(due)
        return applied

    def _put(self, question: Sequence[str | int | float]) -> list[float | str]:
        answer = self._ask(question)
        words = question_words(question), answer_words(answer)
        self.applied.asked.append(words)
        self._tell(": ".join(words))
        return answer

    def _tell(self, line: str) -> None:
        if self._heard is not None:
            self._heard(line)

    def _read(self, question: Question, so_far: str) -> list[float | str]:
        """Put a question that changes nothing; `so_far` is a sentence on what was changed before."""
        try:
            return self._put(question)
        except LinkError as failure:
            raise InputError(f"{failure} Asked was {question_words(question)!r}. {so_far}") from failure

    def _demand_part(self) -> None:
        known = self._read(["get", "skin"], UNCHANGED)
        names = [each for each in known if isinstance(each, str) and each in SKIN_PARTS]
        # Older versions do not know the question.
        if names and self._positions.part not in names:
            raise InputError(
                f"this skinManager has {', '.join(names)}, and not {self._positions.part}: ask the one that runs this part, "
                f"or give --part. {UNCHANGED}"
            )

    def _poses(self, so_far: str) -> FloatArray:
        """Return (width, 6) or, with confidences, (width, 7) float: what the robot has now."""
        answer, width = self._read(["get", "pose", self._positions.number], so_far), self._positions.width
        numbers = [each for each in answer if isinstance(each, float)]
        if len(numbers) != len(answer) or len(answer) not in (6 * width, 7 * width) or not np.isfinite(numbers).all():
            expected = f"expected the {7 * width} numbers of {width} taxels of {self._positions.part}"
            raise InputError(f"skinManager answers {answer_words(answer)!r} when asked for its poses; {expected}. {so_far}")
        return np.array(numbers).reshape(width, -1)

    def _differs(self, had: FloatArray, channel: int) -> bool:
        return float(np.abs(had[:6] - self._positions.rows[channel]).max()) > SAME or (
            len(had) == 7 and self._doubted(had, channel)
        )

    def _doubted(self, had: FloatArray, channel: int) -> bool:
        """Return whether the robot does not know that there is a taxel, or believes in one where there is none."""
        return bool(had[6] > 0) != bool(self._positions.rows[channel][:3].any())

    def _set(self, question: Question, due: int) -> None:
        words = question_words(question)
        try:
            answer = self._put(question)
        except LinkError as failure:
            raise InputError(f"{failure} {self._how_far(due, f'whether it did {words!r} is not known')}") from failure
        if answer[:1] not in ([0.0], ["ok"]):
            raise InputError(f"skinManager answers {answer_words(answer)!r} to {words!r}. {self._how_far(due, '')}")

    def _how_far(self, due: int, doubt: str) -> str:
        changed = self.applied.changed
        if not changed and not doubt:
            return UNCHANGED
        also = f", {doubt}" if doubt else ""
        return f"{changed} of {due} taxels were changed before{also}; {self._back}."

    def _check(self, due: Sequence[int]) -> None:
        """Ask for what the robot has now: it may say that it took what it did not."""
        rows = self._positions.rows
        has = self._poses(f"{plural(len(due), 'taxel')} were changed, and could not be read again; {self._back}.")
        wrong = [channel for channel in due if float(np.abs(has[channel][:6] - rows[channel]).max()) > SAME]
        if wrong:
            raise InputError(
                f"skinManager took every position, but has others at channels {list_channels(wrong)}; {self._back}."
            )
