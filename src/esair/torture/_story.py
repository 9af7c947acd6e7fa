"""A story: what is done to a robot, when; flat, so that a shorter one is easily tried."""

from __future__ import annotations

import attrs

from esair.values import printable


@attrs.frozen
class Step:
    """One thing that is done to a robot.

    Attributes:
        at: When, in seconds of the virtual clock since the robot began to start.
        kind: What is done; one of `esair.torture.KINDS`.
        target: The component that it is done to; empty if it is the robot's.
        lasts: For how long, in seconds; then it is undone. 0 for what has no end.
        how: Which variant of it.
        much: How much of it, in the unit of the kind.
    """

    at: float
    kind: str
    target: str = ""
    lasts: float = attrs.field(default=0.0, kw_only=True)
    how: str = attrs.field(default="", kw_only=True)
    much: float = attrs.field(default=0.0, kw_only=True)

    def __str__(self) -> str:
        words = [self.kind, self.target, self.how]
        if self.much:
            words.append(f"{self.much:g}")
        if self.lasts:
            words.append(f"for {self.lasts:g} s")
        return f"{self.at:7.3f} s  {' '.join(filter(None, words))}"

    def source(self) -> str:
        """Return it in Python's words."""
        words = [f"{self.at:g}", repr_of(self.kind)]
        if self.target:
            words.append(repr_of(self.target))
        for name, default in (("lasts", 0.0), ("how", ""), ("much", 0.0)):
            value = getattr(self, name)
            if value != default:
                told = repr_of(value) if isinstance(value, str) else f"{value:g}"
                words.append(f"{name}={told}")
        return f"Step({', '.join(words)})"


@attrs.frozen
class Story:
    """What happens to one robot from its start to its end.

    Attributes:
        seed: Decides the order of tasks, and what stand-ins of sensors say.
        steps: What is done, in order.
        lasts: When the robot is stopped, if no step does it before, in seconds.
    """

    seed: int
    steps: tuple[Step, ...] = ()
    lasts: float = 3.0

    @property
    def over_at(self) -> float:
        """When the last fault is undone, in seconds; its end is none."""
        faults = (each for each in self.steps if each.kind != "end")
        return max((each.at + each.lasts for each in faults), default=0.0)


def repr_of(text: str) -> str:
    """Return a text as a formatter writes it: in double quotes."""
    escaped = text.replace("\\", r"\\").replace('"', r"\"")
    return f'"{printable(escaped)}"'
