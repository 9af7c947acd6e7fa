"""The quadrature encoder, counted by whatever the board has."""

import random
import sys

import pytest
from tests.boards import pio

from esair.boards import encoder as module
from esair.boards import stand_in
from esair.boards.encoder import QuadratureEncoder

A, B = 7, 3  # no neighbours, and not in order


@pytest.fixture(autouse=True)
def machine(monkeypatch):
    """A board without anything connected."""
    for each in ("inputs", "handlers"):
        monkeypatch.setattr(stand_in, each, {})
    monkeypatch.setattr(module, "_units", set())
    monkeypatch.setitem(sys.modules, "machine", stand_in)


@pytest.fixture
def rp2(monkeypatch):
    """A board with PIO."""
    monkeypatch.setitem(sys.modules, "rp2", pio)
    monkeypatch.setattr(pio, "machines", {})
    monkeypatch.delitem(sys.modules, "esair.boards._encoder_pio", raising=False)
    yield
    sys.modules.pop("esair.boards._encoder_pio", None)


@pytest.fixture(params=["pins", "rp2", "Encoder"])
def board(request, monkeypatch):
    """A board that counts in interrupts, by PIO, in hardware."""
    if request.param == "rp2":
        request.getfixturevalue("rp2")
    elif request.param == "Encoder":
        monkeypatch.setattr(
            stand_in, "Encoder", stand_in.HardwareEncoder, raising=False
        )


def opened(a=A, b=B, levels=(0, 0), **options) -> QuadratureEncoder:
    stand_in.inputs.update({a: levels[0], b: levels[1]})
    found = QuadratureEncoder(a, b, **options)
    found.open()
    return found


@pytest.mark.parametrize("levels", [(0, 0), (1, 0), (1, 1), (0, 1)])
def test_it_counts_all_four_edges(board, levels) -> None:
    """In both directions, from any position, since it was opened."""
    encoder = opened(levels=levels)
    at = 0

    assert encoder.read() == 0
    for edges in (1, 1, 1, 1, 1, -1, -1, -1, -1, -1, -1, -7, 1, 100, -250):
        stand_in.turn(A, B, edges)
        at += edges
        assert encoder.read() == at


def test_closed_it_keeps_its_count_and_opened_again_begins_at_zero(board) -> None:
    encoder = opened(per_count=0.5)
    stand_in.turn(A, B, 5)
    encoder.close()
    stand_in.turn(A, B, 5)
    assert encoder.read() == 2.5

    encoder.open()
    stand_in.turn(A, B, -3)

    assert encoder.read() == -1.5


def test_encoders_do_not_disturb_each_other(board) -> None:
    """Each takes a counter that is free."""
    left, right = opened(), opened(10, 11)
    stand_in.turn(A, B, 5)
    stand_in.turn(10, 11, -6)
    left.close()
    third = opened(12, 13)
    stand_in.turn(12, 13, 7)
    stand_in.turn(10, 11, -6)

    assert (left.read(), right.read(), third.read()) == (5, -12, 7)
    assert module._units == {0, 1}


def test_a_counter_that_is_taken_is_refused(board) -> None:
    """Both would count the wheel of the last one."""
    first = opened(unit=2)
    with pytest.raises(ValueError, match="unit: 2 counts for another encoder"):
        opened(10, 11, unit=2)
    first.close()

    assert opened(10, 11, unit=2).read() == 0


def test_a_board_with_too_few_counters_says_so(rp2) -> None:
    """The board's own error; the number is not taken by the one that failed."""
    with pytest.raises(ValueError, match="invalid StateMachine"):
        opened(unit=8)

    assert module._units == set()


@pytest.mark.parametrize("seed", range(5))
def test_pio_counts_edges_of_any_rhythm(rp2, seed) -> None:
    """From 25 cycles on, read at any moment, with bounces of a cycle and more."""
    dice = random.Random(seed)
    encoder = opened(levels=dice.choice([(0, 0), (1, 0), (1, 1), (0, 1)]))
    (machine,) = pio.machines.values()
    at = 0
    for _ in range(400):
        way = dice.choice((1, 1, 1, -1))
        before = dict(stand_in.inputs)
        for edge in range(2 * dice.choice((0, 0, 0, 1, 5)) + 1):  # there, back, there
            if edge:
                machine.run(dice.randrange(1, 40))
            back = edge % 2
            stand_in.inputs.update(before)
            if not back:
                states = ((0, 0), (1, 0), (1, 1), (0, 1))
                index = states.index((before[A], before[B]))
                levels = states[(index + way) % 4]
                stand_in.inputs.update({A: levels[0], B: levels[1]})
        at += way
        machine.run(dice.randrange(pio.PACE, 60))
        if dice.random() < 0.3:
            assert encoder.read() == at

    assert encoder.read() == at


@pytest.mark.parametrize("x", [2**30 - 2, 2**31 - 2, 2**32 - 2, 0])
@pytest.mark.parametrize("way", [1, -1])
def test_pio_counts_on_where_its_register_wraps(rp2, x, way) -> None:
    encoder = opened()
    pio.machines[0].x = x
    pio.machines[0].run(50)
    begin = encoder.read()

    for turns in range(1, 9):
        stand_in.turn(A, B, 3 * way)
        assert encoder.read() - begin == 3 * way * turns


def test_pio_is_read_as_it_is_now(rp2) -> None:
    """Its queue is full of what was, however long it was not read."""
    encoder = opened()
    pio.machines[0].run(1000)
    stand_in.turn(A, B, 9)

    assert len(pio.machines[0].queue) == 4
    assert encoder.read() == 9


def test_the_program_leaves_room_for_others(rp2) -> None:
    """A block of PIO holds 32 instructions; two encoders share theirs."""
    opened()
    opened(10, 11)

    assert pio.machines[0].program is pio.machines[1].program
    assert len(pio.machines[0].program.code) == 20
