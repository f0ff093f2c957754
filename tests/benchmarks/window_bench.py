"""Measure the window's live figures: `python -m tests.benchmarks.window_bench --seconds 30`.

Opens the real window on the present display (or under `xvfb-run -a -s "-screen 0 1600x1000x24"`) and lets the shipped simulated
rig poke. The window itself is unchanged. Measured are:

- the first paint and the first 3D picture, from the start of this program;
- 3D pictures a second while the tool presses;
- the time from the reading that ends a poke to the end of the paint that shows its outcome;
- the time from the reading that fills a poke's still window to the first sample of its sound at the sound device, or at the
  sound library's null device;
- stalls: the lateness of a 5 ms timer, and the processor time of the window's thread in it, which other programs do not change;
- the program's memory each ten seconds (Linux only), and the readings and losses of each link.

`--wrench`, `--skin` and `--joints` give addresses of real devices.
"""

# ruff: noqa: E402 - what the imports take is part of what is measured.

from __future__ import annotations

import time

START_TIME = time.monotonic()

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from PySide6.QtCore import QEvent, QObject, QSettings, QStandardPaths, QTimer
from PySide6.QtWidgets import QApplication, QStackedLayout, QWidget

from app.preflight import no_display, objection

if TYPE_CHECKING:
    from app.scene3d.view import View3D
    from app.sound.cues import Cue
    from app.sound.player import Output
    from app.state.view_state import ViewState
    from app.window import Window

Call: TypeAlias = Callable[..., Any]
WINDOW_SIZE_PX = (1280, 720)
TIMER_MS = 5
START_UP_S = 5.0
"""s. Earlier stalls belong to start-up."""
VISIBLE_STALL_S = 0.1
"""s. People see a longer stall."""
MEMORY_INTERVAL_MS = 10_000
MIN_PRESS_S = 0.3
"""s. Shorter presses are not used for the picture rate."""


