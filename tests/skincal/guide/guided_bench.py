"""A guide, a simulated rig, and a hand that pokes what the guide or the test says."""

from dataclasses import replace
from functools import cache

import numpy as np

from skincal.contacts.outcome import Rejection
from skincal.guide.guide import Guide
from skincal.session.session import Session
from skincal.simulation.example_parts import ExamplePart
from skincal.simulation.poking_strategies import CAREFUL_HABITS, Conditions, Hand, MeantPokes, displaced_rig
from skincal.taxels.result import Method

PART = ExamplePart()
STEADY = Conditions(replace(CAREFUL_HABITS, aim=0.0, hand=0.0))


def make_guide(method=Method.FREE, plan=None, **options):
    return Guide(plan or PART.plan, PART.scene.noise, method, **options)


class GuidedBench:
    def __init__(self, method=Method.FREE, seed=1, conditions=None):
        self.conditions = conditions or Conditions()
        solved = (Method.FREE, Method.SURFACE, *((method,) if method is Method.MODULES else ()))
        self.session, self.guide = Session(PART.scene, PART.surface, solved), make_guide(method)
        self.rig, self.rng = displaced_rig(PART, self.conditions, seed), np.random.default_rng(seed)
        self.contacts, self.targets, self.asked, self.count = {}, {}, [], 0
        self.look()

    def update(self, guide, estimates=None, **others):
        """What a guide says of the session."""
        moment = self.session.snapshot()
        moment = moment if estimates is None else replace(moment, estimates=estimates)
        return guide.update(moment, self.targets.get, **others)

    def look(self):
        self.guidance = self.update(self.guide)
        return self.guidance

    def press(self, place, push):
        """The contacts of the next poke."""
        self.count += 1
        return Hand(self.rig, self.conditions, self.rng).poke(MeantPokes(place[None], push[None]), self.count)[0]

    def poke(self, place=None, push=None, *, shown=True):
        target = self.guidance.target
        self.asked.append(target.channel)
        if shown:
            self.targets[self.count + 1] = target
        for contact in self.press(target.place if place is None else place, target.push if push is None else push):
            self.report(contact)
        return self.look()

    def report(self, contact):
        self.session.add(contact)
        self.contacts[contact.poke] = contact

    def poke_taxel(self, row, aside=0.0):
        place, normal = self.true(int(PART.plan.channels[row]))
        return self.poke(place + aside, -normal)

    def reject(self, reason, place, push, channels=()):
        """End a poke as rejected, its force known."""
        self.count += 1
        self.targets[self.count] = self.guidance.target
        force = 8.0 * push
        self.session.add(
            Rejection(
                self.count, 0.0, 1.0, reason, 1.0, 0.5, "", np.array(channels, dtype=np.int64), True,
                force=force, moment=np.cross(place, force), link_from_sensor=np.eye(4),
            )
        )  # fmt: skip
        return self.look()

    def skip(self):
        self.guide.skip(self.guidance.target)
        return self.look()

    def true(self, channel):
        row = self.rig.row_of(channel)
        return self.rig.places[row], self.rig.normals[row]

    def diversity(self, row):
        return self.guide.axis_diversity(int(PART.plan.channels[row]), self.session.snapshot())


@cache
def after(pokes, method=Method.FREE, seed=1):
    """A bench that followed its guide; tests leave it as it is."""
    bench = GuidedBench(method, seed)
    for _ in range(pokes):
        bench.poke()
    return bench


def tilted(normal, degrees):
    """A unit push that leans from the inward normal."""
    lean = np.cross(normal, [1.0, 0.0, 0.0])
    return np.sin(np.radians(degrees)) * lean / np.linalg.norm(lean) - np.cos(np.radians(degrees)) * normal
