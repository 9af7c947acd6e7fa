"""Plain data as bytes and back: equal, of its class, and nothing else."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import datetime
import decimal
import enum
import fractions
import gc
import math
import random
import time
from typing import Any, NamedTuple

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from esair.codec import CodecError, Kinds, declared, decode, encode
from esair.exceptions import DeviceLostError, EsairError

pytestmark = pytest.mark.promise("SEC-2")

CALLS: list[str] = []


@attrs.frozen
class Pose:
    """Frozen, with slots; its constructor checks."""

    x: float
    y: float = attrs.field(default=0.0, validator=lambda *_: CALLS.append("validator"))

    def __attrs_post_init__(self) -> None:
        CALLS.append("post_init")


@attrs.define(slots=False)
class Track:
    """Others in it, and a field that no argument sets."""

    poses: list[Pose]
    length: float = attrs.field(init=False, default=0.0)


@dataclasses.dataclass
class Scan:
    """A data class; its objects may have more than it says."""

    ranges: tuple[float, ...]
    best: Pose | None = None

    def __post_init__(self) -> None:
        CALLS.append("__post_init__")


@dataclasses.dataclass(frozen=True, slots=True)
class Small:
    """Frozen, with slots."""

    a: int
    b: str = "b"


class Cell(NamedTuple):
    """A named tuple."""

    row: int
    column: int = 0


class Colour(enum.Enum):
    """Its values are anything."""

    RED = "r"
    BLUE = (1, 2)
    ROUGE = "r"  # noqa: PIE796 - an alias


class Parts(enum.Flag):
    """Flags that are set together have no name."""

    ARM = 1
    LEG = 2
    EYE = 4


class Level(enum.IntEnum):
    """A number, too."""

    LOW = 1


class Odd(Exception):  # noqa: N818 - somebody else's
    """Cannot be made by its arguments."""

    def __init__(self, *, code: int) -> None:
        CALLS.append("Odd")
        super().__init__(f"code {code}")
        self.code = code


class Gone(DeviceLostError):  # noqa: N818 - as above
    """A driver's own."""


class Door(EsairError, OSError):  # noqa: N818 - as above
    """With the number of the system."""

    def __init__(self, number: int) -> None:
        super().__init__(number, "is closed", "/dev/door")
        self.number = number


class Closes:
    """Whoever forgets it runs code."""

    def __del__(self) -> None:
        CALLS.append("__del__")


@attrs.define
class Trap(Closes):
    """Plain to look at."""

    path: str = ""


CLASSES = (Track, Scan, Small, Cell, Colour, Parts, Level, Odd, Gone, Door)


def kinds(*more: Any, **options: Any) -> Kinds:
    """Return a table of what this module declares."""
    return Kinds((*CLASSES, *more), **options)


def through(value: Any, limit: int = 1 << 20) -> Any:
    """Return a value after it was bytes, in a table of its own."""
    return decode(encode(value, kinds(), limit), kinds(), limit)


def track() -> Track:
    """Return one whose last field is set."""
    made = Track([Pose(1.0, 2.0), Pose(math.inf)])
    made.length = 3.5
    return made


def more_than_said() -> Scan:
    """Return one with an attribute beside its fields."""
    made = Scan((1.0, 2.0), Pose(0.5))
    vars(made)["noted"] = {"a": 1}
    return made


HOUR = datetime.timedelta(hours=1)

