"""A real broker on this computer: mosquitto, in a process of its own."""

from __future__ import annotations

import shutil
import signal
import socket
import subprocess
import time

import pytest


class Mosquitto:
    """It can be ended, started again at its port, and kept from answering."""

    def __init__(self) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port: int = free.getsockname()[1]
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        assert COMMAND is not None
        self._process = subprocess.Popen(
            [COMMAND, "-p", str(self.port)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        until = time.monotonic() + 10.0
        while time.monotonic() < until:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", self.port)) == 0:
                    return
            time.sleep(0.005)
        raise TimeoutError("mosquitto does not listen")

    def stop(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait()

    def stall(self) -> None:
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        if self._process is not None:
            self._process.send_signal(signal.SIGCONT)


COMMAND = shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin:/usr/bin:/bin")

needs_mosquitto = pytest.mark.skipif(
    COMMAND is None, reason="needs mosquitto: apt install mosquitto"
)
