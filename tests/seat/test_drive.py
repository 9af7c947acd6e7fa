"""Driving by hand: a lease that only fresh input renews, by what the wheels were told."""

import asyncio
import contextlib
import os
import pty
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import attrs
import pytest
from rich.cells import cell_len
from tests.patience import within
from tests.seat.conftest import STILL, Twist, Wander, eventually

import esair
from esair.cli._hand import ANSWER, ASK, _Wheel, command_of, drive

pytestmark = pytest.mark.real_clock

FAST = Twist(0.5, 0.0)
LEASE = 0.4


class Hand:
    """Somebody who drives: takes a lease, and answers beats."""

    def __init__(self, client) -> None:
        self.client = client
        self.number = 0
        self.beat = 0

    async def take(self, seconds=LEASE):
        found = await self.client.do(
            f"l{self.number}", "lease", actuator="wheels", seconds=seconds
        )
        self.lease, self.beat = found["result"]["lease"], found["result"]["beat"]
        return found["result"]

    def push(self, command=FAST, beat=None):
        self.number += 1
        self.client.send(
            {
                "id": f"d{self.number}",
                "act": "drive",
                "lease": self.lease,
                "beat": self.beat if beat is None else beat,
                "command": attrs.asdict(command),
            }
        )
        return f"d{self.number}"

    async def listen(self, seconds):
        """Take the beats that come in a time."""
        end = asyncio.get_running_loop().time() + seconds
        while (left := end - asyncio.get_running_loop().time()) > 0:
            try:
                found = await self.client.hear(left)
            except TimeoutError:
                return
            self.beat = found.get("beat", self.beat)


def last_motion(seen):
    return max(time for time, command in seen if command != STILL)


@pytest.fixture
def seen(fake_actuator):
    """Wheels that note when they were told what."""
    wheels = fake_actuator("wheels", STILL)
    wheels.seen = []
    write = wheels.write

    async def noted(command):
        await write(command)
        wheels.seen.append((time.monotonic(), command))

    wheels.write = noted
    return wheels


@pytest.mark.promise("OPS-4", "OPS-2")
async def test_fresh_input_drives_above_the_behaviors(rover, raw, seen):
    """The operator holds the wheels while there is input, then the behavior again."""
    async with rover(Wander(), wheels=seen) as robot, raw() as client:
        hand = Hand(client)
        found = await hand.take()
        assert found["axes"] == {"linear": None, "angular": None}
        for _ in range(10):
            seen.commands.clear()
            hand.push()
            await seen.until(FAST)
            why = robot.resources.why("wheels")
            assert (why.holder, why.priority) == ("operator", 1000)
        assert any("operator" in each for each in why.writers)
        await robot.wheels.until(Twist(0.3, 0.0))
        assert robot.resources.why("wheels").holder == "wander"


@pytest.mark.longer
@pytest.mark.promise("OPS-4")
async def test_without_input_it_is_released(rover, raw, seen):
    """A client that lives and says nothing: safe within the lease + 0.1 s."""
    async with rover(wheels=seen), raw() as client:
        hand = Hand(client)
        await hand.take()
        begun = time.monotonic()
        hand.push()
        await hand.listen(1.0)
        assert seen.commands[-1] == STILL
        assert seen.commands[1] == FAST
        assert within(LEASE + 0.1, seen.seen[-1][0] - begun)
        assert STILL not in seen.commands[1:-1]  # it did not stutter within the lease
        assert any("lapsed" in each for each in client.lines)
        late = await client.answer(hand.push())
        assert "lapsed" in late["error"]["text"]
        assert seen.commands[-1] == STILL


@pytest.mark.longer
@pytest.mark.promise("OPS-4")
@pytest.mark.fault("H13")
async def test_a_client_that_vanishes_releases_at_once(rover, raw, seen):
    """The connection ends: the wheels are safe at once."""
    async with rover(wheels=seen):
        async with raw() as client:
            hand = Hand(client)
            await hand.take()
            await client.answer(hand.push())
            assert seen.commands[-1] == FAST
            gone = time.monotonic()
        await seen.until(STILL)
        assert within(0.1, seen.seen[-1][0] - gone)


