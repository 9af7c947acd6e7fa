"""What the rulebook says of one component, and of its edges: just right is no mistake."""

from __future__ import annotations

import importlib.util
import sys
import typing
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import pytest
from tests.plan import rulebook_parts as parts

import esair
from esair import minimal
from esair.actions import MinimalReaction
from esair.messages import Placement
from esair.plan import Plan, examine
from esair.testing import FakeCan, FakeI2c

pytestmark = pytest.mark.promise("RS-8")

T = TypeVar("T")


def told(component: Any) -> list[tuple[str, str]]:
    """Return what is said about a component among others: the field, and the words."""
    resources: list[Any] = [parts.Sonar(), parts.Wheels(), parts.Wheels(name="other")]
    behaviors = []
    if isinstance(component, esair.Sensor | esair.Actuator):
        resources.append(component)
    else:
        behaviors.append(component)
    found = examine(Plan(resources=resources, behaviors=behaviors))
    return [
        (each.field, each.text)
        for each in found
        if each.component == component.name and each.rule not in {"unused", "silent"}
    ]


# What a reaction guards and reads.


class Limit(esair.Reaction):
    """A guard that needs no sensor."""

    wheels = esair.guards(float)

    def react(self, wheels: float) -> float | None:
        return wheels


class TwoGuards(Limit):
    other = esair.guards(float)

    def react(self, wheels: float, other: float) -> float | None:  # type: ignore[override]
        return wheels


class GuardWrites(Limit):
    other = esair.writes(float)


class AsyncBlind(Limit):
    async def blind(self, wheels: float) -> float | None:  # type: ignore[override]
        return wheels


class BlindAsks(Limit):
    def blind(self, speed: float) -> float | None:  # type: ignore[override]
        return speed


class GuardMisses(Limit):
    sonar = esair.reads(float)


class GuardMistyped(Limit):
    def react(self, wheels: str) -> float | None:  # type: ignore[override]
        return None


class ReactAsks(esair.Reaction):
    rate = 1.0

    def react(self, sonar: float) -> None:
        return None


class Ticks(esair.Reaction):
    """It reads nothing, and says how often it runs."""

    rate = 10.0
    wheels = esair.writes(float)

    def react(self) -> float:
        return 0.0


class InWords(parts.Brake):
    def react(self, sonar: typing.Annotated[float, "in metres"]) -> float | None:
        return None


class Whole(parts.Brake):
    def react(self, sonar: esair.Reading) -> float | None:  # type: ignore[override]
        return None


class WithTime(parts.Brake):
    def react(self, sonar: esair.Reading[float]) -> float | None:  # type: ignore[override]
        return None


class AnyKind(parts.Brake):
    def react(self, sonar: T) -> T | None:  # type: ignore[override]
        return None


class OfMin(minimal.Reaction):
    """What its parameters are is for readers: MicroPython has no types."""

    wheels = minimal.writes(float)
    sonar = minimal.reads(float)

    def react(self, sonar: str) -> float | None:
        return None


@pytest.mark.parametrize(
    ("component", "field", "words"),
    [
        (TwoGuards, "wheels", "a guard guards one actuator and writes none: make other "
         "part of another reaction"),
        (GuardWrites, "wheels", "a guard guards one actuator and writes none: make other "
         "part of another reaction"),
        (AsyncBlind, "blind", "expected a plain function"),
        (BlindAsks, "blind", "its parameter must be the command (wheels): missing a "
         "required argument: 'speed'"),
        (GuardMisses, "react", "its parameters must be its readings and the command "
         "(wheels, sonar): got an unexpected keyword argument 'sonar'"),
        (GuardMistyped, "react", "its parameter 'wheels' is a str, but the port 'wheels' "
         "guards float: annotate it as float"),
        (ReactAsks, "react", "its parameters must be its readings (none): missing a "
         "required argument: 'sonar'"),
    ],
)  # fmt: skip
def test_a_mistake_in_what_a_reaction_does_is_told(
    component: type[esair.Reaction], field: str, words: str
) -> None:
    """Once, with the way to write it."""
    texts = told(component())
    if component is ReactAsks:  # it has no sensor, and a rate
        assert texts == [(field, words)]
    assert (field, words) in texts


