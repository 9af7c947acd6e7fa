"""The other end of the control socket: what the command line uses, without a loop."""

from __future__ import annotations

import contextlib
import itertools
import json
import select
import socket
import time
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Self

from esair.exceptions import BadValueError, EsairError, hint_for
from esair.seat._place import reach, robots
from esair.seat._wire import LIMIT, VERSION, encode

ANSWERS = 15.0
"""How long an answer is waited for unless its asker says otherwise, in seconds."""


class NoRobotError(EsairError, LookupError):
    """There is no such robot on this computer, or it is not clear which one is meant."""


class RefusedActError(EsairError):
    """The robot has not done what it was told.

    Attributes:
        kind: The name of the robot's error.
    """

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


class GoneError(EsairError, ConnectionError):
    """The robot has ended, or has cut the connection."""


def connect(name: str | None = None) -> Client:
    """Connect to a robot that runs on this computer.

    Args:
        name: Its name; may be left out if there is only one.

    Raises:
        NoRobotError: There is none of this name, or there are several.
    """
    found = robots()
    if name is None and len(found) == 1:
        (name,) = found
    if name is None:
        told = f"several robots run: {', '.join(found)}; say which: --robot NAME"
        raise NoRobotError(
            told
            if found
            else "no robot runs here with a control socket: esair run, esair sim or "
            "esair.Robot(socket=True) starts one"
        )
    if name not in found:
        told = f"no robot named {name!r:.80} runs here{hint_for(name, found)}"
        raise NoRobotError(told)
    return Client(name, found[name])


class Client:
    """A connection to one robot.

    Args:
        name: The name of the robot.
        path: Its socket.

    Raises:
        NoRobotError: Nobody answers there.
    """

    def __init__(self, name: str, path: Path) -> None:
        self.name = name
        try:
            self._link: socket.socket = reach(path)
        except OSError as error:
            raise NoRobotError(f"robot {name!r} cannot be reached: {error}") from None
        self._data = bytearray()
        self._ids = (f"{uuid.uuid4().hex[:16]}-{n}" for n in itertools.count(1))
        self.pushed: list[dict[str, Any]] = []
        """What came beside the answers: beats, pictures, events."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the connection."""
        self._link.close()

    def fileno(self) -> int:
        """Return the descriptor, to wait for it."""
        return self._link.fileno()

    def send(
        self,
        act: str,
        fields: Mapping[str, Any] | None = None,
        *,
        until: float | None = None,
    ) -> str:
        """Send an act, and do not wait for its outcome.

        Returns:
            Its id.
        """
        name = next(self._ids)
        message = {"v": VERSION, "id": name, "act": act, **(fields or {})}
        if until is not None:
            message["until"] = until
        try:
            line = encode(message)
        except ValueError:
            raise BadValueError(act, "", "expected finite numbers") from None
        if len(line) > LIMIT:
            raise BadValueError(act, "", f"expected at most {LIMIT} bytes")
        try:
            self._link.sendall(line)
        except OSError:
            raise GoneError(self._gone()) from None
        return name

    def do(
        self,
        act: str,
        fields: Mapping[str, Any] | None = None,
        *,
        timeout: float = ANSWERS,
    ) -> Any:
        """Do an act and return its result.

        Raises:
            RefusedActError: It was not done.
            GoneError: The robot has ended meanwhile.
            TimeoutError: It did not answer in time.
        """
        # A robot that is stuck shall not do later what nobody waits for any more; a
        # stop is always welcome.
        until = None if act == "stop" else time.monotonic() + timeout
        name = self.send(act, fields, until=until)
        end = time.monotonic() + timeout
        for found in self.lines(timeout):
            if time.monotonic() > end:
                break
            if "ok" in found and found.get("id") in {name, None}:
                if found["ok"]:
                    return found["result"]
                error = found["error"]
                raise RefusedActError(str(error["type"]), str(error["text"]))
            self.pushed.append(found)
            del self.pushed[:-1000]
        raise TimeoutError(f"robot {self.name!r} has not answered in {timeout:g} s")

    def lines(self, timeout: float | None = None) -> Iterator[dict[str, Any]]:
        """Yield what comes, until nothing has come for a time.

        Raises:
            GoneError: The robot has ended.
        """
        while True:
            while (end := self._data.find(b"\n")) >= 0:
                line = bytes(self._data[:end])
                del self._data[: end + 1]
                found = json.loads(line)
                if found.get("ended"):
                    raise GoneError(self._gone())
                yield found
            if not select.select([self._link], [], [], timeout)[0]:
                return
            data = b""
            with contextlib.suppress(OSError):
                data = self._link.recv(1 << 16)
            if not data:
                raise GoneError(self._gone())
            self._data += data

    def _gone(self) -> str:
        return f"robot {self.name!r} has ended"
