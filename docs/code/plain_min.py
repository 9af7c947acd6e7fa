"""The whole of MIN, without guards, in its plainest form: what the page explains.

It takes the same sensors, reactions and actuators as `esair.minimal.Loop` and decides
the same. It makes what it needs anew in each step, so a board has better.
"""

import math

from esair.minimal import declared, give_name

NEVER = -math.inf


class Reading:
    """A sensor, its newest value, and when that came."""

    def __init__(self, sensor):
        self.sensor, self.value, self.time = sensor, None, NEVER


class Mind:
    """A reaction: what it needs, what it may move, and whether it is blind."""

    def __init__(self, loop, reaction):
        self.reaction, self.blind, self.before = reaction, True, None
        self.name = give_name(reaction)
        self.values, self.needs, self.ports = {}, [], {}
        for key, need in declared(reaction):
            name = need.name or key
            if hasattr(need, "max_age"):
                reading = loop.readings[name]
                rate = min(reading.sensor.rate or loop.rate, loop.rate)
                age = round(1000 * (need.max_age or 3 / rate))
                self.needs.append((key, reading, age, need.optional))
            else:
                self.ports[key] = Port(self, need, loop.wheels[name])

    def lose_sight(self):
        """It wants nothing any more; what it could move is looked at by `settle`."""
        self.blind = True
        for port in self.ports.values():
            port.asked = NEVER

    def wants(self, said, now):
        """Remember what it has said for each of its ports."""
        if not isinstance(said, dict):
            said = dict.fromkeys(self.ports, said)  # it has one port
        for key in said:
            self.ports[key]  # a KeyError: it may not move that
        for key, port in self.ports.items():
            if said.get(key) is not None:
                port.command = fitted(port.wheel, said[key])
                port.asked = now
            elif port.wheel.holder is port:
                port.wheel.holder = None  # None gives it back


class Port:
    """What one reaction wants of one actuator, and when it said so."""

    def __init__(self, mind, need, wheel):
        self.mind, self.wheel, self.command, self.asked = mind, wheel, None, NEVER
        self.priority = need.priority
        self.hold = round(1000 * (need.hold or wheel.actuator.command_timeout))
        self.bar = need.priority if need.blind == "safe" else NEVER
        wheel.ports.append(self)
        wheel.ports.sort(key=lambda port: (-port.priority, port.mind.name))


class Wheel:
    """An actuator: who holds it, whose command stands, and since when."""

    def __init__(self, actuator):
        self.actuator, self.ports = actuator, []
        self.timeout = round(1000 * actuator.command_timeout)
        self.holder = self.writer = self.last = None
        self.since, self.owes_safe = 0, True

    def send(self, command, writer):
        """Send a command, or safe if it is nobody's; safe is tried until it is taken."""
        self.writer, self.last, self.owes_safe = writer, command, writer is None
        try:
            self.actuator.write(command if writer else self.actuator.safe)
            self.owes_safe = False
        except Exception:
            if writer:
                self.holder = None
                self.send(None, None)

    def settle(self, now, then, armed):
        """Do the will of the best who asks in this step, as things are at a moment."""
        if self.owes_safe:
            self.send(None, None)
            if self.owes_safe:
                return  # nothing goes before it
        age = then - self.since
        blind = [port for port in self.ports if port.mind.blind]
        asking = [
            port for port in self.ports if port.asked == now and port not in blind
        ]
        # 1. Who cannot see keeps away what is not above it; unarmed, all is kept away.
        bar = max((port.bar for port in blind), default=NEVER) if armed else math.inf
        if self.writer in blind:
            self.writer = None
        if self.holder in blind:
            self.holder = None
        # 2. The highest priority; of equals the one that holds, else the first by name.
        over = self.holder is None or age >= self.holder.hold
        best = asking[0] if asking else None
        if self.holder in asking and not over and self.holder.priority == best.priority:
            best = self.holder
        # 3. A motion that stands is stopped by a bar, unless a hold above it still runs.
        gone = self.holder is None or age > self.holder.hold
        moves = self.writer is not None and self.last != self.actuator.safe
        if bar > NEVER and moves and (gone or self.holder.priority <= bar):
            self.holder = self.writer = None
        # What is safe passes every bar, and holds nothing.
        still = best is not None and best.priority <= bar
        still = still and best.command == self.actuator.safe
        if still:
            bar = NEVER
        # 4. A hold that runs keeps lower and equal priorities away.
        if over:
            self.holder = None
        elif self.holder is not None and best is not self.holder:
            bar = max(bar, self.holder.priority)
        # 5. The best gets it; or what stands goes on, until its time is out.
        passes = best is not None and best.priority > bar
        if passes and not still:
            self.holder, self.since = best, now
            self.send(best.command, best)
            return
        if age >= self.timeout:
            self.writer = None
        if passes:
            self.send(best.command if self.writer else None, self.writer)
        if self.writer is None and self.last is not None:
            self.send(None, None)


