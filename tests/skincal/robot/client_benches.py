"""Both clients that poke for a robot, on arms above a flat top, behind one face: what a client must do is written once.

`Program` is the program's client without a network, in periods of its arm. `Template` is the example for a robot of one's own,
in a thread, asked by the real target server.
"""

import importlib.util
import threading
import time
from contextlib import contextmanager

import numpy as np

from skincal.mesh.surface import make_surface
from skincal.model.scene import resource
from skincal.robot.poking_client import Phase, PokeSettings, PokingClient
from skincal.robot.target_lines import Answer, AnswerKind, NoTarget, PokeTarget, RobotPace, TipPose
from skincal.robot.target_server import TargetServer, open_port, parse_port
from tests.skincal.robot.plain_arm import PlainArm

PATIENCE_S = 60.0
DOWN = np.array([0.0, 0.0, -1.0])
STIFFNESS = 2000.0
HALF = np.array([0.03, 0.06, 0.02])
"""m, of the part of the program's client: a box."""


def box(*boxes):
    """A surface of boxes, each given by its middle and its half sides."""
    corner = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([[(a, b, c), (a, c, d)] for a, b, c, d in quads]).reshape(-1, 3)
    vertices = np.concatenate([middle + corner * half for middle, half in boxes])
    return make_surface(vertices, np.concatenate([faces + 8 * number for number in range(len(boxes))]))


BOX = box((np.zeros(3), HALF))


def load_example():
    spec = importlib.util.spec_from_file_location("poker", resource("examples/poker.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class FlatPart:
    """An arm above a flat part at height 0, in its own time, four times as fast: faster, its reports were a flood."""

    frame = "flat part"
    part = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

    def __init__(self):
        self.now_s, self.place, self.force_age_s, self.stiffness = 0.0, (0.0, 0.0, 0.2), 0.0, STIFFNESS
        self.course, self.reach, self.load = [], lambda _place: True, lambda _place: 0.0

    def monotonic(self):
        return self.now_s

    def sleep(self, seconds):
        self.now_s += seconds
        time.sleep(seconds / 4.0)

    def read(self):
        force = 3.0 + self.stiffness * max(0.0, -self.place[2]) + self.load(self.place)
        return self.place, force, self.force_age_s

    def move_tip(self, place, _push):
        self.course.append(place[2])
        self.place = place

    def can_reach(self, place, _push):
        return self.reach(place)


class Client:
    """What a client must do is asked here, whichever it is. Heights are in metres, of the tip's end above the top."""

    gave_up_kind: AnswerKind
    """Answer after a poke that was given up: only the program's client may be asked again for the place."""

    def said(self):
        """Kind and number of each answer so far."""
        return [(each.kind, each.number) for each in self.answers if isinstance(each, Answer)]

    def text(self):
        """Text of the last answer."""
        return [each.text for each in self.answers if isinstance(each, Answer)][-1]

    def until_answers(self, count=1):
        return self.until(lambda: len(self.said()) >= count)

    def until_pressed(self):
        return self.until(lambda: self.force() > 3.0)


class Program(Client):
    standoff_m, gave_up_kind = 0.012, AnswerKind.SKIP

    def __init__(self, surface=BOX, **options):
        self.arm, self.answers, self.tips = PlainArm(surface, **options), [], []
        self.client = PokingClient(self.arm, surface, self.hear, PokeSettings(frame="box"))

    def hear(self, line):
        (self.tips if isinstance(line, TipPose) else self.answers).append(line)

    def ask(self, number, frame="box", x=0.01):
        place = np.array([x, 0.02, HALF[2]])
        return self.say(PokeTarget(number, 3, place, DOWN, frame=frame, force=9.5, hold=0.6))

    def say(self, line):
        self.client.receive_line(line)
        return self

    def until(self, condition, limit_s=PATIENCE_S):
        end = self.arm.time_s + limit_s
        while not condition():
            assert self.arm.time_s < end, (self.client.phase, self.answers, self.arm.position)
            self.client.run_period()
        return self

    def until_phase(self, phase):
        return self.until(lambda: self.client.phase is phase)

    def rest(self, seconds):
        end = self.arm.time_s + seconds
        return self.until(lambda: self.arm.time_s >= end)

    @property
    def forces(self):
        return np.array([force for _, _, force in self.arm.course])

    def force(self):
        return self.arm.course[-1][2] if self.arm.course else 0.0

    def heights(self):
        return np.array([place[2] for place, _, _ in self.arm.course]) - HALF[2] - self.arm.tip_radius_m

    def largest_force(self):
        return self.forces.max()

    def is_at_rest(self):
        return self.client.phase is Phase.IDLE

    def limit_reach(self, x):
        self.arm.reach = lambda place, _direction: place[0] < x

    def silence(self, *, silent=True):
        self.arm.is_silent = silent

    def meet(self, height):
        self.arm.obstacle = lambda centre: centre[2] < HALF[2] + height

    def lose_skincal(self):
        self.client.lose_connection()


class Template(Client):
    gave_up_kind = AnswerKind.FAULT

    def __init__(self, server, arm):
        self.server, self.arm, self.answers, self.ended = server, arm, [], None
        self.example = load_example()
        self.example.time = self.arm
        self.poker, self.standoff_m = self.example.Poker(self.arm, server.host, server.port), self.example.STANDOFF
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self):
        try:
            self.poker.run()
        except ConnectionError as error:
            self.ended = error

    def ask(self, number, frame="flat part", x=0.01, push=DOWN):
        self.server.send([PokeTarget(number, 3, np.array([x, 0.02, 0.0]), push, frame=frame, force=9.5, hold=0.6)])
        return self

    def say(self, line):
        self.server.send([line])
        return self

    def until(self, condition):
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, (self.arm.place, self.answers)
            self.answers += [item for item in self.server.read_answers() if isinstance(item, (Answer, RobotPace, TipPose))]
            time.sleep(0.005)
        return self

    def rest(self, seconds):
        end = self.arm.now_s + seconds
        return self.until(lambda: self.arm.now_s >= end)

    def force(self):
        return self.arm.stiffness * max(0.0, -self.arm.place[2])

    def heights(self):
        return np.array(self.arm.course)

    def largest_force(self):
        return -self.arm.stiffness * min(self.arm.course)

    def is_at_rest(self):
        return self.arm.place[2] > self.standoff_m - 1e-9

    def limit_reach(self, x):
        self.arm.reach = lambda place: place[0] < x

    def silence(self, *, silent=True):
        self.arm.force_age_s = 1.0 if silent else 0.0

    def meet(self, height):
        self.arm.load = lambda place: 30.0 if place[2] < height else 0.0

    def lose_skincal(self):
        self.server.close()
        self.thread.join(PATIENCE_S)


@contextmanager
def template(arm=None):
    server = TargetServer(open_port(*parse_port("0")))
    try:
        client = Template(server, arm or FlatPart())
        yield client
        server.send([NoTarget.ENOUGH])
        client.thread.join(PATIENCE_S)
    finally:
        server.close()
