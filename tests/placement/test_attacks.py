"""Children that flood, lie and leak; robots that are killed: nobody else is disturbed."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import math
import os
import queue
import shutil
import signal
import socket
import struct
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.placement.parts import (
    Avoid,
    Drive,
    Leaks,
    Liar,
    Performer,
    Talker,
    Twist,
    Unsendable,
)
from tests.placement.pitfalls import Begins
from tests.placement.test_life import STOP, fake_wheels, lives, place, until

import esair
from esair.codec import CodecError
from esair.placement._child import Child
from esair.placement._nursery import Nursery
from esair.placement._wire import PACKET, Item, Op, Wire
from esair.testing import FakeSensor

pytestmark = [pytest.mark.real_clock, pytest.mark.xdist_group("placement")]


def long_(value: str) -> Any:
    return pytest.param(value, marks=pytest.mark.long)


def children_of(pid: int) -> list[int]:
    """The processes below one, their children too."""
    found: list[int] = []
    for each in Path("/proc").iterdir():
        if each.name.isdigit():
            with contextlib.suppress(OSError):
                if parent_of(int(each.name)) == pid:
                    found += [int(each.name), *children_of(int(each.name))]
    return found


def parent_of(pid: int) -> int:
    told = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2]
    return int(told.split()[1])


@pytest.mark.promise("PLC-4")
@pytest.mark.parametrize(
    "how",
    [
        signal.SIGKILL,
        pytest.param(signal.SIGSEGV, marks=pytest.mark.long),
        pytest.param(signal.SIGTERM, marks=pytest.mark.long),
    ],
)
@pytest.mark.parametrize("busy", [False, pytest.param(True, marks=pytest.mark.long)])
@pytest.mark.parametrize("stood", [False, True])
def test_nothing_outlives_the_robot(
    tmp_path: Path, how: signal.Signals, busy: bool, stood: bool
) -> None:
    """Whatever ends the robot's process ends its children, and what they have begun.

    Also where the one that makes them was stopped before.
    """
    script = tmp_path / "robot_of_children.py"
    script.write_text(
        textwrap.dedent(
            f"""
            import subprocess
            import esair

            class Busy(esair.ThreadBehavior):
                placement = esair.Placement(stall=60.0)

                def run(self) -> None:
                    helper = subprocess.Popen(["sleep", "600"])
                    print("begun", flush=True)
                    while {busy}:
                        pass
                    super().run()

            if __name__ == "__main__":
                import logging
                logging.basicConfig(level=logging.INFO)
                esair.run(esair.Robot(behaviors=[Busy(name="one"), Busy(name="two")]))
            """
        ),
        encoding="utf-8",
    )
    with subprocess.Popen(
        [sys.executable, str(script)], stderr=subprocess.PIPE, text=True
    ) as robot:
        assert robot.stderr is not None
        begun = 0
        for line in robot.stderr:
            begun += "begun" in line
            if begun == 2:
                break
        children = children_of(robot.pid)
        assert len(children) == 5  # the one that makes them, and two with a helper
        if stood:
            os.kill(children[0], signal.SIGSTOP)
        os.kill(robot.pid, how)
        end = time.monotonic() + 10.0
        while any(lives(pid) for pid in children):
            assert time.monotonic() < end, "a child has outlived its robot"
            time.sleep(0.005)


@pytest.mark.promise("PLC-1", "ROB-2")
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGHUP])
def test_a_stop_that_all_are_told_is_the_robots(
    tmp_path: Path, how: signal.Signals
) -> None:
    """A service manager may tell each process: children end in order all the same."""
    script = tmp_path / "robot_of_children.py"
    script.write_text(
        textwrap.dedent(
            """
            import asyncio
            import esair

            class Rests(esair.Behavior):
                placement = "process"

                async def run(self) -> None:
                    print("begun", flush=True)
                    await asyncio.sleep(600)

                async def teardown(self) -> None:
                    print("torn down", flush=True)

            if __name__ == "__main__":
                import logging
                logging.basicConfig(level=logging.INFO)
                esair.run(esair.Robot(behaviors=[Rests()]))
            """
        ),
        encoding="utf-8",
    )
    with subprocess.Popen(
        [sys.executable, str(script)], stderr=subprocess.PIPE, text=True
    ) as robot:
        assert robot.stderr is not None
        for line in robot.stderr:
            if "begun" in line:
                break
        for pid in (*children_of(robot.pid), robot.pid):
            os.kill(pid, how)
        told = robot.stderr.read()
    assert "torn down" in told
    assert "failed" not in told


@pytest.mark.promise("PLC-1")
def test_a_script_that_runs_when_it_is_imported_is_refused(tmp_path: Path) -> None:
    """A child imports the script: one that would begin a robot then is one error."""
    script = tmp_path / "unguarded.py"
    script.write_text(
        "import esair\n"
        "class One(esair.Behavior):\n"
        "    placement = 'process'\n"
        "    async def run(self) -> None: pass\n"
        "esair.run(esair.Robot(behaviors=[One()]), duration=5.0)  # in __main__\n",
        encoding="utf-8",
    )
    ended = subprocess.run(
        [sys.executable, str(script)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert ended.returncode == 1
    assert ended.stderr.count("if __name__ == '__main__':") == 1
    assert "restart" not in ended.stderr


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.long
@pytest.mark.promise("PLC-4")
async def test_nothing_is_left_behind() -> None:
    """Twenty that come, die and go leave no process, descriptor or task behind."""
    wheels = fake_wheels()
    async with esair.Robot(
        resources=[wheels], behaviors=[Drive(name="first")]
    ) as robot:
        before = descriptors()
        for number in range(20):
            drive = Drive(name="drive", fault="kill", at=2 + number % 3)
            await robot.behaviors.add(drive)
            if number % 2:
                await until(lambda: robot.behaviors.query("drive").restarts == 1)
            await robot.behaviors.remove("drive")
        await asyncio.sleep(0.1)
        assert descriptors() == before
        assert len(children_of(os.getpid())) == 2
    await until(lambda: children_of(os.getpid()) == [])


@pytest.mark.promise("PLC-4", "TURN-4")
async def test_nobody_waits_for_the_end_of_what_makes_children() -> None:
    """Other robots of the loop go on meanwhile; it ends all the same, and is reaped."""
    were_there = []
    for _ in range(5):  # it may be quick
        nursery = Nursery.hold()
        (pid,) = children_of(os.getpid())
        nursery.let_go()
        were_there.append(lives(pid))
        await until(lambda: children_of(os.getpid()) == [])
    assert any(were_there)


@pytest.mark.promise("PLC-4")
async def test_what_makes_children_ends_in_silence_while_it_starts(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Its robot may be over, or dead, before it is ready: that is no error of its own."""
    for delay in (0.0, 0.05, 0.1, 0.2):
        nursery = Nursery.hold()
        await asyncio.sleep(delay)
        nursery.let_go()
        await until(lambda: children_of(os.getpid()) == [])
    assert capfd.readouterr().err == ""


