"""A module that lies off its mesh: seen where its pokes meet beside the surface, and in the covariance along the normal."""

from dataclasses import replace
from functools import cache

import numpy as np

from skincal.mesh.surface import make_surface
from skincal.methods import estimate_taxels
from skincal.modules.pose import ModuleModel
from skincal.simulation.contacts import simulate_contacts, unguided
from skincal.simulation.rig_errors import RigErrors
from skincal.studies.independent_simulator import SmoothSurface
from skincal.taxels.result import Method
from tests.skincal.sim_support import make_rig


@cache
def poked(seed):
    rig = make_rig(RigErrors.noise(), seed)
    rng = np.random.default_rng([seed, 5])
    return rig, simulate_contacts(rig, unguided(rig, 6, rng), rng)


def along_normals(seed, inflated=0.0, skin=0.0015):
    """(84,) the predicted sd along the normal of the taxels, m, on a mesh that is larger than the part."""
    rig, contacts = poked(seed)
    surface = rig.surface
    normals = SmoothSurface(surface.vertices, surface.triangles).normals
    wrong = make_surface(surface.vertices + inflated * normals, surface.triangles)
    model = ModuleModel(rig.scene.skin.layout, rig.scene.skin.anchor, wrong)
    noise = replace(rig.scene.noise, skin=skin)
    found = estimate_taxels(contacts, rig.channels.tolist(), [Method.MODULES], noise, wrong, model=model)[Method.MODULES]
    return np.array([np.sqrt(max(each.normal @ each.covariance @ each.normal, 0.0)) for each in found.values()])


def test_a_mesh_that_is_too_large_is_seen_and_one_that_is_right_is_not():
    rms = {size: np.sqrt(np.mean([along_normals(seed, size) ** 2 for seed in (1, 2, 3)])) for size in (0.0, 0.002)}
    assert rms[0.0] < 0.0007
    assert 0.0012 < rms[0.002] < 0.003


def test_what_a_thick_skin_explains_is_not_the_meshs():
    """A mesh that lies too low and a skin that is touched above its taxels look alike."""
    thin, thick = (np.sqrt(np.mean(along_normals(1, -0.002, skin) ** 2)) for skin in (0.0, 0.003))
    assert thin > 0.0012
    assert thick < 0.0003
