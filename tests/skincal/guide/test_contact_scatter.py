"""The scatter of contact points is learned from misses whose scatter is known, and no error of the rig passes for it."""

import numpy as np
import pytest

from skincal.guide.contact_scatter import PokeMisses, learn_scatter

OWN_SD = 1.0e-3  # m, of a poke by the scene's noise
POKES = 960


def made(scatter_sd, edge_sd=None, motion=0.0, seed=1):
    """Misses of pokes that scatter by `scatter_sd` (m), with 2 of 6 answers by `edge_sd`; `motion` (m) moves each dozen."""
    rng = np.random.default_rng(seed)
    directions = np.linalg.qr(rng.normal(size=(POKES, 3, 3)))[0]
    pairs = directions[:, :2]
    answers = np.where(rng.random(POKES) < 0.15, 2, 6)
    extra = np.where(answers == 2, scatter_sd if edge_sd is None else edge_sd, scatter_sd)
    shifts = motion * rng.normal(size=(POKES // 12, 3)).repeat(12, axis=0)
    noise = rng.normal(size=(POKES, 2)) * np.hypot(OWN_SD, extra)[:, None]
    return PokeMisses(
        pokes=np.arange(POKES),
        poses=np.arange(POKES) // 240,
        answers=answers,
        pairs=pairs,
        levers=0.1 + 0.05 * rng.normal(size=(POKES, 3)),
        misses=noise + (pairs @ shifts[:, :, None])[:, :, 0],
        covariances=np.tile(OWN_SD**2 * np.eye(2), (POKES, 1, 1)),
        variances=np.full(POKES, OWN_SD**2),
    )


@pytest.mark.parametrize("motion", [0.0, 5e-3])
def test_scatter_is_learned_whatever_moves_all_pokes_of_a_window(motion):
    found = learn_scatter(made(0.8e-3, motion=motion))
    assert np.sqrt(found.common) == pytest.approx(0.8e-3, rel=0.2)


def test_pokes_that_few_taxels_answer_have_a_scatter_of_their_own():
    misses = made(0.5e-3, edge_sd=2.0e-3)
    found = learn_scatter(misses)
    assert np.sqrt(found.common) == pytest.approx(0.5e-3, rel=0.35)
    assert np.sqrt(found.edge) == pytest.approx(2.0e-3, rel=0.25)
    assert np.mean(misses.squares(found) <= 5.991) == pytest.approx(0.95, abs=0.02)


def test_the_noise_of_the_scene_is_enough():
    found = learn_scatter(made(0.0))
    assert found.common < (0.3e-3) ** 2
    assert found.edge < (0.5e-3) ** 2


def test_misses_that_are_no_scatter_are_judged_by_the_scenes_noise():
    assert learn_scatter(made(3.0e-3)).common == 0.0


def test_few_pokes_teach_nothing():
    assert learn_scatter(made(0.8e-3).select(np.arange(90))).common == 0.0