VALUES = [
    *(None, True, False, 0, -1, 2**63 - 1, 2**63, -(2**63), -(2**63) - 1, 10**400),
    *(0.0, -0.0, 1e-300, math.inf, 1 - 2j, "", "é\u2028\udc80", "x" * 70_000),
    *(b"", b"\0\xff" * 200, bytearray(b"a"), (), [], {}, set(), frozenset()),
    *((1, 1.0, True), [1.0, 2.0, 3.0, 4.0, 5.0], (1.0, 2.0, 3.0, 4.0), [[1.0] * 9] * 3),
    {1: "a", "b": [2], (3, None): {}, 1.5: b"x", None: Pose(1.0)},
    *({1, "a", (2,)}, frozenset({b"x", None})),
    collections.OrderedDict([("b", 1), ("a", 2)]),
    *(collections.deque([1, 2], maxlen=2), collections.deque("abc")),
    *(
        range(3, 9, 2),
        slice(None, 4),
        decimal.Decimal("-1.50"),
        fractions.Fraction(3, 7),
    ),
    decimal.Decimal("1E+999999"),
    *(datetime.date(2026, 2, 28), datetime.time(1, 2, 3, 4, fold=1)),
    datetime.datetime(2026, 1, 2, 3, 4, 5, 6, tzinfo=datetime.UTC),
    datetime.datetime(2026, 1, 2, tzinfo=datetime.timezone(HOUR), fold=1),
    *(datetime.timezone(HOUR, "CET"), datetime.timedelta(-3, 5, 7)),
    *(Pose(1.0, 2.0), track(), more_than_said(), Small(1), Cell(1, 2)),
    *(
        Colour.RED,
        Colour.BLUE,
        Colour.ROUGE,
        Parts.ARM,
        Parts.ARM | Parts.EYE,
        Parts(0),
    ),
    *(Level.LOW, np.float32(2.5), np.int8(-3), np.bool_(True), np.str_("ab")),
    np.datetime64("2026-01-02T03:04:05", "ns"),
]


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_plain_data_comes_back_equal_and_of_its_class(value: Any) -> None:
    """Whatever recordings held, and children and other computers will."""
    back = through(value)

    assert type(back) is type(value)
    assert back == value
    assert sorted(repr(back)) == sorted(repr(value))  # a set has no order


def test_nan_and_the_sign_of_zero_come_back() -> None:
    """What is not equal to itself is there all the same."""
    back = through([math.nan, -0.0])
    assert math.isnan(back[0])
    assert math.copysign(1.0, back[1]) == -1.0


def test_what_is_beside_the_fields_comes_back() -> None:
    """As long as the object has room for it."""
    assert vars(through(more_than_said()))["noted"] == {"a": 1}


@pytest.mark.parametrize(
    "array",
    [
        np.arange(6.0).reshape(2, 3),
        np.asfortranarray(np.arange(6, dtype=">i2").reshape(2, 3)),
        np.array(3.0),
        np.zeros((0, 4), np.uint8),
        np.array(["ab", "c"]),
        np.array(["2026-01-02"], "datetime64[D]"),
        np.ones(3, [("a", "f4"), ("b", "i2", (2,)), ("c", [("d", "?")])]),
    ],
    ids=lambda array: array.dtype.str,
)
def test_arrays_come_back(array: Any) -> None:
    """With type, shape and items; they can be written to, as those that were sent."""
    back = through(array)
    assert (back.dtype, back.shape) == (array.dtype, array.shape)
    assert (back == array).all()
    assert back.flags.writeable


def test_errors_come_back_with_all_that_is_asked_of_them() -> None:
    """Class, arguments, attributes, number of the system, file, cause in a circle."""
    lost, gone = DeviceLostError("sonar", "gone"), OSError(19, "no", "/dev/x")
    lost.__cause__, gone.__cause__ = gone, lost
    group = ExceptionGroup("both", [ValueError(1), Odd(code=3)])
    sent = [lost, gone, Odd(code=7), Door(5), group, Gone("arm"), KeyError("k")]
    back = through(sent)

    assert [type(each) for each in back] == [type(each) for each in sent]
    assert [str(each) for each in back] == [str(each) for each in sent]
    assert [each.args for each in back[:4]] == [each.args for each in sent[:4]]
    assert (back[0].resource, back[2].code, back[3].number) == ("sonar", 7, 5)
    assert (back[1].errno, back[1].filename, back[3].errno) == (19, "/dev/x", 5)
    assert (back[0].__cause__, back[1].__cause__) == (back[1], back[0])
    assert [str(each) for each in back[4].exceptions] == ["1", "code 3"]


