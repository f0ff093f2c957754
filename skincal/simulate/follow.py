"""A person who is shown a target: goes there as well as a hand can, and sometimes pokes something else.

The guide's ring is drawn where it believes the taxel to be, on the part; that is where the hand goes, beside the true taxel if
need be. The person looks at the screen until the hand goes down: a target that comes earlier than a reaction before the touch
still counts, a later one is for the next poke.

A known point of the part, such as a screw head, is seen and felt: the hand goes to it more exactly, and neither slides off nor
pokes something else instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skincal.geometry.arrays import FloatArray
from skincal.mesh.search import nearest_points
from skincal.model.errors import InputError
from skincal.simulate.landmarks import LandmarkHabits
from skincal.simulate.operator import Action, Auto, Habits, Press, aim, press
from skincal.simulate.orders import NoTarget, Order, TargetOrder, Wish
from skincal.simulate.poke import Pokes, by_hand, held, tangents
from skincal.simulate.rig import Rig


class Guided(Auto):
    """Pokes the target that is shown; by itself, as `Auto`, as long as nobody guides.

    The same seed and the same targets at the same times give the same pokes.

    Parameters
    ----------
    pokes, poses, channels : as for `Auto`, guided or not; `channels` are for pokes of its own choice
    """

    def __init__(
        self,
        rig: Rig,
        habits: Habits,
        rng: np.random.Generator,
        pokes: int | None = None,
        poses: Sequence[str] = (),
        channels: Sequence[int] | None = None,
    ) -> None:
        super().__init__(rig, habits, rng, pokes, poses, channels)
        self._firm = LandmarkHabits()
        self._told: Wish = NoTarget.ANY
        """The newest, from any thread."""
        self._wish: Wish = NoTarget.ANY
        """What is seen on the screen now."""
        self._touch: float | None = None
        """s, when the hand that is on its way will touch."""

    def accept(self, order: Order | None) -> None:
        """Take what the guide shows now, from any thread; None changes nothing.

        Raises
        ------
        InputError
            There is no such taxel, or the order is not a guide's.
        """
        if order is None:
            return
        if not isinstance(order, TargetOrder | NoTarget):
            raise InputError("poke and pose are for --operator told; expected target, any or wait.")
        if isinstance(order, TargetOrder) and order.channel is not None:
            self._rig.row_of(order.channel)
        self._told = order

    def next(self, now: float) -> Action | None:
        """Return the next poke, or the way to the next arm pose; None while the hand is on its way, or has to wait."""
        self._wish = self._told
        if self._wish is NoTarget.WAIT:
            self._touch = None
            return None
        return super().next(now)

    def _poke(self, now: float) -> Press | None:
        if not isinstance(self._wish, TargetOrder):
            self._touch = None
            return super()._poke(now)
        if self._touch is None:
            self._touch = now + self._rng.uniform(*self._habits.approach_s)
        if now < self._touch - self._habits.reaction_s:
            return None
        touch, self._touch = max(self._touch, now), None
        self.begun += 1
        at_once = replace(self._habits, approach_s=(0.0, 0.0))
        if self._wish.known:
            firm = replace(at_once, slide_rate=0.0)
            return press(self._rig, self._at_point(self._wish), touch, firm, self._rng)
        return press(self._rig, self._aimed(self._wish), touch, at_once, self._rng)

    def _aimed(self, target: TargetOrder) -> Pokes:
        """Return where the hand goes that is shown a target, or that goes where it likes."""
        habits, rng = self._habits, self._rng
        if rng.uniform() < habits.ignores:
            return aim(self._rig, rng.choice(self._channels, 1), habits, rng)
        row = self._row(target)
        place, normal = self._on_part(row, target.place)
        e1, e2 = tangents(normal[None])
        beside = habits.aim * rng.standard_normal(2)
        place, normal = self._on_part(row, place + beside[0] * e1[0] + beside[1] * e2[0])
        push = held(by_hand(target.push[None], habits.hand, rng), normal[None], habits.cone)
        channel = self._rig.channels[row : row + 1]
        return Pokes(
            channel, place[None], normal[None], push, rng.uniform(*habits.force, 1), rng.uniform(0.0, np.pi / 2, 1)
        )  # fmt: skip

    def _at_point(self, target: TargetOrder) -> Pokes:
        """Return how the hand pokes a known point: there, whether or not the surface and the skin pass through it."""
        surface, rng = self._rig.surface, self._rng
        normal = -target.push if surface is None else surface.normals[nearest_points(surface, target.place[None])[1][0]]
        e1, e2 = tangents(normal[None])
        beside = self._firm.aim * rng.standard_normal(2)
        place = target.place + beside[0] * e1[0] + beside[1] * e2[0]
        push = held(by_hand(target.push[None], self._habits.hand, rng), normal[None], self._firm.cone)
        nobody = np.array([-1], dtype=np.int64)
        return Pokes(nobody, place[None], normal[None], push, rng.uniform(*self._firm.force, 1), np.zeros(1))

    def _row(self, target: TargetOrder) -> int:
        """Return the index of the taxel that is shown, or of the one that is nearest to the place that is."""
        if target.channel is not None:
            return self._rig.row_of(target.channel)
        return int(np.sum((self._rig.places - target.place) ** 2, axis=1).argmin())

    def _on_part(self, row: int, place: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the nearest place on the part, and its normal; where there is no surface, in the plane of a taxel."""
        rig = self._rig
        if rig.surface is None:
            normal = rig.normals[row]
            return place - ((place - rig.places[row]) @ normal) * normal, normal
        places, triangles = nearest_points(rig.surface, place[None])
        return places[0], rig.surface.normals[triangles[0]]
