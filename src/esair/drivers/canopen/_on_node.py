"""What the devices on a node have in common."""

from __future__ import annotations

import collections
from collections.abc import Callable
from typing import Any, Required, TypedDict

from canopen.objectdictionary import ObjectDictionary

from esair.buses import CanBus
from esair.drivers._on_bus import shared
from esair.drivers.canopen._node import Emergency, Node, T
from esair.exceptions import ConfigError, DeviceLostError
from esair.resources import Resource
from esair.values import check_seconds, check_whole


class NodeSettings(TypedDict, total=False):
    node: Required[int]
    heartbeat: float | None
    sdo_timeout: float


class OnNode(Resource):
    """What the devices on a node have in common: they share its opening."""

    dictionary: ObjectDictionary
    """The objects of the node."""

    emergencies: collections.deque[Emergency]
    """What the node has told in emergency messages, the newest last; 16 are kept."""

    bus: CanBus
    deadline: float = 2.0

    def __init__(
        self,
        *,
        node: int,
        heartbeat: float | None = None,
        sdo_timeout: float = 0.3,
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        self.node: int = check_whole(self.name, "node", node, 1, 127)
        self.heartbeat = heartbeat
        if heartbeat is not None and not 0.001 <= heartbeat <= 65.0:
            raise ConfigError(
                self.name, "heartbeat", f"expected 0.001 to 65 s, not {heartbeat!r}"
            )
        self.sdo_timeout: float = check_seconds(self.name, "sdo_timeout", sdo_timeout)
        self.emergencies = collections.deque(maxlen=16)
        self._link: Node | None = None

    async def open(self) -> None:
        """Open the node."""
        await self.close()
        nodes = shared(self.bus, Node)
        link = nodes.get(self.node)
        if link is None or not link.usable:
            link = nodes[self.node] = Node(self.bus, self.node)
        link.users.add(self)
        self._link = link
        await link.open(self)

    async def close(self) -> None:
        """Leave the node."""
        link, self._link = self._link, None
        if link is not None:
            await link.leave(self)

    async def is_set_up(self) -> bool:
        """Tell whether the node still runs, as far as its heartbeat shows it."""
        return self._link is not None and self._link.is_running

    def heed(self, emergency: Emergency) -> None:
        """Be told what the node says in an emergency message."""
        self.emergencies.append(emergency)

    def make_ready(self, remote: Any) -> None:
        """Tell the node what must be there before it is started, in its thread."""

    def _connected(self) -> Node:
        if self._link is None or self._link.remote is None:
            raise DeviceLostError(self.name, f"node {self.node} is not open")
        return self._link

    @property
    def _remote(self) -> Any:
        """The node as the package canopen has it."""
        return self._connected().remote

    async def _call(
        self,
        function: Callable[..., T],
        *args: Any,
        guard: Callable[[], bool] | None = None,
    ) -> T:
        return await self._connected().call(self, function, *args, guard=guard)