@pytest.mark.promise("PLC-4", "ROB-5")
async def test_robots_that_begin_at_once_all_begin() -> None:
    """They wait for one process that makes children, each in a thread of its own."""

    async def run() -> None:
        wheels = fake_wheels()
        async with esair.Robot(resources=[wheels], behaviors=[Drive()]):
            await wheels.until(Twist(0.3, 0.0), timeout=10.0)

    async with asyncio.timeout(20.0), asyncio.TaskGroup() as tasks:
        for _ in range(3):
            tasks.create_task(run())


@pytest.mark.long
@pytest.mark.promise("PLC-4")
async def test_the_process_that_makes_children_is_replaced() -> None:
    """Killed, it takes its children along: they are failures, and come back."""
    wheels, begins = fake_wheels(), Begins()
    place(begins, "process")
    async with esair.Robot(resources=[wheels], behaviors=[Drive(), begins]) as robot:
        await wheels.until(Twist(0.3, 0.0), timeout=10.0)
        pids = await robot.behaviors.get(sender="begins", receiver="user")
        server = parent_of(parent_of(pids[0]))
        os.kill(server, signal.SIGKILL)
        await until(lambda: not any(map(lives, pids)))
        await until(lambda: robot.behaviors.query("drive").restarts >= 1)
        await until(lambda: STOP in wheels.commands)
        before = len(wheels.commands)
        await until(lambda: Twist(0.3, 0.0) in wheels.commands[before:])


