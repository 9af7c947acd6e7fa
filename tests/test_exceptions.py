"""Errors: one root, the built-ins that people expect, and messages that help."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import pytest

import esair
from esair.exceptions import describe, did_you_mean, in_short

FAMILY: dict[str, tuple[type[Exception], tuple[Any, ...]]] = {
    "ConfigError": (ValueError, ("robot.toml", "sensor.sonar.rate", "expected Hz > 0")),
    "NameTakenError": (ValueError, ("resource", "sonar")),
    "UnknownNameError": (LookupError, ("resource", "sonr", ["sonar"])),
    "NotRegisteredError": (PermissionError, ("wander", "wheels")),
    "AccessDeniedError": (PermissionError, ("wander", "wheels", "WRITE", "the policy")),
    "ResourceRemovedError": (ConnectionError, ("wheels",)),
    "DeviceLostError": (ConnectionError, ("wheels", "unplugged")),
    "DeviceFaultError": (OSError, ("wheels", "checksum")),
    "DriverStuckError": (TimeoutError, ("wheels", "write", 1.0)),
    "NoTurnError": (TimeoutError, ("chips", "a read", 1.0)),
    "StaleReadingError": (TimeoutError, ("sonar", 0.7, 0.5)),
    "BadValueError": (ValueError, ("wheels", "linear", "expected a finite number")),
    "BehaviorUnavailableError": (TimeoutError, ("mapper", "receive", 1.0, "running")),
    "BehaviorRemovedError": (esair.EsairError, ("mapper", [1])),
    "BehaviorFailedError": (esair.EsairError, ("mapper", "ValueError: bug")),
    "CircularRequestError": (esair.EsairError, (["a", "b", "a"],)),
    "BusyError": (esair.EsairError, ("mapper", "inbox_size", 16)),
    "StoppingError": (esair.EsairError, ("behaviors", "stopped")),
    "HaltedError": (PermissionError, ("arm", "somebody is in the cell")),
    "WrongLoopError": (RuntimeError, ("wander", "wheels")),
    "ProcessDiedError": (ConnectionError, ("detect", "was killed by SIGKILL", -9)),
    "RefusedError": (esair.EsairError, ("the battery is full", "docking")),
    "OutcomeUnknownError": (ConnectionError, ("far_docking", "no beat")),
    "RecordingError": (OSError, ("day.mcap", "the disk is full")),
    "RecordingBrokenError": (ValueError, ("day.mcap", "it is no recording")),
}


@pytest.mark.parametrize("name", FAMILY)
def test_each_error_is_under_the_root_and_its_built_in(name: str) -> None:
    """`except EsairError` and `except TimeoutError` (or the like) both catch it."""
    built_in, args = FAMILY[name]
    error = getattr(esair, name)(*args)

    assert isinstance(error, esair.EsairError)
    assert isinstance(error, built_in)
    assert error.args
    assert "\n" not in str(error)


def test_a_loss_is_told_once_for_each_wire_and_not_by_its_class() -> None:
    """What matters is the reason, which stands behind the names."""
    wire = esair.DeviceLostError("front", "no answer in 50 ms")
    lost = esair.DeviceLostError("ranges", describe(wire))

    assert describe(wire) == "device of 'front' is lost: no answer in 50 ms"
    assert in_short(lost) == describe(wire)
    assert in_short(esair.DeviceLostError("ranges")) == "device of 'ranges' is lost"


@pytest.mark.parametrize("name", FAMILY)
def test_each_error_names_the_component(name: str) -> None:
    """The message holds the first thing that the error is about."""
    _, args = FAMILY[name]
    error = getattr(esair, name)(*args)
    subject = args[0] if isinstance(args[0], str) else args[0][0]

    assert subject in str(error)


@pytest.mark.parametrize("name", FAMILY)
def test_each_error_can_be_copied_and_pickled(name: str) -> None:
    """It crosses threads and processes with its text and all that it is about."""
    _, args = FAMILY[name]
    error = getattr(esair, name)(*args)

    for twin in (copy.copy(error), pickle.loads(pickle.dumps(error))):
        assert type(twin) is type(error)
        assert str(twin) == str(error)
        assert vars(twin) == vars(error)


def test_every_error_of_the_family_is_exported() -> None:
    """Nothing is raised that cannot be caught by name."""
    exported = {
        name
        for name in esair.__all__
        if isinstance(getattr(esair, name), type)
        and issubclass(getattr(esair, name), esair.EsairError)
    }

    assert exported == {*FAMILY, "EsairError"}


def test_unknown_names_come_with_the_nearest() -> None:
    """A misspelling is answered with what was meant, or with what there is."""
    near = esair.UnknownNameError("sensor", "sonr", ["sonar", "radar"])
    far = esair.UnknownNameError("sensor", "lamp", ["sonar", "radar"])
    none = esair.UnknownNameError("sensor", "lamp")

    assert "did you mean 'sonar'?" in str(near)
    assert "there are radar, sonar" in str(far)
    assert "there are none" in str(none)
    assert did_you_mean("lamp", ["sonar"]) == ""


def test_errors_keep_what_they_are_about() -> None:
    """A program can ask an error; it need not parse its text."""
    assert esair.StaleReadingError("sonar", None, 0.5).age is None
    assert "no reading yet" in str(esair.StaleReadingError("sonar", None, 0.5))
    assert esair.CircularRequestError(iter("aba")).path == ("a", "b", "a")
    assert esair.BehaviorRemovedError("a", "data").data == "data"
    assert esair.ConfigError("robot", "", "is empty").args == ("robot: is empty",)
    assert esair.BadValueError("wheels", "", "is odd").args == ("wheels: is odd",)
    detailed = esair.NotRegisteredError("a", "b", "it was revoked")
    assert "(it was revoked)" in str(detailed)
    assert str(esair.DeviceLostError("sonar")) == "device of 'sonar' is lost"
    assert str(esair.BehaviorFailedError("a")) == "behavior 'a' failed"


@pytest.mark.fault("D25")
def test_any_error_can_be_described_in_one_line() -> None:
    """Even one whose text cannot be had, or has many lines."""

    class MuteError(Exception):
        def __str__(self) -> str:
            raise RuntimeError("no")

    assert describe(MuteError()) == "MuteError: (its text cannot be shown)"
    assert describe(ValueError("a\n  b")) == "ValueError: a b"
    assert describe(KeyboardInterrupt()) == "KeyboardInterrupt"


@pytest.mark.promise("SEC-1")
@pytest.mark.fault("P06")
def test_what_a_device_says_forges_no_line() -> None:
    """Line ends, escapes and what turns the direction of writing are shown as numbers."""
    error = ValueError("bad\n\x1b[2J\u202egnp\x00")
    assert describe(error) == r"ValueError: bad \x1b[2J\u202egnp\x00"
