"""The thread that reads a link: it stamps what it read, says what happened to the link, and does nothing else."""

from __future__ import annotations

import queue
import threading
import time

from skincal.model.readings import Chunk, LinkEvent, LinkState
from skincal.streams.links import FailureKind, Link, LinkFailure, LinkSpec, open_link

READ_S = 0.1
"""s. Longest wait in one read: how soon a stop is seen."""
RETRY_S = 0.1
"""s. Pause between attempts to open a link that is away."""
JOIN_S = 2.0
"""s. Longest wait for the thread at a stop: longer than a connection may take."""
NEW_REASON_S = 1.0
"""s. A new reason why a lost link does not open is reported when it has lasted so long: a port that comes back may deny
access until the system has set its owner."""

EXPECTED_WHILE_LOST = (FailureKind.ABSENT, FailureKind.REFUSED)
"""Reasons that say no more than that the link is still away."""


class Reader:
    """Reads one link into a queue, in one daemon thread, and takes a lost link up again by itself.

    Events: OPEN each time the link opens; FAILED when it cannot be opened at first, LOST when it vanished, each with a
    sentence, and again if the reason becomes another; ENDED at the end of a file. Attempts to open go on until `stop`,
    save after an end and for an address that cannot be right. Silence is no event.
    """

    def __init__(self, spec: LinkSpec, items: queue.SimpleQueue[Chunk | LinkEvent]) -> None:
        self._spec = spec
        self._items = items
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"reader {spec.name}", daemon=True)
        self._opened = False
        self._reported = ""
        """The sentence that was reported last."""
        self._reason, self._reason_since_s = "", 0.0
        """Another reason that is not reported yet, and since when it holds."""

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def halt(self) -> None:
        """Read no more after the read in progress; returns at once, and the thread closes the link."""
        self._stop.set()

    def stop(self) -> None:
        """Stop reading and close the link; waits for the thread, at most two seconds."""
        self.halt()
        if self._thread.ident is not None:
            self._thread.join(JOIN_S)

    @property
    def running(self) -> bool:
        """Whether the thread still reads or tries to."""
        return self._thread.is_alive()

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                final = self._try_once()
                if final:
                    return
                self._stop.wait(RETRY_S)
        except Exception as error:  # noqa: BLE001 - nothing above catches it: the operator must hear of it
            self._say(LinkState.FAILED, f"Reading stopped by a fault of the program: {error!r}.")

    def _try_once(self) -> bool:
        """Open the link and read it until it fails or is to stop; say whether to leave it at that."""
        try:
            link = open_link(self._spec)
        except LinkFailure as failure:
            self._could_not_open(failure)
            return failure.kind is FailureKind.ADDRESS
        self._opened = True
        self._say(LinkState.OPEN)
        try:
            self._read(link)
        except LinkFailure as failure:
            ended = failure.kind is FailureKind.ENDED
            self._say(LinkState.ENDED if ended else LinkState.LOST, str(failure))
            return ended
        finally:
            link.close()
        return True

    def _read(self, link: Link) -> None:
        while not self._stop.is_set():
            data = link.read(READ_S)
            if data:
                self._items.put(Chunk(self._spec.name, time.monotonic_ns(), data))

    def _could_not_open(self, failure: LinkFailure) -> None:
        """Report why the link does not open: at once the first time, later only what is new and lasts."""
        sentence = str(failure)
        if not self._reported:
            self._say(LinkState.FAILED, sentence)
            return
        expected = self._opened and failure.kind in EXPECTED_WHILE_LOST
        if expected or sentence == self._reported:
            self._reason = ""
            return
        now_s = time.monotonic()
        if sentence != self._reason:
            self._reason, self._reason_since_s = sentence, now_s
        elif now_s - self._reason_since_s >= NEW_REASON_S:
            self._say(LinkState.LOST if self._opened else LinkState.FAILED, sentence)

    def _say(self, state: LinkState, sentence: str = "") -> None:
        self._reported, self._reason = sentence, ""
        self._items.put(LinkEvent(self._spec.name, time.monotonic_ns(), state, sentence))
