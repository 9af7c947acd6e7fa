"""The page of error messages shows the messages as they are, and all of them."""

from pathlib import Path

import esair
import esair.exceptions

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "error-messages.md"

ERRORS = [
    esair.UnknownNameError("resource", "sonr", ["sonar", "wheels"]),
    esair.NameTakenError("behavior", "wander"),
    esair.NotRegisteredError("wander", "wheels"),
    esair.AccessDeniedError("visitor", "arm", "WRITE", "no rule allows it"),
    esair.ResourceRemovedError("sonar"),
    esair.DeviceLostError("sonar"),
    esair.DeviceFaultError("wheels", "expected a fan41"),
    esair.DriverStuckError("arm", "write", 1.0),
    esair.NoTurnError("chips", "chip 0x40", 1.0),
    esair.StaleReadingError("sonar", 0.62, 0.5),
    esair.BadValueError("wheels", "linear", "expected at most 0.6, not 3.0"),
    esair.BehaviorUnavailableError("mapper", "receive", 1.0, "parked"),
    esair.BehaviorRemovedError("mapper"),
    esair.BehaviorFailedError("eyes", "OSError: the camera library has crashed"),
    esair.ProcessDiedError("detect", "was killed by SIGKILL", -9),
    esair.RefusedError("no way in", "docking"),
    esair.OutcomeUnknownError("far_docking", "no beat for 1.1 s"),
    esair.CircularRequestError(["a", "b", "a"]),
    esair.BusyError("docking", "queue", 16),
    esair.ConfigError("robot.toml", "actuator.wheels.safe", "expected a command"),
    esair.StoppingError("robot 'rover'", "stopping"),
    esair.HaltedError("wheels", "hand in the gripper"),
    esair.WrongLoopError("wander", "wheels"),
    esair.RecordingError("run.mcap", "the disk is full"),
    esair.RecordingBrokenError("run.mcap", "it is cut"),
]


def test_each_message_is_on_the_page_as_it_is_raised() -> None:
    """With the name of its class beside it."""
    text = PAGE.read_text(encoding="utf-8")

    missing = [
        str(error)
        for error in ERRORS
        if f"`{error}` : `{type(error).__name__}`" not in text
    ]

    assert missing == []


def test_no_error_is_forgotten() -> None:
    """A new one needs a message, a meaning, and what to do."""
    every = {
        value
        for value in vars(esair.exceptions).values()
        if isinstance(value, type) and issubclass(value, esair.EsairError)
    }

    assert every - {esair.EsairError} == {type(error) for error in ERRORS}
