"""Held-out pokes that a session can predict by one method: how many test the result already.

A poke is predicted from the others of its module or taxel. The result is kept until an estimate of these changes. The count
stops when the test has enough pokes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from skincal.geometry import IntArray
from skincal.guide.moment import Moment
from skincal.guide.verdict import held_out, predict_by_modules, predict_by_taxels
from skincal.model.scene import NoiseSettings
from skincal.modules.pose import ModuleModel
from skincal.taxels.predictions import PokePredictions
from skincal.taxels.result import Estimate, Method, State

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface

EstimateOf = Callable[[int], Estimate | None]
"""Estimate of a channel; `None` for a channel that is no taxel."""
HELD_OUT_POKES_AT_ONCE = 12
"""Predicted at once by the methods of single taxels: a few more than the test needs."""


class PredictablePokes:
    """Pokes that can be predicted; parameters as for `verdict.check`, `channels` (n,) are those of the plan."""

    def __init__(
        self, channels: IntArray, method: Method, noise: NoiseSettings, surface: Surface | None, model: ModuleModel | None
    ) -> None:
        self._method, self._noise, self._surface, self._model = method, noise, surface, model
        self._modules: list[tuple[int, ...]] = []
        """Channels of each module."""
        if model is not None and method is Method.MODULES:
            owners = model.layout.module_of
            known = channels[channels < model.layout.width]
            modules = np.unique(owners[known])
            self._modules = [tuple(known[owners[known] == module].tolist()) for module in modules[modules >= 0]]
        self._found: dict[int, tuple[Sequence[Estimate | None], IntArray]] = {}
        """For each module the estimates at the last look, and the numbers of its predictable pokes, ascending."""
        self._is_predictable: dict[int, tuple[Estimate | None, bool]] = {}
        """For each held-out poke the estimate of its taxel at the last look, and whether it can be predicted."""

    def count_held_out(self, moment: Moment, estimate_of: EstimateOf, enough: int) -> int:
        """Count the held-out pokes that can be predicted; the count may stop at `enough`."""
        numbers, strongest = held_out(moment.columns)
        if self._method is Method.MODULES:
            return self._count_by_modules(moment, estimate_of, numbers, enough)
        return self._count_by_taxels(moment, estimate_of, numbers, strongest, enough)

    def _count_by_modules(self, moment: Moment, estimate_of: EstimateOf, numbers: IntArray, enough: int) -> int:
        count = 0
        for module, channels in enumerate(self._modules):
            estimates = [estimate_of(channel) for channel in channels]
            if module not in self._found or self._found[module][0] != estimates:
                self._found[module] = estimates, self._predict_module(moment, estimates)
            pokes = self._found[module][1]
            at = np.searchsorted(numbers, pokes)
            count += int(np.count_nonzero(numbers[at[at < len(numbers)]] == pokes[at < len(numbers)]))
            if count >= enough:
                break
        return count

    def _predict_module(self, moment: Moment, estimates: Sequence[Estimate | None]) -> IntArray:
        assert self._model is not None
        used = {each.channel: each for each in estimates if each is not None and each.state is not State.DEAD}
        answers, predicted, _ = predict_by_modules(moment, used, used, self._noise, self._model)
        return np.sort(answers.pokes[_known_rows(predicted)])

    def _count_by_taxels(
        self, moment: Moment, estimate_of: EstimateOf, numbers: IntArray, strongest: IntArray, enough: int
    ) -> int:
        count = 0
        for first in range(0, len(numbers), HELD_OUT_POKES_AT_ONCE):
            some = slice(first, first + HELD_OUT_POKES_AT_ONCE)
            pairs = [
                (poke, channel, estimate_of(channel))
                for poke, channel in zip(numbers[some].tolist(), strongest[some].tolist(), strict=True)
            ]
            used = [(poke, channel, each) for poke, channel, each in pairs if each is not None and each.state is not State.DEAD]
            news = [each for each in used if self._is_predictable.get(each[0], (None, False))[0] is not each[2]]
            if news:
                pokes, channels = (np.array(column) for column in list(zip(*news, strict=True))[:2])
                answers, predicted = predict_by_taxels(moment, pokes, channels, self._method, self._noise, self._surface)
                known = set(answers.pokes[_known_rows(predicted)].tolist())
                self._is_predictable.update((poke, (each, poke in known)) for poke, _, each in news)
            count += sum(self._is_predictable[poke][1] for poke, _, _ in used)
            if count >= enough:
                break
        return count


def _known_rows(predicted: PokePredictions) -> IntArray:
    """Select the rows of the pokes whose position is predicted."""
    return predicted.rows[np.isfinite(predicted.misses).all(axis=1)]