def test_an_error_that_is_unknown_here_is_one_of_its_name() -> None:
    """Who catches what it derives from catches it."""
    back = decode(encode(Gone("arm", "broken"), kinds()), Kinds())

    assert type(back).__name__ == "Gone"
    assert type(back) is not Gone
    assert isinstance(back, DeviceLostError)
    assert (str(back), back.resource) == (str(Gone("arm", "broken")), "arm")


def test_nothing_of_a_class_is_called() -> None:
    """Neither constructor, validator, nor what follows them; objects have fields."""
    data = encode([Pose(1.0), Scan(()), Odd(code=1)], kinds())
    CALLS.clear()
    decode(data, kinds())
    assert CALLS == []


def test_a_class_that_would_run_code_when_it_is_forgotten_never_crosses() -> None:
    """It could be named in bytes of anybody."""
    with pytest.raises(CodecError, match="Trap is no plain data"):
        encode(Trap(), kinds(Trap))
    data = encode(Small(1), kinds()).replace(b":Small", b":Trap_")
    CALLS.clear()
    with pytest.raises(CodecError, match="does not declare"):
        decode(data, kinds(Trap))
    gc.collect()
    assert CALLS == []


@attrs.frozen
class Stranger:
    """In nobody's table."""

    x: float
    y: Any = None


@pytest.mark.parametrize(
    ("value", "told"),
    [
        (lambda: None, "builtins.function is no plain data"),
        ({"pose": [Pose(1.0), object()]}, r"pose\[1\]: builtins.object is no plain"),
        (Track([Pose(object())]), r"poses\[0\]\.x: "),  # type: ignore[arg-type]
        (Stranger(1.0), "Stranger is not declared: name it"),
        (type("Metres", (float,), {})(1.0), "Metres is no plain data"),
        (np.array([object()]), "an array of object"),
        (10**10_001, "more than 10000 digits"),
        ([memoryview(b"a")], r"\[0\]: builtins.memoryview"),
        (tuple.__new__(Cell, (1, 2, 3)), "ValueError while it was read"),
        (tuple.__new__(Cell, (1,)), "ValueError while it was read"),
    ],
    ids=range(10),
)
def test_anything_else_is_an_error_of_its_sender(value: Any, told: str) -> None:
    """It names the field, and what to do."""
    with pytest.raises(CodecError, match=told):
        encode(value, kinds())


def test_a_message_is_bounded() -> None:
    """In its size, its depth and its items, for who sends and for who receives."""
    deep: Any = 1
    for _ in range(70):
        deep = [deep]
    for value, told in (
        (deep, "deeper"),
        (bytes(2000), "bytes"),
        ([None] * 900, "item"),
    ):
        with pytest.raises(CodecError, match=told):
            encode(value, kinds(), 1 << 14 if value is deep else 1000)
    data = encode(bytes(2000), kinds())
    with pytest.raises(CodecError, match="at most 1000 are read"):
        decode(data, kinds(), 1000)
    endless: list[Any] = []
    endless.append(endless)
    with pytest.raises(CodecError, match="deeper"):
        encode(endless, kinds())


def test_classes_are_those_that_a_component_declares() -> None:
    """Those of its ports and annotations, and what stands beside it in its module."""
    import esair

    class Near:
        pass

    @attrs.frozen
    class Local:
        pose: Pose

    class Eye(esair.Sensor[Local]):
        async def read(self) -> Local:
            return Local(Pose(1.0))

    class Look(esair.Reaction):
        eye = esair.reads(Local)

        def react(self, eye: Local) -> None:
            return None

    for component in (Eye, Look):
        table = Kinds(declared(component))
        value = Local(Pose(2.0))
        assert decode(encode(value, table), table) == value
        assert Small in table  # beside it
        assert Near not in table


