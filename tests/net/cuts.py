"""Two robots in two network namespaces, and what goes wrong on the way between them.

``python -m tests.net.cuts --cuts 20`` makes a way of two TUN devices whose packets go through
this process: each is late, some are lost, and while it is cut all are. It needs root.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import heapq
import itertools
import json
import math
import os
import random
import select
import signal
import statistics
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import attrs

import esair
from esair.buses.peer import Network, PeerBus, Tls
from esair.connections import _gate
from esair.drivers.peer import Peer, PeerActuator
from esair.loop import clock_beside
from esair.peers import Share, Sharing
from esair.testing import FakeActuator

TIMEOUT, LOST = 0.2, 1.3
KINDS = ("cut", "from base", "from rover", "stop 0", "stop 1")
"""What is cut: the way, one direction of it, and the process of the base or the rover."""

ADDRESSES = {"base": "10.77.0.1", "rover": "10.77.0.2"}


@attrs.frozen
class Twist:
    """A motion: when it was decided, and when it was sent."""

    decided: float
    speed: float
    sent: float = 0.0


STILL = Twist(0.0, 0.0)


def tell(*told: Any) -> None:
    """Print what happened, and when."""
    sys.stdout.write(json.dumps([time.monotonic(), *told]) + "\n")
    sys.stdout.flush()


class Wheels(FakeActuator[Twist]):
    """Tells when the driver is called, and when the clock was looked at for that."""

    looked = 0.0

    async def write(self, command: Twist) -> None:
        at = time.monotonic()
        await super().write(command)
        if command == STILL:
            tell("still", at)
        else:
            tell("told", at, command.decided, command.sent, self.looked)


class FarWheels(PeerActuator):
    """Says when a command is sent: it may have waited for the answer to another one."""

    async def write(self, command: Any) -> Any:
        if isinstance(command, Twist):
            command = attrs.evolve(command, sent=time.monotonic())
        return await super().write(command)


@attrs.frozen
class Told:
    """What the wheels were told.

    Attributes:
        at: When their driver was called.
        decided: When that was decided.
        sent: When it was sent, with the newest beat that was heard.
        looked: When the owner has looked at its clock for that.
    """

    at: float
    decided: float
    sent: float
    looked: float


# The two robots: each a process in its namespace.


class Driving(esair.Behavior):
    """Writes when it decided, fifty times a second, whatever becomes of it."""

    wheels = esair.writes(Twist)

    async def run(self) -> None:
        async for _ in esair.every(0.02):
            with contextlib.suppress(esair.EsairError):
                await self.wheels.write(Twist(time.monotonic(), 1.0))


def network(me: str, peer: str, certificates: str) -> Network:
    end = f"{'tls' if certificates else 'tcp'}/{ADDRESSES['base']}:7447"
    ends: dict[str, Any] = {"listen" if me == "base" else "connect": [end]}
    if certificates:
        there = Path(certificates)
        ends["tls"] = Tls(there / "ca.pem", there / f"{me}.pem", there / f"{me}.key")
    return Network(me=me, peers=[peer], insecure=True, **ends)


def base(certificates: str) -> esair.Robot:
    """Has the wheels, and prints what they are told."""
    wheels = Wheels("wheels", safe=STILL, command_timeout=TIMEOUT)
    bus = PeerBus(name="rover", network=network("base", "rover", certificates))
    bus.declare(Twist)
    bus.on_lost(lambda _: tell("lost"))
    sharing = Sharing(bus=bus, shares=[Share("wheels", "write", priority=5)])
    robot = esair.Robot(
        name="base",
        resources=[wheels, Peer(name="rover", bus=bus)],
        behaviors=[sharing],
    )

    def beside(loop: Any) -> Callable[[], float]:
        def look() -> float:
            wheels.looked = time.monotonic()
            return clock_beside(loop)()

        return look

    _gate.clock_beside = beside  # it looks there before the driver is called
    return robot


def rover(certificates: str) -> esair.Robot:
    """Drives the wheels of the base."""
    bus = PeerBus(name="base", network=network("rover", "base", certificates))
    bus.on_lost(lambda _: tell("lost"))
    wheels = FarWheels(name="wheels", bus=bus, type=Twist)
    return esair.Robot(
        name="rover",
        resources=[Peer(name="base", bus=bus), wheels],
        behaviors=[Driving()],
    )


# The way between them.


class Way(threading.Thread):
    """Carries packets between two namespaces, as late and as badly as it is told."""

    def __init__(self, delay: float, loss: float, seed: int) -> None:
        super().__init__(daemon=True)
        self.delay, self.loss = delay, loss
        self.cut: set[int] = set()
        """The ends from which nothing comes any more: 0 the base, 1 the rover."""
        self.over = False
        self._chance = random.Random(seed)
        self._ends: list[int] = []
        self.names = [f"{who}{os.getpid()}" for who in ADDRESSES]

    def __enter__(self) -> Way:
        for number, (name, address) in enumerate(
            zip(self.names, ADDRESSES.values(), strict=True)
        ):
            device = f"t{number}n{os.getpid()}"
            end = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
            self._ends.append(end)
            made = struct.pack("16sH22x", device.encode(), 0x1001)  # TUN, no header
            fcntl.ioctl(end, 0x400454CA, made)  # TUNSETIFF
            for command in (
                f"netns add {name}",
                f"link set {device} netns {name}",
                f"-n {name} link set lo up",
                f"-n {name} addr add {address}/24 dev {device}",
                f"-n {name} link set {device} up",
            ):
                subprocess.run(["ip", *command.split()], check=True)
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.over = True
        self.join()
        for name, end in zip(self.names, self._ends, strict=True):
            os.close(end)
            subprocess.run(["ip", "netns", "del", name], check=True)

    def run(self) -> None:
        due: list[tuple[float, int, int, bytes]] = []
        numbers = itertools.count()
        while not self.over:
            wait = max(0.0, due[0][0] - time.monotonic()) if due else 0.1
            for end in select.select(self._ends, [], [], min(wait, 0.1))[0]:
                number, packet = self._ends.index(end), os.read(end, 1 << 16)
                if number not in self.cut and self._chance.random() >= self.loss:
                    at = time.monotonic() + self.delay
                    heapq.heappush(due, (at, next(numbers), number, packet))
            while due and due[0][0] <= time.monotonic():
                _, _, number, packet = heapq.heappop(due)
                if number not in self.cut:
                    with contextlib.suppress(OSError):
                        os.write(self._ends[1 - number], packet)

    def tell(self) -> None:
        """Print how each connection is: what it waits for, and since when."""
        for name in self.names:
            told = ["ip", "netns", "exec", name, "ss", "-tinoa"]
            shown = subprocess.run(told, capture_output=True, text=True, check=False)
            sys.stderr.write(f"{name}:\n{shown.stdout}\n")


class Robots:
    """The two processes, and what they have told."""

    def __init__(self, way: Way, certificates: str) -> None:
        self.told: list[Told] = []
        self.still: list[float] = []
        """When the wheels were told to be safe."""
        self.lost: list[tuple[float, str]] = []
        """When who has lost the other one."""
        self.processes = [
            subprocess.Popen(
                [
                    *("ip", "netns", "exec", name, sys.executable, "-m"),
                    *("tests.net.cuts", "--be", who, "--certificates", certificates),
                ],
                stdout=subprocess.PIPE,
                stderr=None if os.environ.get("LOUD") else subprocess.DEVNULL,
            )
            for who, name in zip(ADDRESSES, way.names, strict=True)
        ]
        for who, process in zip(ADDRESSES, self.processes, strict=True):
            threading.Thread(
                target=self._hear, args=(who, process), daemon=True
            ).start()

    def _hear(self, who: str, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            at, what, *rest = json.loads(line)
            if what == "told":
                self.told.append(Told(*rest))
            elif what == "still":
                self.still.append(rest[0])
            else:
                self.lost.append((at, who))

    def fresh(self, since: float, seconds: float) -> float | None:
        """Return when the first command was sent that was decided after a moment."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if self.told and self.told[-1].decided >= since:
                return next(each.at for each in self.told if each.decided >= since)
            time.sleep(0.005)
        return None

    def end(self) -> None:
        for process in self.processes:
            process.send_signal(signal.SIGCONT)
            process.terminate()
        for process in self.processes:
            process.wait()