@pytest.mark.parametrize("sound", [Limit, Ticks, InWords, Whole, WithTime, AnyKind])
def test_a_reaction_as_it_may_be_is_fine(sound: type[esair.Reaction]) -> None:
    """A guard alone, one with a rate alone, and what may be said of a parameter."""
    assert told(sound()) == []


def test_types_of_min_are_for_readers() -> None:
    """A parameter of a reaction of MIN may be annotated with anything."""
    assert told(MinimalReaction(OfMin())) == []


# What is computed.


class Computed(esair.Derived[float]):
    sonar = esair.reads(float)

    def compute(self, sonar: float) -> float:
        return sonar


class AsyncCompute(Computed):
    async def compute(self, sonar: float) -> float:  # type: ignore[override]
        return sonar


class ComputeYields(Computed):
    def compute(self, sonar: float) -> Any:
        yield sonar


class ComputeAsks(Computed):
    def compute(self, sonra: float) -> float:  # type: ignore[override]
        return sonra


class ComputeMistyped(Computed):
    def compute(self, sonar: str) -> float:  # type: ignore[override]
        return 1.0


class Configures(Computed):
    sonar = esair.reads(float, configure=True)


class OfNothing(esair.Derived[float]):
    def compute(self) -> float:
        return 1.0


class Reads(Computed):
    async def read(self) -> float:
        return 1.0


class Pushes(Computed):
    async def stream(self) -> AsyncIterator[float]:
        yield 1.0


class Begins(Computed):
    initial = 1.0


class OnABus(Computed):
    def __init__(self) -> None:
        super().__init__(bus=FakeCan("drive"))


class AsyncOpen(Computed):
    async def open(self) -> None: ...  # type: ignore[override]


class NoBudget(Computed):
    budget = 0.0


class PlainHome(Computed):
    @esair.operation
    def home(self) -> None: ...


class WrongName(Computed):
    sonar = esair.reads(float, name="Front Sonar")


class ComputedInInit(Computed):
    def __init__(self) -> None:
        super().__init__()
        self.other = esair.reads(float)


ONLY_COMPUTE = "a derived sensor has no read, stream or initial value: write compute"


@pytest.mark.parametrize(
    ("component", "field", "words"),
    [
        (AsyncCompute, "compute", "expected a plain function, not async"),
        (ComputeYields, "compute", "expected a plain function that does not yield"),
        (ComputeAsks, "compute", "its parameters must be its readings (sonar): missing a "
         "required argument: 'sonra'"),
        (ComputeMistyped, "compute", "its parameter 'sonar' is a str, but the port "
         "'sonar' reads float: annotate it as float"),
        (Configures, "sonar.configure",
         "what is computed of a sensor does not change its settings"),
        (OfNothing, "", "it is computed of nothing: declare what with esair.reads"),
        (Reads, "compute", ONLY_COMPUTE),
        (Pushes, "compute", ONLY_COMPUTE),
        (Begins, "compute", ONLY_COMPUTE),
        (OnABus, "bus", "it is computed, and is on no bus"),
        (AsyncOpen, "open", "expected a plain function, not async"),
        (NoBudget, "budget", "expected seconds > 0, not 0.0"),
        (PlainHome, "home", "expected async def: a thread would meet compute at work"),
        (WrongName, "sonar", "resource 'Front Sonar': name: expected a lower-case letter, "
         "then letters, digits or '_', 63 at most"),
        (ComputedInInit, "other", "a port is an attribute of the class: write it there, "
         "not in __init__, or give it to super().__init__(reads={...}, writes={...})"),
    ],
)  # fmt: skip
def test_a_mistake_in_what_is_computed_is_told(
    component: type[esair.Derived[float]], field: str, words: str
) -> None:
    """Once, and nothing else."""
    assert told(component()) == [(field, words)]


def test_what_is_computed_of_a_sensor_is_fine() -> None:
    """With a plain function, and an operation that is awaited."""

    class Homes(Computed):
        @esair.operation
        async def home(self) -> None: ...

    assert told(Homes()) == []


