"""The control socket: what comes in, who comes in, and what the wheels are told."""

import asyncio
import enum
import fcntl
import json
import math
import os
import socket
import stat
import subprocess
import sys
import threading

import attrs
import numpy as np
import pytest
from tests.patience import within
from tests.seat.conftest import STILL, Twist, Wander, eventually, held

import esair
from esair import messages, seat
from esair.seat import CLIENTS, LIMIT
from esair.seat._place import Place

pytestmark = pytest.mark.real_clock

MOVES = Twist(0.3, 0.0)


class Lamp(esair.Actuator[float]):
    safe = 0.0
    power = esair.setting(0.5, unit="W", min=0.0, max=2.0)

    def __init__(self, **options) -> None:
        super().__init__(**options)
        self.applied: list[float] = []

    async def apply(self, power: float) -> None:
        self.applied.append(power)

    async def write(self, command: float) -> None:
        pass

    @esair.operation
    async def blink(self, times: int) -> int:
        return times + 1


@pytest.mark.promise("OPS-1")
async def test_the_socket_is_for_this_user_alone(rover, sockets):
    """0600 in a folder of 0700; gone when the robot has stopped."""
    async with rover():
        path = sockets / "rover.sock"
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert stat.S_IMODE(sockets.stat().st_mode) == 0o700
    assert not path.exists()


@pytest.mark.promise("OPS-1", "OPS-3")
async def test_a_stop_from_outside_stops_the_wheels(rover, raw):
    """The halt latch: the wheels are told safe, nothing follows, each has answered."""
    async with rover(Wander()) as robot, raw() as client:
        await robot.wheels.until(MOVES)

        answer = await client.do("1", "stop", reason="a cat")

        assert robot.wheels.commands[-1] == STILL
        (told,) = answer["result"]["told"]
        assert (told["resource"], told["safe"], told["answered"]) == (
            "wheels",
            True,
            True,
        )
        count = len(robot.wheels.commands)
        await asyncio.sleep(0.2)
        assert len(robot.wheels.commands) == count
        assert robot.halted == "a cat"

        assert (await client.do("2", "resume"))["ok"]
        await robot.wheels.until(MOVES)


@pytest.mark.promise("OPS-3")
async def test_a_device_that_does_not_answer_is_not_acknowledged(rover, raw):
    """The stop is told of each device whether it answered."""
    async with rover(Wander()) as robot, raw() as client:
        await robot.wheels.until(MOVES)
        robot.wheels.stall()

        answer = await client.do("1", "stop")

        (told,) = answer["result"]["told"]
        assert not told["answered"]
        assert told["error"]
        robot.wheels.resume()


@pytest.mark.promise("OPS-1", "OPS-3")
async def test_a_stop_is_done_whatever_its_id(rover, raw):
    """A script may give each of its lines the same id; nobody is told an old stop."""
    async with rover(Wander()) as robot, raw() as client:
        for _ in range(2):
            await robot.wheels.until(MOVES)
            assert (await client.do("one", "stop"))["ok"]
            assert robot.wheels.commands[-1] == STILL
            robot.resume()


@pytest.mark.promise("OPS-3")
async def test_a_stop_is_done_whatever_is_said_with_it(rover, raw):
    """What it does not know, or cannot read, keeps nobody from stopping the robot."""
    async with rover(Wander()) as robot, raw() as client:
        await robot.wheels.until(MOVES)
        answer = await client.do("1", "stop", reason=7, hurry=True)
        assert answer["ok"]
        assert robot.wheels.commands[-1] == STILL


@pytest.mark.promise("OPS-3")
@pytest.mark.parametrize("until", [-5, 0.0, "soon"])
async def test_no_stop_comes_too_late(rover, raw, until):
    """Who says so of each of its lines, by another clock, stops the robot all the same."""
    async with rover(Wander()) as robot, raw() as client:
        await robot.wheels.until(MOVES)
        assert (await client.do("1", "stop", until=until))["ok"]
        assert robot.wheels.commands[-1] == STILL


@pytest.mark.promise("OPS-1", "OPS-3")
async def test_who_says_no_more_hears_the_outcome(rover, raw):
    """A script sends its lines and their end: each has an answer, a stop per device."""
    async with rover(Wander()) as robot, raw() as client:
        await robot.wheels.until(MOVES)
        client.send({"id": "1", "act": "list"})
        client.send({"id": "2", "act": "stop"})
        client.writer.write_eof()

        assert (await client.answer("1"))["ok"]
        (told,) = (await client.answer("2"))["result"]["told"]
        assert told["answered"]
        assert await client.is_closed()


