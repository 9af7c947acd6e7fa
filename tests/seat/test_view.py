"""``esair view``: what a viewer sees of a robot, by Foxglove's protocol; read only."""

import asyncio
import contextlib
import json
import struct
import types
from typing import Any

import attrs
import pytest
from tests.seat.conftest import Twist, Wander, eventually

import esair
from esair.cli._view import PROTOCOLS, VIEWERS, Views, show
from esair.journal import Journal, Kind
from esair.seat import connect
from esair.seat._visitor import FEEDS
from esair.seat._wire import Message

websockets = pytest.importorskip("websockets")

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("REC-6", "SEC-1")]


@attrs.frozen
class Turn:
    """One turn of a laser."""

    angles: tuple[float, ...]
    ranges: tuple[float, ...]


class Laser(esair.Sensor[Turn]):
    rate = 20.0

    async def read(self) -> Turn:
        return Turn((-0.1, 0.0, 0.1), (1.0, 2.0, 3.0))


class Camera(esair.Sensor[bytes]):
    rate = 20.0

    async def read(self) -> bytes:
        return b"x" * 10_000_000


class Looks(esair.Behavior):
    laser = esair.reads(Turn)
    camera = esair.reads(bytes)

    async def run(self) -> None:
        async for _ in self.laser:
            await self.camera.read()


@pytest.fixture
def viewed(rover):
    """Show a robot; gives it, and how to look at it."""

    @contextlib.asynccontextmanager
    async def make():
        robot = rover(Wander(), Looks(), resources=[Laser(), Camera()])
        async with robot:
            await robot.wheels.until(Twist(0.3, 0.0))
            with connect("rover") as client:
                views = Views("rover", ["https://mine.example.org"])
                showing = asyncio.create_task(show(client, views, 0))
                await eventually(lambda: views.port)

                def look(**options: Any) -> Any:
                    options = {"subprotocols": PROTOCOLS, "compression": None} | options
                    return websockets.connect(f"ws://127.0.0.1:{views.port}", **options)

                try:
                    yield robot, views, look
                finally:
                    showing.cancel()
                    await asyncio.wait([showing])

    return make


async def channels_of(link: Any, *topics: str) -> dict[str, Any]:
    """Take what is told until all topics are known."""
    found: dict[str, Any] = {}
    async with asyncio.timeout(10):
        while not found.keys() >= {*topics}:
            line = await link.recv()
            if isinstance(line, str):
                told = json.loads(line)
                for each in told.get("channels", ()):
                    found[each["topic"]] = each
    return found


async def test_a_viewer_sees_what_it_subscribes_to(viewed):
    """Values in the schemas that viewers know, commands with who gave them."""
    async with viewed() as (_, _, look), look() as link:
        hello = json.loads(await link.recv())
        assert hello["op"] == "serverInfo"
        assert hello["capabilities"] == []
        assert link.subprotocol == PROTOCOLS[0]
        found = await channels_of(link, "/sensor/laser", "/actuator/wheels")
        assert found["/sensor/laser"]["schemaName"] == "foxglove.LaserScan"
        assert json.loads(found["/sensor/laser"]["schema"])["properties"]["ranges"]
        subscriptions = [
            {"id": 7, "channelId": found["/sensor/laser"]["id"]},
            {"id": 8, "channelId": found["/actuator/wheels"]["id"]},
        ]
        await link.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))
        seen: dict[int, Any] = {}
        while len(seen) < 2:
            data = await asyncio.wait_for(link.recv(), 10.0)
            if isinstance(data, bytes):
                op, subscription, when = struct.unpack_from("<BIQ", data)
                assert op == 1
                assert when > 1e18
                seen[subscription] = json.loads(data[13:])
        assert seen[7]["ranges"] == [1.0, 2.0, 3.0]
        assert seen[8]["peer"] == "wander"