class Measure(QObject):
    """Time measurements of one window."""

    def __init__(self, window: Window, sounds: Sounds) -> None:
        super().__init__()
        self.window = window
        self.first_paint: float | None = None
        self.first_picture: float | None = None
        self.pictures: list[float] = []
        self.presses: list[tuple[float, float]] = []
        self.latencies: list[float] = []
        self.stalls: list[tuple[float, float, float]] = []
        """Time, lateness and processor time of the window's thread, s."""
        self._canvas: QWidget | None = None
        self._pressing_since: float | None = None
        self._released: list[tuple[int, float]] = []
        """Number and end time of each poke that is not shown yet."""
        self.sounds = sounds
        self._last_timer, self._worked = time.monotonic(), time.thread_time()
        self._timer = QTimer(self)
        self._timer.setInterval(TIMER_MS)
        self._timer.timeout.connect(self._on_timer)
        self._timer.start()
        self.memory: list[tuple[float, float]] = []
        """Time, s, and memory, MB."""
        self._memory_timer = QTimer(self)
        self._memory_timer.timeout.connect(self._record_memory)
        self._memory_timer.start(MEMORY_INTERVAL_MS)
        window.installEventFilter(self)

    def watch(self) -> bool:
        """Start to measure the 3D view, then the session; return False if one of them does not exist yet."""
        workspace, session_view = self.window.workspace, self.window.session_view
        if workspace is not None and self._canvas is None and workspace.view.list_layers():
            self._watch_picture(workspace.view)
        if self._canvas is None or session_view is None or session_view.state is None:
            return False
        from skincal.session.pipeline import Pipeline

        wrap_method(Pipeline, "_commit", self._commit)
        self.sounds.watch()
        session_view.workspace.show_tab("Readings")
        return True

    def _watch_picture(self, view: View3D) -> None:
        stack = view.layout()
        canvas = stack.currentWidget() if isinstance(stack, QStackedLayout) else None
        assert canvas is not None
        self._canvas = canvas
        canvas.installEventFilter(self)
        view.update()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Let the widget paint, and note the time of its end."""
        if event.type() is not QEvent.Type.Paint:
            return False
        # Returning True tells Qt that the event is done.
        watched.event(event)
        if watched is self._canvas:
            self._painted()
        else:
            self.first_paint = time.monotonic() - START_TIME
            watched.removeEventFilter(self)
        return True

    def on_tick(self, tick: ViewState) -> None:
        """Note when the tool starts and stops pressing."""
        from skincal.contacts.outcome import PRESSING_PHASES

        now = time.monotonic()
        pressing = tick.live.progress.phase in PRESSING_PHASES
        if pressing and self._pressing_since is None:
            self._pressing_since = now
        elif not pressing and self._pressing_since is not None:
            self.presses.append((self._pressing_since, now))
            self._pressing_since = None

    def _commit(self, call: Call, pipeline: Any, item: Any, outcomes: Any) -> None:
        """Note the arrival of each reading that ends a poke."""
        last = pipeline.session.last_poke
        call(pipeline, item, outcomes)
        if pipeline.session.last_poke != last:
            self._released.append((pipeline.session.last_poke, item.host_ns * 1e-9))

    def _painted(self) -> None:
        now = time.monotonic()
        if not self.pictures:
            self.first_picture = now - START_TIME
        self.pictures.append(now)
        shown = self._shown_poke()
        self.latencies += [now - ended for poke, ended in self._released if poke <= shown]
        self._released[:] = [(poke, ended) for poke, ended in self._released if poke > shown]

    def _shown_poke(self) -> int:
        """Return the number of the newest poke in the painted state."""
        state = None if self.window.session_view is None else self.window.session_view.state
        return state.snapshot.pokes[-1].outcome.poke if state is not None and state.snapshot.pokes else 0

    def _on_timer(self) -> None:
        now, worked = time.monotonic(), time.thread_time()
        self.stalls.append((now - START_TIME, now - self._last_timer - TIMER_MS * 1e-3, worked - self._worked))
        self._last_timer, self._worked = now, worked

    def _record_memory(self) -> None:
        held = memory_mb()
        if held is not None:
            self.memory.append((time.monotonic() - START_TIME, held))

    def _links(self) -> dict[str, Any]:
        """Return readings and losses of each link."""
        view = self.window.session_view
        state = None if view is None else view.state
        links = () if state is None else state.live.links
        return {
            link.link: {
                "readings": link.readings,
                "lost": {loss.value: count for loss, count in link.losses.items() if count},
            }
            for link in links
        }

    def result(self) -> dict[str, Any]:
        """Return the figures, seconds and pictures per second."""
        self._timer.stop()
        long_enough = [(a, b) for a, b in self.presses if b - a >= MIN_PRESS_S]
        shown = sum(sum(a <= t <= b for t in self.pictures) for a, b in long_enough)
        pressed = sum(b - a for a, b in long_enough)
        early, later = ([s for s in self.stalls if (s[0] >= START_UP_S) is settled] for settled in (False, True))
        return {
            "first_paint_s": self.first_paint,
            "first_picture_s": self.first_picture,
            "pictures": len(self.pictures),
            "pictures_per_s_pressing": shown / pressed if pressed else None,
            "pressing_s": pressed,
            "releases": len(self.latencies),
            "release_to_painted_p50_s": percentile(self.latencies, 50),
            "release_to_painted_p95_s": percentile(self.latencies, 95),
            "sounds": len(self.sounds.latencies),
            "sound_device": self.sounds.device,
            "dwell_to_sound_p50_s": percentile(self.sounds.latencies, 50),
            "dwell_to_sound_p95_s": percentile(self.sounds.latencies, 95),
            "dwell_to_sound_max_s": max(self.sounds.latencies, default=None),
            "longest_stall_starting_s": max((late for _, late, _ in early), default=None),
            "longest_work_starting_s": max((work for _, _, work in early), default=None),
            "longest_stall_s": max((late for _, late, _ in later), default=None),
            "longest_work_s": max((work for _, _, work in later), default=None),
            "stalls_above_100_ms": sum(late > VISIBLE_STALL_S for _, late, _ in later),
            "memory_mb": self.memory,
            "links": self._links(),
            "load_average": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
            "cpu_share": time.process_time() / (time.monotonic() - START_TIME),
        }


class Sounds:
    """Times from the end of a poke's dwell to its sound."""

    def __init__(self) -> None:
        self.latencies: list[float] = []
        self.device: str | None = None
        self._since: float | None = None
        """Time of the reading that filled it, until the sound is requested."""
        self._asked: float | None = None
        """The same, until the sound begins."""

    def open(self) -> Output:
        """Open the sound device, or the library's null device."""
        from app.sound.player import NoSoundError, open_output

        try:
            output = open_output()
        except NoSoundError:
            output = open_output(real=False)
        self.device = getattr(output, "backend", "")
        return output

    def watch(self) -> None:
        """Measure calls of the press and the player."""
        from app.sound.player import Line, Player
        from skincal.contacts.press import Press

        wrap_method(Press, "add", self._add)
        wrap_method(Player, "play", self._play)
        wrap_method(Line, "next_samples", self._on_sound_read)

    def _add(self, call: Call, press: Any, *arguments: Any) -> None:
        before = press.may_release
        call(press, *arguments)
        if press.may_release and not before:
            self._since = arguments[0].host_s

    def _play(self, call: Call, player: Any, sound: Cue | None, word: str = "") -> None:
        if sound is not None and sound.name == "HELD":
            self._asked, self._since = self._since, None
        call(player, sound, word)

    def _on_sound_read(self, call: Call, line: Any, frames: int) -> bytes:
        begins = not line.taken
        part = call(line, frames)
        if begins and part and self._asked is not None:
            self.latencies.append(time.monotonic() - self._asked)
            self._asked = None
        return part


