"""Frames, links and pokes made by hand for the tests of the window."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from PySide6.QtCore import QEvent, QObject
from PySide6.QtGui import QColor, QFontMetrics, QGuiApplication, QImage
from PySide6.QtWidgets import QApplication, QWidget

from app.panels.widgets import FittedLabel
from app.state.policies import allowed
from app.state.running import Running
from app.state.view_state import ViewState
from app.theme import DARK, Colours
from app.window import qpalette
from skincal.contacts.outcome import Contact, PressPhase, Progress, Reason, Rejection
from skincal.following.background import Run, run_at_once
from skincal.following.guided_session import GuidedSession
from skincal.geometry import Arm, DhLink
from skincal.model.readings import LinkAnswer, LinkHealth, LinkState, LinkVerdict, Loss, Stream
from skincal.model.scene import ArmSpec, Scene
from skincal.part.part import Part
from skincal.session.snapshot import LiveView, PokeRecord, Snapshot
from skincal.session.undo import History
from skincal.taxels.result import Estimate, Method
from skincal.words.units import ChannelNames
from tests.app.scene3d_support import laid, layout, live, scene, snapshot

PLAN = layout()
NAMES = ChannelNames(PLAN)
SCENE: Scene = scene(PLAN)
SECOND = 1_000_000_000
METHODS = (Method.SURFACE, Method.FREE)


def arm_scene() -> Scene:
    """The small part behind one joint with two named poses."""
    arm = Arm((0,), (DhLink(0.0, 0.1, 0.0, 0.0),), np.eye(4))
    return replace(SCENE, arm=ArmSpec(arm, {"low": np.array([0.0]), "high": np.array([0.5])}))


def touch(
    poke: int, channels: Sequence[int] = (3,), responses: Sequence[float] = (50.0,), force: Sequence[float] = (0, 0, -11.2)
) -> Contact:
    """A poke from above that counts; its pitch is 2 mm."""
    pushed = np.array(force, dtype=float)
    moment = 0.002 * pushed
    k = np.array(channels, dtype=np.int64)
    return Contact(poke, 0.0, 0.3, pushed, moment, k, np.array(responses, float), np.eye(4), "low", 0.05, True)


def slip(poke: int, reason: Reason = Reason.SLID, value: float = 0.0021, limit: float = 0.0015, unit: str = "m") -> Rejection:
    """A poke that does not count."""
    return Rejection(poke, 0.0, 0.3, reason, value, limit, unit, np.array([3]), True)


def session(
    generation: int = 1,
    known: Mapping[int, Estimate] | None = None,
    pokes: Sequence[Contact | Rejection] = (),
    excluded: Sequence[int] = (),
    dead: Mapping[int, str] | None = None,
) -> Snapshot:
    """A session on the small part."""
    base = snapshot(generation, known or {})
    records = tuple(PokeRecord(poke, poke.poke in excluded) for poke in pokes)
    history = History(tuple(poke.poke for poke in pokes[-1:]))
    return replace(base, pokes=records, dead=dead or {}, history=history)


def reading(phase: PressPhase = PressPhase.READY, force: float = 0.0, still: float = 0.0, **changes: object) -> LiveView:
    """A live view in a phase."""
    progress = Progress(phase, np.array([0.0, 0.0, -force]), np.zeros(3), np.empty(0, np.int64), np.empty(0), still)
    return replace(live(), progress=progress, **changes)


def link(name: str = "wrench", state: LinkState = LinkState.OPEN, last_s: float = 100.0, **changes: object) -> LinkHealth:
    """A link whose last bytes came at `last_s`."""
    carries = (Stream(name),) if name in ("wrench", "skin", "joints") else (Stream.WRENCH,)
    base = LinkHealth(name, state, "", carries, "SKB/1", 5000, 1000.0, round(last_s * SECOND), {Loss.BAD_CHECKSUM: 3})
    return replace(base, **{"verdict": LinkVerdict(LinkAnswer.GOOD), **changes})


def frame(
    at: Snapshot | None = None,
    view: LiveView | None = None,
    now_s: float = 100.0,
    method: Method = Method.FREE,
    selected: int | None = None,
    running: Running = Running.STREAMING,
    where: Scene = SCENE,
) -> ViewState:
    """What the window shows of a moment."""
    found = at or session()
    return ViewState(
        snapshot=found,
        live=view or reading(),
        scene=where,
        names=NAMES,
        method=method,
        selected=selected,
        running=running,
        now_ns=round(now_s * SECOND),
        may=allowed(found, running, (), selected),
    )


def show_in(colours: Colours) -> None:
    """Give the program a theme's colours."""
    QApplication.setPalette(qpalette(colours))


