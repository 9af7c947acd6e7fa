"""Whether a robot has a seat for its operator, and when."""

from __future__ import annotations

from typing import TYPE_CHECKING

from esair.exceptions import ConfigError
from esair.loop import outside
from esair.messages import Operator, Page

if TYPE_CHECKING:
    from esair.seat import Seat
    from esair.standard._robot import Robot


class Seating:
    """The seat of a robot: there if somebody may sit in it, or once somebody types."""

    def __init__(
        self, name: str, *, socket: bool, page: Page | None, rights: Operator | None
    ) -> None:
        given = (("operator", rights, Operator), ("page", page, Page))
        for field, value, kind in given:
            if value is not None and not isinstance(value, kind):
                told = f"expected an esair.{kind.__name__}, not {value!r:.80}"
                raise ConfigError(f"robot {name!r}", field, told)
        if rights is not None:
            from esair.seat import check_rights

            check_rights(rights)
        self._name = name
        self.socket = socket
        self.page = page
        self.seat: Seat | None = None

    @property
    def is_wanted(self) -> bool:
        """Whether it is there from the start of the robot to its end."""
        return self.socket or self.page is not None

    def take(self, *, closed: bool) -> Seat:
        """Take its place, which nobody else may have, or none if it is closed."""
        from esair.seat import Seat

        socket, page = (False, None) if closed else (self.socket, self.page)
        self.seat = Seat(self._name, socket=socket, page=page)
        return self.seat

    async def start(self, robot: Robot) -> None:
        if self.seat is not None:
            self.seat.begin(robot)
            await outside(("seat", "start"), self.seat.start)

    async def typed(self, robot: Robot, text: str) -> str:
        if self.seat is None:
            self.take(closed=True).begin(robot)
        assert self.seat is not None
        return await self.seat.typed(text)

    def leave(self) -> None:
        if self.seat is not None:
            self.seat.leave()

    async def close(self) -> None:
        """Take no more acts, and let its place go."""
        if self.seat is not None:
            await self.seat.close()
