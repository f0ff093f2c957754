"""A simulated robot that is asked over a port for targets, and its devices as a source for `simulation.serve.Server`."""

from __future__ import annotations

from typing import Any

from skincal.mesh.surface import Surface
from skincal.physics.devices import CONTROL_PERIODS_PER_SENT_BLOCK, RobotDevices
from skincal.physics.rig import SimulatedRobot
from skincal.physics.session import make_client
from skincal.robot.target_client import TargetClient


class PokingDevices(RobotDevices):
    """Devices of a robot that pokes the targets of a port.

    Parameters
    ----------
    surface : mesh of the part, for the way around it
    host, port : of the target server; the robot connects again and again until `close`
    """

    def __init__(self, robot: SimulatedRobot, surface: Surface, host: str, port: int) -> None:
        super().__init__(robot)
        self.client = make_client(robot, surface, lambda line: self._connection.say(line))
        self._connection = TargetClient(host, port, self.client.receive_line, (self.client.pace,), self.client.lose_connection)

    def advance(self) -> list[tuple[int, str, bytes]]:
        """Let the robot poke for one block, and encode its readings."""
        for _ in range(CONTROL_PERIODS_PER_SENT_BLOCK):
            self.client.run_period()
        return super().advance()

    def truth(self) -> dict[str, Any]:
        """Return the true taxels for `truth.json`."""
        return self._robot.truth()

    def close(self) -> None:
        """Disconnect from the target server."""
        self._connection.close()