@pytest.mark.promise("OPS-1")
async def test_who_says_no_more_is_not_kept_for_ever(rover, raw, monkeypatch):
    """An answer that is long in coming holds no place for a client that may be gone."""
    monkeypatch.setattr("esair.seat._socket.LAST_WORDS", 0.1)
    async with rover(Wander()), raw() as client:
        put = {"receiver": "wander", "data": 1, "interval": 60.0}
        client.send({"id": "1", "act": "put", **put})
        client.writer.write_eof()

        assert await client.is_closed()


@pytest.mark.promise("OPS-1")
async def test_an_id_is_that_of_one_act(rover, raw):
    """Another act with it is refused, and not taken for the first one."""
    async with rover(Wander()) as robot, raw() as client:
        assert (await client.do("one", "resume"))["ok"]
        refused = await client.do("one", "remove", name="wander")
        assert "id: it was that of resume" in refused["error"]["text"]
        assert (await client.do("three", "stop"))["ok"]
        refused = await client.do("three", "resume")
        assert "id: it was that of stop" in refused["error"]["text"]
        robot.resume()
        assert (await client.do("two", "list"))["result"] == ["wander: running"]


@pytest.mark.promise("OPS-1")
@pytest.mark.fault("H11", "H18")
async def test_the_same_id_is_done_once(rover, raw):
    """Asked again, by another connection too, an id has the outcome that it had."""
    lamp = Lamp()
    async with rover(resources=[lamp]):
        async with raw() as client:
            first = await client.do("once", "set", setting="lamp.power", value=1.0)
            again = await client.do("once", "set", setting="lamp.power", value=2.0)
            assert first == again
        async with raw() as client:
            assert (
                await client.do("once", "set", setting="lamp.power", value=1.5) == first
            )
            client.send(
                {"id": "gone", "act": "set", "setting": "lamp.power", "value": 0.1}
            )
            await asyncio.sleep(0.05)
        async with raw() as client:
            found = await client.do("gone", "set", setting="lamp.power", value=0.9)
            assert found["result"]["value"] == 0.1
    assert lamp.applied == [1.0, 0.1]


@pytest.mark.promise("OPS-2")
@pytest.mark.fault("H04")
async def test_a_setting_is_told_with_unit_and_limits(rover, raw):
    """The answer has the value that was applied; a wrong one names what is allowed."""
    lamp = Lamp()
    async with rover(resources=[lamp]) as robot, raw() as client:
        found = (await client.do("1", "set", setting="lamp.power", value=2))["result"]
        assert (found["value"], found["unit"], found["max"]) == (2.0, "W", 2.0)
        for number, (value, expected) in enumerate(
            ((3.0, "at most 2"), (True, "number"), ("x", "number"))
        ):
            wrong = await client.do(
                f"w{number}", "set", setting="lamp.power", value=value
            )
            assert expected in wrong["error"]["text"]
        wrong = await client.do("2", "set", setting="lamp.powr", value=1.0)
        assert "power" in wrong["error"]["text"]
        assert robot.resources.query("lamp").settings["power"] == 2.0
        assert not [r for r in robot.resources.query("lamp").users if r == "operator"]


GARBAGE = [
    (b"\xff\xfe\n", "UTF-8; byte 0"),
    (b"{\n", "character"),
    (b"[1]\n", "an object"),
    (b'{"v":1,"id":"x","act":"put","data":"\\ud800","receiver":"a"}\n', "surrogate"),
    (b"[" * 60_000 + b"\n", "levels"),
    (b'{"v":1,"id":"x","act":"status","a":' + b"[" * 20 + b"]" * 20 + b"}\n", "levels"),
    (b'{"v":' + b"9" * 5000 + b"}\n", "64 bit"),
    (b'{"v":NaN}\n', "finite"),
    (b'{"v":1e999}\n', "finite"),
    (b'{"v":-Infinity}\n', "finite"),
    (b'{"v":1,"v":1}\n', "twice"),
    (b'{"v":2,"id":"x","act":"status"}\n', "expected 1"),
    (b'{"v":1,"id":7,"act":"status"}\n', "64 printable"),
    (b'{"v":1,"id":"\\u001b","act":"status"}\n', "64 printable"),
    (b'{"v":1,"id":"x","act":"explode"}\n', "explode"),
    (b'{"v":1,"id":"x","act":"status","more":1}\n', "no such field"),
    (b'{"v":1,"id":"x","act":"remove","name":"../../etc"}\n', "letter"),
    (b'{"v":1,"id":"x","act":"remove","name":"a\\u0000b"}\n', "letter"),
    (b"x" * (1 << 20) + b"\n", f"{LIMIT} bytes"),
]