# What a behavior takes.

ONE_PARAMETER = (
    "expected one parameter, annotated with a class derived from esair.Request"
)


class NoRequest(esair.Behavior):
    orders = esair.takes(int)  # type: ignore[type-var]


class NoQueue(esair.Behavior):
    orders = esair.takes(parts.Order, queue=0)


class HalfQueue(esair.Behavior):
    orders = esair.takes(parts.Order, queue=2.5)  # type: ignore[arg-type]


class PerhapsNewest(esair.Behavior):
    orders = esair.takes(parts.Order, newest="no")  # type: ignore[arg-type]


class TakesTwice(esair.Behavior):
    orders = esair.takes(parts.Order)
    more = esair.takes(parts.Order)


class TakesInInit(esair.Behavior):
    def __init__(self) -> None:
        super().__init__()
        self.orders = esair.takes(parts.Order)

    async def run(self) -> None: ...


class NoType(esair.Behavior):
    sonar = esair.reads(None)  # type: ignore[arg-type,var-annotated]

    async def run(self) -> None: ...


class AnswersUnknown(esair.Behavior):
    @esair.answers
    async def order(self, request: parts.Missing) -> int:  # type: ignore[name-defined]
        return 1


class AnswersByName(esair.Behavior):
    @esair.answers  # type: ignore[arg-type]
    async def order(self, *, request: parts.Order) -> int:
        return 1


class AnswersTwo(esair.Behavior):
    @esair.answers  # type: ignore[arg-type]
    async def order(self, request: parts.Order, other: parts.Order) -> int:
        return 1


class AnswersAll(esair.Behavior):
    @esair.answers
    async def order(self, request: esair.Request[int]) -> int:
        return 1


class AnswersText(esair.Behavior):
    @esair.answers
    async def order(self, request: parts.Order) -> str:
        return ""


class AnswersNothing(esair.Behavior):
    @esair.answers
    async def order(self, request: parts.Order) -> None: ...


class PlainYields(esair.Behavior):
    @esair.answers
    def order(self, request: parts.Order) -> Any:
        yield 1


class Done(esair.Request[None]):
    """It is answered, and there is nothing to say."""


class AnswersDone(esair.Behavior):
    @esair.answers
    async def done(self, request: Done) -> None: ...

    @esair.answers
    def order(self, request: parts.Order):  # type: ignore[no-untyped-def]
        return 1


class ThreadReacts(esair.ThreadBehavior):
    def react(self) -> float:
        return 1.0


@pytest.mark.parametrize(
    ("component", "field", "words"),
    [
        (NoRequest, "orders",
         "expected a class derived from esair.Request, not <class 'int'>"),
        (NoQueue, "orders", "expected a queue of 1 or more, not 0"),
        (HalfQueue, "orders", "expected a queue of 1 or more, not 2.5"),
        (PerhapsNewest, "orders", "expected newest=True or False, not 'no'"),
        (TakesTwice, "more", "Order is taken by 'orders' already"),
        (TakesInInit, "orders", "a port is an attribute of the class: write it there, "
         "not in __init__"),
        (NoType, "sonar", "expected a type such as float, not None (a name is given by "
         "name=)"),
        (AnswersUnknown, "order", "its annotations cannot be read: module "
         "'tests.plan.rulebook_parts' has no attribute 'Missing'"),
        *((each, "order", ONE_PARAMETER) for each in (AnswersByName, AnswersTwo)),
        (AnswersAll, "order", ONE_PARAMETER),
        (AnswersText, "order", "it returns str, but Order is answered with int"),
        (AnswersNothing, "order",
         "it returns NoneType, but Order is answered with int"),
        (PlainYields, "order",
         "expected a method that returns its answer, not one that yields"),
        (ThreadReacts, "react",
         "it never runs: derive from esair.Reaction, or write run"),
    ],
)  # fmt: skip
def test_a_mistake_in_what_a_behavior_takes_is_told(
    component: type[esair.Behavior], field: str, words: str
) -> None:
    """Once, and nothing else."""
    assert told(component()) == [(field, words)]


