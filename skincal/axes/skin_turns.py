"""The turns of all taxels of a skin, from its contacts: the noise and the ratio of gains they share, and one fit each.

All taxels are of one kind. So the noise of a reading's direction and the usual ratio of gains (`usual_ratio.py`) are found from
all of them together, and each taxel is then fitted with both. The noise is that of the readings (raw units), or that of their
directions (rad), whichever makes the misses likelier. Its size is that for which the median miss is the expected one; with few
pokes at least that for which their sum is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import TypeAlias

import numpy as np

from skincal.axes.reading_steps import find_step
from skincal.axes.turn_fit import (
    MIN_ANGULAR_NOISE,
    START_ANGULAR_NOISE,
    AxisNoise,
    AxisPokes,
    TurnFit,
    fit_both_hands,
)
from skincal.axes.usual_ratio import with_usual_ratio
from skincal.chi_square import CHI2_2DOF_MEDIAN
from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray

NOISE_ROUNDS = 3
"""Fits of all taxels until their common noise is found; a fourth changes it by less than 1 %."""
MIN_SHARE_OF_STRONGEST = 0.7
"""Of the strongest answer of a poke. By simulation readings of less make the turn worse, and more pokes are lost with a higher
share (docs/three-axes.md)."""
UNKNOWNS_OF_TURN = 4
"""Three of the rotation, and the ratio of gains."""
CERTAIN_LOG_ODDS = float(np.log(20.0))
"""Natural logarithm of the odds that make a finding certain."""
MAX_FREEDOM_OF_MEAN = 60
"""Degrees of freedom of the misses below which their sum counts, too."""
MAX_SQUARE_IN_SUM = 16.0
"""Squared miss in standard deviations: a larger one is an outlier."""
SCALES_TRIED = 201
"""Of the noise, from nothing to the largest."""
MAX_ANGULAR_NOISE = 0.5
"""rad. Readings that scatter by more than half a radian carry no direction."""


ReadingOfForce: TypeAlias = tuple[FloatArray, FloatArray, int]
"""Force on the part, (3,) float, N, link frame; reading of a taxel, (3,) float, raw units, its axes; number of the poke."""


class TurnState(Enum):
    """State of a turn; the value is its word in files."""

    IN_PLANE_UNKNOWN = "turn in the plane unknown"
    """z is known, the turn about it is not: no poke leaned enough."""
    KNOWN = "known"


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """The turn of one taxel, or of the taxels of a module together."""

    channels: tuple[int, ...]
    fits: tuple[TurnFit, TurnFit]
    """Right-handed axes, and mirrored ones."""
    share: float = 1.0
    """Pokes over readings: the information of a reading if the taxels of a poke share its errors."""

    @property
    def fit(self) -> TurnFit:
        """The fit of right-handed axes."""
        return self.fits[0]

    @property
    def state(self) -> TurnState:
        """State of the turn."""
        return TurnState.KNOWN if self.fit.is_in_plane_known else TurnState.IN_PLANE_UNKNOWN

    @property
    def pokes(self) -> int:
        """Number of its pokes."""
        return len(self.fit.misses)

    @property
    def log_odds_mirrored(self) -> float:
        """Natural logarithm of the odds of mirrored axes over right-handed ones."""
        return (self.fits[1].log_evidence - self.fits[0].log_evidence) / self.fit.repeats


@dataclass(frozen=True, slots=True, eq=False)
class SkinTurns:
    """The turns of all taxels that have pokes."""

    taxels: Mapping[int, Turn]
    noise: AxisNoise
    """Noise of forces and readings, and the usual ratio of gains."""
    pokes: Mapping[int, AxisPokes]

    @property
    def log_odds_mirrored(self) -> float:
        """Natural logarithm of the odds that the axes of all taxels are mirrored."""
        return float(sum(turn.log_odds_mirrored for turn in self.taxels.values()))

    @property
    def is_mirrored(self) -> bool:
        """Whether the axes of the skin are mirrored for certain."""
        return self.log_odds_mirrored > CERTAIN_LOG_ODDS


def pokes_by_taxel(contacts: Sequence[Contact]) -> dict[int, AxisPokes]:
    """Collect the readings of the taxels that each contact presses, with the force in the link frame.

    A taxel counts if it answers `MIN_SHARE_OF_STRONGEST` of the strongest one: near the edge of the tip the skin is pulled
    sideways. A reading with a value at an end of the range is left out.
    """
    rows: dict[int, list[ReadingOfForce]] = {}
    for contact in contacts:
        for channel, row in readings_of_contact(contact):
            rows.setdefault(channel, []).append(row)
    return {channel: as_pokes(own) for channel, own in sorted(rows.items())}


def readings_of_contact(contact: Contact) -> list[tuple[int, ReadingOfForce]]:
    """List the pressed taxels of a contact, each with force, reading and poke, as `pokes_by_taxel` has them."""
    if contact.vectors is None:
        return []
    force = contact.link_from_sensor[:3, :3] @ contact.force
    if not (np.isfinite(force).all() and force.any()):
        # Without a force sensor.
        return []
    is_pressed = contact.responses >= MIN_SHARE_OF_STRONGEST * contact.responses.max()
    usable = is_pressed & np.isfinite(contact.vectors).all(axis=1) & contact.vectors.any(axis=1)
    places = np.flatnonzero(usable).tolist()
    return [(int(contact.channels[place]), (force, contact.vectors[place], contact.poke)) for place in places]


def as_pokes(rows: Sequence[ReadingOfForce]) -> AxisPokes:
    """Gather the readings of a taxel."""
    forces, readings, numbers = zip(*rows, strict=True)
    return AxisPokes(np.array(forces), np.array(readings), np.array(numbers, dtype=np.int64))


def joined(pokes: Sequence[AxisPokes]) -> AxisPokes:
    """Join the pokes of taxels that share their axes."""
    forces, readings, numbers = ([getattr(each, name) for each in pokes] for name in AxisPokes.__slots__)
    return AxisPokes(np.concatenate(forces), np.concatenate(readings), np.concatenate(numbers))


def find_turns(pokes: Mapping[int, AxisPokes], force_noise: float) -> SkinTurns:
    """Fit the turn of every taxel in `pokes`; `force_noise` is the sd of each force component, N."""
    noise = find_noise(list(pokes.values()), force_noise)
    taxels = {channel: fit_group((channel,), own, noise) for channel, own in pokes.items()}
    return SkinTurns(taxels, noise, pokes)


def fit_group(channels: tuple[int, ...], pokes: AxisPokes, noise: AxisNoise) -> Turn:
    """Fit one turn to the pokes of taxels that share their axes.

    Taxels that one poke presses share the error of its force, so the covariance is that of the pokes, and not of the readings.
    """
    right, mirrored = fit_both_hands(pokes, noise)
    readings_per_poke = len(pokes) / len(np.unique(pokes.pokes))
    fits = _widened(right, readings_per_poke), _widened(mirrored, readings_per_poke)
    return Turn(channels, fits, 1.0 / readings_per_poke)


def _widened(fit: TurnFit, factor: float) -> TurnFit:
    """Multiply the covariance of a known turn by a factor."""
    return replace(fit, covariance=fit.covariance * factor) if factor > 1.0 and fit.is_in_plane_known else fit


def find_noise(groups: Sequence[AxisPokes], force_noise: float) -> AxisNoise:
    """Find the noise of the readings and the usual ratio of gains from all groups of pokes, each with axes of its own."""
    noise = AxisNoise(force_noise, 0.0, START_ANGULAR_NOISE)
    many = [pokes for pokes in groups if 2 * len(pokes) > UNKNOWNS_OF_TURN]
    if not many:
        # No group has a miss of its own.
        return noise
    noise = replace(noise, step=find_step([pokes.readings[:, 2] for pokes in many]))
    both: list[tuple[TurnFit, TurnFit]] = []
    starts: list[tuple[TurnFit, TurnFit] | None] = [None] * len(many)
    for _ in range(NOISE_ROUNDS):
        # Mirrored axes, too: else the noise of a mirrored skin would be the size of its mistake.
        both = [fit_both_hands(pokes, noise, start) for pokes, start in zip(many, starts, strict=True)]
        starts = [*both]
        fits: list[TurnFit] = [min(each, key=lambda fit: fit.cost) for each in both]
        noise = _likelier_noise(many, fits, noise)
    # One hand for all groups: they are of one kind. The likelier hand of each would have a correlation by chance.
    hand = int(sum(mirrored.cost - right.cost for right, mirrored in both) < 0)
    # Last: a fit with this ratio as its prior would confirm it.
    return with_usual_ratio(many, [each[hand] for each in both], noise)


def _likelier_noise(groups: Sequence[AxisPokes], fits: Sequence[TurnFit], noise: AxisNoise) -> AxisNoise:
    """Choose noise of readings or of directions, with the size that the median miss shows."""
    size = np.concatenate([np.linalg.norm(pokes.readings, axis=1) for pokes in groups])
    force_part = np.concatenate([fit.variances for fit in fits]) - (noise.reading / size) ** 2 - noise.angle**2
    spare = [(2 * len(fit.misses)) / (2 * len(fit.misses) - UNKNOWNS_OF_TURN) for fit in fits]
    misses = np.concatenate([fit.misses**2 * factor for fit, factor in zip(fits, spare, strict=True)])
    squares = np.concatenate([fit.misses**2 for fit in fits])
    # Readings of one poke share the error of its force.
    freedom = max(1, sum(2 * len(np.unique(pokes.pokes)) - UNKNOWNS_OF_TURN for pokes in groups))
    found: list[tuple[float, AxisNoise]] = []
    for shape, name in ((1.0 / size, "reading"), (np.ones(len(size)), "angle")):
        scale = _scale_of(misses, np.maximum(force_part, 0.0), shape)
        if freedom < MAX_FREEDOM_OF_MEAN:
            # Fits of few pokes take up single misses, so that the median is too small.
            scale = max(scale, _expected_scale(squares, np.maximum(force_part, 0.0), shape, freedom))
        variances = np.maximum(force_part, 0.0) + (scale * shape) ** 2
        # Of two normal directions each; capped, so that outliers do not decide.
        cost = float(np.sum(np.minimum(misses / variances, 16.0) + 2.0 * np.log(variances)))
        found.append((cost, replace(noise, **{"reading": 0.0, "angle": 0.0, name: scale})))
    return min(found, key=lambda each: each[0])[1]


def _scale_of(misses: FloatArray, force_part: FloatArray, shape: FloatArray) -> float:
    """Find the scale for which the squared misses (n,) have the median expected of variances `force_part` + (scale shape)^2."""
    low, high = 0.0, MAX_ANGULAR_NOISE / float(np.median(shape))
    for _ in range(60):
        middle = 0.5 * (low + high)
        variances = force_part + (middle * shape) ** 2
        if np.median(misses / np.maximum(variances, 1e-12)) > CHI2_2DOF_MEDIAN:
            low = middle
        else:
            high = middle
    return high


def _expected_scale(squares: FloatArray, force_part: FloatArray, shape: FloatArray, freedom: int) -> float:
    """Compute the root mean square of the scale, given the squared misses (n,) of fits that leave `freedom` degrees of freedom.

    The variances are those of `_scale_of`. Before, each scale up to `MAX_ANGULAR_NOISE` is equally likely. With few degrees of
    freedom the likeliest scale may be 0, and errors by it are too small.
    """
    highest = MAX_ANGULAR_NOISE / float(np.median(shape))
    scales = highest * np.linspace(0.0, 1.0, SCALES_TRIED) ** 2
    variances = np.maximum(force_part + (scales[:, None] * shape) ** 2, MIN_ANGULAR_NOISE**2)
    fitted = np.minimum(squares / variances, MAX_SQUARE_IN_SUM).sum(axis=1)
    log_likelihood = -0.5 * (fitted + freedom * np.log(variances).mean(axis=1))
    weights = np.exp(log_likelihood - log_likelihood.max()) * np.gradient(scales)
    return float(np.sqrt(weights @ scales**2 / weights.sum()))