@pytest.mark.promise("OPS-1", "OPS-2")
async def test_a_limit_that_is_infinite_is_told_as_none(rover, raw):
    """JSON has no infinity: the picture, a setting and a lease have an answer all the same."""

    class Winch(esair.Actuator[float]):
        safe = 0.0
        limits = (np.int64(0), math.inf)  # type: ignore[assignment]
        pull = esair.setting(1.0, min=0.0, max=math.inf)

        async def write(self, command: float) -> None:
            pass

    async with rover(resources=[Winch()]), raw() as client:
        answers = [
            await client.do("1", "status"),
            await client.do("2", "set", setting="winch.pull", value=2.0),
            await client.do("3", "lease", actuator="winch"),
        ]

        assert [each["ok"] for each in answers] == [True] * 3
        assert (answers[1]["result"]["min"], answers[1]["result"]["max"]) == (0.0, None)
        assert answers[2]["result"]["axes"] == {"": [0.0, 1.0]}


@pytest.mark.promise("OPS-1")
@pytest.mark.fault("H01", "H02", "H03", "H04", "H05", "H16")
async def test_garbage_has_an_answer_and_nothing_else_suffers(rover, raw):
    """What is wrong is told; the same connection and the others work on."""
    async with rover(Wander()) as robot, raw() as client, raw() as other:
        for line, expected in GARBAGE:
            client.send(line)
            answer = await client.hear()
            assert not answer["ok"]
            assert expected in answer["error"]["text"], line[:60]
        assert (await client.do("ok", "status"))["ok"]
        assert (await other.do("ok", "status"))["result"]["robot"] == "rover"
        await robot.wheels.until(MOVES)


@pytest.mark.fault("H02")
async def test_a_line_without_an_end_costs_no_memory(rover, raw):
    """100 MB without a line end: one answer, and nothing is kept of it."""
    import tracemalloc

    async with rover(), raw() as client:
        piece = b"y" * (1 << 20)
        tracemalloc.start()
        for _ in range(100):
            client.send(piece)
            await client.writer.drain()
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        client.send(b"\n")
        assert "bytes" in (await client.hear())["error"]["text"]
        assert (await client.do("ok", "status"))["ok"]
        assert peak < 16 << 20


@pytest.mark.fault("H07")
async def test_a_half_line_is_not_waited_for(rover, raw, monkeypatch):
    """Who does not end its line in time is cut off, with a word."""
    monkeypatch.setattr("esair.seat._socket.HALF_LINE", 0.2)
    async with rover(), raw() as client:
        client.send(b'{"v":1,')
        assert "whole line" in (await client.hear())["error"]["text"]
        assert await client.is_closed()


@pytest.mark.promise("OPS-1")
async def test_whole_lines_without_a_pause_are_no_half_line(raw, rover, monkeypatch):
    """Each comes in time, though there is always one that is not over yet."""
    monkeypatch.setattr("esair.seat._socket.HALF_LINE", 0.1)
    begin, end = b'{"v":1,"id":"1",', b'"act":"status"}\n'
    async with rover(), raw() as client:
        client.send(begin)
        for _ in range(30):
            client.send(end + begin)
            assert (await client.hear())["ok"]
            await asyncio.sleep(0.01)


@pytest.mark.promise("SEC-1")
@pytest.mark.fault("H08")
async def test_one_lane_is_kept_for_stop(rover, raw):
    """At most 16 clients; one more can still stop the robot, and do nothing else."""
    async with rover(Wander()) as robot:
        await robot.wheels.until(MOVES)
        clients = [raw() for _ in range(CLIENTS)]
        for each in clients:
            await each.__aenter__()
            assert (await each.do("s", "status"))["ok"]

        async with raw() as late:
            refused = await late.do("1", "status")
            assert refused["error"]["type"] == "BusyError"
            assert robot.halted is None
            assert (await late.do("2", "stop"))["ok"]
            assert robot.wheels.commands[-1] == STILL
        for each in clients:
            await each.__aexit__()


