"""The search for taxels on a part without a layout."""

from dataclasses import replace

import numpy as np
import pytest
from guided_bench import PART

from skincal.contacts.outcome import Reason, Rejection
from skincal.guide.believed_positions import plan_without_positions
from skincal.guide.guidance import GuidePhase
from skincal.guide.guide import Guide
from skincal.guide.surface_search import MAX_UNPOKED_DISTANCE_M, SEARCH_PLACE_SPACING_M, SurfaceSearch, spread_over
from skincal.mesh.search import nearest_points
from skincal.pokes import Pokes
from skincal.session.session import Session
from skincal.simulation.poking_strategies import Conditions, Hand, MeantPokes, displaced_rig
from skincal.taxels.result import Method


def test_places_are_spread_evenly_without_a_hole():
    places, triangles = spread_over(PART.surface, SEARCH_PLACE_SPACING_M)
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    assert apart.min() >= 0.8 * SEARCH_PLACE_SPACING_M
    assert np.linalg.norm(PART.surface.vertices[:, None] - places[None], axis=2).min(axis=1).max() < SEARCH_PLACE_SPACING_M
    np.testing.assert_allclose(nearest_points(PART.surface, places)[0], places, atol=1e-9)
    assert triangles.shape == places.shape[:1]


def test_the_search_goes_far_from_all_pokes_and_around_those_that_were_answered():
    search = SurfaceSearch(PART.surface)

    def poke(number, index, answered):
        force = -8.0 * search.normals[index]
        pushed = Pokes(
            np.array([number]), force[None], np.cross(search.places[index], force)[None], np.eye(4)[None], np.array([""])
        )
        search.add_poke(pushed[0], answered=answered)
        search.count_pokes({number: True})
        return search.next_place(search.places[index])

    first = search.next_place(None)
    second = poke(1, first, answered=False)
    assert np.linalg.norm(search.places[second] - search.places[first]) > MAX_UNPOKED_DISTANCE_M
    third = poke(2, second, answered=True)
    assert (
        SEARCH_PLACE_SPACING_M * 0.8
        <= np.linalg.norm(search.places[third] - search.places[second])
        < 2.5 * SEARCH_PLACE_SPACING_M
    )
    search.skip(search.places[third])
    assert search.next_place(search.places[second]) != third
    search.count_pokes({2: False})
    assert search.next_place(search.places[first]) == second, "the second poke was undone"


@pytest.mark.parametrize("method", [Method.FREE, Method.SURFACE])
def test_without_a_layout_the_taxels_are_found_and_then_poked(method):
    scene = replace(PART.scene, skin=replace(PART.scene.skin, layout=None, anchor=None))
    plan = plan_without_positions(np.arange(scene.skin.channels))
    guide = Guide(plan, scene.noise, method, search=SurfaceSearch(PART.surface))
    session = Session(scene, PART.surface, (Method.FREE, Method.SURFACE))
    rig, rng = displaced_rig(PART, Conditions(), 1), np.random.default_rng(5)
    contacts, targets, seen, phases = {}, {}, set(), []
    for poke in range(1, 181):
        guidance = guide.update(session.snapshot(), targets.get)
        phases.append(guidance.phase)
        target = targets[poke] = guidance.target
        made, pokes = Hand(rig, Conditions(), rng).poke(MeantPokes(target.place[None], target.push[None]), poke)
        for contact in made:
            session.add(contact)
            contacts[poke] = contact
            seen |= set(contact.channels.tolist())
        if not made:
            force, none = 8.0 * pokes.directions[0], np.empty(0, dtype=np.int64)
            moment = np.cross(pokes.points[0], force)
            session.add(Rejection(poke, 0.0, 1.0, Reason.NO_TAXEL, 0.0, 1.0, "", none, True, force, moment, np.eye(4)))
    assert phases[0] is GuidePhase.COVER
    assert phases[-1] in (GuidePhase.OWN, GuidePhase.SWEEP)
    assert set(guidance.channels.tolist()) <= seen
    assert len(seen) > 70
    assert len(guidance.needs) == len(guidance.channels) == len(guidance.places)
    assert len(contacts) > 110, "hardly any poke misses once the skin is found"
