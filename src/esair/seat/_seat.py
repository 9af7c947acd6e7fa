"""The seat of one robot: what of it is there, from its start to its end."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from esair.exceptions import ConfigError, StoppingError, describe
from esair.seat._acts import act_of, coming_of
from esair.seat._operator import Console, Session
from esair.seat._place import Place
from esair.seat._socket import Socket

if TYPE_CHECKING:
    from esair.messages import Page
    from esair.seat._page import PageServer
    from esair.standard import Robot

_log = logging.getLogger("esair")


class Seat:
    """Where people operate a robot: typed lines, and the socket if it has one.

    Args:
        name: The name of the robot.
        socket: Whether it has a control socket.
        page: Where its page is served; None for nowhere.

    Raises:
        ConfigError: A robot of this name runs already, the folder for sockets
            belongs to somebody else, or a package of the page or its certificate is missing.
    """

    def __init__(self, name: str, *, socket: bool, page: Page | None = None) -> None:
        if page is not None:
            from esair.seat._page import import_packages

            import_packages()
            page.tls()  # what is wrong with it is told before anything moves
        self._wanted = page
        self._page: PageServer | None = None
        self._place = _place(name) if socket else None
        self._console: Console | None = None
        self._socket: Socket | None = None
        self._typing = Session("somebody who types")

    def begin(self, robot: Robot) -> None:
        """Take acts that are typed, from now on; and in a replay those of then."""
        self._console = Console(robot)

    async def start(self) -> None:
        """Let people in, after `begin`."""
        assert self._console is not None
        if self._place is not None:
            place, self._place = self._place, None
            self._socket = Socket(self._console, place)
            try:
                await self._socket.start()
            except OSError as error:
                _without(error)
                await self._socket.close()
                self._socket = None
        if self._wanted is not None:
            from esair.seat._page import PageServer

            self._page = PageServer(self._console, self._wanted)
            await self._page.start()

    @property
    def port(self) -> int | None:
        """The port of the page, if there is one."""
        return None if self._page is None else self._page.port

    def leave(self) -> None:
        """The robot begins to stop: nobody drives it any more."""
        if self._console is not None:
            self._console.close()

    async def close(self) -> None:
        """Take no more acts; clients are told that the robot has ended."""
        if self._place is not None:
            self._place.close()
        if self._page is not None:
            await self._page.close()
        if self._socket is not None:
            await self._socket.close()
        self._console = None

    async def typed(self, text: str) -> str:
        """Do what an operator types, and return the answer for people.

        Raises:
            ConfigError: The line is not understood.
            EsairError: As the act.
        """
        coming = coming_of(text)
        act, fields = act_of(text) if coming is None else (coming.act, {})
        if self._console is None:
            raise StoppingError("operator", "stopped")
        if coming is not None:
            return await self._console.bring(coming, self._typing)
        return act.tells(await self._console.do(act.name, fields, self._typing))


def _place(name: str) -> Place | None:
    try:
        return Place(name)
    except ConfigError:
        raise
    except OSError as error:
        _without(error)
        return None


def _without(error: OSError) -> None:
    """There is no place for a socket: the robot runs without, and says so."""
    _log.warning("there is no control socket: %s", describe(error))