@pytest.mark.promise("PLC-3")
async def test_what_makes_children_and_does_not_start_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With how it has ended, in the error of who wanted one."""
    monkeypatch.setattr(sys, "executable", shutil.which("false"))
    async with esair.Robot(resources=[fake_wheels()], behaviors=[Drive()]) as robot:
        await until(lambda: robot.behaviors.query("drive").restarts >= 1)
        assert "makes processes" in str(robot.behaviors.query("drive").error)


@pytest.mark.promise("PLC-3")
async def test_what_a_child_cannot_send_is_in_its_last_words() -> None:
    """Its robot is there: that it ended by itself would be no reason."""
    async with esair.Robot(behaviors=[Leaks()]) as robot:
        await until(lambda: robot.behaviors.query("leaks").restarts >= 1)
        assert "Too many open files" in str(robot.behaviors.query("leaks").error)


@pytest.mark.promise("PLC-2", "PLC-5")
@pytest.mark.parametrize(
    "lie",
    [
        "garbage",
        "verb",
        "port",
        "time",
        "early",
        "method",
        "flood",
        "files",
        "turn",
        "private",
    ],
)
async def test_a_child_that_lies_is_a_component_that_failed(lie: str) -> None:
    """What is no message, or asks for what it cannot have, moves nothing."""
    wheels = fake_wheels()
    liar = Liar(lie)
    async with esair.Robot(resources=[wheels], behaviors=[liar]) as robot:
        await until(lambda: robot.behaviors.query("liar").restarts >= 1)
        assert set(wheels.commands) <= {STOP}
    assert "raised" not in str(robot.behaviors.query("liar").error)


@pytest.mark.promise("PLC-6")
async def test_what_it_writes_appears_under_its_name(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Prints, records of its log and its warnings are lines of the robot's log."""
    caplog.set_level("INFO")
    async with esair.Robot(behaviors=[Talker()]) as robot:
        await until(lambda: robot.behaviors.query("talker").error is not None)
    text = caplog.text
    for words in ("talker: it prints", "talker: it logs 3", "it warns"):
        assert words in text
    assert "rover.parts" in caplog.text  # the logger that it has used
    assert f"talker: it was called with {sys.argv!r}" in text
    assert "--placement NAME=task" in str(robot.behaviors.query("talker").error)


