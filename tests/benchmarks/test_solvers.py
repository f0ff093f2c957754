"""What the solvers and what they stand on take: `python3 -m pytest tests/benchmarks --benchmark-only`.

Not part of the tests: `docs/benchmarks.md` says how to compare two states of the program. The contacts are those of the
runtime study: a good rig, poked with care, unguided.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skincal.mesh.search import build_tree, nearest_in_metric
from skincal.mesh.surface import make_surface
from skincal.methods import estimate_from, estimate_taxels
from skincal.model.scene import resource
from skincal.session.replay import load
from skincal.simulation.example_parts import SHAPE_OF_PART, ExamplePart
from skincal.studies import baselines, runtime
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Method
from tests.skincal.session.test_session_scale import write_pokes

PER_TAXEL = 12
BOTH = [Method.FREE, Method.SURFACE]


@pytest.fixture(scope="module")
def forearm():
    return ExamplePart("icub-forearm")


@pytest.fixture(scope="module")
def torso():
    return ExamplePart("whole-body")


@pytest.fixture(scope="module")
def forearm_contacts(forearm):
    return forearm.contacts(PER_TAXEL, seed=1)


@pytest.fixture(scope="module")
def torso_contacts(torso):
    return torso.contacts(PER_TAXEL, seed=1)


def test_a_poke_of_seven_taxels_in_a_session(benchmark, forearm, forearm_contacts):
    """Taken in, solved by both methods, shown."""
    session = runtime.solved_session(forearm, forearm_contacts)
    touching = runtime.with_neighbours(forearm, forearm_contacts[0])

    def poke():
        session.add(replace(touching, poke=session.last_poke + 1))
        return session.snapshot()

    snapshot = benchmark.pedantic(poke, rounds=50, warmup_rounds=5)
    assert len(snapshot.touched) == runtime.TAXELS_ANSWERING_A_POKE


def test_seven_taxels_solved_by_both_methods(benchmark, forearm, forearm_contacts):
    ledger = ContactTable(forearm_contacts)
    channels = runtime.with_neighbours(forearm, forearm_contacts[0]).channels.tolist()
    found = benchmark(estimate_from, ledger, channels, BOTH, forearm.scene.noise, forearm.surface)
    assert len(found[Method.SURFACE]) == runtime.TAXELS_ANSWERING_A_POKE


@pytest.mark.parametrize("method", BOTH)
def test_the_forearm_from_its_contacts(benchmark, forearm, forearm_contacts, method):
    found = benchmark(estimate_taxels, forearm_contacts, forearm.channels, [method], forearm.scene.noise, forearm.surface)
    assert len(found[method]) == 84


@pytest.mark.parametrize("method", BOTH)
def test_the_whole_body_from_its_contacts(benchmark, torso, torso_contacts, method):
    arguments = (torso_contacts, torso.channels, [method], torso.scene.noise, torso.surface)
    found = benchmark.pedantic(estimate_taxels, arguments, rounds=3, warmup_rounds=1)
    assert len(found[method]) == 4200


@pytest.mark.parametrize("method", BOTH)
def test_the_whole_body_from_a_sessions_ledger(benchmark, torso, torso_contacts, method):
    arguments = (ContactTable(torso_contacts), torso.channels, [method], torso.scene.noise, torso.surface)
    found = benchmark.pedantic(estimate_from, arguments, rounds=3, warmup_rounds=1)
    assert len(found[method]) == 4200


def test_the_whole_bodys_search(benchmark, torso, torso_contacts):
    problems = baselines.taxel_problems(torso_contacts, torso.channels, torso.scene.noise).values()
    arguments = (torso.surface, *(np.array(part) for part in zip(*problems, strict=True)))
    found = benchmark.pedantic(nearest_in_metric, arguments, rounds=3, warmup_rounds=1)
    assert (found.triangles >= 0).all()


def test_one_taxel_by_every_triangle_of_the_whole_body(benchmark, torso, torso_contacts):
    problems = baselines.taxel_problems(torso_contacts, torso.channels[:1], torso.scene.noise)
    point = benchmark(baselines.by_every_triangle, torso.surface, next(iter(problems.values())))
    assert point.shape == (3,)


@pytest.mark.parametrize("triangles", [10_000, 100_000])
def test_a_search_tree_is_built(benchmark, triangles):
    mesh = SHAPE_OF_PART["whole-body"].mesh(triangles)

    def build():
        return build_tree(make_surface(mesh.vertices, mesh.triangles))

    assert len(benchmark.pedantic(build, rounds=3).places) == len(mesh.triangles)


def test_the_sample_session_is_loaded(benchmark):
    pipeline = benchmark.pedantic(load, (resource("sessions/sample"),), rounds=3, warmup_rounds=1)
    assert pipeline.session.contacts


def test_a_session_of_ten_thousand_pokes_is_opened(benchmark, forearm, tmp_path):
    """From its journal, to the estimates of both methods."""
    contacts = forearm.contacts(-(-10_000 // len(forearm.channels)), seed=1)[:10_000]
    spaced = [replace(contact, poke=i, start_s=2.5 * i, end_s=2.5 * i + 0.3) for i, contact in enumerate(contacts, start=1)]
    write_pokes(tmp_path / "session", forearm.scene, spaced)
    pipeline = benchmark.pedantic(load, (tmp_path / "session",), rounds=3)
    assert len(pipeline.session.contacts) == len(spaced)
    assert pipeline.snapshot().estimates[Method.SURFACE]
