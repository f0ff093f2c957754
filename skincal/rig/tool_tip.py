"""Tip of a tool that carries the sensor: the point of the sensor's frame that all force axes pass.

The part moves under the tool, and the tip does not. So equation (5) of the paper, for one point and with all pokes, gives the
tip t in the sensor's frame:

    E_k (t - a_k) = 0,   noise D_k + sigma^2 I,

with a_k a point of the force axis of poke k in that frame, E_k two unit directions across its push, and D_k the sensor's noise
at t. sigma, found from the residuals, is the rolling of the ball on the part. Huber's weights leave out slips.

Only pushes that lean against each other show t along the mean push u, and noise of the force looks like a lean. With the sd s
of a force component, relative to the force, the expectation of E'E is E0'E0 + 2 s^2 u u', and that of E'E a is E0'E0 t. So the
noise's share 2 s^2 u u' is subtracted from the normal matrix (corrected least squares: W. A. Fuller, Measurement Error Models,
1987, section 3.1); otherwise t is drawn to the origin. A direction in which the lean is mostly noise is open, and the
covariance says so.

A tip that the scene gives is compared with it. One that is off by more than both errors and the usual cross-talk of a sensor
(`usual_errors`: 7 mm) is of another tool centre point, or the axes are not those of the tool's sensor. Axes that do not meet at
all come from a wrench in another frame than the tool's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, axis_point, orthonormal_pair
from skincal.model.scene import NoiseSettings
from skincal.rig.pivot import KNOWN_TIP_SD_M, TIP_MAX_CHI2
from skincal.rig.tip_frame import TIP_FRAME_MIN_POKES, TIP_SD_MIN_M, TipFrame, TipPokes, TipState
from skincal.rig.usual_errors import FORCE_TO_MOMENT_LENGTH_M, MATRIX_ERROR_SD
from skincal.taxels.noise import row_precision

TIP_SPREAD_MAX_M = 0.010
"""m, sigma above which the axes do not meet at one tip: a ball of 5 mm that leans by 40 degrees rolls by 3 mm."""
TOOL_TIP_MAX_SD_M = 0.005
"""m, largest sd of a found tip in any direction with which it is used."""
MISMATCH_MIN_M = 0.003
"""m. A smaller distance from the scene's tip is never named."""
TIP_PRIOR_SD_M = 0.5
"""m, of the tip from the sensor: no poking tool is longer."""
MIN_INFORMATION_OVER_NOISE_SHARE = 3.0
"""A direction with less is open. At 3 an error of the noise's variance by a quarter moves the tip by an eighth of its lever."""
NOISE_VARIANCE_SD = 0.25
"""Relative sd of the scene's variance of the force."""
FIT_STEPS = 20
HUBER_THRESHOLD_SDS = 2.5


@dataclass(frozen=True, slots=True, eq=False)
class AxesTip:
    """Point that the force axes pass, in the sensor's frame."""

    pokes: int
    place: FloatArray
    """(3,) float, metres: t."""
    covariance: FloatArray
    """(3, 3) float, m^2."""
    spread: float
    """m, each direction: sigma, the sd of an axis from it without the sensor's noise."""

    @property
    def sd(self) -> float:
        """m, in the worst direction."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance)[2]))

    @property
    def open_direction(self) -> FloatArray:
        """(3,) float, unit, sensor frame: the worst direction."""
        return np.linalg.eigh(self.covariance)[1][:, 2]

    @property
    def is_open(self) -> bool:
        """Whether the axes leave the tip open along a direction."""
        return self.sd > TOOL_TIP_MAX_SD_M

    @property
    def meets(self) -> bool:
        """Whether the axes meet at one tip."""
        return self.spread <= TIP_SPREAD_MAX_M

    def disagrees_with(self, place: FloatArray) -> bool:
        """Whether a known tip (3,), metres, sensor frame, differs by more than both errors and the usual ones of a sensor."""
        off = self.place - place
        # Cross-talk of the sensor moves the point where the axes meet, for a force of 1 N along each axis.
        usual = MATRIX_ERROR_SD * math.hypot(FORCE_TO_MOMENT_LENGTH_M, *place.tolist())
        error = self.covariance + (KNOWN_TIP_SD_M**2 + usual**2) * np.eye(3)
        return float(np.linalg.norm(off)) > MISMATCH_MIN_M and float(off @ np.linalg.solve(error, off)) > TIP_MAX_CHI2


@dataclass(frozen=True, slots=True, eq=False)
class ToolTip(TipFrame):
    """Tip of a tool, as the methods use it: a shift in the sensor's frame, without a rotation.

    `shift` is the tip. `covariance` has its error in its last three rows.
    """

    axes: AxesTip | None = None
    """Where the force axes meet; `None` with few pokes, and without a sensor."""
    known: FloatArray | None = None
    """(3,) float, metres, sensor frame: the scene's tip; `None` if it gives none."""

    def places(self, pokes: TipPokes) -> tuple[FloatArray, FloatArray]:
        """Give the tips that pokes have, (n, 3), metres, link frame, and (n, 3, 6) their gradients by the error of `shift`."""
        turns = pokes.link_from_sensor[:, :3, :3]
        return np.array(pokes.tip), np.concatenate([np.zeros_like(turns), turns], axis=2)

    @property
    def places_pokes(self) -> bool:
        """Whether the tip alone says where a poke is: a scene's tip is right to a millimetre, the axes of a sensor are not."""
        return self.state is TipState.USED and self.known is not None

    @property
    def is_given_alone(self) -> bool:
        """Whether nothing but the scene says where the tip is."""
        return self.axes is None and self.known is not None

    @property
    def is_mismatch(self) -> bool:
        """Whether the scene's tip is not where the force axes meet."""
        return self.known is not None and self.axes is not None and self.axes.meets and self.axes.disagrees_with(self.known)


