"""Frames, links and pokes made by hand for the tests of the window."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from PySide6.QtGui import QFontMetrics, QImage
from PySide6.QtWidgets import QApplication, QWidget

from app.panels.widgets import FittedLabel
from app.state.policies import allowed
from app.state.running import Running
from app.state.view_state import ViewState
from app.theme import Colours
from app.window import qpalette
from skincal.contacts.outcome import Contact, PressPhase, Progress, Reason, Rejection
from skincal.geometry import Arm, DhLink
from skincal.model.readings import LinkAnswer, LinkHealth, LinkState, LinkVerdict, Loss, Stream
from skincal.model.scene import ArmSpec, Scene
from skincal.session.snapshot import LiveView, PokeRecord, Snapshot
from skincal.session.undo import History
from skincal.taxels.result import Estimate, Method
from skincal.words.units import ChannelNames
from tests.app.scene3d_support import layout, live, scene, snapshot

PLAN = layout()
NAMES = ChannelNames(PLAN)
SCENE: Scene = scene(PLAN)
SECOND = 1_000_000_000


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
        may=allowed(found, where, (), running, (), selected),
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
