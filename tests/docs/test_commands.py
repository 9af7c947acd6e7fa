"""What a page says to type is typed, and prints what the page shows."""

import collections

import pytest
from docs import commands

STEPS = {
    page: [
        step
        for step in commands.commands(page.read_text(encoding="utf-8"))
        if isinstance(step, commands.Command)
    ]
    for page in commands.PAGES
}


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=page.stem)
        for page, steps in STEPS.items()
        if any(not step.reason for step in steps)
    ],
)
def test_a_page_prints_what_it_says(page, tmp_path) -> None:
    """Every command of it, in one session; 0 differences."""
    for package in ("cyclopts", "matplotlib", "mcap"):
        pytest.importorskip(package)
    text = page.read_text(encoding="utf-8")

    assert "\n".join(commands.differences(text, tmp_path)) == ""


def test_what_is_not_typed_has_a_reason_and_is_counted() -> None:
    """A page that stops being typed changes a number here."""
    steps = [step for steps in STEPS.values() for step in steps]

    reasons = collections.Counter(step.reason for step in steps)

    assert reasons.keys() - commands.REASONS.keys() == {""}
    assert reasons == {
        "": 36,
        "installs": 10,
        "hardware": 3,
        "system": 4,
        "terminal": 6,
        "browser": 2,
        "compiler": 1,
        "ros": 1,
    }


def test_no_command_stands_where_it_is_not_typed() -> None:
    """A block of another kind has no prompt: commands are in ``console``."""
    for page in commands.PAGES:
        rest = commands.BLOCK.sub("", page.read_text(encoding="utf-8"))
        assert "\n$ " not in rest, page
        assert not {"```bash", "```sh"} & set(rest.splitlines()), page


def test_a_difference_is_found(tmp_path) -> None:
    """Other words, more words, an exit code that nobody tells of: each is one."""
    page = """
<!-- before: echo there > file -->
```console
$ cat file
there
$ echo took 0.3 s, pid 12 in /tmp/a/b
took 12.0 s, pid 7 in /home/me/b
$ printf '1 one\\n2 two\\n3 three\\n'
...
3 th...
$ cd / && echo more than it says
more than it
$ false
$ sh -c 'exit 3'
$ echo $?
3
$ pwd
/
```

<!-- not run: hardware -->
```console
$ exit 1
```
"""
    found = commands.differences(page, tmp_path)

    assert [each.splitlines()[0] for each in found] == [
        "line 4: cd / && echo more than it says: the page shows",
        "line 4: false: exit 1",
    ]
