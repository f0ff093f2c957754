"""Scenes and rigs that the tests of the simulator share."""

import shutil
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from skincal.mesh.load import load_surface
from skincal.mesh.surface import Surface
from skincal.model.scene import Scene, load_scene, resource
from skincal.robot.target_lines import PokeTarget
from skincal.session.replay import load
from skincal.simulation.contacts import RECIPE_TILT, RECIPE_TURN
from skincal.simulation.device import DeviceSettings
from skincal.simulation.operator import Habits, presses_at
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import PressedPlaces, Rig
from tests.build import noted_session

SLOW_DEVICES = DeviceSettings(wrench_hz=200.0, joints_hz=20.0, block_s=0.02)
"""A fifth of the readings: the same pipeline in less time."""
RECIPE_HAND = float(np.radians(6.0))
"""rad, sd of the push about the one asked for, in each direction: a hand without a guide. Assumed."""


@lru_cache
def scene_and_surface(name: str = "icub-forearm") -> tuple[Scene, Surface | None]:
    scene = load_scene(resource(f"scenes/{name}/scene.toml"))
    return scene, None if scene.surface is None else load_surface(scene.surface)[0]


def make_rig(errors: RigErrors, seed: int = 1, name: str = "icub-forearm") -> Rig:
    return Rig(*scene_and_surface(name), errors, np.random.default_rng(seed))


def recipe(rig: Rig, per_taxel: int, rng: np.random.Generator) -> PressedPlaces:
    """Return pokes by a printed recipe, `per_taxel` at each taxel: round by round, tilted, the tilt turned with each round."""
    habits = Habits.careful()
    targets = np.concatenate([rng.permutation(rig.channels) for _ in range(per_taxel)])
    count = len(targets)
    turns = RECIPE_TURN * np.repeat(np.arange(per_taxel), len(rig.channels))
    tilts = np.clip(RECIPE_TILT + RECIPE_HAND * rng.standard_normal(count), 0.0, np.pi / 4)
    azimuths = turns + RECIPE_HAND / np.sin(RECIPE_TILT) * rng.standard_normal(count)
    beside = habits.aim * rng.standard_normal((count, 2))
    return presses_at(rig, targets, beside, np.column_stack([tilts, azimuths]), rng.uniform(*habits.force, count), rng)


def sample_with(folder: Path, file: str, *changes: tuple[str, str]) -> Path:
    """The pokes of the sample session in a scene that says something else: `changes` of the text of one of its files."""
    sample = resource("sessions/sample")
    path = shutil.copytree(sample / "scene", folder / "scene") / file
    text = path.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text, encoding="utf-8")
    scene = load_scene(folder / "scene" / "scene.toml")
    outcomes = [record.outcome for record in load(sample).snapshot().pokes]
    noted_session(folder / "session", scene, load_surface(scene.surface)[0], outcomes).close()
    shutil.copy(sample / "truth.json", folder / "session")
    return folder / "session"


def ask_on(hand):
    """Have a guided hand that has reached what is asked for be asked for the same under the next number."""

    def ask(answer):
        if isinstance(hand._newest, PokeTarget):
            hand.show(replace(hand._newest, number=answer.number + 1))

    hand.answered = ask
