"""Nodes of python-can: this module and the two for its nodes know the package.

Where the interface is SocketCAN the event loop watches the socket, and frames are read
and written here: python-can makes two more system calls for each, fails on descriptors
above 1023, and takes four times as long. Every other interface gets a thread that reads,
and sends on the executor of the bus, because its ``send`` may block. Neither is python-can's
own Notifier, which goes silent after an error (python-can#1865).
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from typing import Any, Final

from esair.buses._opening import open_on
from esair.buses._stats import BusStats
from esair.buses.can import _interface as _can_interface
from esair.buses.can._errors import CanState
from esair.buses.can._frame import Frame, FrameLink, FrameOpener
from esair.buses.can._socket_node import FD, Owner, SocketNode, shut_bus
from esair.buses.can._thread_node import ThreadNode
from esair.exceptions import ConfigError, describe
from esair.loop import Executor

OPEN_TIMEOUT = 5.0
"""How long opening an interface may take, in seconds."""

_OWN_ERRORS: Final = frozenset(
    {"ixxat", "kvaser", "neovi", "nican", "nixnet", "pcan", "usb2can", "vector"}
)
"""Interfaces whose error frames have a form of their own, not that of the kernel."""


def python_can(
    interface: str,
    channel: str,
    *,
    executor: Executor,
    stats: BusStats | None = None,
    fd: bool = False,
    bitrate_switch: bool = False,
    **options: Any,
) -> FrameOpener:
    """Return what opens a node of one of python-can's interfaces.

    Args:
        interface: What python-can calls it.
        channel: Which of them.
        executor: The thread for the calls that may block; has the name of the bus.
        stats: Where frames are counted that were thrown away.
        fd: Whether frames may have up to 64 bytes.
        bitrate_switch: Whether the data of long ones are sent faster.
        **options: Further options of ``can.Bus``.
    """
    if fd:
        options = {**options, "fd": True}

    async def opener(
        received: Callable[[Frame], None], gone: Callable[[Exception], None]
    ) -> FrameLink:
        bus, state = await open_on(
            executor,
            _Opening(executor.name, interface, channel, options).make,
            lambda opened: shut_bus(opened[0]),
            timeout=OPEN_TIMEOUT,
        )
        owner = Owner(executor, stats or BusStats(), received, gone, fd, bitrate_switch)
        try:
            if state is not None:
                return SocketNode(bus, state, owner)
            return ThreadNode(
                bus,
                owner,
                echoes=bool(options.get("receive_own_messages")),
                decodes_errors=interface not in _OWN_ERRORS,
            )
        except BaseException:  # the executor may be stuck
            threading.Thread(target=shut_bus, args=(bus,), daemon=True).start()
            raise

    return opener


class _Opening:
    """One try to open an interface, on the executor."""

    def __init__(
        self, owner: str, interface: str, channel: str, options: dict[str, Any]
    ) -> None:
        self._owner = owner
        self._interface = interface
        self._channel = channel
        self._options = options

    def make(self) -> tuple[Any, CanState | None]:
        """Open the interface, blocking; its state is that of SocketCAN, or None."""
        bus = self._open()
        try:
            return bus, self._state(bus)
        except BaseException:
            shut_bus(bus)
            raise

    def _open(self) -> Any:
        import can

        if self._interface == "socketcan":
            # SocketcanBus forgets its descriptor when it cannot bind it.
            self._check(_can_interface.look_up(self._channel))
        try:
            return can.Bus(
                channel=self._channel, interface=self._interface, **self._options
            )
        except can.CanInterfaceNotImplementedError as error:
            known = ", ".join(sorted(can.VALID_INTERFACES))
            raise ConfigError(
                self._owner,
                "interface",
                f"{self._interface!r} cannot be used: {describe(error)}; "
                f"python-can knows {known}",
            ) from error
        except ImportError as error:
            raise ConfigError(
                self._owner,
                "interface",
                f"{self._interface!r} needs another package: {describe(error)}",
            ) from error
        except (TypeError, ValueError) as error:
            if isinstance(error, OSError):
                raise
            raise ConfigError(
                self._owner,
                "options",
                f"python-can's {self._interface!r} does not take them: {describe(error)}",
            ) from error
        except can.CanError as error:
            raise ConnectionError(describe(error)) from error

    def _state(self, bus: Any) -> CanState | None:
        if not _is_socket_can(bus):
            return None
        if bus.socket.family != socket.AF_CAN:  # a stand-in without the kernel's CAN
            return CanState.ACTIVE
        found = _can_interface.look_up(self._channel)
        self._check(found)
        return found.state

    def _check(self, found: _can_interface.Interface) -> None:
        if not found.is_up:
            raise ConnectionError(
                f"the interface is down: ip link set {self._channel} up"
            )
        wanted = self._options.get("bitrate")
        actual = found.bitrate  # rounded to what its clock can do
        if wanted and actual and abs(actual - wanted) > 0.05 * actual:
            raise ConfigError(
                self._owner,
                "bitrate",
                f"{self._channel} is set to {actual}, not {wanted}: ip link set"
                f" {self._channel} down, then up type can bitrate {wanted}",
            )
        if self._options.get("fd") and found.mtu < FD.size:
            raise ConfigError(
                self._owner,
                "fd",
                f"{self._channel} is not set up for CAN FD: "
                f"ip link set {self._channel} type can ... dbitrate ... fd on",
            )


def _is_socket_can(bus: Any) -> bool:
    try:
        from can.interfaces.socketcan import SocketcanBus
    except ImportError:  # not on this system
        return False
    return isinstance(bus, SocketcanBus)