@pytest.mark.promise("SEC-1")
@pytest.mark.fault("H08")
async def test_who_only_sits_in_the_lane_for_stop_gives_way(rover, raw):
    """Fifty that are idle keep nobody from stopping the robot."""
    async with rover(Wander()) as robot:
        await robot.wheels.until(MOVES)
        idle = [raw() for _ in range(50)]
        for each in idle:
            await each.__aenter__()

        async with raw() as late:
            assert (await late.do("1", "stop"))["ok"]
            assert robot.wheels.commands[-1] == STILL
        for each in idle:
            await each.__aexit__()


@pytest.mark.promise("SEC-1")
@pytest.mark.fault("H06")
async def test_a_client_that_never_reads_is_cut_off(rover, raw):
    """It costs a bounded buffer, then its connection; the others go on."""
    async with rover(Wander()) as robot, raw() as good:
        lazy = socket.socket(socket.AF_UNIX)
        lazy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        lazy.connect(str(raw().path))
        lazy.setblocking(False)
        line = b'{"v":1,"id":"x","act":"help"}\n'
        ended = False
        for _ in range(20_000):
            try:
                lazy.send(line)
            except BlockingIOError:
                await asyncio.sleep(0.01)
            except OSError:
                ended = True
                break
            if _ % 100 == 0:
                await asyncio.sleep(0.01)
        lazy.close()
        assert ended
        assert robot.journal.counts()["socket"]["cut_off"] == 1
        assert (await good.do("1", "stop"))["ok"]
        assert robot.wheels.commands[-1] == STILL


@pytest.mark.promise("SEC-1")
async def test_a_slow_client_gets_the_newest_only(rover, raw):
    """Pictures that nobody has read yet are not followed by more."""
    lamps = [Lamp(name=f"lamp_{number}") for number in range(40)]
    async with rover(resources=lamps) as robot:
        lazy = socket.socket(socket.AF_UNIX)
        lazy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        lazy.connect(str(raw().path))
        lazy.send(b'{"v":1,"id":"w","act":"watch","every":0.1}\n')
        await asyncio.sleep(0.05)
        client_limit = robot._seat.seat._socket
        for client in client_limit.there:
            link = client.transport.get_extra_info("socket")
            link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2048)
        await eventually(lambda: robot.journal.counts()["socket"]["dropped"])
        (client,) = client_limit.there
        assert client.transport.get_write_buffer_size() < 64 * 1024
        lazy.close()


@pytest.mark.promise("OPS-1", "TURN-5")
async def test_who_looks_does_no_act(rover, raw):
    """The counter of acts is of what was done to the robot."""
    async with rover() as robot, raw() as client:
        for number, act in enumerate(("status", "stop", "status")):
            assert (await client.do(str(number), act))["ok"]
        assert robot.journal.counts()["operator"]["acts"] == 1


@pytest.mark.promise("OPS-1", "TURN-4")
async def test_who_looks_without_end_does_not_hold_the_loop(rover, raw):
    """What comes at once is done for some, and refused to the rest: each has an answer."""
    async with rover() as robot, raw() as client:
        lines = [{"v": 1, "id": f"l{n}", "act": "status"} for n in range(100)]
        client.writer.write("".join(json.dumps(each) + "\n" for each in lines).encode())
        done: dict[str, bool] = {}
        while len(done) < 100:
            told = json.loads(await client.reader.readline())
            if "ok" in told:
                done[told["id"]] = told["ok"]
        assert 16 < sum(done.values()) < 100
        assert robot.journal.counts()["operator"]["refused"] > 0


@pytest.mark.promise("OPS-1", "TURN-4")
@pytest.mark.parametrize(
    "flood",
    [
        b"\n" * 200_000,
        b"{" + b"".join(b'"%d":1,' % n for n in range(6000)) + b'"5999":1}\n',
    ],
    ids=["lines", "keys"],
)
async def test_who_pours_holds_the_loop_for_a_moment(rover, raw, flood):
    """Many lines at once, a line of many keys: they are looked at piece by piece."""
    async with rover() as robot, raw() as client:
        async with held() as stretches:
            client.send(flood)
            await client.writer.drain()
            await asyncio.sleep(0.3)
        assert max(stretches) < 0.06
        async with raw() as hand:
            assert (await hand.do("1", "stop"))["ok"]
        assert robot.halted


