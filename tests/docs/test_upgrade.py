"""Who comes from an earlier version finds each name that is gone in the page."""

import importlib
import inspect

import pytest
from docs.sync import ROOT

import esair
from esair import buses

PAGE = (ROOT / "docs" / "how-to" / "upgrade.md").read_text(encoding="utf-8")

GONE = {  # what public modules exported in 0.1 or 0.2, and do not any more
    "esair.actions": "Answers mistakes_in_needs mistakes_in_reaction mistakes_in_requests",
    "esair.boards.link": "stuffed unstuffed",
    "esair.buses.can": "VirtualCan",
    "esair.config": "ActuatorSafety Writer",
    "esair.connections": "Calls READ_TIMEOUT Told check_duration is_drivers",
    "esair.discovery": "Kind",
    "esair.drivers.odrive": "decode_mode decode_state encode_state",
    "esair.drivers.pca9685_servo": "",
    "esair.drivers.servo": "ServoLink",
    "esair.firmware": "mistakes",
    "esair.loop": (
        "Bridge Entry Every Lane Recorder Spoke Suspended Tape Wheel bridge finish"
        " first_step freeze_garbage stepping unfreeze_garbage"
    ),
    "esair.messages": "check_name is_positive passes_as snake_case",
    "esair.minimal": "Guards Reads Writes mistakes step_text",
    "esair.plan": "only_looking refuse_while_looking wrong_bus",
    "esair.testing.parts": "",
    "esair.wires": "",
}

KEYWORDS = {  # what a call took, and does not any more
    "opener=": buses.SerialBus,
    "inline=": buses.I2CBus,
    "lane=": buses.python_can,
    "component=": esair.BehaviorSupervisor.add,
    "estimate_period=": importlib.import_module("esair.drivers.odrive.fake").FakeOdrive,
    "heartbeat_period=": importlib.import_module(
        "esair.drivers.odrive.fake"
    ).FakeOdrive,
}

ATTRIBUTES = {  # what an object had, and has not any more
    "overrun": buses.BusStats,
    "obsolete": buses.BusStats,
    "lines": buses.SerialBus,
    "start": esair.BehaviorSupervisor,
    "stop": esair.ResourceSupervisor,
    "wake": esair.ResourceSupervisor,
    "grant": esair.ResourceSupervisor,
    "latch": esair.ResourceSupervisor,
    "make_safe": esair.ResourceSupervisor,
    "halt": esair.BehaviorSupervisor,
    "all_ended": esair.BehaviorSupervisor,
}


def words() -> set[str]:
    """Return every word of the left column, as it is called or imported."""
    rows = [
        line.split(" | ")[0] for line in PAGE.splitlines() if line.startswith("| `")
    ]
    text = " ".join(rows)
    for sign in "`,|()":
        text = text.replace(sign, " ")
    found = set(text.split())
    return found | {word.rpartition(".")[2] for word in found}


def exported(module: str) -> list[str]:
    """Return what a module exports; nothing if it is not there."""
    try:
        found = importlib.import_module(module)
    except ModuleNotFoundError:
        return []
    own = [n for n, v in vars(found).items() if getattr(v, "__module__", "") == module]
    return getattr(found, "__all__", own)


@pytest.mark.parametrize(
    "name",
    [
        f"{module}.{name}" if name else module
        for module, names in GONE.items()
        for name in (names.split() or [""])
    ],
)
def test_a_name_that_is_gone_is_in_the_page(name) -> None:
    """With its module, or alone; and it is really gone."""
    module, _, last = name.rpartition(".")

    assert name in words() or last in words()
    assert last not in exported(module)
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module(name)


@pytest.mark.parametrize("keyword", KEYWORDS)
def test_a_keyword_that_is_gone_is_in_the_page(keyword) -> None:
    """As it is written."""
    assert keyword in words() or f"{keyword}..." in words()
    taken = inspect.signature(KEYWORDS[keyword]).parameters
    assert keyword.rstrip("=") not in taken


@pytest.mark.parametrize("name", ATTRIBUTES)
def test_an_attribute_that_is_gone_is_in_the_page(name) -> None:
    """As it is written."""
    assert name in words()
    assert not hasattr(ATTRIBUTES[name], name)


def test_what_stands_for_a_name_is_there() -> None:
    """Each dotted name of esair in the right column can be imported."""
    wrong = []
    for line in PAGE.splitlines():
        if not line.startswith("| `"):
            continue
        for word in line.split(" | ")[1].replace("`", " ").replace(",", " ").split():
            if not word.startswith("esair."):
                continue
            module, _, last = word.rstrip(".:;").rpartition(".")
            try:
                found = importlib.import_module(module)
                if not hasattr(found, last):
                    importlib.import_module(f"{module}.{last}")
            except ImportError:
                wrong.append(word)
    assert wrong == []