def wrap_method(kind: type[Any], name: str, see: Callable[..., Any]) -> None:
    """Replace a method by `see`, which receives the original method and its arguments."""
    call = getattr(kind, name)
    setattr(kind, name, lambda its, *arguments: see(call, its, *arguments))


def memory_mb() -> float | None:
    """Return the memory of this process; `None` except on Linux."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return None
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def percentile(values: list[float], share: float) -> float | None:
    """Return a percentile, one of the values; `None` for an empty list."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(len(ordered) * share / 100))] if ordered else None


def measure(seconds: float, scene: Path | None, addresses: Sequence[str] = ()) -> dict[str, Any]:
    """Run the window for `seconds` and return its figures."""
    from app.run import run_window
    from app.session.opening import Addresses, OpenRequest, find_scene, server_command
    from app.sound.player import Player
    from app.window import Window

    application = QApplication(sys.argv[:1])
    sounds, watching = Sounds(), QTimer(interval=10)
    results: dict[str, Any] = {}

    def attach() -> None:
        window = next(widget for widget in QApplication.topLevelWidgets() if isinstance(widget, Window))
        window.resize(*WINDOW_SIZE_PX)
        measured = Measure(window, sounds)
        window.controller.ticked.connect(measured.on_tick)
        watching.timeout.connect(lambda: measured.watch() and watching.stop())
        watching.start()
        QTimer.singleShot(round(seconds * 1e3), lambda: end(measured))

    def end(measured: Measure) -> None:
        results.update(measured.result())
        measured.window.leave()
        application.quit()

    QTimer.singleShot(0, attach)
    path = None if scene is None else find_scene(scene)
    named = Addresses(*addresses)
    run_window(OpenRequest(scene=path, addresses=named, server=() if named else server_command(path)), Player(sounds.open))
    return results


def table(result: dict[str, Any]) -> str:
    """Format the figures as lines, times in milliseconds."""

    def words(name: str, value: object) -> str:
        if isinstance(value, float):
            return f"{value * 1e3:.0f} ms" if name.endswith("_s") else f"{value:.2f}"
        return "-" if value is None else str(value)

    return "\n".join(f"{name.removesuffix('_s').replace('_', ' '):34} {words(name, value)}" for name, value in result.items())


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser("window_bench", description="Measure the window's live figures.")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--scene", type=Path, help="scene file, or the name of one that ships")
    for stream in ("wrench", "skin", "joints"):
        parser.add_argument(f"--{stream}", default="", help="address of the device")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    reason = no_display() or objection()
    if reason:
        sys.exit(f'{reason}\nOr: xvfb-run -a -s "-screen 0 1600x1000x24" python -m tests.benchmarks.window_bench')
    with tempfile.TemporaryDirectory() as folder:
        # Keeps the user's own settings and log unchanged.
        QStandardPaths.setTestModeEnabled(True)
        QSettings.setPath(QSettings.Format.NativeFormat, QSettings.Scope.UserScope, folder)
        result = measure(options.seconds, options.scene, (options.wrench, options.skin, options.joints))
    sys.stdout.write((json.dumps(result, indent=1) if options.json else table(result)) + "\n")


if __name__ == "__main__":
    main()