class Loop:
    """Reads, decides and settles, at a fixed rate."""

    def __init__(self, reactions=(), sensors=(), actuators=(), rate=50, armed=True):
        self.rate, self.armed, self.number = rate, armed, 0
        self.readings = {give_name(each): Reading(each) for each in sensors}
        self.wheels = {give_name(each): Wheel(each) for each in actuators}
        self.minds = [Mind(self, each) for each in reactions]

    def open(self):
        """Every actuator is opened and safe first."""
        for wheel in self.wheels.values():
            wheel.actuator.open()
            wheel.send(None, None)
        for reading in self.readings.values():
            reading.sensor.open()

    def step(self):
        """One moment: see, decide, do."""
        now = self.number * 1000 // self.rate
        for mind in self.minds:  # what ended since the last step ends before this one
            if any(now - each.time > age and not o for _, each, age, o in mind.needs):
                mind.lose_sight()
        if any(mind.blind for mind in self.minds):
            for wheel in self.wheels.values():
                wheel.settle(now, now - 1, self.armed)
        for reading in self.readings.values():
            if self.is_turn_of(reading.sensor):
                try:
                    reading.value = checked(reading.sensor.read())
                    reading.time = now
                except Exception:
                    pass  # the last one ages
        for mind in self.minds:
            self.decide(mind, now)
        for wheel in self.wheels.values():
            wheel.settle(now, now, self.armed)
        self.number += 1

    def decide(self, mind, now):
        """Let a reaction decide, if it sees and it is its turn, or there is news."""
        timed = mind.reaction.rate is not None
        turn = timed and self.is_turn_of(mind.reaction)
        for key, reading, age, optional in mind.needs:
            value = reading.value
            if now - reading.time > age:
                if not optional:
                    mind.lose_sight()
                    return
                value = None
            news = reading.time == now or (value is None) != (
                mind.values.get(key) is None
            )
            turn = turn or (news and not timed)
            mind.values[key] = value
        if not turn:
            return
        mind.blind = False
        mind.reaction.now_ms = now
        mind.reaction.elapsed_ms = 0 if mind.before is None else now - mind.before
        mind.before = now
        try:
            mind.wants(mind.reaction.react(**mind.values), now)
        except Exception:
            mind.lose_sight()

    def is_turn_of(self, part):
        """A part with a rate has its turns as evenly as the steps allow."""
        if part.rate is None or part.rate >= self.rate or self.number == 0:
            return True
        share = part.rate / self.rate
        return int(self.number * share + 1e-9) > int((self.number - 1) * share + 1e-9)

    def close(self):
        """Every exit ends with each actuator's safe command."""
        for wheel in self.wheels.values():
            wheel.send(None, None)


def checked(value):
    """Refuse what is not finite; in a row infinity stands for "nothing in reach"."""
    if isinstance(value, tuple | list):
        if any(each != each for each in value):
            raise ValueError(value)
    elif value != value or value in (math.inf, -math.inf):
        raise ValueError(value)
    return value


def fitted(wheel, command):
    """Return a command in the type and limits of an actuator, or refuse it."""
    actuator, kind = wheel.actuator, type(wheel.actuator.safe)
    if kind is float and type(command) is int:
        command = float(command)
    elif not isinstance(command, kind) or (kind is int and type(command) is bool):
        raise TypeError(command)
    limits = actuator.limits or {}
    for field, (low, high) in (
        limits if isinstance(limits, dict) else {"": limits}
    ).items():
        each = getattr(command, field) if field else command
        if not low <= each <= high:
            if not actuator.clamp or not math.isfinite(each):
                raise ValueError(command)
            command = kind(min(high, max(low, each)))
    flat = command if isinstance(command, tuple) else (command,)
    if any(isinstance(each, float) and not math.isfinite(each) for each in flat):
        raise ValueError(command)
    return command
