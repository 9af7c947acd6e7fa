"""Each reaction of the examples and of the docs is translated, or refused truly."""

import importlib.util
import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.chips import robots

import esair
from esair.cli._new import write_project
from esair.firmware.c._wiring import Wiring
from esair.minimal import Reaction, declared

pytestmark = pytest.mark.promise("MIN-7")

ROOT = Path(__file__).parents[2]

TRANSLATED = {
    *("coming_from LedFollowsButton", "corridor Keep", "gripper Hold", "guarded Door"),
    *("line_follower Follow", "line_follower ClearLeft", "line_follower ClearRight"),
    *("reflex Stop", "reflex Cruise", "reflexes Avoid", "reflexes Gentle"),
    *("greenhouse NotTooWarm", "greenhouse NotTooWet", "modbus_pump Fill"),
    *("follow_line Follow", "follow_line Clear", "greenhouse_plan NotTooWet"),
    "rover KeepClear",
}
"""The others read or write what only a computer has, or take the history of a port."""

REASONS = (
    "write a namedtuple",
    "example = ...",
    "history(3)]: C has nothing like it",
    "valve.applied",
)


def reactions() -> Iterator[Any]:
    places = [
        "examples/*.py",
        "examples/*/*.py",
        "docs/code/*.py",
        "src/esair/demo/_reactions.py",
    ]
    for file in sorted(file for place in places for file in ROOT.glob(place)):
        text = file.read_text()
        if "Reaction)" in text:
            yield pytest.param(file, id=str(file.relative_to(ROOT)))


class Like:
    """A sensor or an actuator of what a reaction says."""

    clamp, limits, rate, command_timeout = False, None, None, 0.5
    EXAMPLES = {float: 1.0, int: 1, bool: False}  # noqa: RUF012

    def __init__(self, name: str, kind: Any) -> None:
        self.name = name
        self.safe = self.EXAMPLES.get(kind, kind)
        if kind is tuple:
            self.safe = (0.0, 0.0)
        elif hasattr(kind, "_fields"):
            self.safe = kind(*[0.0] * len(kind._fields))

    def read(self) -> Any:
        raise OSError

    def write(self, command: Any) -> None:
        raise OSError


@pytest.mark.long
@pytest.mark.parametrize("file", [*reactions()])
def test_it_is_translated_or_refused_with_a_reason(file, tmp_path, monkeypatch) -> None:
    if "drivers.mavlink" in file.read_text():
        pytest.importorskip("pymavlink", reason="the extra 'mavlink' is missing")
    monkeypatch.syspath_prepend(str(file.parent))
    if "from scout." in file.read_text():  # the tutorial's project
        write_project("scout", tmp_path / "scout")
        monkeypatch.syspath_prepend(str(tmp_path / "scout"))
    spec = importlib.util.spec_from_file_location(f"chips_of_{file.stem}", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    found = {}
    for name, cls in vars(module).items():
        if (
            inspect.isclass(cls)
            and issubclass(cls, Reaction | esair.Reaction)
            and (cls.__module__ == module.__name__ or "demo" in str(file))
        ):
            found[name] = outcome(made(cls), tmp_path / name)
    found.pop("Reaction", None)
    for each in [each for each in sys.modules if each.partition(".")[0] == "scout"]:
        del sys.modules[each]
    assert found
    for name, told in found.items():
        is_translated = f"{file.stem} {name}" in TRANSLATED
        assert is_translated == (told == ""), (name, told)
        assert is_translated or any(each in told for each in REASONS), (name, told)


def made(cls: Any) -> Any:
    parameters = inspect.signature(cls).parameters.values()
    needed = {each.name: 1.0 for each in parameters if each.default is each.empty}
    return cls(**needed)


def outcome(reaction: Any, folder: Path) -> str:
    needs = dict(declared(reaction))
    sensors = [
        Like(n.name or k, n.type) for k, n in needs.items() if hasattr(n, "max_age")
    ]
    actuators = [
        Like(n.name or k, n.type) for k, n in needs.items() if not hasattr(n, "max_age")
    ]
    refused: list[str] = []
    wired = robots.Robot([reaction], sensors, actuators)  # type: ignore[arg-type]
    Wiring(
        wired.reactions,
        sensors,
        actuators,
        50,
        True,
        lambda _, error: refused.append(error.reason),
    ).program()
    if refused:
        return " | ".join(refused)
    robots.in_c(wired, folder)
    return ""


class ByWord(esair.Reaction):
    wheel = esair.guards(float)

    def react(self, wheel: float) -> Any:
        return wheel if wheel < 0.0 else esair.REFUSE


class ByNone(esair.Reaction):
    wheel = esair.guards(float)

    def react(self, wheel: float) -> Any:
        return wheel if wheel < 0.0 else None


class NoGuard(esair.Reaction):
    far = esair.reads(float)
    wheel = esair.writes(float)

    def react(self, far: float) -> Any:
        return esair.REFUSE


def test_refuse_is_the_none_of_a_guard(tmp_path) -> None:
    """The same C; what is no guard has nothing to refuse."""
    texts = []
    for cls in (ByWord, ByNone):
        folder = tmp_path / cls.__name__
        assert outcome(cls(name="guard"), folder) == ""
        text = (folder / "robot" / "robot.c").read_text(encoding="utf-8")
        assert "react_guard" in text
        texts.append(text)
    assert texts[0] == texts[1]
    assert "esair.REFUSE" in outcome(NoGuard(), tmp_path / "none")