@pytest.mark.longer
@pytest.mark.promise("OPS-4")
@pytest.mark.fault("H14")
async def test_input_that_has_not_seen_a_fresh_beat_is_old(rover, raw, seen):
    """A client whose work hangs, or a network that delivers late, drives nothing."""
    async with rover(wheels=seen), raw() as client:
        hand = Hand(client)
        await hand.take()
        old = hand.beat
        for _ in range(6):  # the sender goes on, the listener hangs
            hand.push(beat=old)
            await asyncio.sleep(0.1)
        await eventually(lambda: seen.commands[-1] == STILL)
        assert within(LEASE + 0.2, seen.seen[-1][0] - seen.seen[1][0])
        await hand.take()
        answer = await client.answer(hand.push(beat=old))
        assert "older than" in answer["error"]["text"]
        answer = await client.answer(hand.push(beat=10**6))
        assert not answer["ok"]
        assert seen.commands[-1] == STILL


@pytest.mark.promise("OPS-4")
async def test_nothing_from_before_a_gap_is_done(rover, raw, seen):
    """The loop stands still for 1 s: what came meanwhile is never executed."""
    async with rover(wheels=seen), raw() as client:
        hand = Hand(client)
        await hand.take()
        await client.answer(hand.push())
        hand.push(Twist(-0.9, 0.0))
        await client.writer.drain()
        time.sleep(1.0)  # noqa: ASYNC251 - the loop stands still
        await hand.listen(0.3)
        assert Twist(-0.9, 0.0) not in seen.commands
        assert seen.commands[-1] == STILL


@pytest.mark.promise("OPS-4")
async def test_a_slow_device_queues_nothing(rover, raw, seen):
    """Of inputs that come while the device is busy only the newest is sent."""
    async with rover(wheels=seen), raw() as client:
        hand = Hand(client)
        await hand.take(2.0)
        seen.stall()
        names = [hand.push(Twist(n / 10, 0.0)) for n in range(1, 6)]
        await hand.listen(0.1)
        seen.resume()
        answer = await client.answer(names[-1])
        assert answer["result"]["written"]
        told = [each for each in seen.commands if each != STILL]
        assert set(told) <= {Twist(0.1, 0.0), Twist(0.5, 0.0)}


@pytest.mark.promise("OPS-4")
async def test_a_halt_is_above_who_drives(rover, raw, seen):
    """Input of a halted robot is refused, and after resume only fresh input moves."""
    async with rover(wheels=seen) as robot, raw() as client, raw() as other:
        hand = Hand(client)
        await hand.take()
        await client.answer(hand.push())
        await other.do("1", "stop", reason="a cat")
        count = len(seen.commands)
        await hand.listen(0.05)
        answer = await client.answer(hand.push())
        assert answer["result"] == {"written": False, "holder": "halt", "rule": "a cat"}
        assert set(seen.commands[count - 1 :]) == {STILL}
        assert robot.halted