@attrs.frozen
class Cut:
    """What came of one, in seconds.

    Attributes:
        kind: What was cut.
        length: For how long.
        old: How many commands were too old when the driver was called.
        amid: How many the owner had judged, rightly, before it was stopped, and handed
            to the driver right after: nothing in a process can see that.
        safe: From the last command, or what made it old, to the safe one.
        fresh: From the heal to the first new command.
        lost: From the begin until the last of those who run has lost the other.
    """

    kind: str
    length: float
    old: int
    amid: int
    safe: float | None
    fresh: float | None
    lost: float | None


def cuts(
    number: int,
    *,
    seed: int = 1,
    delay: float = 0.005,
    loss: float = 0.0,
    certificates: str = "",
    lengths: tuple[float, float] = (0.1, 10.0),
    kinds: tuple[str, ...] = KINDS,
) -> Iterator[Cut]:
    """Cut the way, and stop the robots, so many times."""
    chance = random.Random(seed)
    with Way(delay, loss, seed) as way:
        robots = Robots(way, certificates)
        try:
            if robots.fresh(time.monotonic(), 60.0) is None:
                raise RuntimeError("the robots do not meet")
            for count in range(number):
                time.sleep(chance.uniform(0.3, 1.3))
                kind = kinds[count % len(kinds)]
                length = lengths[0] * (lengths[1] / lengths[0]) ** chance.random()
                begin = time.monotonic()
                stopped = (
                    robots.processes[int(kind[-1])] if kind[:4] == "stop" else None
                )
                if stopped is not None:
                    stopped.send_signal(signal.SIGSTOP)
                else:
                    way.cut = {"cut": {0, 1}, "from base": {0}}.get(kind, {1})
                time.sleep(length)
                healed = time.monotonic()
                if stopped is not None:
                    stopped.send_signal(signal.SIGCONT)
                way.cut = set()
                fresh = robots.fresh(healed, 0.5 + healed - time.monotonic())
                if fresh is None:
                    way.tell()
                    fresh = robots.fresh(healed, 15.0)
                time.sleep(0.1)
                yield _judged(robots, kind, begin, healed, fresh)
        finally:
            robots.end()