class RunsAndReacts(esair.Behavior):
    async def run(self) -> None: ...

    def react(self) -> None: ...


class SetsOfAnother(parts.Drive):
    """What it assigns to is another's attribute, which has the name of its port."""

    async def run(self) -> None:
        other: Any = Plan()
        other.wheels = 1.0


@pytest.mark.parametrize(
    "sound", [RunsAndReacts, SetsOfAnother, parts.TakesOne, AnswersDone]
)
def test_a_behavior_as_it_may_be_is_fine(sound: type[esair.Behavior]) -> None:
    """Its run calls its react; no port of its own is hidden; one request may wait."""
    assert told(sound()) == []


# Numbers, at their edges.


@pytest.mark.parametrize(
    ("component", "field", "right", "wrong"),
    [
        (parts.Sonar, "history_size", 1, True),
        (parts.Sonar, "max_repeat", 1, 1.0),
        (parts.Sonar, "traffic", 0, 0.5),
        (parts.Sonar, "required", True, 1),
        (parts.Wheels, "own_timeout", None, 0.0),
        (parts.Wheels, "command_timeout", 1e-3, None),
        (parts.Drive, "inbox_size", 1, True),
        (parts.Brake, "rate", 100_000.0, 100_001.0),
        (parts.Brake, "rate", None, "fast"),
        (parts.Brake, "mute_limit", 0, -1.0),
        (parts.Brake, "mute_limit", 0.5, None),
        (parts.Brake, "overrun_limit", 0, 1.5),
        (parts.Brake, "overrun_limit", None, True),
        (parts.Brake, "budget", None, -1.0),
    ],
)
def test_a_value_is_right_up_to_its_edge(
    component: Any, field: str, right: object, wrong: object
) -> None:
    """What is none of its kind, or one step beyond, is a mistake."""
    sound, bad = component(), component()
    setattr(sound, field, right)
    setattr(bad, field, wrong)
    ours = [each for each in told(sound) if each[0] == field]
    assert not [each for each in ours if each[1].startswith("expected")]
    assert [each for each, words in told(bad) if words.startswith("expected")] == [
        field
    ]


@pytest.mark.parametrize(
    "terms", [{"priority": True}, {"blind": "perhaps"}, {"configure": 1}]
)
def test_a_term_of_a_port_that_is_none_is_told(terms: Any) -> None:
    """A truth is no priority, and a word no protection."""
    writer = esair.Behavior(
        name="writer", writes={"wheels": esair.writes(float, **terms)}
    )

    (field,) = terms
    assert [each for each, _ in told(writer)] == [f"wheels.{field}"]


# Limits, slew, safe and initial values.


class Twist(NamedTuple):
    left: float
    right: float


class Cart(esair.Actuator[Twist]):
    safe = Twist(0.0, 0.0)

    async def write(self, command: Twist) -> None: ...


class Stays(esair.Actuator[Twist]):
    safe = esair.HOLD

    async def write(self, command: Twist) -> Twist | None: ...


class Box(esair.Actuator[dict[str, float]]):
    safe = esair.HOLD

    async def write(self, command: dict[str, float]) -> None: ...


class Lift(parts.Wheels):
    """Its safe place is the lowest."""


class Opaque:
    """Only an instance knows what it has."""


class Sealed(esair.Actuator[Opaque]):
    safe = esair.HOLD

    async def write(self, command: Opaque) -> None: ...


@pytest.mark.parametrize(
    ("component", "limits", "field", "words"),
    [
        (Cart, {"lefft": (-1.0, 1.0)}, "limits.lefft",
         "Twist(left=0.0, right=0.0) has no such field"),
        (Cart, {"left": (1.0, 2.0)}, "safe",
         "Twist(left=0.0, right=0.0) is outside the limits"),
        (Cart, {"left": (-1.0,)}, "limits.left",
         "expected (least, greatest), not (-1.0,)"),
        (Cart, {"left": 1.0}, "limits.left", "expected (least, greatest), not 1.0"),
        (Stays, {"lefft": (-1.0, 1.0)}, "limits.lefft", "Twist has no such field"),
        (Stays, (-1.0, 1.0), "limits",
         "expected a pair for each field of Twist, not (-1.0, 1.0)"),
        (Box, (-1.0, 1.0), "limits",
         "expected a pair for each field of dict, not (-1.0, 1.0)"),
        (Stays, {"left": (1.0, -1.0)}, "limits.left",
         "expected (least, greatest), not (1.0, -1.0)"),
    ],
)  # fmt: skip
def test_limits_that_do_not_fit_are_told(
    component: type[esair.Actuator[Any]], limits: Any, field: str, words: str
) -> None:
    """By the field, with what was expected, once."""
    actuator = component()
    actuator.limits = limits
    assert told(actuator) == [(field, words)]


