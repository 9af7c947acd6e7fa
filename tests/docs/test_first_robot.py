"""The first robot needs at most twelve ideas, in each of the three ways to it."""

import ast
import re
import tomllib
from collections.abc import Iterator

import pytest
from docs.sync import ROOT

import esair

MOST = 12

IDEAS = {
    "robot": {"Robot", "resources", "behaviors", "robot.toml", "[robot]", "name"},
    "run": {"run"},
    "project": {"esair new"},
    "simulation": {"esair sim", "sim"},
    "driver": {"driver"},
    "sensor": {"Sensor", "[sensor]"},
    "actuator": {"Actuator", "[actuator]"},
    "safe": {"safe"},
    "command_timeout": {"command_timeout"},
    "behavior": {"Behavior", "[behavior]"},
    "reaction": {"Reaction"},
    "reads": {"reads"},
    "writes": {"writes"},
    "priority": {"priority"},
    "every": {"every"},
}
"""Each idea, and how it is spelled: a class and its table in a file are one idea.

What is not in here, a reader of the first robot does not meet: esair's names and the keywords of
its calls, attributes of its classes, commands, files, and the tables and keys of a robot.toml.
"""

TEMPLATE = ROOT / "src" / "esair" / "cli" / "templates" / "project"


def between(page: str, start: str, end: str) -> str:
    text = (ROOT / page).read_text(encoding="utf-8")
    return text[text.index(start) : text.index(end)]


def written() -> str:
    """Return what ``esair new`` writes, as blocks of a page; without tests and what is next."""
    found = []
    for file in sorted(TEMPLATE.rglob("*.tmpl")):
        name = file.name.removesuffix(".tmpl")
        text = file.read_text(encoding="utf-8").replace("{{name}}", "scout")
        if name.startswith("test_") or name in {"pyproject.toml", ".gitignore"}:
            continue
        language = {"py": "python", "toml": "toml"}.get(name.rpartition(".")[2], "")
        text = text.partition("## Next")[0].replace("```", "")
        found.append(f"{name}\n```{language}\n{text}```\n")
    return "".join(found)


WAYS = {
    "README": lambda: between("README.md", "## A first robot", "## A first test"),
    "tutorial": lambda: between(
        "docs/tutorial/your-first-robot.md", "## A robot that runs", "## Its tests"
    ),
    "esair new": written,
}


def words_of(page: str) -> Iterator[str]:
    """Return the words of esair that stand in a part of a page."""
    for language, text in re.findall(r"^```(\w*)\n(.*?)^```$", page, re.M | re.S):
        if language == "python":
            yield from of_python(text)
        elif language == "toml":
            yield from of_toml(text)
    for verb in re.findall(r"\besair ([a-z]+) (?=[\w.-]+)", page):
        yield f"esair {verb}"
    yield from {"robot.toml"} & set(re.findall(r"[\w.]+", page))


def of_python(text: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Attribute(value=ast.Name(id="esair"), attr=name):
                yield name
            case ast.ImportFrom(module=str(module), names=names):
                if module.split(".")[0] == "esair":
                    yield from (each.name for each in names)
            case ast.Call(
                func=ast.Attribute(value=ast.Name(id="esair")), keywords=given
            ):
                yield from (str(each.arg) for each in given)
            case ast.ClassDef(bases=bases, body=body):
                of_esair = re.findall(
                    r"esair\.(\w+)", " ".join(map(ast.unparse, bases))
                )
                for line in body:
                    targets = getattr(line, "targets", [getattr(line, "target", None)])
                    for each in targets:
                        name = getattr(each, "id", "")
                        known = [getattr(esair, base) for base in of_esair]
                        hints = [
                            vars(k).get("__annotations__", {})
                            for b in known
                            for k in b.__mro__
                        ]
                        if any(hasattr(k, name) for k in known) or any(
                            name in h for h in hints
                        ):
                            yield name


def of_toml(text: str) -> Iterator[str]:
    for kind, tables in tomllib.loads(text).items():
        yield f"[{kind}]"
        if kind == "robot":
            yield from tables
            continue
        for table in tables.values():
            own = {"speed", "distance"} if kind == "behavior" else set()  # the user's
            yield from table.keys() - own


@pytest.mark.parametrize("way", WAYS)
def test_the_first_robot_has_few_ideas(way) -> None:
    """No word without an idea, and no more ideas than that."""
    met = set(words_of(WAYS[way]()))

    ideas = {idea for idea, spelled in IDEAS.items() if spelled & met}
    assert met - {word for spelled in IDEAS.values() for word in spelled} == set()
    assert len(ideas) <= MOST, sorted(ideas)


def test_each_idea_is_met_somewhere() -> None:
    """One that is gone is out of the table, too."""
    met = {word for page in WAYS.values() for word in words_of(page())}

    assert {word for spelled in IDEAS.values() for word in spelled} == met


@pytest.mark.parametrize(
    "more",
    [
        "```python\nclass A(esair.Sensor[float]):\n    rate = 5.0\n```\n",
        "```python\nwheels = esair.writes(float, hold=1.0)\n```\n",
        "```python\nwheels = esair.guards(float)\n```\n",
        "```python\nfrom esair.buses import SerialBus\n```\n",
        '```toml\n[access.wheels]\nwander = "write"\n```\n',
        '```toml\n[sensor.sonar]\nbus = "base"\n```\n',
        "then type `esair check robot.toml`\n",
    ],
)
def test_one_more_word_is_found(more) -> None:
    """In each kind of place."""
    known = {word for spelled in IDEAS.values() for word in spelled}

    assert set(words_of(more)) - known