@pytest.mark.promise("PLC-6")
async def test_a_print_is_seen_where_no_log_is_set_up(
    caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    """A script that prints needs no logging to show what its processes print."""
    caplog.set_level("WARNING", logger="esair")
    async with esair.Robot(behaviors=[Talker()]) as robot:
        await until(lambda: robot.behaviors.query("talker").error is not None)
    assert "talker: it prints\n" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.promise("PLC-6")
async def test_a_restart_begins_as_it_was_added() -> None:
    """What waits for it survives its death; what it had changed in itself does not."""
    wheels = fake_wheels()
    drive = Drive(0.1, fault="kill", at=30)
    async with esair.Robot(resources=[wheels], behaviors=[drive]) as robot:
        await wheels.until(Twist(0.1, 0.0), timeout=10.0)
        drive.speed = 9.0  # nobody asks this one
        await robot.behaviors.put("hello", sender="user", receiver="drive")
        await until(lambda: robot.behaviors.query("drive").restarts == 1)
        await until(lambda: robot.behaviors.query("drive").state.value == "running")
        before = len(wheels.commands)
        await until(lambda: Twist(0.1, 0.0) in wheels.commands[before:])
        left = await robot.behaviors.remove("drive")
    assert left == ["hello"]
    assert Twist(9.0, 0.0) not in wheels.commands


@pytest.mark.promise("PLC-1")
async def test_what_cannot_be_placed_is_a_finding() -> None:
    """Each is a finding with its reason."""

    class Local(esair.Behavior):
        placement = "process"

    class Guard(esair.Reaction):
        placement = "process"
        sonar = esair.reads(float)
        wheels = esair.guards(Twist)

        def react(self, sonar: float, wheels: Twist) -> Twist | None:
            return wheels

    wheels, sonar = fake_wheels(), FakeSensor("sonar", 1.0)
    place(wheels, "process")
    moon = Drive()
    place(moon, "moon")
    with pytest.raises(ExceptionGroup) as raised:
        async with esair.Robot(
            resources=[wheels, sonar],
            behaviors=[Local(), Guard(), Unsendable(print), moon, Avoid(name="a")],
        ):
            pass
    text = "\n".join(str(each) for each in raised.value.exceptions)
    assert "an actuator stays" in text
    assert "a guard stays" in text
    assert "cannot be imported as" in text
    assert "cannot be sent to a process" in text
    assert "expected 'process', 'task'" in text
    assert len(raised.value.exceptions) == 5


@pytest.mark.promise("PLC-1", "RS-8")
async def test_a_kernel_that_cannot_watch_a_process_is_a_finding(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Such as that of an old container: it is told before anything starts."""

    def refuse(*_: int) -> int:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "pidfd_open", refuse)
    with pytest.raises(ExceptionGroup) as raised:
        async with esair.Robot(resources=[fake_wheels()], behaviors=[Drive()]):
            pass
    (finding,) = raised.value.exceptions
    assert "cannot watch a process of its own: PermissionError" in str(finding)


REFUSED = {
    "guard": "a guard stays in the robot's process",
    "local": "the robot has no class of an action loaded as",
    "function": "the robot has no class of an action loaded as os:abort",
    "constructor": "the robot has no class of an action loaded as os:PathLike",
    "nonsense": "expected an action, not 3",
    "verdict": "has sent what is no value",
    "limits for ever": "timeout: expected seconds > 0, not nan",
    "limits blind": "blind_timeout: expected seconds > 0, not -1.0",
    "limits one": "missing 1 required positional argument: 'blind_timeout'",
}


@pytest.mark.promise("PLC-1", "PLC-5")
@pytest.mark.parametrize(
    "act", [each if each == "guard" else long_(each) for each in REFUSED]
)
async def test_what_a_child_cannot_perform_is_refused_in_words(act: str) -> None:
    """A guard, what is no class of an action, and limits that are no seconds."""
    wheels, sonar = fake_wheels(), FakeSensor("sonar", 1.0)
    allows = esair.Policy.behaviors(allow={"performer": "manage"})
    async with esair.Robot(
        resources=[wheels, sonar], behaviors=[Performer(act)], policies=[allows]
    ) as robot:
        await until(lambda: robot.behaviors.query("performer").error is not None)
        assert REFUSED[act] in str(robot.behaviors.query("performer").error)
        assert set(wheels.commands) <= {STOP}


@pytest.mark.long
@pytest.mark.promise("PLC-1", "PLC-5")
async def test_a_stage_of_no_step_is_nothing() -> None:
    """A child that says it twice, or of a step that is over, moves nothing by it."""
    wheels = fake_wheels()
    async with esair.Robot(resources=[wheels], behaviors=[Performer("stage")]) as robot:
        await wheels.until(Twist(0.7, 0.0), timeout=10.0)
        assert robot.behaviors.query("performer").restarts == 0


@pytest.mark.long
@pytest.mark.promise("PLC-3", "BEH-2")
@pytest.mark.parametrize("fault", ["kill", "segfault", "exit", "abort", "hang"])
async def test_a_step_that_kills_its_process_is_its_performers_death(
    fault: str,
) -> None:
    """What it moved is safe; its performer is started again, and performs it again."""
    wheels, sonar = fake_wheels(), FakeSensor("sonar", 1.0)
    sonar.rate = 50.0
    performer = Performer(fault)
    place(performer, esair.Placement(stall=0.6))
    async with esair.Robot(resources=[wheels, sonar], behaviors=[performer]) as robot:
        await wheels.until(Twist(0.0, 0.5), timeout=10.0)
        await until(lambda: robot.behaviors.query("performer").restarts == 1)
        assert isinstance(
            robot.behaviors.query("performer").error, esair.ProcessDiedError
        )
        await until(lambda: wheels.commands[-1] == STOP)
        before = len(wheels.commands)
        await until(lambda: Twist(0.0, 0.5) in wheels.commands[before:])


@pytest.mark.promise("PLC-1")
def test_nobody_pays_who_places_nothing() -> None:
    """Without a placed component nothing of it is imported, and no process is begun."""
    script = (
        "import asyncio, sys, esair\n"
        "async def main():\n"
        "    async with esair.Robot(behaviors=[esair.Behavior(name='one')]):\n"
        "        await asyncio.sleep(0.05)\n"
        "asyncio.run(main())\n"
        "print([name for name in sys.modules if name.startswith('esair.placement')])\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert ended.stdout == "[]\n"


@pytest.mark.promise("PLC-5")
def test_a_packet_that_is_cut_is_no_message() -> None:
    """Also where the cut lies between two items: the second would be lost in silence."""
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    wire, other = Wire(ends[0]), Wire(ends[1])
    try:
        wire.send(Op.GO, 1.0, [Item(Op.CALL, 1, "run", b"")])
        one = ends[1].recv(PACKET, socket.MSG_PEEK)
        assert other.receive() == (Op.GO, 1.0, [Item(Op.CALL, 1, "run", b"")])
        size = PACKET - len(one)
        wire.send(Op.GO, 1.0, [Item(Op.CALL, 1, "run", b"x" * size)])
        full = ends[1].recv(PACKET)
        assert len(full) == PACKET
        ends[0].send(full + one[struct.calcsize("<cd") :])
        with pytest.raises(CodecError):
            other.receive()
    finally:
        wire.close()
        other.close()


@contextlib.contextmanager
def living_child(component: object) -> Iterator[tuple[Wire, Child]]:
    """Let a component live as in a child, but in a thread; the other end is the robot's."""
    mine, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    robot, made = Wire(mine), queue.Queue[Child]()

    def live() -> None:
        child = Child(Wire(its))
        child.component = component
        made.put(child)
        child.loop.run_forever()

    thread = threading.Thread(target=live)
    thread.start()
    child = made.get()
    yield robot, child
    child.loop.call_soon_threadsafe(child.loop.stop)
    robot.send(Op.GO, 1.0)  # the turn in which it stops
    thread.join()
    child.loop.close()
    robot.close()
    its.close()


@pytest.mark.promise("PLC-1", "PLC-5")
def test_what_is_cancelled_before_it_has_begun_has_an_end() -> None:
    """A call and its cancellation in one message: who waits is told, and nothing is left."""
    begun: list[int] = []

    class Component:
        async def run(self) -> None:
            begun.append(1)

    call, cancel = Item(Op.CALL, 7, "run", b""), Item(Op.CANCEL, 7, "", b"")
    with living_child(Component()) as (robot, child):
        robot.send(Op.GO, 1.0, [call, cancel])
        message = robot.receive()
    assert message is not None
    (told,) = message[2]
    assert (told.op, told.number, begun) == (Op.FAIL, 7, [])
    assert isinstance(child.opened(told)[1], asyncio.CancelledError)
    assert not child.tasks
    assert not child.owner.living()


@pytest.mark.promise("PLC-1")
def test_a_request_that_is_over_may_be_withdrawn(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Its end and its withdrawal may pass each other on the way: nobody minds."""
    with living_child(object()) as (robot, _):
        robot.send(Op.GO, 1.0, [Item(Op.WITHDRAWN, 5, "", b"")])
        assert robot.receive() == (Op.IDLE, math.inf, [])
    assert not caplog.records