def fit_axes_tip(contacts: Sequence[Contact], noise: NoiseSettings) -> AxesTip | None:
    """Fit the tip to the force axes of contacts; `None` below `TIP_FRAME_MIN_POKES`."""
    count = len(contacts)
    if count < TIP_FRAME_MIN_POKES:
        return None
    force = np.array([contact.force for contact in contacts])
    points = axis_point(force, np.array([contact.moment for contact in contacts]))
    sizes = np.linalg.norm(force, axis=1)
    pairs = orthonormal_pair(force / sizes[:, None])
    steps: list[tuple[FloatArray, float, FloatArray]] = [(np.zeros(3), TIP_SPREAD_MAX_M**2, np.ones(count))]
    covariance, prior = np.eye(3), np.eye(3) / TIP_PRIOR_SD_M**2
    lean_noise = 2.0 * (noise.force / sizes) ** 2
    pushes = force / sizes[:, None]
    for _ in range(FIT_STEPS):
        place, variance, trust = steps[-1]
        lever = np.broadcast_to(place, (count, 3))
        weights = row_precision(pairs, lever, sizes, np.full(count, variance), noise) * trust[:, None, None]
        pulls = pairs.transpose(0, 2, 1) @ weights
        noisy = np.sum(pulls @ pairs, axis=0)
        by_noise = (pushes.T * (lean_noise * np.trace(weights, axis1=1, axis2=2) / 2.0)) @ pushes
        shown = _shown_directions(noisy, by_noise)
        # The noise turns a direction that is dropped, about the origin.
        turned = (
            TIP_PRIOR_SD_M**2 * float(lean_noise.mean()) / (2.0 * count) * (shown if np.trace(shown) < 2.5 else 0.0 * shown)
        )
        inverse = np.asarray(np.linalg.inv(shown @ (noisy - by_noise) @ shown + prior), dtype=np.float64)
        place = inverse @ (shown @ np.sum(pulls @ (pairs @ points[:, :, None]), axis=0)[:, 0])
        unsure = NOISE_VARIANCE_SD * (inverse @ shown @ by_noise @ place)
        covariance = inverse @ (shown @ noisy @ shown + prior) @ inverse + np.outer(unsure, unsure) + turned
        misses = (pairs @ (place - points)[:, :, None])[:, :, 0]
        precision = row_precision(pairs, np.broadcast_to(place, (count, 3)), sizes, np.full(count, variance), noise)
        squares = np.einsum("ni,nij,nj->n", misses, precision, misses)
        trust = np.minimum(1.0, HUBER_THRESHOLD_SDS / np.sqrt(np.maximum(squares, 1e-12)))
        sensor = np.linalg.inv(row_precision(pairs, np.broadcast_to(place, (count, 3)), sizes, np.zeros(count), noise))
        freedom = (2.0 * count - 3.0) / (2.0 * count)
        seen = np.sum(misses**2, axis=1) / freedom - np.trace(sensor, axis1=1, axis2=2)
        steps.append((place, max(float(trust @ seen / trust.sum()) / 2.0, TIP_SD_MIN_M**2), trust))
    place, variance, _ = steps[-1]
    return AxesTip(count, place, covariance, float(np.sqrt(variance)))


def _shown_directions(noisy: FloatArray, by_noise: FloatArray) -> FloatArray:
    """Make the projection (3, 3) onto the directions that a normal matrix (3, 3) shows, with its share by noise (3, 3)."""
    axes = np.linalg.eigh(noisy)[1]
    whole, share = np.sum(axes * (noisy @ axes), axis=0), np.sum(axes * (by_noise @ axes), axis=0)
    shown = axes[:, whole > MIN_INFORMATION_OVER_NOISE_SHARE * share]
    return shown @ shown.T


def find_tool_tip(contacts: Sequence[Contact], noise: NoiseSettings, known: FloatArray | None, place_sd: float) -> ToolTip:
    """Find the tip of a tool that carries the sensor.

    Parameters
    ----------
    contacts : accepted and not excluded, in the order of their numbers; wrenches in the sensor's frame
    known : (3,) float, metres, sensor frame: the scene's tip; `None` if it gives none
    place_sd : m, each direction: sd of one place of the tip, by the poses of the tool
    """
    axes = fit_axes_tip(contacts, noise)
    none, eye = np.zeros(3), np.eye(3)
    tip = ToolTip(TipState.FEW_POKES, len(contacts), eye, none, none, np.zeros((6, 6)), place_sd, axes=axes, known=known)
    if axes is not None and (not axes.meets or tip.is_mismatch):
        return replace(tip, state=TipState.DISAGREES, tip_sd=axes.spread)
    if known is not None:
        return used_tip(tip, known, KNOWN_TIP_SD_M**2 * eye)
    if axes is None:
        return tip
    if axes.is_open:
        return replace(tip, state=TipState.AMBIGUOUS)
    return used_tip(tip, axes.place, axes.covariance)


def used_tip(tip: ToolTip, place: FloatArray, covariance: FloatArray) -> ToolTip:
    """Use a tip at a place (3,) with its covariance (3, 3), metres, sensor frame."""
    both = 1e-12 * np.eye(6)  # nothing turns, and its root must exist
    both[3:, 3:] += covariance
    return replace(tip, state=TipState.USED, shift=place, centre=place, covariance=both)