@pytest.mark.promise("OPS-4")
async def test_a_guard_is_above_the_operator(rover, raw, seen, fake_sensor):
    """Every command of the operator passes the guards."""

    class Brake(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.guards(Twist)

        def react(self, sonar: float, wheels: Twist) -> Twist | None:
            return None if sonar < 0.4 else wheels

    sonar = fake_sensor("sonar", 0.2)
    async with rover(Brake(), wheels=seen, resources=[sonar]), raw() as client:
        hand = Hand(client)
        await hand.take()
        answer = await client.answer(hand.push())
        assert answer["result"]["holder"] == "brake"
        assert set(seen.commands) == {STILL}


@pytest.mark.parametrize(
    ("axes", "key", "expected"),
    [
        ({"": (-2.0, 4.0)}, (1, 0), 2.0),
        ({"": (-2.0, 4.0)}, (-1, 0), -1.0),
        (
            {"linear": (-1.0, 1.0), "angular": (-4.0, 4.0)},
            (0, 1),
            {"linear": 0, "angular": 2},
        ),
        ({"left": None, "right": None}, (1, 0), {"left": 0.5, "right": 0.5}),
        ({"left": None, "right": None}, (0, 1), {"left": -0.5, "right": 0.5}),
    ],
)
def test_what_a_key_means(axes, key, expected):
    """Up is forward, left turns to the left, within the limits of the actuator."""
    forward, left = key
    assert command_of(forward, left, axes, 0.5) == expected


@pytest.mark.promise("OPS-4")
@pytest.mark.parametrize("speed", [-1.0, 0.0, float("nan"), float("inf")])
def test_a_speed_that_turns_the_keys_round_is_refused(capsys, speed):
    """Forward means forward: it is told before anything is connected."""
    assert drive("wheels", speed=speed) == 2
    assert "--speed: expected a number above 0" in capsys.readouterr().err


@pytest.mark.promise("OPS-4")
def test_a_line_of_wide_letters_does_not_wrap(capsys, monkeypatch):
    """What wraps is not erased by the next line: a letter may take two columns."""
    monkeypatch.setenv("COLUMNS", "20")
    wheel = _Wheel(None, "wheels", 0.3, 0.5)  # type: ignore[arg-type]
    wheel._show("refused by fence: " + "\N{HIRAGANA LETTER A}" * 30)
    line = capsys.readouterr().out.removeprefix("\r\x1b[K")
    assert line.startswith("refused by fence")
    assert cell_len(line) <= 19


@pytest.mark.promise("OPS-4")
@pytest.mark.parametrize(
    ("rule", "told"),
    [
        ("fence is blind: gate lost: it is unplugged", "refused: fence is blind: gate"),
        ("nobody may", "refused: fence: nobody may"),
    ],
)
def test_who_refuses_is_told_once(capsys, monkeypatch, rule, told):
    """A rule that names it leaves the room of the line to what is wrong."""
    monkeypatch.setenv("COLUMNS", "60")
    answer = {"written": False, "holder": "fence", "rule": rule}
    client = SimpleNamespace(
        lines=lambda _: [{"id": "1", "ok": True, "result": answer}]
    )
    wheel = _Wheel(client, "wheels", 0.3, 0.5)  # type: ignore[arg-type]
    wheel._sent = "1"
    wheel._hear()
    assert told in capsys.readouterr().out


@pytest.mark.promise("OPS-4")
def test_how_to_go_on_fits_into_60_columns(capsys, monkeypatch):
    """After a lease has lapsed a narrow terminal says all of it, the key to leave too."""
    monkeypatch.setenv("COLUMNS", "60")
    client = SimpleNamespace(lines=lambda _: [{"lapsed": 1}])
    wheel = _Wheel(client, "front_left_wheel", 0.3, 0.5)  # type: ignore[arg-type]
    wheel._lease = {"lease": 1}
    wheel._hear()
    assert "space stops, q leaves" in capsys.readouterr().out


class Terminal:
    """``esair drive wheels`` on a terminal of its own."""

    def __enter__(self):
        self.keys, slave = pty.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "esair", "drive", "wheels", "--lease", str(LEASE)],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            env={**os.environ, "COLUMNS": "100", "TERM": "xterm"},
        )
        os.close(slave)
        return self

    def press(self, keys=b"\x1b[A"):
        os.write(self.keys, keys)

    async def drive(self, wheels):
        """Hold the key until the wheels are told."""
        moved = len(wheels.seen)

        def is_driving():
            self.press()
            return any(command != STILL for _, command in wheels.seen[moved:])

        for _ in range(5):  # what has lapsed is let go first
            with contextlib.suppress(TimeoutError):
                await eventually(is_driving, 2.0)
                return
            await asyncio.sleep(0.5)
        raise TimeoutError

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        os.close(self.keys)


