"""A current MicroPython on an emulated Cortex-M3: 32-bit words, single floats."""

import importlib.util
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Self

FIRMWARE = Path(__file__).parent / "mps2-micropython-1.29p-192k.elf"
EMULATOR = "qemu-system-arm"


def why_not() -> str:
    """Return why the board cannot run here; nothing if it can."""
    if shutil.which(EMULATOR) is None:
        return f"no emulated board: apt-get install {EMULATOR}"
    if importlib.util.find_spec("mpremote") is None:
        return "no emulated board: pip install mpremote"
    return ""


class Board:
    """A board that runs while its context is open.

    Args:
        folder: Its files are those of the board.
        exact: Whether its clock counts instructions, 32 ns each: a cost that is
            measured there is the same on any machine.
    """

    def __init__(self, folder: Path, *, exact: bool = False) -> None:
        self._folder = folder
        self._exact = exact

    def __enter__(self) -> Self:
        self._files = Path(tempfile.mkdtemp())
        image = self._files / "files.romfs"
        pack = [sys.executable, "-m", "mpremote", "romfs", "-o", str(image)]
        subprocess.run(
            [*pack, "--no-mpy", "build", str(self._folder)],
            check=True,
            capture_output=True,
        )
        exact = ["-icount", "shift=5,sleep=off"] if self._exact else []
        self._process = subprocess.Popen(
            [
                *(EMULATOR, "-machine", "mps2-an385", "-nographic", "-monitor", "none"),
                *("-semihosting", "-serial", "stdio", *exact, "-kernel", str(FIRMWARE)),
                *("-device", f"loader,file={image},addr=0x21000000,force-raw=on"),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            bufsize=0,
        )
        self._until(b">>> ")
        self._write(b"\x01")
        self._until(b"exit\r\n>")
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.communicate()
        shutil.rmtree(self._files)

    def run(self, code: str, *, seconds: float = 120.0) -> str:
        """Run code on the board; return what it printed."""
        data = code.encode()
        for i in range(0, len(data), 16):  # its serial line has no flow control
            self._write(data[i : i + 16])
            time.sleep(0.002)
        self._write(b"\x04")
        self._until(b"OK", seconds)
        out = self._until(b"\x04", seconds)[:-1].decode()
        error = self._until(b"\x04")[:-1].decode()
        self._until(b">")
        if error:
            raise RuntimeError(out + error)
        return out.replace("\r\n", "\n")

    def _write(self, data: bytes) -> None:
        stdin: Any = self._process.stdin
        stdin.write(data)

    def _until(self, mark: bytes, seconds: float = 60.0) -> bytes:
        stdout: Any = self._process.stdout
        text, end = b"", time.monotonic() + seconds
        while not text.endswith(mark):
            left = end - time.monotonic()
            if left <= 0 or not select.select([stdout], [], [], left)[0]:
                raise TimeoutError(text[-2000:].decode(errors="replace"))
            byte = os.read(stdout.fileno(), 1)
            if not byte:
                raise EOFError(text.decode(errors="replace"))
            text += byte
        return text
