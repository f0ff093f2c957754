"""The guide without a mesh, by the modules method: a flat patch comes to its end with all taxels done and none far off."""

import numpy as np

from skincal.guide.guidance import GuidePhase
from skincal.session.guiding import SessionGuide
from skincal.session.part import lay_part
from skincal.session.session import Session
from skincal.simulate.contacts import PressedPlaces, simulate_contacts
from skincal.simulate.courses import errors_of
from skincal.simulate.faults import RigErrors
from skincal.taxels.result import Method
from tests.skincal.sim_support import make_rig

UP = np.array([[0.0, 0.0, 1.0]])


def poke_as_asked(rig, target, rng, number):
    """Poke the patch where a target stands as a hand does: 1.5 mm and 5 degrees off in each direction."""
    place = np.append(target.place[:2] + 0.0015 * rng.standard_normal(2), 0.0)
    push = target.push + np.append(np.radians(5.0) * rng.standard_normal(2), 0.0)
    nobody = np.zeros(1, dtype=np.int64)
    pressed = PressedPlaces(
        nobody, place[None], UP, push[None] / np.linalg.norm(push), rng.uniform(6.0, 12.0, 1), rng.uniform(0.0, np.pi / 2, 1)
    )
    return simulate_contacts(rig, pressed, rng, first_poke=number)


def test_a_flat_patch_is_done_by_about_as_many_pokes_as_were_told_at_the_start():
    rig, rng = make_rig(RigErrors.noise(), 0, "flat-patch"), np.random.default_rng(5)
    session, guide = Session(rig.scene, None), SessionGuide(lay_part(rig.scene, None, ()))
    stance = rig.stance()

    def follow():
        at = session.snapshot()
        return guide.next_target(at, (stance.name, stance.reported), Method.MODULES, session.evidence, 100.0)

    told, pokes = guide.costs[Method.MODULES], 0
    while not (guidance := follow()).enough:
        pokes += 1
        for contact in poke_as_asked(rig, guidance.target, rng, pokes):
            session.add(contact)
    assert guidance.phase in (GuidePhase.ENOUGH, GuidePhase.CLOSING)
    assert 0.75 * told < pokes < 1.25 * told
    done = np.array([not needs for needs in guidance.needs])
    assert done.mean() > 0.9
    assert np.max(errors_of(session.snapshot().estimates[Method.MODULES], rig)[done]) < 0.003
