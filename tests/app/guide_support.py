"""What the guide says, made by hand, for the tests of the window."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from app.state.camera_pose import CameraPose
from skincal.contacts.outcome import PressPhase, Progress
from skincal.guide.guidance import Guidance, GuidePhase, Target
from skincal.guide.press_coaching import PokeError, compare_to_target, smooth_wrench
from skincal.guide.progress import Need
from skincal.session.snapshot import LiveView
from skincal.taxels.result import Method
from tests.app.scene3d_support import laid
from tests.app.window_support import PLAN, reading

TILT = float(np.radians(28.0))
NEEDED = (Need.POKES, Need.ACCURACY)


def target(channel: int = 3, tilt: float = 0.0, lean: Sequence[float] = (1.0, 0.0, 0.0), **changes: object) -> Target:
    """A poke from above; the tool's upper end leans along `lean` by `tilt`, rad."""
    place, up = laid(PLAN).places[channel], np.array([0.0, 0.0, 1.0])
    push = -np.cos(tilt) * up - np.sin(tilt) * np.array(lean)
    return replace(Target(channel, place, up, push, tilt, 0.0124, 0.0061), **changes)


def eye_of(right: np.ndarray, up: np.ndarray) -> CameraPose:
    """A camera with these axes on the screen."""
    return CameraPose(np.stack([right, up, np.cross(right, up)]), np.zeros(3), 1.0)


def guidance(
    asked: Target | None = None,
    done: Sequence[int] = (),
    method: Method = Method.FREE,
    needs: Mapping[int, tuple[Need, ...]] | None = None,
    rms: float = 0.0124,
    left: int = 0,
    seconds: float | None = None,
) -> Guidance:
    """What is asked for; all taxels but `done` still need something."""
    channels = PLAN.channels
    missing = tuple(() if c in done else (needs or {}).get(c, NEEDED) for c in channels.tolist())
    phase = GuidePhase.SWEEP if any(missing) else GuidePhase.ENOUGH
    count = len(channels)
    own = np.zeros(count, dtype=np.int64)
    return Guidance(
        method=method, phase=phase, target=asked, channels=channels, places=laid(PLAN).places[channels],
        rms=np.full(count, rms), diversity=np.zeros(count), own=own, needs=missing, given_up={},
        usable_tilt=float(np.radians(28.0)), pokes_left=left, seconds_left=seconds,
    )  # fmt: skip


_BESIDE = PLAN.places[2] - PLAN.places[3]
TO_2 = (*(_BESIDE / np.linalg.norm(_BESIDE)).tolist(), 0.0)  # From taxel 3, in the middle of its triangle, to taxel 2
ASKED = target(3, TILT, TO_2)


def held(
    tilt: float,
    lean: Sequence[float] = TO_2,
    newtons: float = 8.0,
    phase: PressPhase = PressPhase.PRESSING,
    aside: Sequence[float] = (0.0, 0.0, 0.0),
    landed: int | None = 3,
    asked: Target = ASKED,
    still: float = 0.0,
) -> LiveView:
    """A live view of a tool whose upper end leans by `tilt`, degrees, its tip `aside` the target, metres."""
    leans = np.radians(tilt)
    push = -np.cos(leans) * asked.normal - np.sin(leans) * np.array(lean)
    channels = np.array([] if landed is None else [landed], dtype=np.int64)
    tip = asked.place + np.array(aside)
    progress = Progress(phase, newtons * push, tip - 0.3 * push, channels, np.full(len(channels), 50.0), still)
    return replace(reading(), progress=progress)


def coaching_of(progress: Progress, asked: Target) -> PokeError | None:
    """What the coach says of one reading."""
    felt = smooth_wrench(None, progress)
    return None if felt is None else compare_to_target(felt, progress, asked, asked.place)