@pytest.mark.promise("OPS-4")
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP, None])
@pytest.mark.long
async def test_the_terminal_goes_while_it_drives(rover, seen, end):
    """Killed, stopped, or just no key any more: safe within the lease + 0.1 s."""
    async with rover(wheels=seen):
        with Terminal() as terminal:
            await terminal.drive(seen)
            for _ in range(5):
                terminal.press()
                await asyncio.sleep(0.05)
            gone = time.monotonic()
            if end is not None:
                terminal.process.send_signal(end)
            await asyncio.sleep(LEASE + 0.5)
            assert seen.commands[-1] == STILL
            assert last_motion(seen.seen) < gone + LEASE + 0.1
            if end is signal.SIGSTOP:
                count = len(seen.commands)
                terminal.press(b"\x1b[A\x1b[A\x1b[A")
                terminal.process.send_signal(signal.SIGCONT)
                await asyncio.sleep(0.5)
                assert set(seen.commands[count:]) <= {STILL}  # typed in the gap


@pytest.mark.long
@pytest.mark.promise("OPS-4")
async def test_q_gives_back_and_leaves(rover, seen):
    """The key to leave releases at once, exit code 0."""
    async with rover(wheels=seen):
        with Terminal() as terminal:
            await terminal.drive(seen)
            terminal.press(b"q")
            code = await asyncio.to_thread(terminal.process.wait, 5.0)
            assert code == 0
            assert os.read(terminal.keys, 65536).endswith(b"wheels is released\r\n")
            await eventually(lambda: seen.commands[-1] == STILL)


class Distant(Terminal):
    """A terminal that answers, at the other end of a network."""

    cut = False

    def __enter__(self):
        super().__enter__()
        self.late = b""
        asyncio.get_running_loop().add_reader(self.keys, self.shows)
        return self

    def shows(self):
        self.press(os.read(self.keys, 65536).count(ASK.encode()) * ANSWER)

    def press(self, keys=b"\x1b[A"):
        if self.cut:
            self.late += keys
        else:
            super().press(keys)

    def mend(self):
        """Deliver what was typed, and then what was asked."""
        self.cut = False
        keys, answers = self.late.replace(ANSWER, b""), self.late.count(ANSWER)
        self.press(keys + answers * ANSWER)

    def __exit__(self, *error):
        asyncio.get_running_loop().remove_reader(self.keys)
        super().__exit__(*error)


@pytest.mark.promise("OPS-4")
async def test_keys_that_a_network_delivers_late_move_nothing(rover, seen):
    """By ssh the keys lie far from the program, whose beats are fresh."""
    async with rover(wheels=seen):
        with Distant() as terminal:
            await terminal.drive(seen)
            terminal.cut = True
            for _ in range(30):
                terminal.press()
                await asyncio.sleep(0.05)
            assert seen.commands[-1] == STILL
            count = len(seen.commands)
            terminal.mend()
            await asyncio.sleep(0.6)
            assert set(seen.commands[count:]) <= {STILL}
            await terminal.drive(seen)  # and fresh ones do


@pytest.mark.promise("OPS-4")
async def test_no_answer_of_the_terminal_is_left_to_the_shell(rover, seen):
    """It would be typed there: what was asked is waited for."""
    async with rover(wheels=seen):
        with Distant() as terminal:
            await terminal.drive(seen)
            terminal.cut = True
            await eventually(lambda: ANSWER in terminal.late)
            Terminal.press(terminal, b"q")
            await asyncio.sleep(0.3)
            assert terminal.process.poll() is None
            terminal.mend()
            assert await asyncio.to_thread(terminal.process.wait, 5.0) == 0


@pytest.mark.promise("OPS-4")
async def test_a_key_that_is_held_takes_nothing_back(rover, seen, raw):
    """The last one to take it has it, and may drive away from somebody."""
    async with rover(wheels=seen), raw() as client:
        with Terminal() as terminal:
            await terminal.drive(seen)
            hand = Hand(client)
            await hand.take(2.0)
            for _ in range(20):
                terminal.press()
                await hand.listen(0.05)
            assert not any("lapsed" in each for each in client.lines)
            await asyncio.sleep(0.5)  # let go
            await terminal.drive(seen)
