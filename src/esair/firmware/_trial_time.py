"""``time`` of a trial: a sleep takes no time, and is as long as ever by its clock."""

# mypy: disable-error-code="attr-defined, no-redef"
# ruff: noqa: F403
# MicroPython's time has more than CPython's; all of it stands here, too.

import time as _time
from time import *

_skipped = [0]  # in microseconds


def sleep_us(count: int) -> None:
    _skipped[0] += count


def sleep_ms(count: int) -> None:
    sleep_us(count * 1000)


def sleep(seconds: float) -> None:
    sleep_us(int(seconds * 1000000))


def ticks_us() -> int:
    return int(_time.ticks_add(_time.ticks_us(), _skipped[0]))


def ticks_ms() -> int:
    return int(_time.ticks_add(_time.ticks_ms(), _skipped[0] // 1000))


def time_ns() -> int:
    return _time.time_ns() + _skipped[0] * 1000


def time() -> float:
    return time_ns() / 1000000000
