"""A process that reviews a session: `python -m skincal.session.review_process`.

Messages are pickles with their length before them, 8 bytes, little endian: in come `Part`, once, then each `Change`; out goes
a `Review` for the newest change, or a sentence where it cannot be made. Newer changes end the work on older ones. It ends
where its input does. Both ends are the same program on the same machine, as pickles demand.
"""

from __future__ import annotations

import os
import pickle
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BufferedIOBase, BufferedReader, FileIO
from typing import Any

from skincal.mesh.load import load_surface
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.scene import Scene
from skincal.session.review import Reviewer

LENGTH = 8
"""Bytes of a message's length."""
NICE = 5
AT_ONCE = 1 << 16
"""Bytes read at once."""
PATIENCE_S = 5.0
"""s. Work on an older change goes on after that: on a large part each poke would else end the work on the one before."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """What the session is of; the mesh is read again, which is quicker than to send it."""

    scene: Scene
    mesh_sha256: str | None


class _SupersededError(Exception):
    """A newer change waits."""


def packed(message: object) -> bytes:
    """Return a message with its length before it."""
    body = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
    return len(body).to_bytes(LENGTH, "little") + body


class Unpacker:
    """Bytes in, messages out; how the bytes were cut does not matter."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> Iterator[Any]:
        """Take bytes; give the messages that are whole."""
        self._bytes += data
        while len(self._bytes) >= LENGTH:
            end = LENGTH + int.from_bytes(self._bytes[:LENGTH], "little")
            if len(self._bytes) < end:
                return
            body = bytes(self._bytes[LENGTH:end])
            del self._bytes[:end]
            yield pickle.loads(body)


def load_part(part: Part) -> Surface | None:
    """Load the mesh of a session.

    Raises
    ------
    InputError
        It is gone, or another than the session's.
    """
    if part.scene.surface is None:
        return None
    surface, _ = load_surface(part.scene.surface)
    if surface.sha256 != part.mesh_sha256:
        raise InputError(f"{part.scene.surface.path}: the mesh changed since the session was opened; open it again.")
    return surface


def serve(source: BufferedIOBase, answer: Callable[[object], None]) -> None:
    """Review changes until the source ends."""
    inbox: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(source, inbox), daemon=True).start()
    part = inbox.get()
    if part is None:
        return
    try:
        reviewer = Reviewer(part.scene, load_part(part))
    except InputError as error:
        answer(str(error))
        return
    while (change := inbox.get()) is not None:
        reviewer.take(change)
        if inbox.empty():
            _review(reviewer, inbox, answer)


def _review(reviewer: Reviewer, inbox: queue.SimpleQueue[Any], answer: Callable[[object], None]) -> None:
    begun = time.monotonic()

    def between() -> None:
        if not inbox.empty() and time.monotonic() - begun < PATIENCE_S:
            raise _SupersededError

    try:
        answer(reviewer.review(between))
    except _SupersededError:
        return


def _read(source: BufferedIOBase, inbox: queue.SimpleQueue[Any]) -> None:
    """Queue the messages of a source, and None at its end."""
    unpacker = Unpacker()
    while data := source.read1(AT_ONCE):
        for message in unpacker.feed(data):
            inbox.put(message)
    inbox.put(None)


def main() -> None:
    """Serve standard input and output, behind the window that waits for a hand."""
    if hasattr(os, "nice"):
        os.nice(NICE)
    out = sys.stdout.buffer

    def answer(message: object) -> None:
        out.write(packed(message))
        out.flush()

    serve(BufferedReader(FileIO(sys.stdin.fileno(), closefd=False)), answer)


if __name__ == "__main__":
    main()