@pytest.mark.parametrize(
    ("component", "limits"),
    [
        (Cart, {"left": (0.0, 0.0), "right": (-1.0, 1.0)}),
        (Stays, {"left": (-1.0, 1.0)}),
        (Box, {"left": (-1.0, 1.0)}),
        (Sealed, {"left": (-1.0, 1.0)}),
        (Lift, (0.0, 1.0)),
    ],
)
def test_limits_that_fit_are_fine(
    component: type[esair.Actuator[Any]], limits: Any
) -> None:
    """Just one value, the safe one at their edge, and what nobody can know before."""
    actuator = component()
    actuator.limits = limits
    assert told(actuator) == []


def test_a_slew_of_what_is_no_number_is_told() -> None:
    """There is no way from one command to the next by it."""
    wheels = parts.Wheels(name="motor")
    wheels.slew = {"left": 1.0}
    ((field, words),) = told(wheels)
    assert field == "slew"
    assert words.startswith("does not fit: ")


class Shaft(Stays):
    slew: Any = {"left": 1.0}  # noqa: RUF012 - as users write it


class SilentShaft(Shaft):
    async def write(self, command: Twist) -> None: ...  # type: ignore[override]


class KnownShaft(SilentShaft):
    safe = Twist(0.0, 0.0)


class FreeShaft(SilentShaft):
    slew = None


@pytest.mark.parametrize(
    ("component", "count"),
    [(SilentShaft, 1), (Shaft, 0), (KnownShaft, 0), (FreeShaft, 0)],
)
def test_a_slew_from_nowhere_is_told(
    component: type[esair.Actuator[Twist]], count: int
) -> None:
    """Who stays where it is, and does not say where, has an unbounded first command."""
    told_of = [words for field, words in told(component()) if field == "slew"]
    assert len(told_of) == count
    assert all("its first command after each opening" in each for each in told_of)


def test_an_initial_value_may_have_a_time_of_its_own() -> None:
    """What it begins with is looked at, not the stamp; wrong limits are told alone."""

    class Begun(parts.Bumper):
        initial: Any = esair.Stamped(False, 0.0)

    class Odd(Begun):
        limits: Any = (1.0, -1.0)

    assert told(Begun()) == []
    assert [field for field, _ in told(Odd())] == ["limits"]


def test_who_has_an_identify_may_have_an_identity() -> None:
    """It is compared with what the device answers."""

    class Known(parts.Sonar):
        identity = "serial 7"

        async def identify(self) -> str:
            return "serial 7"

    assert told(Known(name="known")) == []


@pytest.mark.parametrize(
    ("bus", "words"),
    [
        (None, "expected an I2CBus, not None"),
        ("front", "expected an I2CBus, not 'front'"),
        (FakeCan("drive"), "expected an I2CBus, but 'drive' is a FakeCan"),
    ],
)
def test_a_bus_of_another_kind_is_told(bus: Any, words: str) -> None:
    """A class that declares its bus says of which kind it is."""
    assert told(parts.Chip(name="chip", bus=bus)) == [("bus", words)]


@pytest.mark.parametrize("bus", [FakeI2c("front"), FakeCan("drive")])
def test_what_says_nothing_of_its_bus_may_be_on_any(bus: Any) -> None:
    """And one that says so is on a bus of that kind."""
    assert told(parts.Slow(name="slow", bus=bus)) == []
    if isinstance(bus, FakeI2c):
        assert told(parts.Chip(name="chip", bus=bus)) == []


