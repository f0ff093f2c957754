"""Bodies of a tracker: the chosen one among those that it sends, for the decoders of trackers.

A tracker sends the poses of all its bodies. `?body=NAME` of the address chooses one. Without it the only body is taken.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, cast
from urllib.parse import quote

BODIES_LISTED_MAX = 8
"""Bodies that a sentence lists."""
BODY_NAME_MAX_CHARS = 60
"""Characters of a body's name in a sentence."""


class BodyChoice:
    """The body whose poses are read."""

    def __init__(self) -> None:
        self._wanted = ""
        self.problem = ""
        """Sentence on why no body could be chosen; empty after one was."""

    def read_options(self, data: bytes) -> bool:
        """Read what `write_options` wrote; return whether it can be read."""
        try:
            options: Any = json.loads(data)
            self._wanted = str(cast("dict[str, Any]", options)["body"])
        except (ValueError, KeyError, TypeError, RecursionError):
            return False
        return True

    def index_of(self, names: Sequence[str], numbers: Sequence[int] = ()) -> int | None:
        """Find the chosen body among those of the tracker; `None` if none or several fit.

        Parameters
        ----------
        names : of the bodies, in the order of the tracker; an empty one is not known
        numbers : of the bodies, if the tracker numbers them: a number in the address counts, too
        """
        found = [index for index, name in enumerate(names) if self._wanted in ("", name)]
        if not found and self._wanted.isdecimal():
            found = [index for index, number in enumerate(numbers) if number == int(self._wanted)]
        if len(found) == 1:
            self.problem = ""
            return found[0]
        labels = [name or f"{numbers[index]}" if numbers else name for index, name in enumerate(names)]
        self.problem = self._describe(labels, found)
        return None

    def label(self, names: Sequence[str], index: int) -> str:
        """Name a body in a sentence."""
        return shown_name(names[index] or self._wanted or "1")

    def _describe(self, labels: Sequence[str], found: Sequence[int]) -> str:
        listed = ", ".join(shown_name(label) for label in labels[:BODIES_LISTED_MAX])
        more = f" and {len(labels) - BODIES_LISTED_MAX} more" if len(labels) > BODIES_LISTED_MAX else ""
        if not labels:
            return "The tracker sends no body: define a rigid body in its program, and enable it"
        if not self._wanted:
            return f"The tracker sends several bodies ({listed}{more}): choose one by {_option(labels[0])}"
        if found:
            return f"{len(found)} bodies are called {shown_name(self._wanted)}: give each its own name in the tracker's program"
        known = f"it sends {listed}{more}: correct the address, such as {_option(labels[0])}"
        return f"The tracker has no body {shown_name(self._wanted)}; {known}"


def _option(name: str) -> str:
    """Write the option that chooses a body: an address has a plus or a space in another form."""
    return f"?body={quote(shown_name(name), safe='')}"


def shown_name(name: str) -> str:
    """Shorten a body's name for a sentence."""
    return name[:BODY_NAME_MAX_CHARS]


def write_options(body: str) -> bytes:
    """Write the choice of an address, for the bytes that a journal keeps."""
    return json.dumps({"body": body}).encode()
