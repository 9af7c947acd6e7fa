"""Reactions written at random: expressions, statements and wiring of their own.

Each text comes in two forms: as a user writes it, which is translated, and with ``i32``
around what makes an integer, which is what MIN runs: integers of C have 32 bits, and what
does not fit is a fault.
"""

from __future__ import annotations

import random
import re
from typing import Any

HEAD = """
import math
from collections import namedtuple
from esair.minimal import Reaction, guards, reads, writes

class Twist(namedtuple("Twist", ("linear", "angular"))):
    def total(self, share):
        return (self.linear + self.angular) * share

class Touch(namedtuple("Touch", ("left", "count", "far"))):
    pass

LEVELS = (0.25, 0.5, -1.5, 3.0)
COUNTS = (3, -7, 100)
GAIN = 1.25
MOST = 2147483647

def i32(value):
    if not -2147483648 <= value <= 2147483647:
        raise OverflowError
    return value

def blend(a, b=0.5):
    return a * 0.75 + b * 0.25
"""

SENSORS = {"far": 1.0, "count": 1, "touch": False, "row": (0.0, 0.0, 0.0), "feel": None}
KINDS = {"number": 0.0, "amount": 0, "lamp": False, "pair": (0.0, 0.0), "twist": None}


class Writer:
    """Writes one reaction."""

    def __init__(self, rng: random.Random, params: dict[str, str]) -> None:
        self.rng, self.params = rng, params
        self.loop = 0

    def one(self, *options: Any) -> str:
        made = self.rng.choice(options)
        return str(made() if callable(made) else made)

    def real(self, depth: int) -> str:
        rng, d = self.rng, depth - 1
        plain = [
            repr(round(rng.uniform(-3, 3), 2)),
            "GAIN",
            "self.level",
            "v",
            "w",
            "0.0",
            "-0.0",
        ]
        plain += ["1e300", "5e-324"] * (rng.random() < 0.1)
        plain += [p for p, kind in self.params.items() if kind == "float"]
        for p, kind in self.params.items():
            plain += [f"{p}[{rng.randint(-3, 2)}]"] * (kind == "row")
            plain += [f"{p}.far"] * (kind == "feel")
        if depth <= 0:
            return rng.choice(plain)
        r, i, b = self.real, self.whole, self.truth
        return self.one(
            *plain[:3],
            lambda: f"({r(d)} {rng.choice('+-*')} {r(d)})",
            lambda: f"({r(d)} {rng.choice(['/', '//', '%'])} {r(d)})",
            lambda: f"({i(d)} / {i(d)})",
            lambda: f"({r(d)} {rng.choice('+-*')} {i(d)})",
            lambda: f"(-{r(d)})",
            lambda: f"abs({r(d)})",
            lambda: f"{rng.choice(['min', 'max'])}({r(d)}, {r(d)}, {r(d)})",
            lambda: f"({r(d)} if {b(d)} else {r(d)})",
            lambda: f"({r(d)} {rng.choice(['and', 'or'])} {r(d)})",
            lambda: f"float({i(d)})",
            lambda: f"math.sqrt({r(d)})",
            lambda: (
                f"math.{rng.choice(['sin', 'atan', 'radians', 'fabs', 'exp'])}({r(d)})"
            ),
            lambda: f"math.atan2({r(d)}, {r(d)})",
            lambda: f"self.bump({r(d)})",
            lambda: f"self.pure({r(d)}, {i(d)})",
            lambda: f"blend({r(d)})",
            lambda: f"blend(b={r(d)}, a={r(d)})",
            lambda: f"LEVELS[(k ^ {i(d)}) & 5]",
            lambda: f"({r(d)}, {r(d)}, {r(d)})[(k | {i(d)}) % 4]",
            lambda: f"Twist({r(d)}, angular={r(d)}).total({r(d)})",
            lambda: f"self.place.{rng.choice(['linear', 'angular'])}",
            lambda: f"(self.maybe if self.maybe is not None else {r(d)})",
            lambda: "(self.maybe * 1.0)",
            lambda: (
                f"{{(True, False): 0.5, (False, False): {rng.uniform(-1, 1):.2f}}}"
                f".get(({b(d)}, {b(d)}), {r(d)})"
            ),
            lambda: "max(LEVELS)",
        )

    def whole(self, depth: int) -> str:
        rng, d = self.rng, depth - 1
        plain = [
            str(rng.randint(-9, 9)),
            "self.n",
            "k",
            "self.now_ms",
            "self.elapsed_ms",
        ]
        plain += ["MOST", "(-2147483648)", "40000"] * (rng.random() < 0.15)
        plain += [p for p, kind in self.params.items() if kind == "int"]
        plain += [f"{p}.count" for p, kind in self.params.items() if kind == "feel"]
        if depth <= 0:
            return rng.choice(plain)
        r, i, b = self.real, self.whole, self.truth
        return self.one(
            *plain[:4],
            lambda: f"i32({i(d)} {rng.choice('+-*')} {i(d)})",
            lambda: f"i32({i(d)} {rng.choice(['//', '%'])} {i(d)})",
            lambda: f"({i(d)} {rng.choice('&|^')} {i(d)})",
            lambda: f"i32({i(d)} << ({i(d)} % 40))",
            lambda: f"({i(d)} >> {i(d)})",
            lambda: f"(~{i(d)})",
            lambda: f"i32(-{i(d)})",
            lambda: f"i32(abs({i(d)}))",
            lambda: f"{rng.choice(['min', 'max'])}({i(d)}, {i(d)})",
            lambda: f"i32(int({r(d)}))",
            lambda: f"i32(round({r(d)}))",
            lambda: f"i32(math.{rng.choice(['floor', 'ceil'])}({r(d)}))",
            lambda: f"({i(d)} if {b(d)} else {i(d)})",
            lambda: f"({i(d)} {rng.choice(['and', 'or'])} {i(d)})",
            lambda: f"i32({b(d)} + {i(d)})",
            lambda: f"COUNTS[k - {i(d)}]",
            lambda: "len(LEVELS)",
            lambda: f"self.next({i(d)})",
        )

    def truth(self, depth: int) -> str:
        rng, d = self.rng, depth - 1
        plain = ["self.on", "self.near"]
        plain += [p for p, kind in self.params.items() if kind == "bool"]
        plain += [f"{p}.left" for p, kind in self.params.items() if kind == "feel"]
        if depth <= 0:
            return rng.choice(plain)
        r, i, b = self.real, self.whole, self.truth
        compare = ["<", "<=", ">", ">=", "==", "!="]
        return self.one(
            plain[0],
            lambda: f"({r(d)} {rng.choice(compare)} {r(d)})",
            lambda: f"({i(d)} {rng.choice(compare)} {i(d)})",
            lambda: f"({r(d)} {rng.choice(compare)} {i(d)})",
            lambda: f"({r(d)} < {i(d)} <= {r(d)})",
            lambda: f"({i(d)} < self.next({i(d)}) != {i(d)} > {r(d)})",
            lambda: f"({b(d)} and {b(d)} or {b(d)})",
            lambda: f"(not {b(d)})",
            lambda: f"({b(d)} {rng.choice(['==', '!=', '&', '|', '^'])} {b(d)})",
            lambda: "(self.maybe is None)",
            lambda: f"({i(d)} in (1, 2, 40, -3))",
            lambda: f"bool({r(d)})",
            lambda: f"(self.place == Twist({r(d)}, {r(d)}))",
            lambda: f"(math.isfinite({r(d)}))",
            lambda: f"self.poke({b(d)})",
        )

    def statements(self, depth: int, pad: str) -> list[str]:
        rng = self.rng
        lines: list[str] = []
        for _ in range(rng.randint(1, 3)):
            lines += [pad + line for line in self.statement(depth)]
        return lines

    def statement(self, depth: int) -> list[str]:
        rng, r, i, b = self.rng, self.real, self.whole, self.truth
        simple = [
            lambda: [f"v = {r(3)}"],
            lambda: [f"self.level = {r(3)}"],
            lambda: [f"self.level {rng.choice('+-*')}= {r(2)}"],
            lambda: [f"k = {i(3)}"],
            lambda: [f"self.n = i32(self.n {rng.choice('+-')} {i(2)})"],
            lambda: [f"self.on = {b(3)}"],
            lambda: [f"self.maybe = {self.one('None', lambda: r(2))}"],
            lambda: [f"self.place = Twist({r(2)}, {r(2)})"],
            lambda: ["v, w = w, v"],
            lambda: [f"self.near = v < ({r(1)} if self.near else {r(1)})"],
            lambda: [f"assert {b(3)}"] if rng.random() < 0.3 else ["pass"],
            lambda: [f"self.bump({r(2)})"],
        ]
        if depth <= 0:
            return rng.choice(simple)()
        inner = "    "
        self.loop += 1
        j = f"j{self.loop}"
        return rng.choice(
            [
                *simple,
                lambda: [
                    f"if {b(3)}:",
                    *self.statements(depth - 1, inner),
                    *(
                        [f"elif {b(2)}:", *self.statements(depth - 1, inner)]
                        * rng.randint(0, 1)
                    ),
                    *(
                        ["else:", *self.statements(depth - 1, inner)]
                        * rng.randint(0, 1)
                    ),
                ],
                lambda: [
                    f"for {j} in range({rng.randint(-2, 2)}, "
                    f"{rng.randint(0, 6)}, {rng.choice([1, 2])}):",
                    f"{inner}k = i32(k + {j})",
                    *self.statements(depth - 1, inner),
                    f"{inner}if {b(2)}:",
                    f"{inner}    {rng.choice(['break', 'continue'])}",
                ],
                lambda: [
                    f"for {j}, x in enumerate(LEVELS):",
                    f"{inner}v = v * 0.5 + x + {j}",
                    *self.statements(depth - 1, inner),
                ],
            ]
        )()

    def command(self, kind: str, given: str | None = None) -> str:
        r, i, b = self.real, self.whole, self.truth
        if given is not None and self.rng.random() < 0.5:
            half = {
                "number": f"{given} * 0.5",
                "amount": f"{given} // 2",
                "lamp": f"{given} and {b(1)}",
                "pair": f"({given}[0] * 0.5, {given}[1])",
                "twist": f"Twist({given}.linear, {given}.angular * 0.5)",
            }
            return self.one(given, half[kind])
        return {
            "number": lambda: self.one(lambda: r(3), lambda: i(2)),
            "amount": lambda: i(3),
            "lamp": lambda: b(3),
            "pair": lambda: f"({r(2)}, {r(2)})",
            "twist": lambda: f"Twist({r(2)}, {r(2)})",
        }[kind]()