async def test_a_large_value_costs_nobody_anything(viewed):
    """Of 10 MB only that they came is shown; what is small goes on."""
    async with viewed() as (_, _, look), look() as link:
        found = await channels_of(link, "/sensor/camera")
        wanted = [{"id": 1, "channelId": found["/sensor/camera"]["id"]}]
        await link.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        while isinstance(data := await asyncio.wait_for(link.recv(), 10.0), str):
            pass
        assert json.loads(data[13:])["value"] is None
        assert len(data) < 1000


@pytest.mark.parametrize(
    "line",
    [
        b"\x01\x00\x00\x00\x00garbage",
        "garbage",
        "[" * 5000,
        "{}",
        '{"op": "subscribe"}',
        '{"op": "subscribe", "subscriptions": [{"id": "x", "channelId": []}]}',
        '{"op": "unsubscribe", "subscriptionIds": 3}',
        '{"op": "advertise", "channels": [{"id": 1, "topic": "/actuator/wheels"}]}',
        '{"op": "setParameters", "parameters": []}',
        '{"op": "subscribe", "subscriptions": [{"id": 1e999, "channelId": 1}]}',
    ],
)
async def test_nothing_can_be_done_there(viewed, line):
    """Publishing, setting, garbage: an answer that it is read only; it goes on."""
    async with viewed() as (robot, _, look), look() as link:
        await channels_of(link, "/actuator/wheels")
        await link.send(line)
        async with asyncio.timeout(10):
            while '"op": "status"' not in str(found := await link.recv()):
                pass
        assert "read only" in str(found)
        assert robot.wheels.commands[-1] == Twist(0.3, 0.0)


@pytest.mark.parametrize(
    ("headers", "good"),
    [
        ({}, True),
        ({"Origin": "https://app.foxglove.dev"}, True),
        ({"Origin": "https://mine.example.org"}, True),
        ({"Origin": "https://evil.example.org"}, False),
        ({"Origin": "null"}, False),
        ({"Host": "evil.example.org:8765"}, False),
    ],
)
async def test_strangers_pages_may_not_look(viewed, headers, good):
    """Origin and Host are checked: any page in a browser could come here."""
    async with viewed() as (_, views, _):
        head = {"Host": f"127.0.0.1:{views.port}", "Origin": None, **headers}
        lines = [
            "GET / HTTP/1.1",
            *(f"{name}: {value}" for name, value in head.items() if value),
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
            "Sec-WebSocket-Version: 13",
            f"Sec-WebSocket-Protocol: {PROTOCOLS[1]}",
        ]
        reader, writer = await asyncio.open_connection("127.0.0.1", views.port)
        writer.write("\r\n".join([*lines, "", ""]).encode())
        answer = await reader.readline()
        writer.close()
        assert (b" 101 " in answer) == good
        assert good or b" 403 " in answer


async def test_there_are_not_too_many(viewed):
    """One too many is told so; those who look are not disturbed."""
    async with viewed() as (_, _, look), contextlib.AsyncExitStack() as stack:
        links = [await stack.enter_async_context(look()) for _ in range(VIEWERS)]
        with pytest.raises(websockets.InvalidStatus) as error:
            await stack.enter_async_context(look())
        assert error.value.response.status_code == 429
        await channels_of(links[0], "/actuator/wheels")


async def test_who_does_not_read_is_looked_at_by_one_timer():
    """However often something happens meanwhile, there is one look at its room."""
    loop, journal = asyncio.get_running_loop(), Journal()
    console = types.SimpleNamespace(robot=types.SimpleNamespace(journal=journal))
    slow: Any = types.SimpleNamespace(
        console=console, gone=False, unread=1 << 20, dropped=0
    )
    journal.start(loop)
    feed = FEEDS["view"](slow, Message("a", "view", {}))
    feed.start()
    before = len(loop._scheduled)
    for number in range(50):
        journal.publish(Kind.READING, "laser", value=esair.Reading(1.0, 0.0, number))
    await eventually(lambda: slow.dropped == 49)

    assert len(loop._scheduled) - before <= 2  # the wait of this test is one
    slow.gone = True
    feed.stop()
