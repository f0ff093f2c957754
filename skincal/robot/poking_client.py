"""Client of the target lines: an arm that pokes what skincal asks for, as a state machine.

A poke: travel outside the clearance hull, tare before the part, approach along the asked direction until something is felt,
press with force control until skincal says `held`, let go, and answer. `run_period` does one control period. It needs no port
and no clock of its own, so a study may run it in virtual time.

Safety: a force above the limit makes it let go. Without a fresh force reading it moves nowhere but away from the part. A new
target, `wait`, `stop` and a lost connection end every motion; a tip on the part lets go first.
"""

from __future__ import annotations

import queue
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise

import numpy as np

from skincal.geometry import FloatArray, crossed, length_of
from skincal.guide.robot_order import RobotPace
from skincal.mesh.surface import Surface
from skincal.robot import target_lines
from skincal.robot.aim_correction import AimCorrection
from skincal.robot.arm import PokingArm, TipCentre
from skincal.robot.clearance import Clearance, ViaPoint
from skincal.robot.target_lines import Answer, AnswerKind, AskedLine, Held, NoTarget, PartPlace, PokeTarget, Refused, RobotLine

OUT_OF_REACH = "out of reach"
WAY_BLOCKED = "the part is in the way"
FORCE_ABOVE_LIMIT = "the wanted force is above the robot's limit"
"""Reasons why a target is impossible, for `skip`."""
NOT_THERE = "the arm does not get there"
TOUCHED_EARLY = "something was touched before the place"
NOTHING_FELT = "nothing was felt at the place"
TOO_STRONG = "the force exceeded the limit"
NO_FRESH_READING = "no fresh force reading"
NOT_AWAY = "the arm does not get away from the part"
PRESSED_AT_REST = "something presses on the sensor while the arm stands still"
OTHER_FRAME = "the target is in the frame {}, this robot's part is {}"
"""Reasons why a target failed, for `fault`."""
MEASURE_AGAIN = "{count} targets in a row failed ({reason}): measure the tip and the pose of the part again"
REACH_CHECK_SPACING_M = 0.06
"""m, between the points of a way that the arm must reach."""
MIN_LENGTH_OF_MEAN_DIRECTION = 0.1
"""Two directions whose mean is shorter are opposite: nothing is known of the turn between them."""


@dataclass(frozen=True, slots=True)
class PokeSettings:
    """Speeds, distances and limits of a client, SI units."""

    clearance: float = 0.030
    """m, between the convex hull of the part and a travelling tip."""
    standoff: float = 0.012
    """m, before the place: from here on the tip is slow."""
    search: float = 0.012
    """m, behind the place, at which the search for the part ends."""
    travel_speed: float = 0.20
    enter_speed: float = 0.05
    """m/s, from the clearance to the standoff."""
    approach_speed: float = 0.015
    press_speed: float = 0.008
    retreat_speed: float = 0.08
    tare_s: float = 0.20
    touch_force: float = 1.0
    """N, filtered, at which the part is touched."""
    force_limit: float = 25.0
    """N, unfiltered, above the tare: the client lets go."""
    travel_force_limit: float = 8.0
    """N, the same away from the part: the tip backs off. A part that the arm carries weighs on its sensor; its controller has
    to compensate the weight."""
    back_off: float = 0.02
    """m, from something that the tip met on its way."""
    force_tolerance: float = 0.06
    """Share of the wanted force within which the client holds."""
    force_gain: float = 4.0
    """1/s, of the force control, for the measured stiffness of the contact."""
    across_gain: float = 2.0
    """1/s, the same across the push. The force there should be 0. An arm that yields sideways tilts the force by up to 30
    degrees, and the layer then answers 1 mm beside the force axis."""
    across_tolerance: float = 0.1
    """Share of the wanted force across the push within which the client holds."""
    across_way: float = 0.003
    """m, way of the tip across the push to let that force go. A tip that slides moves no farther."""
    filter_s: float = 0.02
    """s, time constant of the low-pass filter of the force along the push."""
    axis_filter_s: float = 0.1
    """s, time constant of the low-pass filter of the wrench from which the aim is corrected."""
    force_max_age_s: float = 0.10
    """s. Older readings allow no motion towards the part."""
    give_up_age_s: float = 1.0
    """s of old readings after which the client gives the target up."""
    held_wait_s: float = 1.5
    """s after the asked hold to wait for `held`."""
    settle_s: float = 4.0
    """s at most to reach the wanted force."""
    slip_share: float = 0.5
    """Share of the wanted force below which a held tip has slid."""
    arrive: float = 0.0015
    """m, from a goal at which it is reached."""
    late_s: float = 3.0
    """s after the expected arrival at which the arm does not get there."""
    frame: str = ""
    """Name of the part's frame: a target in another one is a fault. Empty: any frame."""
    corrects_aim: bool = True
    """The force axes of the pokes correct the robot's frame."""
    tip_report_s: float = 0.1
    max_failures: int = 3
    """Targets in a row that fail at the part before the client reports a fault."""