@pytest.mark.promise("OPS-3")
@pytest.mark.long
async def test_a_flood_of_settings_does_not_delay_a_stop(rover, raw):
    """1,000 settings a second beside it: the wheels are safe within 20 ms."""
    lamp = Lamp()
    late: list[float] = []
    loop = asyncio.get_running_loop()
    async with (
        rover(Wander(), resources=[lamp]) as robot,
        raw() as flood,
        raw() as hand,
    ):
        ended = asyncio.Event()

        async def pour() -> None:
            number = 0
            while not ended.is_set():
                for _ in range(10):
                    number += 1
                    flood.send(
                        {
                            "id": f"f{number}",
                            "act": "set",
                            "setting": "lamp.power",
                            "value": number % 20 / 10,
                        }
                    )
                await asyncio.sleep(0.01)

        async def drain() -> None:
            while await flood.reader.readline():
                pass

        work = [asyncio.create_task(pour()), asyncio.create_task(drain())]
        for number in range(50):
            await robot.wheels.until(MOVES)
            begun = loop.time()
            hand.send({"id": f"s{number}", "act": "stop"})
            await robot.wheels.until(STILL)
            late.append(loop.time() - begun)
            await hand.answer(f"s{number}")
            await hand.do(f"r{number}", "resume")
        ended.set()
        flood.writer.close()
        await asyncio.gather(*work, return_exceptions=True)
    assert len(lamp.applied) > 100
    late.sort()  # a computer with other work to do may be late itself, not each time
    assert within(0.020, late[len(late) // 10]), late


@pytest.mark.fault("H12")
async def test_what_came_too_late_is_not_done(rover, raw):
    """An act whose time has passed is refused, not done."""
    lamp = Lamp()
    now = asyncio.get_running_loop().time()
    async with rover(resources=[lamp]), raw() as client:
        late = await client.do(
            "1", "set", setting="lamp.power", value=1.0, until=now - 1.0
        )
        assert late["error"]["type"] == "BehaviorUnavailableError"
    assert lamp.applied == []


@pytest.mark.promise("SEC-1")
@pytest.mark.fault("H09")
@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
async def test_another_user_is_turned_away(rover, sockets, tmp_path, caplog):
    """Even where the folder lets it in: the peer's credentials decide."""
    async with rover(Wander()) as robot:
        for path in (*tmp_path.parents, tmp_path, sockets):
            if (
                path != path.parent
                and os.stat(path).st_uid == 0
                and "pytest" in str(path)
            ):
                os.chmod(path, 0o755)
        os.chmod(sockets / "rover.sock", 0o666)
        code = (
            "import os, socket, sys\n"
            "os.setuid(65534)\n"
            "s = socket.socket(socket.AF_UNIX); s.connect(sys.argv[1])\n"
            'try: s.send(b\'{"v":1,"id":"1","act":"stop"}\\n\')\n'
            "except BrokenPipeError: pass\n"
            "print(s.makefile().read())\n"
        )
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-c", code, str(sockets / "rover.sock"),
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip
        out, err = await process.communicate()
        answer = json.loads(out.decode() or "{}")
        assert answer.get("error", {}).get("type") == "AccessDeniedError", err
        assert robot.halted is None
    assert "user 65534 was turned away" in caplog.text


@pytest.mark.promise("OPS-1")
@pytest.mark.fault("O18", "H17")
async def test_a_second_robot_of_the_name_is_refused(rover, raw):
    """A live socket is never taken over; the first robot does not notice."""
    async with rover(Wander()) as robot:
        with pytest.raises(esair.ConfigError, match="runs already"):
            async with rover():
                pass
        async with raw() as client:
            assert (await client.do("1", "stop"))["ok"]
        assert robot.wheels.commands[-1] == STILL
    async with rover():
        pass


@pytest.mark.promise("OPS-1")
async def test_who_looks_for_robots_keeps_none_from_starting(sockets):
    """A look has the lock of a dead robot for an instant; its next start is not refused."""
    sockets.mkdir(mode=0o700)
    with (sockets / "rover.lock").open("wb") as lock:
        fcntl.flock(lock, fcntl.LOCK_SH)  # as a look does
        release = threading.Timer(0.01, lambda: fcntl.flock(lock, fcntl.LOCK_UN))
        release.start()

        Place("rover").close()

        release.join()


@pytest.mark.fault("O18")
async def test_a_start_that_fails_gives_the_name_back(
    rover, raw, tmp_path, monkeypatch, caplog
):
    """At any point of it: the next start of the same name is not refused."""
    taken = socket.create_server(("127.0.0.1", 0))
    page = esair.Page(port=taken.getsockname()[1])
    with pytest.raises(esair.ConfigError, match="cannot be had"):
        async with rover(page=page):
            pass
    taken.close()
    with monkeypatch.context() as missing:
        missing.setitem(sys.modules, "foxglove", None)
        with pytest.raises(esair.ConfigError, match=r"esair\[record\]"):
            async with rover(record=esair.Recording(tmp_path)):
                pass
    (tmp_path / "esair" / "rover.sock").mkdir()
    async with rover():  # it runs without
        pass
    assert "there is no control socket" in caplog.text
    (tmp_path / "esair" / "rover.sock").rmdir()
    async with rover(), raw() as client:
        assert (await client.do("1", "status"))["ok"]


@pytest.mark.fault("H17")
async def test_a_stale_socket_is_replaced_and_a_link_is_not_followed(
    rover, raw, sockets
):
    """What a dead robot left goes; a folder that is a link is refused."""
    sockets.mkdir(mode=0o755)
    dead = socket.socket(socket.AF_UNIX)
    dead.bind(str(sockets / "rover.sock"))
    dead.close()
    async with rover(), raw() as client:
        assert (await client.do("1", "status"))["ok"]
        assert stat.S_IMODE(sockets.stat().st_mode) == 0o700
    elsewhere = sockets.parent / "elsewhere"
    sockets.rename(elsewhere)
    sockets.symlink_to(elsewhere)
    with pytest.raises(esair.ConfigError, match="link"):
        async with rover():
            pass


@pytest.mark.promise("OPS-2")
@pytest.mark.fault("H10")
async def test_the_operator_has_rights_of_its_own(rover, raw):
    """What [operator] does not allow is refused; looking and stopping always go."""
    rights = esair.Operator(allow=("set",))
    async with rover(Wander(), operator=rights) as robot, raw() as client:
        assert (await client.do("1", "status"))["ok"]
        assert (await client.do("2", "stop"))["ok"]
        refused = await client.do("3", "resume")
        assert refused["error"]["type"] == "AccessDeniedError"
        assert "set" in refused["error"]["text"]
        refused = await client.do("4", "remove", name="wander")
        assert "'operator' may not remove 'wander'" in refused["error"]["text"]
        assert robot.halted is not None


def test_what_may_be_allowed_is_what_there_is() -> None:
    """The acts that `Operator` knows by name are those of the seat."""
    assert set(messages.ACTS) == set(seat.ACTS)


@pytest.mark.promise("OPS-2")
async def test_what_an_operator_does_is_in_the_journal(rover, raw):
    """Each act is an event in the name of the operator; looking is none."""
    seen: list[esair.journal.Event] = []
    async with rover(Wander()) as robot, raw() as client:
        robot.journal.listen(seen.append, kinds=[esair.journal.Kind.OPERATOR])
        await client.do("1", "status")
        await client.do("2", "remove", name="wander")
    (event,) = seen
    assert (event.component, event.peer) == ("wander", "operator")
    assert event.value["act"] == "remove"


@pytest.mark.promise("SEC-1")
async def test_a_secret_setting_is_never_shown(rover, raw, caplog):
    """Neither in a picture, nor in the answer, the journal or the log."""
    caplog.set_level("DEBUG")
    seen: list[esair.journal.Event] = []

    class Radio(Lamp):
        key = esair.setting("none", secret=True)

        async def apply(self, **_: object) -> None:  # type: ignore[override]
            pass

    radio = Radio(name="radio")
    async with rover(resources=[radio]) as robot, raw() as client:
        robot.journal.listen(seen.append)
        done = await client.do("1", "set", setting="radio.key", value="hunter2")
        assert done["ok"]
        picture = await client.do("2", "status")
    assert radio.key == "hunter2"
    assert "hunter2" not in f"{done} {picture} {seen} {caplog.text}"


@pytest.mark.promise("OPS-2")
async def test_only_a_bus_of_the_robot_is_told_as_one(rover, raw, tmp_path):
    """A driver may call something else its bus: a file's name is a path, and may be no text."""

    class Stranger:
        name = tmp_path
        outlet = None

    lamp = Lamp(name="lamp")
    async with rover(resources=[lamp]), raw() as client:
        lamp.bus = Stranger()
        answer = await client.do("1", "status")
    (row, _) = answer["result"]["resources"]
    assert (row["name"], row["bus"], row["medium"]) == ("lamp", None, None)


@pytest.mark.promise("OPS-2")
async def test_an_operation_of_a_device_is_called(rover, raw):
    """Typed, with its result; a wrong one is told."""
    async with rover(resources=[Lamp()]), raw() as client:
        blink = {"resource": "lamp", "operation": "blink"}
        done = await client.do("1", "operate", **blink, fields={"times": 2})
        assert done["result"] == 3
        wrong = await client.do("2", "operate", **blink, fields={"times": "x"})
        assert "times" in wrong["error"]["text"]


class Speed(enum.Enum):
    """How fast a lift goes."""

    SLOW = "slow"
    QUICK = "quick"


class Lift(esair.Actuator[float]):
    """Goes up, at a speed that JSON has no word for."""

    safe = 0.0
    pace = esair.setting(Speed.SLOW)
    code = esair.setting("")

    async def write(self, command: float) -> None:
        pass

    async def apply(self, **changes: object) -> None:
        pass

    @esair.operation
    def lift(self, way: tuple[float, float], pace: Speed = Speed.SLOW) -> str:
        return f"{way} {pace.name}"


@pytest.mark.promise("OPS-2")
async def test_what_json_has_no_word_for_is_given_as_in_a_robots_file(rover, raw):
    """Enums by values, tuples as lists, a text of digits: in operations and settings."""
    lift = Lift(name="lift")
    async with rover(resources=[lift]), raw() as client:
        up = {"resource": "lift", "operation": "lift"}
        given = {"way": [1, 2.5], "pace": "quick"}
        done = await client.do("1", "operate", **up, fields=given)
        assert done["result"] == "(1.0, 2.5) QUICK"
        wrong = await client.do("2", "operate", **up, fields={"way": [1], "pace": "x"})
        assert "lift.way" in wrong["error"]["text"]
        await client.do("3", "set", setting="lift.pace", value="quick")
        assert lift.pace is Speed.QUICK
        wrong = await client.do("4", "set", setting="lift.pace", value="x")
        assert "'slow', 'quick'" in wrong["error"]["text"]
        await client.do("5", "set", setting="lift.code", value=5678)
        assert lift.code == "5678"
        wrong = await client.do("6", "set", setting="lift.code", value=1.1)
        assert "expected" in wrong["error"]["text"]
        assert lift.code == "5678"


@attrs.frozen
class Docked:
    bay: int


@attrs.frozen
class Dock(esair.Request[Docked]):
    bay: int


class Docking(esair.Behavior):
    orders = esair.takes(Dock)

    async def run(self) -> None:
        async for request in self.orders:
            async with request:
                request.answer(Docked(request.data.bay + 1))


@attrs.frozen
class Open(esair.Request[str]):
    code: str
    hint: str | None = None
    tries: int | str = 1


class Door(esair.Behavior):
    @esair.answers
    async def opened(self, request: Open) -> str:
        return f"{request.code!r} {request.hint!r} {request.tries!r}"


@pytest.mark.promise("OPS-2")
async def test_typed_digits_are_a_text_where_only_a_text_is_taken(rover, raw):
    """In the fields of a request, too: a terminal has no other word for 5678."""
    fields = {"code": 5678, "hint": 12, "tries": 3}
    async with rover(Door()), raw() as client:
        given = {"receiver": "door", "request": "Open", "fields": fields}
        done = await client.do("1", "ask", **given)
        assert done["result"] == "'5678' '12' 3"


class Knock(esair.Request[str]):
    """Nobody has written ``@attrs.frozen`` above it: in Python it works all the same."""


class Porch(esair.Behavior):
    @esair.answers
    async def knocked(self, request: Knock) -> str:
        return "come in"


@pytest.mark.promise("OPS-2")
async def test_a_request_that_cannot_be_typed_says_what_it_lacks(rover, raw):
    """Its class has to say what its fields are, also if there are none."""
    async with rover(Porch()) as robot, raw() as client:
        assert await robot.behaviors.ask(Knock(), sender="user", receiver="porch")
        told = await client.do("1", "ask", receiver="porch", request="Knock")
        assert "write @attrs.frozen above class Knock" in told["error"]["text"]


class Listens(esair.Behavior):
    def __init__(self, **options) -> None:
        super().__init__(**options)
        self.heard: list[object] = []

    async def run(self) -> None:
        while True:
            self.heard.append(await self.receive_from())


@pytest.mark.promise("OPS-2")
async def test_put_and_ask_reach_behaviors(rover, raw):
    """Typed by the request's class; wrong ones are told what it takes."""
    listens = Listens()
    async with rover(Docking(), listens), raw() as client:
        asked = {"receiver": "docking", "request": "Dock"}
        assert (await client.do("1", "ask", **asked, fields={"bay": 2}))["result"] == {
            "bay": 3
        }
        wrong = await client.do("2", "ask", **asked, fields={"bay": "x"})
        assert "bay" in wrong["error"]["text"]
        wrong = await client.do("3", "ask", receiver="docking", request="Dok")
        assert "Dock" in wrong["error"]["text"]
        await client.do("4", "put", receiver="listens", data={"a": [1]})
    assert listens.heard == [("operator", {"a": [1]})]


@pytest.mark.promise("OPS-2")
async def test_the_log_is_followed_live(rover, raw):
    """Events as they come, of the kinds that are wanted."""
    async with rover() as robot, raw() as client:
        await client.do("1", "log", kinds=["added"])
        await robot.behaviors.add(Wander())
        found = await client.hear()
        assert found["event"]["component"] == "wander"
        assert found["event"]["kind"] == "added"


@pytest.mark.promise("OPS-1")
@pytest.mark.fault("G11")
@pytest.mark.parametrize("act", ["add", "replace"])
async def test_a_message_names_no_class(rover, raw, act: str):
    """What is not in the robot's own file is not imported, whatever its name is."""
    async with rover(Wander()), raw() as client:
        for name in ("antigravity", "antigravity:fly", "antigravity.fly"):
            answer = await client.do(f"{act} {name}", act, name=name)
            assert not answer["ok"]
        assert "antigravity" not in sys.modules


@pytest.mark.promise("RS-8")
async def test_of_several_mistakes_each_is_told(rover, raw, tmp_path):
    """What is added from the file gets the words that the check of the file has."""
    driver = f"{__name__}:Blind"
    text = f'[robot]\nname = "rover"\n[behavior.blind]\ndriver = "{driver}"\n'
    text += f'[sensor.sonar]\ndriver = "{__name__}:Distance"\n'
    text += f'[sensor.bumper]\ndriver = "{__name__}:Distance"\n'
    (file := tmp_path / "robot.toml").write_text(text)
    async with rover() as robot, raw() as client:
        robot.source = (file, False)
        answer = await client.do("1", "add", name="blind")
    told = answer["error"]["text"]
    assert "sonar" in told
    assert "bumper" in told


class Distance(esair.Sensor[float]):
    async def read(self) -> float:
        return 1.0


class Blind(esair.Reaction):
    sonar = esair.reads(float)
    bumper = esair.reads(float)

    def react(self, sonar: float, bumper: float) -> None: ...


@pytest.mark.fault("H15")
def test_no_decoder_for_code_exists():
    """Nothing in the seat can turn a message into code."""
    from pathlib import Path

    import esair.seat

    for path in Path(esair.seat.__file__).parent.rglob("*.py"):
        text = path.read_text()
        for word in ("pickle", "marshal", "eval(", "exec(", "import_module", "yaml"):
            assert word not in text, f"{path.name}: {word}"


async def test_the_end_of_the_robot_is_told(rover, raw):
    """A client hears that the robot has ended, and the connection closes."""
    async with raw_after(rover, raw) as client:
        assert await client.is_closed()
        assert client.lines[-1]["ended"]


class raw_after:  # noqa: N801 - reads as a sentence
    def __init__(self, rover, raw) -> None:
        self.rover, self.client = rover, raw()

    async def __aenter__(self):
        async with self.rover():
            await self.client.__aenter__()
            await self.client.do("1", "status")
        return self.client

    async def __aexit__(self, *_: object) -> None:
        await self.client.__aexit__()
