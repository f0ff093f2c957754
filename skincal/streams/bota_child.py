"""Reader of newer Bota sensors (Gen A) by the maker's `bota-driver`, in a process of its own.

The driver is closed source, writes text to stdout and blocks in calls that nothing interrupts. The process writes its readings
to stdout as frames of the serial sensors (`skincal/devices/bota.py`), so that a session holds one kind of Bota bytes. The
driver's text goes to stderr; the last line there says why it ended. Source: docstrings of bota-driver 1.1.16, its simulated
sensor.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from importlib import import_module
from typing import Any, NoReturn

from skincal.devices.bota import DATA_STRUCT, INVALID, OVERRANGE, RAW, SKIPPED, crc_x25

INTERFACE_OF_KIND = {"socket": "Bota_Socket", "binary": "Bota_Binary", "dummy": "Bota_Dummy"}
"""Name of the driver's interface: Ethernet, serial port, the maker's simulated sensor."""
DEFAULT_MODE, DEFAULT_SUBMODE = 2, 7
"""As in the maker's example: force, torque, acceleration and angular rate."""
FAILURE_EXIT_CODE = 3
DRIVER_SHUTDOWN_MAX_S = 1.0
"""s for the driver to leave its sensor."""


def driver_config(bota: Any, settings: dict[str, Any]) -> Any:
    """Build the driver's configuration.

    Parameters
    ----------
    bota : the module `bota_driver`
    settings : `kind` of `INTERFACE_OF_KIND`, `place` (host or port); maybe `baud`, `mode`, `submode`, `product`, `serial`
    """
    config, sensor, driver = bota.BotaDriverConfig(), bota.GenASensorOperationConfig(), bota.DriverOperationConfig()
    kind, place = settings["kind"], settings["place"]
    config.communication_interface_name = INTERFACE_OF_KIND[kind]
    # The driver needs both, and only prints a remark if the sensor has others.
    config.product_name, config.serial_number = settings.get("product", "unknown"), settings.get("serial", "unknown")
    if kind == "socket":
        link = bota.BotaSocketCommunicationInterfaceConfig()
        link.sensor_ip_address = place
        config.socket_communication_interface_params = link
    elif kind == "binary":
        link = bota.BotaBinaryCommunicationInterfaceConfig()
        link.com_port = place
        if "baud" in settings:
            link.baudrate = settings["baud"]
        config.binary_communication_interface_params = link
    else:
        config.dummy_communication_interface_params = bota.BotaDummyCommunicationInterfaceConfig()
    sensor.app_mode, sensor.app_submode = settings.get("mode", DEFAULT_MODE), settings.get("submode", DEFAULT_SUBMODE)
    config.genA_sensor_operation_params = sensor
    driver.runtime_verbosity = False
    config.driver_operation_params = driver
    return config


def encode_frame(frame: Any) -> bytes:
    """Write a frame of the driver (N, N m, microseconds, degC) as one of the serial sensors."""
    said = frame.status
    bits = ((said.throttled, SKIPPED), (said.overrange, OVERRANGE), (said.invalid, INVALID), (said.raw, RAW))
    status = sum(bit for word, bit in bits if word)
    data = DATA_STRUCT.pack(status, *frame.force, *frame.torque, frame.timestamp % (1 << 32), frame.temperature)
    return b"\xaa" + data + crc_x25(data).to_bytes(2, "little")


def read_driver(bota: Any, settings: dict[str, Any], out: int) -> NoReturn:
    """Write the driver's readings to a file descriptor. Raises RuntimeError: the driver failed; OSError: nothing reads them."""
    driver = bota.BotaDriver(driver_config(bota, settings))
    try:
        if not (driver.configure() and driver.activate()):
            raise RuntimeError("the sensor does not start to send")
        while True:
            os.write(out, encode_frame(driver.read_frame_blocking()))
    finally:
        driver.deactivate()
        driver.shutdown()


def _leave(*_: object) -> NoReturn:
    sys.exit()


def _leave_with_parent() -> None:
    """End the process at the end of stdin, which the parent holds open."""
    sys.stdin.buffer.read()
    signal.raise_signal(signal.SIGTERM)
    time.sleep(DRIVER_SHUTDOWN_MAX_S)
    # A driver that hangs handles no signal.
    os._exit(FAILURE_EXIT_CODE)


def main(text: str) -> None:
    """Run until the parent ends the process or is gone."""
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    # So that `finally` of `read_driver` deactivates the sensor.
    signal.signal(signal.SIGTERM, _leave)
    out = os.dup(1)
    os.dup2(2, 1)
    try:
        read_driver(import_module("bota_driver"), json.loads(text), out)
    except (ImportError, RuntimeError, ValueError, TypeError, OSError) as error:
        sys.stderr.write(f"\n{' '.join(str(error).split())}\n")
        sys.stderr.flush()
        # At once: an orderly exit would let the driver print more lines.
        os._exit(FAILURE_EXIT_CODE)


if __name__ == "__main__":
    main(sys.argv[1])
