"""What the devices on a node have in common."""

from __future__ import annotations

import collections
from collections.abc import Callable
from typing import Any

from canopen.objectdictionary import ObjectDictionary

from esair.drivers._on_can import can_bus
from esair.drivers.canopen._node import Emergency, Node, T, nodes_of_bus
from esair.exceptions import ConfigError, DeviceLostError
from esair.resources import Resource
from esair.values import check_seconds


class OnNode(Resource):
    """What the devices on a node have in common: they share its opening."""

    dictionary: ObjectDictionary
    """The objects of the node."""

    emergencies: collections.deque[Emergency]
    """What the node has told in emergency messages, the newest last; 16 are kept."""

    def _describe(self, node: int, heartbeat: float | None, sdo_timeout: float) -> None:
        if type(node) is not int or not 1 <= node <= 127:
            raise ConfigError(self.name, "node", f"expected 1 to 127, not {node!r:.80}")
        self.node = node
        self.heartbeat = heartbeat
        if heartbeat is not None and not 0.001 <= heartbeat <= 65.0:
            raise ConfigError(
                self.name, "heartbeat", f"expected 0.001 to 65 s, not {heartbeat!r}"
            )
        self.sdo_timeout = check_seconds(self.name, "sdo_timeout", sdo_timeout)
        self.emergencies = collections.deque(maxlen=16)
        self._link: Node | None = None

    async def is_set_up(self) -> bool:
        """Tell whether the node still runs, as far as its heartbeat shows it."""
        return self._link is not None and self._link.is_running

    def heed(self, emergency: Emergency) -> None:
        """Be told what the node says in an emergency message."""
        self.emergencies.append(emergency)

    def make_ready(self, remote: Any) -> None:
        """Tell the node what must be there before it is started, in its thread."""

    async def _join(self) -> Node:
        await self._part()
        bus = can_bus(self)
        nodes = nodes_of_bus.setdefault(bus, {})
        link = nodes.get(self.node)
        if link is None or not link.usable:
            link = nodes[self.node] = Node(bus, self.node)
        link.users.add(self)
        self._link = link
        await link.open(self)
        return link

    async def _part(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            await link.leave(self)

    async def _call(
        self,
        function: Callable[..., T],
        *args: Any,
        guard: Callable[[], bool] | None = None,
    ) -> T:
        link = self._link
        if link is None or link.remote is None:
            raise DeviceLostError(self.name, f"node {self.node} is not open")
        return await link.call(self, function, *args, guard=guard)
