"""What the guide says, made by hand, for the tests of the window."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scene3d_support import laid
from window_support import PLAN, SCENE

from app.opening import Part
from skincal.estimate.result import Method
from skincal.guide.done import Need
from skincal.guide.guidance import Guidance, Phase, Target

NEEDED = (Need.POKES, Need.ACCURACY)


def part() -> Part:
    """The small part with its skin laid on it, without a mesh."""
    return Part(SCENE, None, laid(PLAN), PLAN.channels, ())


def target(channel: int = 3, tilt: float = 0.0, lean: Sequence[float] = (1.0, 0.0, 0.0), **changes: object) -> Target:
    """A poke from above; the tool's upper end leans along `lean` by `tilt`, rad."""
    place, up = laid(PLAN).places[channel], np.array([0.0, 0.0, 1.0])
    push = -np.cos(tilt) * up - np.sin(tilt) * np.array(lean)
    return replace(Target(channel, place, up, push, tilt, 0.0124, 0.0061), **changes)


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
    phase = Phase.SWEEP if any(missing) else Phase.ENOUGH
    count = len(channels)
    own = np.zeros(count, dtype=np.int64)
    return Guidance(
        method=method, phase=phase, target=asked, channels=channels, places=laid(PLAN).places[channels],
        rms=np.full(count, rms), diversity=np.zeros(count), own=own, needs=missing, given_up={},
        usable_tilt=float(np.radians(28.0)), pokes_left=left, seconds_left=seconds,
    )  # fmt: skip