def test_a_class_that_has_changed_is_told_by_its_field() -> None:
    """A field that has a default now is that; another one is an error of the reader."""

    def table(*fields: str, **defaults: Any) -> tuple[Any, Kinds]:
        made = attrs.make_class(
            "Changed",
            {
                name: attrs.field(
                    **({"default": defaults[name]} if name in defaults else {})
                )
                for name in fields
            },
            frozen=True,
        )
        made.__module__, made.__qualname__ = "rover", "Changed"
        return made, Kinds([made])

    then, before = table("x", "y")
    data = encode(then(1, 2), before)
    now, after = table("x", "y", "z", z=5)
    assert decode(data, after) == now(1, 2, 5)
    for fields, told in (
        (("x",), "no field 'y' now"),
        (("x", "y", "z"), "field 'z' now"),
    ):
        with pytest.raises(CodecError, match=f"rover.Changed has .*{told}"):
            decode(data, table(*fields)[1])


def test_strangers_may_be_their_fields() -> None:
    """For who only looks."""
    data = encode([Stranger(1.0, Cell(1)), Colour.RED], kinds(Stranger))
    found = decode(data, Kinds(strangers=True))
    assert found == [{"x": 1.0, "y": {"row": 1, "column": 0}}, "RED"]


LEAVES = (
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False)
    | st.text(max_size=20) | st.binary(max_size=20) | st.complex_numbers(allow_nan=False)
    | st.dates() | st.datetimes() | st.timedeltas() | st.decimals(allow_nan=False)
    | st.fractions() | st.builds(Pose, st.floats(allow_nan=False))
    | st.sampled_from([*Colour, *Parts, Level.LOW])
)  # fmt: skip

ANY = st.recursive(
    LEAVES,
    lambda parts: (
        st.lists(parts, max_size=6)
        | st.lists(parts, max_size=6).map(tuple)
        | st.dictionaries(st.text(max_size=5), parts, max_size=5)
        | st.builds(Scan, st.lists(st.floats(allow_nan=False)).map(tuple))
    ),
    max_leaves=30,
)


@pytest.mark.long
@given(ANY)
def test_any_mixture_comes_back(value: Any) -> None:
    """Equal, and written the same again."""
    data = encode(value, kinds())
    back = decode(data, kinds())
    assert back == value
    assert encode(back, kinds()) == data


@given(ANY, st.data())
def test_damaged_bytes_are_an_error_or_another_value(value: Any, data: Any) -> None:
    """Never anything else, and never much of it."""
    damaged = bytearray(encode(value, kinds()))
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(
            st.integers(0, 255)
        )
    cut = bytes(damaged[: data.draw(st.integers(0, len(damaged)))])
    for each in (bytes(damaged), cut):
        with contextlib.suppress(CodecError):
            decode(each, kinds())


def test_random_bytes_are_read_in_no_time() -> None:
    """Numbers of items that are not there take neither time nor memory."""
    dice, table = random.Random(5), kinds()
    tags = b"NTFiIfcsSbBdtlmOuvqQrwDhMEUzCRonexXxa-"
    began = time.process_time()
    for _ in range(1000):
        data = bytes(
            dice.choice([*tags, 0, 1, 255]) for _ in range(dice.randrange(1, 80))
        )
        with contextlib.suppress(CodecError):
            decode(b"\x01" + data, table)
    assert time.process_time() - began < 20.0


@pytest.mark.parametrize("tag", [b"u", b"v"])
def test_keys_that_are_alike_are_refused(tag: bytes) -> None:
    """A table of them takes the square of their number."""
    import struct

    keys = [each * (2**61 - 1) for each in range(2, 5000)]
    data = encode(keys, Kinds(), 1 << 22)
    assert data[1:2] == b"l"
    with pytest.raises(CodecError, match="alike"):
        decode(b"\x01" + tag + data[2:], Kinds(), 1 << 22)
    assert struct.unpack("<I", data[2:6]) == (len(keys),)
