"""Names of topics and channels as evidence for a proposal: measured values come first, commands never."""

from __future__ import annotations

import re

from skincal.model.readings import Stream

COMMAND_WORDS = frozenset(("command", "commanded", "cmd", "target", "desired", "setpoint", "goal", "reference", "planned"))
"""In names of values that the robot shall reach, and that nothing has measured."""
PROCESSED_WORDS = frozenset(
    ("filtered", "filter", "smoothed", "smooth", "lowpass", "averaged", "mean", "estimated", "predicted")
)
"""In names of values that are late or smoothed; the unprocessed ones are better, if both were recorded."""
_WORD_RE = re.compile(r"[A-Z]?[a-z]+|[A-Z]+")


def is_command(name: str) -> bool:
    """Return whether a name is that of a command, as `/joint_command`, `targetWrench` or `/arm/set_point`."""
    return not COMMAND_WORDS.isdisjoint(_words(name))


def name_rank(name: str, stream: Stream) -> int:
    """Rank a name for a stream, 0 for the best: the standard name of joints first, processed values last."""
    words = _words(name)
    is_usual = stream is not Stream.JOINTS or {"joint", "state"} <= words
    return int(not is_usual) + 2 * int(not PROCESSED_WORDS.isdisjoint(words))


def natural_order(name: str) -> list[tuple[int, str]]:
    """Key that sorts `t2` before `t10`."""
    return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"(\d+)", name)]


def _words(name: str) -> set[str]:
    """Words of a name in lower case and singular; `set_point` is one."""
    found = [each.lower() for each in _WORD_RE.findall(re.sub(r"(?i)set_point", "setpoint", name))]
    return {each.removesuffix("s") if len(each) > 3 else each for each in found} | set(found)
