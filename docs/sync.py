"""Keeps the code that stands in the pages equal to the files that the tests run.

A page is read in a clone as well as in a browser, so code stands in it. A line before a
block says where it is from::

    <!-- code: examples/odometry.py -->
    <!-- code: examples/go_to_goal.py object=Steer -->
    <!-- code: docs/code/corridor.toml from=[sensor.sonar] to=[access.wheels] -->

The whole file, one class or function of it, or its lines from the first that contains
something up to the next that contains something else; quoted as in a shell where a space
is in it. ``name=scout`` fills in the name of the project in a template of ``esair new``.
``python -m docs.sync`` writes the blocks anew; a test says when it has to.
"""

import ast
import re
import shlex
import sys
import textwrap
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted({ROOT / "README.md", *(ROOT / "docs").rglob("*.md")})

LANGUAGES = {
    ".py": "python",
    ".toml": "toml",
    ".service": "ini",
    ".c": "c",
    ".ino": "cpp",
}

BLOCK = re.compile(r"^<!-- code: (?P<where>[^\n]+) -->\n```.*?^```$", re.M | re.S)


def piece(where: str) -> tuple[str, str]:
    """Return the language and the text that a line ``code:`` names.

    Raises:
        ValueError: There is no such file, object or line.
    """
    path, *options = shlex.split(where)
    wanted = dict(option.split("=", 1) for option in options)
    file = ROOT / path
    if not file.is_file():
        raise ValueError(f"code: {where}: there is no file {path}")
    source = file.read_text(encoding="utf-8")
    if "name" in wanted:  # of the project that a template is for
        source = source.replace("{{name}}", wanted["name"])
    lines = source.splitlines()
    if "object" in wanted:
        lines = object_in(source, wanted["object"], where)
    else:
        lines = between(lines, wanted.get("from"), wanted.get("to"), where)
    text = textwrap.dedent("\n".join(lines)).strip("\n")
    suffix = Path(file.name.removesuffix(".tmpl")).suffix
    return LANGUAGES.get(suffix, "text"), text


def object_in(source: str, name: str, where: str) -> list[str]:
    """Return the lines of a class or function, with its decorators."""
    body: list[ast.stmt] = ast.parse(source).body
    for part in name.split("."):
        for node in body:
            if getattr(node, "name", None) == part:
                break
        else:
            raise ValueError(f"code: {where}: there is no {name} in it")
        body = getattr(node, "body", [])
    first = min([node.lineno, *(d.lineno for d in getattr(node, "decorator_list", []))])
    return source.splitlines()[first - 1 : node.end_lineno]


def between(
    lines: list[str], start: str | None, end: str | None, where: str
) -> list[str]:
    """Return the lines from the one with *start* to before the one with *end*."""
    first, last = 0, len(lines)
    if start is not None:
        first = index_of(lines, start, 0, where)
    if end is not None:
        last = index_of(lines, end, first + 1, where)
    return lines[first:last]


def index_of(lines: list[str], text: str, first: int, where: str) -> int:
    """Return the index of the next line that contains a text."""
    for n in range(first, len(lines)):
        if text in lines[n]:
            return n
    raise ValueError(f"code: {where}: no line contains {text!r}")


def synced(page: str) -> str:
    """Return a page with each block as its file has it now."""

    def written(found: re.Match[str]) -> str:
        language, text = piece(found["where"])
        return f"<!-- code: {found['where']} -->\n```{language}\n{text}\n```"

    return BLOCK.sub(written, page)


def main() -> int:
    """Write anew what has changed; name the pages."""
    for path in PAGES:
        page = path.read_text(encoding="utf-8")
        if (new := synced(page)) != page:
            path.write_text(new, encoding="utf-8")
            print(path.relative_to(ROOT))
    return 0


if __name__ == "__main__":
    sys.exit(main())