# What can live in a process of its own.


class Placed(esair.Behavior):
    def __init__(self, what: object = 1, **options: Any) -> None:
        super().__init__(**options)
        self.what = what

    async def run(self) -> None: ...


class PlacedSonar(parts.Sonar):
    def __init__(self, **options: Any) -> None:
        super().__init__(name="eye", **options)


def of_a_function() -> esair.Behavior:
    class Hidden(Placed): ...

    return Hidden()


@pytest.mark.promise("PLC-1")
@pytest.mark.parametrize(
    ("component", "field", "words"),
    [
        (lambda: parts.Wheels(name="motor"), "placement", "an actuator stays in the "
         "robot's process, where its safe command is: place what decides, or what is "
         "read"),
        (Computed, "placement", "what is computed of readings stays with them"),
        (lambda: PlacedSonar(bus=FakeCan("drive")), "bus", "its bus 'drive' has one "
         "owner, the robot's process: let the driver open its own device, or place what "
         "reads it"),
        (of_a_function, "placement", "its class cannot be imported as "
         f"{__name__}:of_a_function.<locals>.Hidden: define it at the top of a module"),
        (lambda: Placed(what=print), "placement", "what cannot be sent to a process"),
        (lambda: Placed(print), "placement", "[0] cannot be sent to a process"),
    ],
)  # fmt: skip
def test_what_stays_in_the_robots_process_is_told(
    component: Any, field: str, words: str
) -> None:
    """With what could be placed instead; in the robot's own process it is fine."""
    made = component()
    assert told(made) == []
    made.placement = "process"
    ((found, text),) = told(made)
    assert found == field
    assert text.startswith(words)


@pytest.mark.promise("PLC-1")
@pytest.mark.parametrize("where", ["process", "task", None, Placement()])
def test_what_can_live_in_a_process_is_fine(where: Any) -> None:
    """A behavior that is made of plain data, a reaction, a sensor without a bus."""
    for made in (Placed(what=[1.0]), Placed(), parts.Brake(), PlacedSonar()):
        made.placement = where
        assert told(made) == []


@pytest.mark.promise("PLC-1")
def test_a_placement_that_is_none_is_told() -> None:
    """With the words that there are."""
    placed = Placed()
    placed.placement = "cellar"  # type: ignore[assignment]
    assert told(placed) == [
        ("placement", "expected 'process', 'task' or an esair.Placement, not 'cellar'")
    ]


CLASS = "class Work(esair.Behavior): ..."


@pytest.mark.promise("PLC-1")
@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"import esair\n{CLASS}\nif __name__ == '__main__': pass\n", None),
        (f"import esair\n{CLASS}\n", "a child imports the script, and would run it: put "
         "what runs under if __name__ == '__main__':"),
        (f"import esair\nif __name__ == '__main__':\n    {CLASS}\n", "a child imports "
         "the script without this class: define it above if __name__ == '__main__':"),
        (f"import esair\nif True:\n    {CLASS}\nif __name__ == '__main__': pass\n", None),
    ],
    ids=["above", "no such line", "inside", "below another if"],
)  # fmt: skip
def test_a_class_of_the_script_is_where_a_child_finds_it(
    text: str, words: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Above what runs only in the script itself."""
    path = tmp_path / "script.py"
    path.write_text(text)
    spec = importlib.util.spec_from_file_location("__main__", path)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "__main__", script)
    spec.loader.exec_module(script)
    work = script.Work()
    work.placement = "process"
    found = [words for field, words in told(work) if field == "placement"]
    assert found == ([] if words is None else [words])


@pytest.mark.promise("PLC-1")
def test_a_class_that_is_in_no_file_cannot_be_placed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Typed at a prompt: a child has nothing to import."""
    typed = type(sys)("__main__")
    typed.__file__ = "<stdin>"
    monkeypatch.setitem(sys.modules, "__main__", typed)
    exec(f"import esair\n{CLASS}", vars(typed))
    work = typed.Work()
    work.placement = "process"
    found = [words for field, words in told(work) if field == "placement"]
    assert found == ["its class is in no file: put it into a module"]
