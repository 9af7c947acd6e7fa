"""What the package for connections leaves behind."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from typing import Any

import pytest

from esair.buses.mqtt import MqttBus


@pytest.mark.real_clock
async def test_a_connection_that_is_cut_off_on_its_way_leaves_no_error_behind() -> None:
    """The robot ends while a broker that stands still has not answered yet."""
    pytest.importorskip("aiomqtt", reason="pip install 'esair[mqtt]'")
    told: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, each: told.append(each))
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        bus = MqttBus(name="house", host="127.0.0.1", port=port, timeout=0.3)
        with contextlib.suppress(OSError):
            await bus.open()
        (left,) = (e for e in asyncio.all_tasks() if e.get_name() == "mqtt connect")
        left.cancel()
        await asyncio.sleep(0.1)
        await bus.close()

    assert told == []
