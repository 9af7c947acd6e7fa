"""The prompt of a board, over a line that damages bytes and a port that goes away.

What is asked carries a checksum and a number, and so does each answer: what was damaged
is asked again; what is asked may be done twice, and does the same then.
"""

from __future__ import annotations

import base64
import re
import time
from binascii import crc32
from typing import Final

from esair.drivers.board.wire import stuffed
from esair.exceptions import ConfigError
from esair.firmware._lines import Lines

PATIENCE: Final = 8.0
"""After so long without an answer, in seconds, a board counts as gone."""

_TRY: Final = 0.7
_AT_ONCE: Final = 256  # bytes; without flow control a board takes no more at once

_AGENT: Final = r"""
import binascii, hashlib, os, sys, machine
_n, _said, _file, _r = -1, "", None, None
def _sum(name):
    found = hashlib.sha256()
    with open(name, "rb") as file:
        while True:
            data = file.read(512)
            if not data:
                return binascii.hexlify(found.digest()).decode()
            found.update(data)
def _there(name):
    try:
        return bool(os.stat(name))
    except OSError:
        return False
def _clear(name):
    try:
        for each in os.listdir(name):
            _clear(name + "/" + each)
        os.rmdir(name)
    except OSError:
        try:
            os.remove(name)
        except OSError:
            pass
def _do(text):
    global _n, _said, _r
    try:
        data = binascii.a2b_base64(text)
    except ValueError:
        return
    if binascii.crc32(data[4:]) & 0xFFFFFFFF != int.from_bytes(data[:4], "little"):
        return
    n = int.from_bytes(data[4:6], "little")
    if n != _n:
        _r = None
        try:
            if data[6:7] == b"w":
                _file.seek(int.from_bytes(data[7:11], "little"))
                _file.write(data[11:])
            else:
                exec(data[7:].decode(), globals())
            _r = repr(_r)
        except Exception as error:
            _r = "!%r" % error
        _said = "%d %s" % (n, _r)
        _said = "%s %08x" % (_said, binascii.crc32(_said.encode()) & 0xFFFFFFFF)
        _n = n
    print("<<" + _said + ">>")
"""


def _harmless(kind: bytes, body: bytes) -> bytes:
    """Return a message of the link without a byte that a prompt takes for a control key.

    JSON and the link do not mind the spaces.
    """
    whole = (stuffed(kind + b" " * n + body) for n in range(32, 250))
    return next(each for each in whole if min(each.strip(b"\0")) >= 32)


_STOP: Final = (
    *(_harmless(b"q", b""), _harmless(b"B", b"1"), _harmless(b"Q", b"1")),
    b"\r\nroom\r\n",
)
"""What ends a program, safe: of each version of the link, and without it."""


class Prompt:
    """What a board without a program is told to do.

    Args:
        lines: Its serial line.
        name: Of its port, for errors.
    """

    def __init__(self, lines: Lines, name: str) -> None:
        self._lines = lines
        self._name = name
        self._number = 0
        self._heard = b""

    def enter(self, seconds: float) -> None:
        """End what runs, safe, and be at the prompt of the board.

        Raises:
            ConfigError: There is none.
        """
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._lines.write(b"\r\x03\x03")
            self._hear(0.1, whole=True)
            if self._is_raw():
                return
            # A linked board takes no Ctrl-C: its bytes may be in a message.
            for message in _STOP:
                self._lines.write(message)
            self._hear(0.3, whole=True)
        told = "the board does not come to its prompt: is it a MicroPython?"
        raise ConfigError("esair min deploy", self._name, told)

    def _is_raw(self) -> bool:
        """Have the prompt for programs, and on it what obeys them."""
        self._heard = b""
        self._lines.write(b"\r\x03\x01")
        for _ in range(10):
            self._hear(0.1)
            if b"raw REPL" in self._heard:
                break
        else:
            return False
        code = base64.b64encode(_AGENT.encode()).decode()
        self.send(
            "import binascii\n"
            f'_a = binascii.a2b_base64("{code}")\n'
            f"if binascii.crc32(_a) & 0xFFFFFFFF == {crc32(_AGENT.encode())}:\n"
            " exec(_a.decode())\n"
        )
        self._number = 0
        try:
            return self.ask("_r = 'here'", patience=1.5) == "'here'"
        except ConfigError:
            return False

    def ask(self, code: str, *, patience: float = PATIENCE) -> str:
        """Run code on the board; return what it leaves in ``_r``, as it is written.

        Raises:
            ConfigError: It raises an error, or the board does not answer.
        """
        return self._do(b"x" + code.encode(), patience)

    def write(self, at: int, data: bytes) -> None:
        self._do(b"w" + at.to_bytes(4, "little") + data, PATIENCE)

    def _do(self, body: bytes, patience: float) -> str:
        self._number += 1
        data = self._number.to_bytes(2, "little") + body
        text = base64.b64encode(crc32(data).to_bytes(4, "little") + data).decode()
        end = time.monotonic() + patience
        tries = 0
        while time.monotonic() < end:
            self._heard = b""
            if tries:  # what is left of a damaged one is thrown away
                self._lines.write(b"\r\x03\x03\x01" if tries % 2 else b"\r\x03")
                self._hear(0.05, whole=True)
            tries += 1
            self.send(f'_do("{text}")')
            again = time.monotonic() + _TRY + len(text) / 2000
            while time.monotonic() < again:
                self._hear(0.02)
                answer = self._answer()
                if answer is not None:
                    if answer[:1] == "!":
                        told = answer[1:].replace("OSError(28,)", "there is no room")
                        reason = f"{told} on the board, by {body[:60]!r}"
                        raise ConfigError("esair min deploy", self._name, reason)
                    return answer
                if b"NameError" in self._heard:
                    break
        told = (
            "the board does not answer any more: at its next start runs what ran before, "
            "or all of the new program"
        )
        raise ConfigError("esair min deploy", self._name, told)

    def _answer(self) -> str | None:
        for found in re.finditer(rb"<<((\d+) (.*?)) ([0-9a-f]{8})>>", self._heard):
            whole, number, said, check = found.groups()
            if int(number) == self._number and int(check, 16) == crc32(whole):
                return said.decode("utf-8", "replace")
        return None

    def send(self, code: str) -> None:
        """Let code run; nothing is said about it."""
        data = code.encode() + b"\x04"
        for at in range(0, len(data), _AT_ONCE):
            self._lines.write(data[at : at + _AT_ONCE])
            if at + _AT_ONCE < len(data):
                time.sleep(0.01)

    def _hear(self, seconds: float, *, whole: bool = False) -> None:
        """Listen until something comes, or for the whole time."""
        end = time.monotonic() + seconds
        while True:
            data = self._lines.take()
            self._heard = (self._heard + data)[-8192:]
            if (data and not whole) or time.monotonic() >= end:
                return