def is_elided(label: FittedLabel) -> bool:
    """Return whether a text does not fit even in the smallest type."""
    return QFontMetrics(label.fitted()).horizontalAdvance(label.text()) > label.width()


def pixels(widget: QWidget) -> np.ndarray:
    """Return what a widget shows, (h, w, 4) uint8."""
    image = widget.grab().toImage().convertToFormat(QImage.Format.Format_RGBA8888)
    data = np.frombuffer(image.constBits(), dtype=np.uint8)
    return data.reshape(image.height(), image.bytesPerLine() // 4, 4)[:, : image.width()].copy()


def changed(before: np.ndarray, after: np.ndarray) -> int:
    """Return how many pixels differ."""
    return int((before != after).any(axis=2).sum())


def part(where: Scene = SCENE, **changes: object) -> Part:
    """The small part with its skin laid on it, without a mesh."""
    return replace(Part(where, None, laid(PLAN), PLAN.channels, ()), **changes)


class Queue:
    """A background whose work is done when the test says so."""

    def __init__(self) -> None:
        self.waiting = []

    def __call__(self, work, done, _failed=None, ended=lambda: None) -> None:
        self.waiting.append((work, done, ended))

    def finish(self) -> None:
        while self.waiting:
            run_at_once(*self.waiting[0][:2], ended=self.waiting.pop(0)[2])


def context(of: Part | None = None, methods: Sequence[Method] = METHODS, compute: Run | None = None) -> GuidedSession:
    """What panels are made from, without a window."""
    guided = GuidedSession(of or part(), compute or Queue())
    guided.methods = tuple(methods)
    return guided


def shown(qtbot, widget, size=(420, 300)):
    """A widget on the screen in the dark theme."""
    show_in(DARK)
    if hasattr(widget, "recolour"):
        widget.recolour()
    widget.resize(*size)
    qtbot.addWidget(widget)
    with qtbot.waitExposed(widget):
        widget.show()
    return widget


class Paints(QObject):
    """Counts the paint events of widgets and all in them."""

    def __init__(self, *widgets: QWidget) -> None:
        super().__init__()
        self.count = 0
        for widget in (each for top in widgets for each in (top, *top.findChildren(QWidget))):
            widget.installEventFilter(self)

    def eventFilter(self, _watched, event):
        self.count += event.type() == QEvent.Type.Paint
        return False


def paints_from_now(qtbot, *widgets: QWidget) -> Paints:
    """Count paints from the moment when nothing is left to paint: a busy machine shows a new window late."""
    paints = Paints(*widgets)

    def is_still() -> bool:
        before = paints.count
        for _ in range(5):
            QGuiApplication.sync()
            qtbot.wait(10)
        return paints.count == before

    qtbot.waitUntil(is_still, timeout=30_000)
    paints.count = 0
    return paints


def ink(picture: np.ndarray, colour: str | QColor, near: int = 8) -> int:
    """Count the pixels of a colour, or nearly."""
    wanted = np.array(QColor(colour).getRgb()[:3])
    return int((np.abs(picture[..., :3].astype(int) - wanted).max(axis=-1) < near).sum())


def luminance(colours: np.ndarray) -> np.ndarray:
    """Relative luminance by WCAG 2 of colours, (..., 3) 0 to 255."""
    share = np.asarray(colours) / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


def contrast(first: str | QColor | np.ndarray, second: str | QColor | np.ndarray) -> float:
    """Contrast of two colours by WCAG 2."""
    both = [each if isinstance(each, np.ndarray) else QColor(each).getRgb()[:3] for each in (first, second)]
    low, high = np.sort(luminance(np.array(both)))
    return float((high + 0.05) / (low + 0.05))
