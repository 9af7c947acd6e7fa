"""A microcontroller on a fake serial line, that speaks in lines ``name=value``."""

from __future__ import annotations

from collections.abc import Callable

from esair.buses.serial import FakeSerial
from esair.drivers.line import LineError, decode_value, encode_value


class FakeBoard:
    """Has values by their names; tells them, and takes commands.

    Args:
        line: The line, with the framing of lines.
        values: What it measures, by name.
        commands: What it can be told, by name, with the values that it begins with.
        name: Who it says it is.
        ack: Whether it confirms commands.
        period: After how many seconds it tells all its values again; 0 for never.

    Attributes:
        values: What it measures now; change it.
        commands: What it was told last.
        silent: Whether it says and obeys nothing, as without power.
        refuse: Called with the name and the value of a command; the text that it
            returns is why the board refuses it, None lets it pass.
    """

    def __init__(
        self,
        line: FakeSerial,
        values: dict[str, float] | None = None,
        commands: dict[str, float] | None = None,
        *,
        name: str = "board",
        ack: bool = False,
        period: float = 0.0,
    ) -> None:
        self.values: dict[str, float] = values or {}
        self.commands: dict[str, float] = commands or {}
        self._at_start = dict(self.commands)
        self.name = name
        self.ack = ack
        self.silent = False
        self.refuse: Callable[[str, float], str | None] = lambda _key, _value: None
        line.on_frame = self.heard
        if period:
            line.repeat(self.report, period)

    def power_cycle(self) -> None:
        """Lose the power for a moment: what it was told is forgotten."""
        self.commands.update(self._at_start)

    def report(self) -> bytes:
        """Return a line for each value."""
        if self.silent:
            return b""
        return b"".join(
            encode_value(key, value) + b"\r\n" for key, value in self.values.items()
        )

    def heard(self, line: bytes) -> bytes | None:
        """Obey a line; return the answer."""
        if self.silent:
            return None
        if line.strip() == b"who?":
            return b"who=" + self.name.encode()
        if line.endswith(b"?"):
            key = line[:-1].decode("ascii", "replace")
            known = {**self.commands, **self.values}
            return encode_value(key, known[key]) if key in known else None
        try:
            key, value = decode_value(line)
        except LineError:
            return None
        if key not in self.commands:
            return None
        why = self.refuse(key, value)
        if why is None:
            self.commands[key] = value
        if not self.ack:
            return None
        if why is not None:
            return f"{key}!{why}".encode()
        return encode_value(key, value).replace(b"=", b":")
