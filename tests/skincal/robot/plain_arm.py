"""An arm without a physics engine: its tip goes where it is told, and a spring answers where it meets the part."""

import numpy as np

from skincal.mesh.search import nearest_points
from skincal.robot.arm import TipCentre, WrenchReading

STIFFNESS = 3000.0
WEIGHT = np.array([1.0, -7.0, 2.0])
"""N, what the sensor reads without a contact."""
SENSOR = np.eye(4)
SENSOR[:3, 3] = 0.01, -0.08, 0.02


class PlainArm:
    tip_radius_m, period_s = 0.002, 0.008

    def __init__(self, surface, start=(0.0, 0.0, 0.3), tip_error=(0.0, 0.0, 0.0)):
        self.surface, self.time_s, self.tip_error = surface, 0.0, np.array(tip_error)
        self.position, self.direction = np.array(start), np.array([0.0, 0.0, -1.0])
        self.goal, self.speed = None, 0.0
        self.sideways, self.stuck_at = np.zeros(3), None
        """m across the push for each metre that the tip presses in: the arm yields sideways."""
        self.is_silent, self.grip, self.reach, self.obstacle = False, 1.0, lambda _place, _direction: True, None
        self.wrench, self.course = WrenchReading(0.0, WEIGHT, np.zeros(3)), []

    def read_tip(self):
        return TipCentre(self.position, self.direction)

    def read_wrench(self):
        return self.wrench

    def link_from_sensor(self):
        return SENSOR

    def room_from_part(self):
        return np.eye(4)

    def is_reachable(self, position, direction):
        return self.reach(position, direction)

    def command(self, position, direction, speed_m_s):
        self.goal, self.speed = (position, direction), speed_m_s

    def stop(self):
        self.goal = None

    def contact(self):
        """Distance of the tip's outside from the part, the force on the part, and its place."""
        centre = self.position + self.tip_error
        (near,), (triangle,) = nearest_points(self.surface, centre[None])
        normal, away = self.surface.normals[triangle], centre - near
        gap = float(np.copysign(np.linalg.norm(away), away @ normal)) - self.tip_radius_m
        force = -self.grip * STIFFNESS * max(0.0, -gap) * normal
        self.stuck_at = None if gap >= 0 else centre if self.stuck_at is None else self.stuck_at
        if self.sideways.any() and self.stuck_at is not None:
            force = force + STIFFNESS * ([1.0, 1.0, 0.0] * (centre - self.stuck_at) + max(0.0, -gap) * self.sideways)
        if self.obstacle is not None and self.obstacle(centre):
            force = force + np.array([0.0, 0.0, -40.0])
        return gap, force, near

    def advance(self):
        self.time_s += self.period_s
        self.move()
        gap, force, near = self.contact()
        self.course.append((self.position, gap, float(np.linalg.norm(force))))
        if not self.is_silent:
            self.wrench = WrenchReading(self.time_s, WEIGHT + force, np.cross(near - SENSOR[:3, 3], force))

    def move(self):
        """Move the tip towards its goal for a period."""
        if self.goal is not None:
            way, turned = self.goal[0] - self.position, self.goal[1]
            size = np.linalg.norm(way)
            share = min(1.0, self.speed * self.period_s / size) if size else 1.0
            self.position = self.position + share * way
            direction = self.direction + min(1.0, max(share, 0.02)) * (turned - self.direction)
            if np.linalg.norm(direction) < 1e-3:
                direction = direction + np.array([0.01, 0.02, 0.0])
            self.direction = direction / np.linalg.norm(direction)
