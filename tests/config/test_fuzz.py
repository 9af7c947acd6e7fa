"""Whatever a file says: a sound description, or clear mistakes. Nothing else."""

import datetime
import json
import math

import hypothesis.strategies as st
import pytest
from hypothesis import HealthCheck, given, settings

from esair import config
from esair.exceptions import ConfigError
from esair.plan import errors_in, examine

SOUND = {
    "robot": {"name": "rover", "grace": 1.0},
    "bus": {
        "front": {
            "type": "{m}:Wire",
            "port": "p",
            "baudrate": 9600,
            "sim": {"port": "memory"},
        },
        "drive": {
            "type": "can",
            "channel": "can0",
            "bitrate": 500000,
            "options": {"app_name": "x"},
        },
    },
    "sensor": {
        "sonar": {
            "driver": "{m}:Sonar",
            "bus": "front",
            "rate": 20.0,
            "gain": 3,
            "required": False,
            "deadline": 1.0,
            "sim": {"driver": "{m}:FakeSonar", "value": 2.5},
        },
        "x": {
            "driver": "{m}:Picky",
            "bus": "front",
            "pin": 3,
            "table": "map",
            "offsets": [1.0, 2.0],
            "start": {"linear": 1.0},
            "weights": {"a": 1.0},
            "mode": "fast",
        },
    },
    "actuator": {
        "wheels": {
            "driver": "{m}:Wheels",
            "bus": "front",
            "safe": {"linear": 0.0, "angular": 0.0},
            "limits": {"linear": [-1.0, 1.0]},
            "slew": {"linear": 2.0},
            "clamp": True,
            "command_timeout": 0.3,
        }
    },
    "behavior": {
        "wander": {
            "driver": "{m}:Wander",
            "speed": 0.5,
            "inbox_size": 4,
            "inbox_policy": "latest",
            "restart": {"max": 3, "within": 30.0},
        },
        "avoid": {
            "driver": "{m}:Avoid",
            "rate": 20.0,
            "reads": {"sonar": {"name": "sonar", "max_age": 0.4}},
            "writes": {"wheels": {"priority": 5, "hold": 0.2}},
        },
    },
    "access": {
        "wheels": {
            "wander": "write",
            "avoid": "write, configure",
            "exclusive": False,
            "max_priority": {"avoid": 20},
        }
    },
}


def toml(value) -> str:
    """Write a value as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml(k)} = {toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, float) and not math.isfinite(value):
        return {"nan": "nan", "inf": "inf", "-inf": "-inf"}[str(value)]
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    return repr(value)


def paths(value, above=()):
    """Yield the path of every value in a document."""
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in items:
        yield (*above, key)
        if isinstance(inner, dict | list):
            yield from paths(inner, (*above, key))


PATHS = sorted(paths(SOUND), key=str)
WORDS = sorted({str(part) for path in PATHS for part in path})
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
VALUES = st.recursive(
    st.one_of(
        st.booleans(),
        st.integers(-(2**70), 2**70),
        st.floats(),
        TEXTS,
        st.sampled_from([*WORDS, "{m}:Sonar", "{m}:Twist", "{m}:Path", "{m}:", "a:b"]),
        st.just(datetime.date(2020, 1, 2)),
        st.just(datetime.time(1, 2)),
    ),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3)
    ),
    max_leaves=5,
)
CHANGES = st.lists(
    st.tuples(
        st.sampled_from(PATHS),
        st.sampled_from(["replace", "remove", "rename", "add"]),
        st.sampled_from(WORDS) | TEXTS,
        VALUES,
    ),
    min_size=1,
    max_size=4,
)


def change(document, path, how, word, value) -> None:
    """Make one change, if the place is still there."""
    holder = document
    for part in path[:-1]:
        try:
            holder = holder[part]
        except (KeyError, IndexError, TypeError):
            return
    last = path[-1]
    if isinstance(holder, list):
        if how == "remove":
            holder[:] = holder[:-1]
        elif isinstance(last, int) and last < len(holder):
            holder[last] = value
    elif isinstance(holder, dict) and last in holder:
        if how == "replace":
            holder[last] = value
        elif how == "remove":
            del holder[last]
        elif how == "rename":
            holder[word] = holder.pop(last)
        else:
            holder[word] = value


def loads_or_tells(project, text, *, simulated) -> None:
    project.file.write_text(text.replace("{m}", project.module), encoding="utf-8")
    try:
        described = config.load(project.file, simulated=simulated)
    except (ConfigError, ExceptionGroup) as error:
        told = getattr(error, "exceptions", [error])
    else:
        # What was accepted is a robot that the core accepts too.
        assert not errors_in(examine(config.build(described).plan))
        told = []
    for each in told:
        assert isinstance(each, config.ConfigFileError)
        assert str(project.file) in str(each)
        assert each.reason
        assert len(str(each)) < 2000
    # ``esair check`` says the same, and never fails over it.
    try:
        report = config.check(project.file)
    except ConfigError:
        return
    assert report.errors == sum(each.severity == "error" for each in report.findings)


FUZZ = settings(
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


def test_the_document_that_is_changed_is_sound(project) -> None:
    """Else the test below would prove nothing."""
    text = "\n".join(f"{key} = {toml(value)}" for key, value in SOUND.items())
    project.file.write_text(text.replace("{m}", project.module))

    assert config.load(project.file).name == "rover"
    assert config.check(project.file).errors == 0


@pytest.mark.long
@pytest.mark.fault("G02")
@pytest.mark.fault("G03")
@FUZZ
@given(changes=CHANGES, simulated=st.booleans())
def test_any_change_of_a_sound_file_loads_or_is_told(
    project, changes, simulated
) -> None:
    """Values, names and keys that are replaced, removed, renamed or added."""
    document = json.loads(json.dumps(SOUND))
    for path, how, word, value in changes:
        change(document, path, how, word, value)
    text = "\n".join(f"{toml(key)} = {toml(value)}" for key, value in document.items())

    loads_or_tells(project, text, simulated=simulated)


@pytest.mark.fault("G01")
@FUZZ
@given(data=st.data())
def test_any_damage_to_the_text_loads_or_is_told(project, data) -> None:
    """Characters that are lost, doubled, or replaced."""
    text = "\n".join(
        f"[{key}]\n" + "\n".join(f"{k} = {toml(v)}" for k, v in table.items())
        for key, table in SOUND.items()
    )
    for _ in range(data.draw(st.integers(1, 3))):
        begin = data.draw(st.integers(0, len(text) - 1))
        length = data.draw(st.integers(0, 8))
        put = data.draw(
            st.sampled_from(["", '"', "=", "]", "\n", "{", "'''", ".", "9"]) | TEXTS
        )
        text = text[:begin] + put + text[begin + length :]

    loads_or_tells(project, text, simulated=False)
