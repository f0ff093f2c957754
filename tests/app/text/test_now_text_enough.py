"""What is said when the modules method needs no more."""

from __future__ import annotations

from dataclasses import replace

import pytest

from app.state.running import Running
from app.text.now_text import modules_enough_words
from skincal.following.session_guide import ModulesEnough, plan_of
from skincal.guide.surroundings import Surroundings
from skincal.taxels.result import Estimate, Method, State
from tests.app.guide_support import guidance
from tests.app.scene3d_support import estimate
from tests.app.window_support import PLAN, SCENE, frame, part, session, slip, touch
from tests.approved import approved

FIRST, SECOND = 3, 15  # A taxel of each of the two modules
ENOUGH = (
    *(touch(poke, (FIRST, SECOND), (60.0, 20.0)) for poke in range(1, 5)),
    *(touch(poke, (SECOND,)) for poke in range(5, 11)),
)

ON_FIRST = tuple(touch(poke, (FIRST, SECOND), (60.0, 20.0)) for poke in range(1, 11))


def at(pokes=ENOUGH, sd=5e-4, generation=1, excluded=(), blind=(), dead=(), done=(), method=Method.FREE, **changes):
    """A moment in which the modules method knows every taxel to `sd`, m, but those that are blind or dead."""
    by_channel = {each.channel: each for each in (estimate(c, (0, 0, 0), Method.MODULES, sd) for c in range(24))}
    by_channel |= {channel: Estimate(channel, Method.MODULES, State.BLIND, 2) for channel in blind}
    by_channel |= {channel: Estimate(channel, Method.MODULES, State.DEAD, 0) for channel in dead}
    snapshot = session(generation, pokes=pokes, excluded=excluded)
    snapshot = replace(snapshot, estimates={**snapshot.estimates, Method.MODULES: tuple(by_channel[c] for c in range(24))})
    return replace(frame(snapshot, method=method), guidance=guidance(done=done), **changes)


class ShortWay(ModulesEnough):
    """What is said of it at a moment; empty where nothing is."""

    def __init__(self) -> None:
        super().__init__(plan_of(part()), 0.0015, Surroundings(SCENE.skin.layout, PLAN.channels))

    def news(self, at) -> str:
        is_news = self.is_news(at.snapshot, at.guidance, at.method, streaming=at.connected)
        return modules_enough_words() if is_news else ""


def test_it_is_said_once():
    short = ShortWay()
    assert short.news(at(ENOUGH[:9], generation=1)) == ""
    words = short.news(at(generation=2))
    assert approved("modules_check.pokes_on_every_module") in words
    assert "1.5 mm" in words
    assert short.news(at(generation=3)) == ""


@pytest.mark.parametrize(
    "changes",
    [
        {"pokes": (*ENOUGH[:3], slip(4), *ENOUGH[4:])},
        {"excluded": (2,)},
        {"sd": 2e-3},
        {"blind": (7,)},
        {"dead": tuple(range(24))},
        {"method": Method.MODULES},
        {"done": tuple(PLAN.channels.tolist())},
        {"running": Running.PAUSED},
        {"guidance": None},
    ],
    ids=["rejected", "excluded", "unsure", "blind", "nothing in use", "shown already", "enough", "paused", "no guide"],
)
def test_it_is_not_said_where(changes):
    short = ShortWay()
    moment = at(**changes) if "guidance" not in changes else replace(at(), guidance=None)
    assert short.news(moment) == ""
    assert short.news(at(generation=2))


def test_who_has_seen_that_method_be_enough_is_not_told():
    short = ShortWay()
    assert short.news(at(method=Method.MODULES, done=tuple(PLAN.channels.tolist()))) == ""
    assert short.news(at(generation=2)) == ""


def test_a_dead_taxel_and_a_dead_module_are_not_waited_for():
    assert ShortWay().news(at(dead=(7,)))
    assert ShortWay().news(at(pokes=ON_FIRST, dead=tuple(range(12, 24))))
    assert not ShortWay().news(at(pokes=ON_FIRST, dead=tuple(range(13, 24))))
