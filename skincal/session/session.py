"""What is known of one calibration: pokes, what the operator decided, and the estimates that follow.

The contacts are the truth. Estimates are a cache of them: a taxel is solved from the kept contacts in the order of their
numbers, and nothing else, so that taking a poke out and in again gives the same numbers to the last bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from skincal import __version__
from skincal.contacts.outcome import Contact, Outcome
from skincal.errors import InputError
from skincal.estimate.result import Estimate, Method
from skincal.estimate.solve import estimate_taxels
from skincal.readings import FloatArray, IntArray
from skincal.scene import Scene
from skincal.session.actions import Action, Exclude, MarkDead, Restore, Revive, SetPose, Undo
from skincal.session.history import History, Step
from skincal.session.snapshot import PokeRecord, Snapshot

if TYPE_CHECKING:
    from skincal.files.calibration import Calibration
    from skincal.surface.mesh import Surface

MARKED = "marked by the operator"
"""Reason of a channel that the operator left out."""


class Session:
    """Pokes and decisions, and the estimates of every method that the scene has.

    Parameters
    ----------
    scene : what there is to calibrate
    surface : the scene's mesh; None leaves out the surface method
    """

    def __init__(self, scene: Scene, surface: Surface | None) -> None:
        self.scene = scene
        self.surface = surface
        self.methods = (Method.FREE,) if surface is None else (Method.FREE, Method.SURFACE)
        self.pose = ""
        """Name of the chosen arm pose; empty where none was chosen: the joint stream says it, if there is one."""
        self._outcomes: dict[int, Outcome] = {}
        self._excluded: set[int] = set()
        self._found: Mapping[int, str] = {}
        self._marked: set[int] = set()
        self._revived: set[int] = set()
        self._history = History()
        self._pokes_of: dict[int, set[int]] = {}
        self._estimates: dict[Method, dict[int, Estimate]] = {method: {} for method in self.methods}
        self._dirty: set[int] = set(self.channels)
        self._touched: IntArray = np.empty(0, dtype=np.int64)
        self._current_pose: tuple[str, FloatArray | None] = (self.pose, None)
        self._generation = 0
        self._snapshot: Snapshot | None = None

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """The contacts that count: accepted and not excluded, in the order of their numbers."""
        return tuple(self._kept(self._outcomes))

    @property
    def excluded(self) -> tuple[int, ...]:
        """Numbers of the pokes that the operator took out."""
        return tuple(sorted(self._excluded))

    @property
    def channels(self) -> tuple[int, ...]:
        """The taxels: those of the layout, or without one those that answered in a contact that counts."""
        layout = self.scene.skin.layout
        if layout is not None:
            return tuple(int(channel) for channel in layout.channels)
        return tuple(sorted(channel for channel, pokes in self._pokes_of.items() if any(True for _ in self._kept(pokes))))

    @property
    def last_poke(self) -> int:
        """Number of the last poke, whatever it ended as; 0 before the first."""
        return max(self._outcomes, default=0)

    @property
    def found_dead(self) -> Mapping[int, str]:
        """Channels that the detector found to be dead, whatever the operator thinks of them."""
        return self._found

    @property
    def dead(self) -> dict[int, str]:
        """Channels that are not used, with the reason."""
        dead = {channel: why for channel, why in self._found.items() if channel not in self._revived}
        dead |= dict.fromkeys(self._marked, MARKED)
        return {channel: dead[channel] for channel in sorted(dead)}

    def add(self, outcome: Outcome) -> None:
        """Take a poke's outcome; one with the same number replaces the earlier."""
        before = self._outcomes.get(outcome.poke)
        self._outcomes[outcome.poke] = outcome
        was, now = isinstance(before, Contact), isinstance(outcome, Contact)
        if isinstance(before, Contact):
            for channel in before.channels:
                self._pokes_of[int(channel)].discard(before.poke)
        if isinstance(outcome, Contact):
            for channel in outcome.channels:
                self._pokes_of.setdefault(int(channel), set()).add(outcome.poke)
        if now and not was:
            self._history.add(self._poke_step(outcome.poke))
        if was and not now:
            self._history.forget_poke(outcome.poke)
        self._touch(before)
        self._touch(outcome)

    def settle(self) -> None:
        """Make every outcome final as it stands: what could have changed it will not come."""
        for outcome in list(self._outcomes.values()):
            if not outcome.final:
                self.add(replace(outcome, final=True))

    def outcome(self, poke: int) -> Outcome | None:
        """Return how a poke ended; None where there is no such poke."""
        return self._outcomes.get(poke)

    def find_dead(self, found: Mapping[int, str]) -> None:
        """Take the channels that the detector found to be dead, in place of those before."""
        if found is not self._found and dict(found) != dict(self._found):
            before = self.dead
            self._found = dict(found)
            self._redo_dead(before)

    def set_current_pose(self, name: str, link_from_sensor: FloatArray | None) -> None:
        """Take the arm pose that holds now, chosen or streamed; it is shown and nothing else."""
        before_name, before = self._current_pose
        if name == before_name and link_from_sensor is before:
            return
        same = before is not None and link_from_sensor is not None and np.array_equal(before, link_from_sensor)
        self._current_pose = (name, link_from_sensor)
        if name != before_name or not same:
            self._changed()

    def act(self, action: Action) -> None:
        """Do what the operator wants.

        Raises
        ------
        InputError
            There is no such poke, pose or channel, or nothing to undo; the session is as it was.
        """
        if isinstance(action, Undo):
            self._undo()
        elif isinstance(action, Exclude | Restore):
            self._choose_poke(action)
        elif isinstance(action, SetPose):
            self._choose_pose(action.name)
        else:
            self._choose_channel(action)
        self._changed()

    def snapshot(self) -> Snapshot:
        """Return everything a view may show; the same object until something changes. Taxels that changed are solved."""
        if self._snapshot is not None:
            return self._snapshot
        channels = self.channels
        # The first snapshot solves every taxel, which is no poke's doing: a session that was opened again rings none.
        if self._dirty and self._generation:
            self._touched = np.array(sorted(self._dirty), dtype=np.int64)
        self._solve(channels)
        last = self._history.last(self._is_excluded)
        self._snapshot = Snapshot(
            generation=self._generation,
            pokes=tuple(PokeRecord(self._outcomes[poke], poke in self._excluded) for poke in sorted(self._outcomes)),
            estimates={method: tuple(self._estimates[method][channel] for channel in channels) for method in self.methods},
            touched=self._touched,
            pose=self._current_pose[0],
            link_from_sensor=self._current_pose[1],
            dead=self.dead,
            can_undo="" if last is None else last.words,
        )
        return self._snapshot

    def calibration(self) -> Calibration:
        """Return what the calibration files are written from."""
        from skincal.files.calibration import Calibration

        estimates = self.snapshot().estimates
        return Calibration(
            scene=self.scene,
            channels=self.channels,
            estimates=estimates,
            contacts=tuple(outcome for _, outcome in sorted(self._outcomes.items()) if isinstance(outcome, Contact)),
            mesh_sha256=None if self.surface is None else self.surface.sha256,
            version=__version__,
            excluded=self.excluded,
            dead=self.dead,
        )

    def _solve(self, channels: tuple[int, ...]) -> None:
        dirty = [channel for channel in channels if channel in self._dirty]
        pokes = set[int]().union(*(self._pokes_of.get(channel, ()) for channel in dirty))
        contacts = list(self._kept(pokes))
        dead = self.dead
        for method in self.methods:
            solved = estimate_taxels(contacts, dirty, method, self.scene.noise, self.surface, dead)
            self._estimates[method].update(solved)
        self._dirty.clear()

    def _kept(self, pokes: Mapping[int, Outcome] | set[int]) -> list[Contact]:
        kept: list[Contact] = []
        for poke in sorted(pokes):
            outcome = self._outcomes[poke]
            if isinstance(outcome, Contact) and poke not in self._excluded:
                kept.append(outcome)
        return kept

    def _touch(self, outcome: Outcome | None) -> None:
        """Mark the taxels of a poke as dirty."""
        if isinstance(outcome, Contact):
            self._dirty.update(int(channel) for channel in outcome.channels)
        self._changed()

    def _changed(self) -> None:
        if self._snapshot is not None:
            self._generation += 1
            self._snapshot = None

    def _is_excluded(self, poke: int) -> bool:
        return poke in self._excluded

    def _poke_step(self, poke: int) -> Step:
        return Step(f"poke {poke}", poke, lambda: self._set_excluded(poke, True))

    def _undo(self) -> None:
        step = self._history.last(self._is_excluded)
        if step is None:
            raise InputError("There is nothing to undo: no poke was accepted and nothing was changed.")
        self._history.drop(step)
        step.take_back()

    def _choose_poke(self, action: Exclude | Restore) -> None:
        poke, out = action.poke, isinstance(action, Exclude)
        if not isinstance(self._outcomes.get(poke), Contact):
            raise InputError(f"Poke {poke} is not an accepted poke of this session; expected the number of one.")
        if (poke in self._excluded) == out:
            raise InputError(f"Poke {poke} {'is already excluded' if out else 'counts already'}.")
        self._set_excluded(poke, out)
        words = f"exclusion of poke {poke}" if out else f"return of poke {poke}"
        self._history.add(Step(words, None, lambda: self._set_excluded(poke, not out)))

    def _set_excluded(self, poke: int, out: bool) -> None:
        (self._excluded.add if out else self._excluded.discard)(poke)
        self._touch(self._outcomes[poke])

    def _choose_pose(self, name: str) -> None:
        known = {} if self.scene.arm is None else self.scene.arm.poses
        if name and name not in known:
            expected = f"one of {', '.join(known)}" if known else "none, since the scene names no poses"
            raise InputError(f"Pose {name!r} is not in the scene; expected {expected}.")
        before, self.pose = self.pose, name

        def take_back() -> None:
            self.pose = before

        self._history.add(Step(f"choice of pose {name}" if name else "choice of the streamed pose", None, take_back))

    def _choose_channel(self, action: MarkDead | Revive) -> None:
        channel = action.channel
        if not 0 <= channel < self.scene.skin.channels:
            raise InputError(f"Channel {channel} does not exist; expected 0 to {self.scene.skin.channels - 1}.")
        before = (set(self._marked), set(self._revived))
        (self._marked.add if isinstance(action, MarkDead) else self._marked.discard)(channel)
        (self._revived.discard if isinstance(action, MarkDead) else self._revived.add)(channel)
        self._dirty.add(channel)

        def take_back() -> None:
            self._marked, self._revived = before
            self._dirty.add(channel)

        words = f"mark of channel {channel}" if isinstance(action, MarkDead) else f"return of channel {channel}"
        self._history.add(Step(words, None, take_back))

    def _redo_dead(self, before: Mapping[int, str]) -> None:
        now = self.dead
        self._dirty.update(channel for channel in before.keys() | now.keys() if before.get(channel) != now.get(channel))
        self._changed()