def _judged(
    robots: Robots,
    kind: str,
    begin: float,
    healed: float,
    fresh: float | None,
) -> Cut:
    moved = [each for each in robots.told if each.at >= begin - 0.2]
    late = [
        each
        for each in moved
        # What is echoed was heard before it was sent, and no gap is in between.
        if each.at - each.sent > TIMEOUT + 0.001
        or (each.decided < begin < healed <= each.at and healed - begin > TIMEOUT)
    ]
    for each in late:
        ago = {"decided": each.at - each.decided, "sent": each.at - each.sent}
        told = f"{kind}: told {each.at - begin:.4f} s after its begin, {ago}"
        sys.stderr.write(f"{told}, looked {each.at - each.looked:.4f} s before\n")
    # While it is stopped it looks at nothing: such a look was before the stop.
    amid = sum(
        kind == "stop 0"
        and each.looked < healed <= each.at
        and each.looked - each.sent <= TIMEOUT
        for each in late
    )
    before = [
        each.at for each in moved if each.at < (healed if fresh is None else fresh)
    ]
    safe = None
    if before and healed - before[-1] > TIMEOUT + 0.1:
        last = max(before[-1], healed - TIMEOUT if kind == "stop 0" else 0.0)
        still = [at for at in robots.still if at >= before[-1]]
        safe = (still[0] if still else 1e9) - last
    first = None if fresh is None else fresh - healed
    lost = None
    if before and healed - begin > LOST + 0.05:  # else it was lost at its begin
        who = {"stop 0": ["rover"], "stop 1": ["base"]}.get(kind, list(ADDRESSES))
        when = {
            w: [at for at, one in robots.lost if one == w and at > begin] for w in who
        }
        lost = max(min(when[w], default=1e9) - begin for w in who)
    return Cut(kind, healed - begin, len(late) - amid, amid, safe, first, lost)


def summary(found: list[Cut]) -> str:
    """Return the worst of each kind."""
    lines = []
    for kind in KINDS:
        some = [each for each in found if each.kind == kind]
        fresh = [math.inf if each.fresh is None else each.fresh for each in some]
        if some:
            safe = max((each.safe or 0.0 for each in some), default=0.0)
            lost = max((each.lost or 0.0 for each in some), default=0.0)
            lines.append(
                f"{kind}: {len(some)} times, old {sum(each.old for each in some)}, "
                f"amid {sum(each.amid for each in some)}, safe after {safe:.3f} s, lost "
                f"after {lost:.2f} s, fresh after {statistics.median(fresh):.3f} s, at most "
                f"{max(fresh):.3f} s, {sum(each > 0.5 for each in fresh)} after 0.5 s"
            )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--be", choices=list(ADDRESSES))
    parser.add_argument("--certificates", default="")
    parser.add_argument("--cuts", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--delay", type=float, default=0.005)
    parser.add_argument("--loss", type=float, default=0.0)
    parser.add_argument("--lengths", type=float, nargs=2, default=(0.1, 10.0))
    parser.add_argument("--kinds", default=",".join(KINDS))
    given = parser.parse_args()
    if given.be is not None:
        robot = {"base": base, "rover": rover}[given.be](given.certificates)
        esair.run(robot)
        return
    found: list[Cut] = []
    for cut in cuts(
        given.cuts,
        seed=given.seed,
        delay=given.delay,
        loss=given.loss,
        certificates=given.certificates,
        lengths=given.lengths,
        kinds=tuple(given.kinds.split(",")),
    ):
        found.append(cut)
        sys.stdout.write(json.dumps(attrs.astuple(cut)) + "\n")
        sys.stdout.flush()
    sys.stdout.write(summary(found) + "\n")


if __name__ == "__main__":
    main()
