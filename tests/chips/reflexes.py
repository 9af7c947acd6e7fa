"""The reactions of natural worlds, as they are written for C: each with its kind of command."""

import math

from esair.minimal import Reaction


class Number(Reaction):
    def as_command(self, value):
        return value

    def part(self, command, share):
        return command * share


class Pair(Reaction):
    def as_command(self, value):
        return (value, -0.5 * value)

    def part(self, command, share):
        return (command[0] * share, command[1] * share)


class Count(Reaction):
    def as_command(self, value):
        return int(value * 10 + 0.0501)

    def part(self, command, share):
        return int(command * share)


class Follow(Reaction):
    def react(self, a):
        return None if a > 1.6 else self.as_command(0.3 * a)


class Avoid(Reaction):
    near = False

    def react(self, a):
        self.near = a < (0.9 if self.near else 0.6)
        return self.as_command(-0.4) if self.near else None


class Sum(Reaction):
    near_ms = 0

    def react(self, a):
        self.near_ms = self.near_ms + self.elapsed_ms if a < 0.9 else 0
        return self.as_command(0.001 * self.near_ms) if self.near_ms > 90 else None


class Back(Reaction):
    until = -1

    def react(self, a):
        if a < 0.35:
            self.until = self.now_ms + 300
        return self.as_command(-0.7) if self.now_ms < self.until else None


class Fuse(Reaction):
    def react(self, b, a):
        return self.as_command(0.25 * (a + b) + 0.05 * a)


class Maybe(Reaction):
    def react(self, a, b):
        return self.as_command(0.2 * a if b is None else 0.1 * b)


class Both(Reaction):
    def react(self, a):
        if a > 1.8:
            return None
        if a < 1.2:
            return {"x": self.as_command(0.5 * a), "y": self.second(0.25 * a)}
        return {"x": self.as_command(0.5 * a)}


class Wrong(Reaction):
    """Wants what is bad by itself when near: no number, what is not defined, too much."""

    def react(self, a):
        if a > 0.9:
            return self.as_command(0.4 * a)
        if a < 0.5:
            return self.as_command(a / (a - a))
        return self.as_command(float("nan") if a < 0.7 else 0.9)


class Half(Reaction):
    def react(self, a):
        value = math.inf if a < 0.8 else 0.25 * a
        return {
            "x": self.as_command(0.5 * a),
            "y": self.second(value) if a < 1.2 else None,
        }


class Slower(Reaction):
    def react(self, a, x):
        if a < 0.3:
            return None
        return self.part(x, 1.0 if a > 1.2 else 0.5)

    def blind(self, x):
        return self.part(x, 0.25)


class Stops(Reaction):
    until = -1

    def react(self, a, x):
        if a < 0.5:
            self.until = self.now_ms + 100
        return None if self.now_ms < self.until else x


class SecondNumber(Reaction):
    def second(self, value):
        return value


class SecondPair(Reaction):
    def second(self, value):
        return (value, value)


KINDS = {"number": Number, "pair": Pair, "count": Count}
SECOND = {"number": SecondNumber, "pair": SecondPair}