def reaction(rng: random.Random, number: int) -> tuple[str, dict[str, Any]]:
    """Write a reaction; return its text, and what it declares."""
    seen = rng.sample(sorted(SENSORS), rng.randint(1, 3))
    params = {
        name: {"far": "float", "count": "int", "touch": "bool"}.get(name, name)
        for name in seen
    }
    is_guard = rng.random() < 0.25
    moved = rng.sample(sorted(KINDS), 2 if not is_guard and rng.random() < 0.25 else 1)
    ages = {name: rng.choice([0.03, 0.06, 0.1, 0.3]) for name in seen}
    optional = {name for name in seen if name in {"far"} and rng.random() < 0.2}
    writer = Writer(
        rng, {name: kind for name, kind in params.items() if name not in optional}
    )
    declared = [
        f"    {name} = reads(None, max_age={ages[name]}, optional={name in optional})"
        for name in seen
    ]
    for name in moved:
        priority = rng.randint(0, 3)
        if is_guard:
            declared.append(
                f"    {name} = guards(None, priority={priority}, latch={rng.random() < 0.2})"
            )
        else:
            hold, blind = (
                rng.choice([None, None, 0.1, 0.3]),
                rng.choice(["safe", "safe", "release"]),
            )
            declared.append(
                f"    {name} = writes(None, priority={priority}, hold={hold}, blind={blind!r})"
            )
    args = [*seen, *moved] if is_guard else seen
    rng.shuffle(args)
    body = ["v = 0.5", "w = -1.5", "k = 3", "if self.n == 5:", "    self.maybe = v"]
    for name in optional:
        body += [f"if {name} is not None:", f"    v = {name}"]
    body += writer.statements(2, "")
    given = moved[0] if is_guard else None
    said = [writer.command(name, given) for name in moved]
    ask = f"{{{', '.join(f'{n!r}: {s}' for n, s in zip(moved, said, strict=True))}}}"
    last = ask if len(moved) > 1 else said[0]
    if rng.random() < 0.5:
        body += [f"if {writer.truth(2)}:", "    return None"]
    body.append(f"return {last}")
    helper = Writer(rng, {})
    pure = Writer(rng, {})
    text = [
        f"class R{number}(Reaction):",
        *declared,
        f"    rate = {rng.choice([None, None, 50, 25, 10, 7])}",
        "    level = 0.25",
        "    n = 2",
        "    on = False",
        "    near = False",
        "    maybe = None",
        "    place = Twist(0.0, 1.0)",
        f"    def react(self, {', '.join(args)}):",
        *("        " + line for line in body),
        "    def bump(self, a):",
        "        self.level = a * 0.5 - self.level",
        "        self.n = i32(self.n + 1)",
        "        self.maybe = a if self.on else None",
        "        return self.level",
        "    def next(self, m):",
        "        self.n = i32(self.n + m)",
        "        return self.n",
        "    def poke(self, o):",
        "        self.on = not o",
        "        return o",
        "    def pure(self, a, m):",
        "        if a < m:",
        "            return a * m",
        "        return a - self.level",
    ]
    del helper, pure
    if is_guard and rng.random() < 0.5:
        half = {
            "number": "c * 0.25",
            "amount": "c // 3",
            "lamp": "c",
            "pair": "(c[0], 0.0)",
        }
        text += [
            "    def blind(self, c):",
            f"        return {half.get(moved[0], 'Twist(0.0, c.angular)')}",
        ]
    return "\n".join([*text, ""]), {}


def plain(text: str) -> str:
    """Return the text as a user writes it: without ``i32``."""
    return re.sub(r"(?<!def )\bi32\(", "(", text)


def robot(rng: random.Random) -> str:
    """Write a module with some reactions."""
    return HEAD + "\n".join(reaction(rng, n)[0] for n in range(rng.randint(1, 4)))


def value(rng: random.Random, name: str, module: Any) -> Any:
    """Draw a reading."""

    def real() -> float:
        if rng.random() < 0.04:
            return rng.choice([float("nan"), float("inf"), -float("inf")])
        return rng.choice(
            [rng.uniform(-3, 3), round(rng.uniform(-2, 2), 1), 0.0, -0.0, 1e9]
        )

    if rng.random() < 0.1:
        return None
    if name == "far":
        return real()
    if name == "count":
        return rng.choice([rng.randint(-5, 50), 0, 2**31 - 1, -(2**31), 100000])
    if name == "touch":
        return rng.random() < 0.4
    if name == "row":
        return (real(), real(), real())
    return module.Touch(rng.random() < 0.5, rng.randint(0, 9), real())
