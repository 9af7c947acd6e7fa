"""Pages are read in a clone: the code stands in them, and is that of the tested files."""

import re

import pytest
from docs import sync

NAMES = [str(page.relative_to(sync.ROOT)) for page in sync.PAGES]


@pytest.mark.parametrize("name", NAMES)
def test_the_code_of_a_page_is_that_of_its_file(name) -> None:
    """``python -m docs.sync`` writes it anew."""
    page = (sync.ROOT / name).read_text(encoding="utf-8")

    assert sync.synced(page) == page


@pytest.mark.parametrize("name", NAMES)
def test_a_page_needs_no_program_to_be_read(name) -> None:
    """No code that is only named, no link that only Sphinx can follow."""
    page = (sync.ROOT / name).read_text(encoding="utf-8")

    assert "{literalinclude}" not in page
    assert "{doc}`" not in page
    assert page.count("<!-- code: ") == len(sync.BLOCK.findall(page))


def test_what_readme_links_is_looked_at() -> None:
    """Each page of the docs that README leads to is one of these."""
    links = re.findall(r"\]\((docs/[^)#]+\.md)", (sync.ROOT / "README.md").read_text())

    assert len(links) > 40
    assert {*links} <= {*NAMES}


def test_a_block_follows_its_file() -> None:
    """A changed line of the page is written anew, the rest of the page stays."""
    page = "a\n\n<!-- code: docs/sync.py object=piece -->\n```python\nold\n```\n\nb\n"

    new = sync.synced(page)

    assert new.startswith(
        "a\n\n<!-- code: docs/sync.py object=piece -->\n```python\ndef "
    )
    assert new.endswith('return LANGUAGES.get(suffix, "text"), text\n```\n\nb\n')
    assert sync.synced(new) == new


@pytest.mark.parametrize(
    ("where", "says"),
    [
        ("nowhere.py", "there is no file nowhere.py"),
        ("docs/sync.py object=Nobody", "there is no Nobody in it"),
        ("docs/sync.py from=!!!!", "no line contains '!!!!'"),
    ],
)
def test_what_is_not_there_is_named(where, says) -> None:
    """A page cannot go on with code that has gone."""
    with pytest.raises(ValueError, match=says):
        sync.piece(where)
