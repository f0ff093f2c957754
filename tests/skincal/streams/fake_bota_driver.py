"""As much of bota_driver 1.1.16 as is used; `test_command_links.py` holds it against the real one."""

import os
import time
from pathlib import Path


class _Settings:
    def __setattr__(self, name, value):
        if name not in self.FIELDS:
            raise AttributeError(name)
        self.__dict__[name] = value


def _settings(name, fields=""):
    return type(name, (_Settings,), {"FIELDS": tuple(fields.split()), "socket_communication_interface_params": None})


BotaDriverConfig = _settings(
    "BotaDriverConfig",
    "product_name serial_number communication_interface_name binary_communication_interface_params "
    "socket_communication_interface_params dummy_communication_interface_params genA_sensor_operation_params "
    "driver_operation_params",
)
BotaBinaryCommunicationInterfaceConfig = _settings("BotaBinaryCommunicationInterfaceConfig", "com_port baudrate")
BotaSocketCommunicationInterfaceConfig = _settings("BotaSocketCommunicationInterfaceConfig", "sensor_ip_address")
BotaDummyCommunicationInterfaceConfig = _settings("BotaDummyCommunicationInterfaceConfig")
GenASensorOperationConfig = _settings("GenASensorOperationConfig", "app_mode app_submode")
DriverOperationConfig = _settings("DriverOperationConfig", "runtime_verbosity")


class DataStatus:
    def __init__(self, throttled=0, overrange=0, invalid=0, raw=0):
        self.throttled, self.overrange, self.invalid, self.raw = throttled, overrange, invalid, raw


class BotaFrame:
    def __init__(self, status, force, torque, timestamp, temperature, acceleration, angular_rate):
        self.status, self.force, self.torque, self.timestamp = status, force, torque, timestamp
        self.temperature, self.acceleration, self.angular_rate = temperature, acceleration, angular_rate


class BotaDriver:
    def __init__(self, config):
        print("chatter on stdout", flush=True)  # noqa: T201
        os.write(1, b"chatter of C++\n")
        socket = config.socket_communication_interface_params
        if socket and socket.sensor_ip_address == "10.0.0.9":
            raise RuntimeError("Failed to open communication with the sensor")
        self._count = 0

    def configure(self):
        if hangs := os.environ.get("BOTA_HANGS"):
            Path(hangs).write_text(str(os.getpid()))
            time.sleep(60)
        return True

    def activate(self):
        return True

    def deactivate(self):
        Path(os.environ["BOTA_LEFT"]).write_text("deactivated")
        return True

    def shutdown(self):
        return True

    def read_frame_blocking(self):
        time.sleep(0.002)
        self._count += 1
        status = DataStatus(overrange=int(self._count == 5))
        return BotaFrame(status, [1.5, -2.25, 30.0], [0.125, -0.5, 0.0625], 2**32 - 4000 + 2000 * self._count, 36.5, [], [])