class Phase(Enum):
    """What the robot does at present; the value is its name."""

    IDLE = "waiting"
    TARE_AT_REST = "taring before the first motion"
    TRAVEL = "travelling"
    TARE = "taring"
    ENTER = "going to the part"
    APPROACH = "approaching"
    PRESS = "pressing"
    HOLD = "holding"
    RELEASE = "letting go"


AT_PART = (Phase.ENTER, Phase.APPROACH, Phase.PRESS, Phase.HOLD)
"""Phases near the part."""


@dataclass(frozen=True, slots=True, eq=False)
class PokePlan:
    """Places of one poke, for the tip's centre."""

    target: PokeTarget
    way: list[ViaPoint]
    """Points to travel; at the last one the client tares."""
    standoff: FloatArray
    """(3,) float, metres: from here on the tip is slow."""
    deepest: FloatArray
    """(3,) float, metres: end of the search."""
    speed: float
    """m/s, on the way."""


class PokingClient:
    """State machine of a robot that pokes.

    Parameters
    ----------
    surface : mesh of the part, for the way around it; `None` without one
    say : sends a line to skincal
    """

    def __init__(
        self, arm: PokingArm, surface: Surface | None, say: Callable[[RobotLine], object], settings: PokeSettings | None = None
    ) -> None:
        self.arm, self.settings = arm, settings or PokeSettings()
        self._say = say
        self._clearance = Clearance(surface, self.settings.clearance)
        self._lines: queue.SimpleQueue[AskedLine] = queue.SimpleQueue()
        self.phase = Phase.IDLE
        self._goal: PokeTarget | None = None
        """Target that is not planned yet."""
        self.locate_part: Callable[[FloatArray], object] | None = None
        """Takes the pose (4, 4) of the part in the base of the arm, metres, as skincal found it; `None` if the arm knows it."""
        self.prepare_arm: Callable[[PokeTarget], bool] | None = None
        """Called before a poke is planned, and says whether a person guides the tip; `None` if the arm always drives."""
        self._part: PartPlace | None = None
        """The newest one, which is not used yet."""
        self._plan: PokePlan | None = None
        self._answer: Answer | None = None
        """To send once the tip has let go."""
        self._since_s = self._expected_s = self._reported_s = arm.time_s
        self._newest_s = -np.inf
        """Time of the newest reading."""
        self._aim, self._shift = AimCorrection(), np.zeros(3)
        """Correction of the robot's frame, and the one of the present poke: true less believed position, (3,), metres."""
        self._tare = np.zeros(6)
        self._sum, self._count = np.zeros(6), 0
        self._wrench = np.zeros(6)
        """(6,) N and N m about the part's origin, above the tare, filtered."""
        self._off_force, self._excess, self.force = np.zeros(3), 0.0, 0.0
        """N: newest reading above the tare, (3,), and its size; and the filtered force along the push."""
        self._setpoint, self._out_direction = np.zeros(3), np.zeros(3)
        """Position of the tip to press with, or to draw back to, and its direction while it draws back."""
        self._touched_at = np.zeros(3)
        """Position of the tip when it felt the part."""
        self._is_held = self._is_tared = False
        self._failures = 0
        self._handlers: dict[Phase, Callable[[], object]] = {
            Phase.IDLE: self._idle,
            Phase.TARE_AT_REST: self._tare_at_rest,
            Phase.TRAVEL: self._travel,
            Phase.TARE: self._take_tare,
            Phase.ENTER: self._go_to_standoff,
            Phase.APPROACH: self._approach,
            Phase.PRESS: self._press,
            Phase.HOLD: self._hold_force,
            Phase.RELEASE: self._release,
        }

    @property
    def _present(self) -> PokePlan:
        """The present poke, in the phases that have one."""
        assert self._plan is not None
        return self._plan

    @property
    def pace(self) -> RobotPace:
        """Pace to greet skincal with, on every connection: then the guide asks for several tilts in a row."""
        own = self.settings
        poke_s = own.tare_s + own.clearance / own.enter_speed + own.standoff / own.approach_speed + 2.0
        return RobotPace(own.travel_speed, poke_s)

    def receive_line(self, line: AskedLine) -> None:
        """Take a line of skincal, from any thread."""
        self._lines.put(line)

    def lose_connection(self) -> None:
        """Stop until skincal is there again, from any thread."""
        self._lines.put(NoTarget.WAIT)

    def run_period(self) -> None:
        """Do one control period: read, decide, command, and advance the arm."""
        self._read_wrench()
        while not self._lines.empty():
            self._follow_line(self._lines.get())
        if self._check_safety():
            self._handlers[self.phase]()
        self._report_tip()
        self.arm.advance()

    # Lines

    def _follow_line(self, line: AskedLine) -> None:
        match line:
            case PokeTarget():
                if line.frame and self.settings.frame not in ("", line.frame):
                    self._goal = None
                    self._break_off()
                    self._say(Answer(AnswerKind.FAULT, line.number, OTHER_FRAME.format(line.frame, self.settings.frame)))
                    return
                if self._plan is not None and self._can_renumber(self._plan, line):
                    self._plan = replace(self._plan, target=line)
                    return
                self._goal = line
                self._break_off()
            case Held():
                # A jolt of the arm on its way may look like a held poke.
                is_pressing = self.phase in (Phase.PRESS, Phase.HOLD)
                self._is_held |= is_pressing and self._plan is not None and line.number == self._plan.target.number
            case PartPlace():
                self._part = line
            case NoTarget() | Refused():
                self._goal = None
                self._break_off()
            case _:
                pass

    def _can_renumber(self, plan: PokePlan, target: PokeTarget) -> bool:
        """Whether a target is the present one under a new number: a jolt of the arm may have ended the first request."""
        is_on_way = self.phase in (Phase.TRAVEL, Phase.TARE, Phase.ENTER) and not self._is_touching
        asked = np.concatenate([target.place - plan.target.place, target.push - plan.target.push])
        return is_on_way and not asked.any()

    def _break_off(self) -> None:
        """End the present poke; a tip that touches the part lets go first."""
        if self._is_touching:
            self._let_go(None)
        elif self.phase is not Phase.RELEASE:
            self.arm.stop()
            self._plan = None
            self._enter(Phase.IDLE)
        else:
            self._answer = None

    # Safety

    def _read_wrench(self) -> None:
        reading = self.arm.read_wrench()
        if reading is None or reading.time_s <= self._newest_s:
            return
        passed_s, self._newest_s = reading.time_s - self._newest_s, reading.time_s
        sensor = self.arm.link_from_sensor()[:3, 3]
        wrench = np.concatenate([reading.force, reading.moment + crossed(sensor, reading.force)])
        off = wrench - self._tare
        self._sum, self._count = self._sum + wrench, self._count + 1
        self._off_force, self._excess = off[:3], length_of(off[:3])
        self._wrench = self._wrench + (1.0 - np.exp(-passed_s / self.settings.axis_filter_s)) * (off - self._wrench)
        if self._plan is not None:
            share = 1.0 - np.exp(-passed_s / self.settings.filter_s)
            self.force += float(share * (off[:3] @ self._plan.target.push - self.force))

    @property
    def _is_touching(self) -> bool:
        is_felt = self.phase in AT_PART and self.force > self.settings.touch_force
        return is_felt or self.phase in (Phase.PRESS, Phase.HOLD)

    @property
    def _is_fresh(self) -> bool:
        return self.arm.time_s - self._newest_s <= self.settings.force_max_age_s

    @property
    def _is_too_strong(self) -> bool:
        return self._excess > (self.settings.force_limit if self.phase in AT_PART else self.settings.travel_force_limit)

    def _check_safety(self) -> bool:
        """Let go where the force is too large or unknown; return whether the present phase may go on."""
        if self._is_too_strong and self._is_tared and self.phase is not Phase.RELEASE:
            self._fail(TOO_STRONG)
            return False
        if self._is_fresh or self.phase in (Phase.IDLE, Phase.TARE_AT_REST, Phase.TARE, Phase.RELEASE):
            return True
        if self.phase in (Phase.PRESS, Phase.HOLD) or self.arm.time_s - self._newest_s > self.settings.give_up_age_s:
            self._fail(NO_FRESH_READING)
        else:
            self.arm.stop()
            # The time of waiting does not count.
            self._expected_s += self.arm.period_s
        return False

    # The arm, in the part's frame: corrected by what the pokes so far show.

    def _shift_for(self, target: PokeTarget) -> FloatArray:
        """Compute the shift across the push. Along it the search finds the part, and the force axes show little."""
        shift = self._aim.shift_at(target.place, self.arm.room_from_part())
        return shift - (shift @ target.push) * target.push

    def _read_tip(self) -> TipCentre:
        tip = self.arm.read_tip()
        return TipCentre(tip.position + self._shift, tip.direction)

    def _command(self, position: FloatArray, direction: FloatArray, speed: float) -> None:
        self.arm.command(position - self._shift, direction, speed)

    def _is_reachable(self, position: FloatArray, direction: FloatArray) -> bool:
        return self.arm.is_reachable(position - self._shift, direction)

    # Phases

    def _enter(self, phase: Phase, expected_s: float = 0.0) -> None:
        self.phase, self._since_s = phase, self.arm.time_s
        self._expected_s = self._since_s + expected_s

    def _go(self, position: FloatArray, speed: float) -> bool:
        """Command a motion along the poke's direction, or to a point of the way; return whether the tip is there."""
        plan = self._present
        direction = plan.way[0].direction if self.phase is Phase.TRAVEL else plan.target.push
        direction = self._out_direction if self.phase is Phase.RELEASE else direction
        self._command(position, direction, speed)
        tip = self._read_tip()
        is_turned = tip.direction @ direction > 0.999
        return length_of(tip.position - position) < self.settings.arrive and bool(is_turned)

    def _idle(self) -> None:
        if self._goal is None or not self._is_fresh:
            return
        if not self._is_tared:
            # Without a tare no force would stop a motion.
            self._begin_tare(Phase.TARE_AT_REST)
            return
        goal, self._goal = self._goal, None
        part, self._part = self._part, None
        if part is not None and self.locate_part is not None:
            # Not during a motion, whose points are in the frame of the part.
            self.locate_part(part.base_from_link)
        if self.prepare_arm is not None and self.prepare_arm(goal):
            self._say(target_lines.GuidedByHand(goal.number))
        self._shift = self._shift_for(goal)
        plan = self._plan_poke(goal)
        if isinstance(plan, str):
            self._say(Answer(AnswerKind.SKIP, goal.number, plan))
            return
        self._plan, self._is_held, self.force = plan, False, 0.0
        self._start_travel()

    def _plan_poke(self, target: PokeTarget) -> PokePlan | str:
        """Plan a poke, or give the reason why it is impossible."""
        own, push = self.settings, target.push
        if target.force >= own.force_limit:
            return FORCE_ABOVE_LIMIT
        touch = target.place - self.arm.tip_radius_m * push
        standoff, deepest = touch - own.standoff * push, touch + own.search * push
        out = self._clearance.exit_point(touch, push)
        if not all(self._is_reachable(place, push) for place in (touch, standoff, out)):
            return OUT_OF_REACH
        if not self._clearance.is_approach_free(target.place, out):
            return WAY_BLOCKED
        here = self._read_tip()
        start, way = here.position, list[ViaPoint]()
        if not self._clearance.is_outside(start):
            if self._clearance.is_straight_way_free(start, standoff, own.standoff / 2.0):
                # Near the part, as for the next poke at the same place.
                return PokePlan(target, [ViaPoint(standoff, push)], standoff, deepest, own.enter_speed)
            start = self._clearance.exit_point(start, here.direction)
            way.append(ViaPoint(start, here.direction))
        for around in self._clearance.ways(start, out):
            if self._can_follow([ViaPoint(start, here.direction), *around, ViaPoint(out, push)]):
                return PokePlan(target, [*way, *around, ViaPoint(out, push)], standoff, deepest, own.travel_speed)
        return OUT_OF_REACH

    def _can_follow(self, way: list[ViaPoint]) -> bool:
        """Whether the arm reaches the corners of a way and points between them."""
        for a, b in pairwise(way):
            count = 1 + int(length_of(b.position - a.position) / REACH_CHECK_SPACING_M)
            for share in np.arange(1, count + 1) / count:
                direction = (1.0 - share) * a.direction + share * b.direction
                size = length_of(direction)
                place = a.position + share * (b.position - a.position)
                if size > MIN_LENGTH_OF_MEAN_DIRECTION and not self._is_reachable(place, direction / size):
                    return False
        return True

    def _start_travel(self) -> None:
        plan, here = self._present, self._read_tip()
        way_s = length_of(plan.way[0].position - here.position) / plan.speed
        turn = float(np.arccos(np.clip(here.direction @ plan.way[0].direction, -1.0, 1.0)))
        self._enter(Phase.TRAVEL, way_s + 2.0 * turn)

    def _travel(self) -> None:
        plan = self._present
        if self._go(plan.way[0].position, plan.speed):
            if len(plan.way) > 1:
                plan.way.pop(0)
                self._start_travel()
                return
            self._begin_tare(Phase.TARE)
        elif self.arm.time_s > self._expected_s + self.settings.late_s:
            self._fail(NOT_THERE)

    def _begin_tare(self, phase: Phase) -> None:
        self._sum, self._count = np.zeros(6), 0
        self._enter(phase, self.settings.tare_s)

    def _has_tare(self) -> bool:
        """Use the mean of the readings as the tare once there are enough; return whether there are."""
        is_over = self.arm.time_s >= self._expected_s and self._is_fresh and self._count > 0
        if is_over:
            self._tare, self._excess, self.force, self._is_tared = self._sum / self._count, 0.0, 0.0, True
        return is_over

    def _tare_at_rest(self) -> None:
        if self._has_tare():
            self._enter(Phase.IDLE)

    def _take_tare(self) -> None:
        plan = self._present
        if self._has_tare():
            # A part that the arm carries has turned on its way.
            self._shift = self._shift_for(plan.target)
            self._enter(Phase.ENTER, 2.0 * self.settings.clearance / self.settings.enter_speed)

    def _go_to_standoff(self) -> None:
        plan = self._present
        if self.force > 2.0 * self.settings.touch_force:
            self._fail(TOUCHED_EARLY)
        elif self._go(plan.standoff, self.settings.enter_speed):
            way = self.settings.standoff + self.settings.search
            self._enter(Phase.APPROACH, way / self.settings.approach_speed)
        elif self.arm.time_s > self._expected_s + self.settings.late_s:
            self._fail(NOT_THERE)

    def _approach(self) -> None:
        plan, own = self._present, self.settings
        if self.force > own.touch_force:
            self._setpoint = self._touched_at = self._read_tip().position
            self._enter(Phase.PRESS, own.settle_s)
        elif self._go(plan.deepest, own.approach_speed) or self.arm.time_s > self._expected_s + own.late_s:
            self._fail(NOTHING_FELT)

    def _press(self) -> None:
        plan, own = self._present, self.settings
        missing = plan.target.force - self.force
        if self._is_pressed_well(missing):
            self._enter(Phase.HOLD, plan.target.hold + own.held_wait_s)
        elif self.arm.time_s > self._expected_s or self._is_held:
            self._let_go(Answer(AnswerKind.REACHED, plan.target.number))
        else:
            self._move_by_force(missing, own.press_speed)

    def _hold_force(self) -> None:
        plan, own = self._present, self.settings
        missing = plan.target.force - self.force
        is_over = self._is_held or self.arm.time_s > self._expected_s
        # A tip that has slid lets go, too: skincal sees that and says what it wants now.
        if is_over or self.force < own.slip_share * plan.target.force:
            self._let_go(Answer(AnswerKind.REACHED, plan.target.number))
        elif not self._is_pressed_well(missing):
            self._move_by_force(missing, own.press_speed / 4.0)

    def _across(self, vector: FloatArray) -> FloatArray:
        """Compute the part (3,) of a vector across the push."""
        push = self._present.target.push
        return vector - (vector @ push) * push

    def _is_pressed_well(self, missing: float) -> bool:
        """Whether the force along the push is right, but for `missing`, and the force across it small."""
        plan, own = self._present, self.settings
        is_along = abs(missing) < own.force_tolerance * plan.target.force
        is_across = length_of(self._across(self._wrench[:3])) < own.across_tolerance * plan.target.force
        return is_along and (is_across or length_of(self._across(self._setpoint - self._touched_at)) > 0.99 * own.across_way)

    def _move_by_force(self, missing: float, most: float) -> None:
        """Move the set point by the missing force, for the stiffness that is felt: along the push, and across it."""
        plan, own = self._present, self.settings
        push = plan.target.push
        depth = max(float((self._setpoint - self._touched_at) @ push), 0.5e-3)
        stiffness = max(self.force, own.touch_force) / depth
        speeds = own.force_gain * missing * push - own.across_gain * self._across(self._wrench[:3])
        size = max(length_of(speeds) / stiffness, 1e-9)
        self._setpoint = self._setpoint + self.arm.period_s * min(1.0, most / size) / stiffness * speeds
        aside = self._across(self._setpoint - self._touched_at)
        self._setpoint = self._setpoint - max(1.0 - own.across_way / max(length_of(aside), 1e-9), 0.0) * aside
        beyond = float((self._setpoint - plan.deepest) @ push)
        self._setpoint = self._setpoint - max(beyond - own.search, 0.0) * push
        self._command(self._setpoint, push, own.press_speed)

    def _let_go(self, answer: Answer | None) -> None:
        """Draw back along the push: to the standoff, or further out if the tip did not get there."""
        plan, own = self._present, self.settings
        is_reached = answer is not None and answer.kind is AnswerKind.REACHED
        if own.corrects_aim and is_reached and self.force > own.slip_share * plan.target.force:
            contact = self.arm.read_tip().position + self.arm.tip_radius_m * plan.target.push
            self._aim.add_poke(contact, self._wrench[:3], self._wrench[3:], self.arm.room_from_part())
        self._answer, self._setpoint = answer, plan.way[0].position if self.phase is Phase.ENTER else plan.standoff
        self._out_direction = plan.target.push
        self._enter(Phase.RELEASE, 2.0 * (own.clearance + own.search) / own.retreat_speed)

    def _release(self) -> None:
        plan = self._present
        if self._go(self._setpoint, self.settings.retreat_speed):
            self._failures = 0 if self._answer is not None and self._answer.kind is AnswerKind.REACHED else self._failures
            self._end_poke(self._answer)
        elif self.arm.time_s > self._expected_s + self.settings.late_s:
            self._end_poke(Answer(AnswerKind.FAULT, plan.target.number, NOT_AWAY))

    def _fail(self, reason: str) -> None:
        """End a poke that failed: at the part let go, else stop. After several in a row report a fault."""
        plan = self._plan
        if plan is None:
            # A touch between two pokes. After it the next target begins with a new tare.
            self.arm.stop()
            if self._goal is not None and self._is_fresh:
                self._say(Answer(AnswerKind.FAULT, self._goal.number, PRESSED_AT_REST))
                self._goal, self._is_tared = None, False
            return
        self._failures += 1
        answer = Answer(AnswerKind.SKIP, plan.target.number)
        if self._failures >= self.settings.max_failures:
            text = MEASURE_AGAIN.format(count=self._failures, reason=reason)
            answer, self._failures = Answer(AnswerKind.FAULT, plan.target.number, text), 0
        if self.phase in AT_PART and (self._is_touching or self._is_too_strong):
            self._let_go(answer)
        elif self._is_too_strong:
            self._back_off(answer)
        else:
            self.arm.stop()
            self._end_poke(answer)

    def _back_off(self, answer: Answer) -> None:
        """Draw back from something that the tip met on its way, against the force."""
        tip, own = self._read_tip(), self.settings
        away = -self._off_force / length_of(self._off_force)
        self._answer, self._setpoint, self._out_direction = answer, tip.position + own.back_off * away, tip.direction
        self._enter(Phase.RELEASE, 2.0 * own.back_off / own.retreat_speed)

    def _end_poke(self, answer: Answer | None) -> None:
        self._plan = self._answer = None
        self._enter(Phase.IDLE)
        if answer is not None:
            self._say(answer)

    def _report_tip(self) -> None:
        if self.arm.time_s - self._reported_s >= self.settings.tip_report_s:
            self._reported_s = self.arm.time_s
            tip = self.arm.read_tip()
            end = tip.position + self.arm.tip_radius_m * tip.direction
            self._say(target_lines.TipPose(end, tip.direction))
