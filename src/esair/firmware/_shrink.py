"""Makes a program small enough for a micro:bit: stripped, renamed, and in pieces.

A micro:bit has some 9.5 KB for everything, and its compiler needs five times the text
that it works on. So it compiles a program piece by piece, all in one namespace.
"""

# ruff: noqa: SIM905

from __future__ import annotations

import ast
import builtins
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice

import python_minifier
from python_minifier import RemoveAnnotationsOptions

from esair.exceptions import ConfigError
from esair.firmware._bundle import MAIN, Chunk, bundle, identifiers
from esair.firmware._short_names import free_parameters, rename_attributes

PIECE = 120
"""Characters of short statements that are compiled together."""

LONGEST = 600
"""Characters of a function: what the compiler takes, while there is much memory."""

LARGEST = 5900
"""Characters of a whole program: as tried out, up to here it never ran out of memory."""

_KEPT = frozenset(
    "run name read write react rate open close safe clamp limits command_timeout "
    "steps late refused faults fault".split()
)
"""Attributes that the parts have, or that somebody wants to see at the prompt."""

_TOO_NEW: dict[type[ast.AST], str] = {
    ast.JoinedStr: "f-strings: write %",
    ast.NamedExpr: "assignment in an expression (:=)",
    ast.AsyncFunctionDef: "async",
}
"""What MicroPython 1.9.2 has not learned yet."""

START = """\
import gc
import micropython
micropython.opt_level(3)
with open("program.py") as _f:
 for _n in {sizes}:
  exec(_f.read(_n))
  gc.collect()
{last}
"""
"""Without a collection after each piece the memory falls into splinters."""


def shrink(sources: Mapping[str, str], main: str) -> dict[str, str]:
    """Return the files of a micro:bit: the program, and the ``main.py`` that compiles it.

    Args:
        sources: The text of each module, by its dotted name.
        main: The text that starts it all.

    Raises:
        ConfigError: It is too large, or has what a micro:bit cannot do.
    """
    bare = {name: _bare(text) for name, text in sources.items()}
    chunks = bundle(bare, _bare(main))
    _refuse_what_is_too_new(chunks)
    tree = ast.Module([node for chunk in chunks for node in chunk.nodes], [])
    others = [text for name, text in bare.items() if name != "esair.minimal"]
    known = {name for text in others for name in identifiers(ast.parse(text))}
    rename_attributes(tree, frozenset(known | _KEPT))
    free_parameters(tree)
    nodes = iter(ast.parse(_renamed(ast.unparse(ast.fix_missing_locations(tree)))).body)
    texts = [_text(islice(nodes, len(chunk.nodes))) for chunk in chunks]
    _refuse_what_is_too_large(chunks, texts)
    pieces = list(_pieces(texts[:-1]))
    sizes = ",".join(str(len(each)) for each in pieces)
    return {
        "program.py": "".join(pieces),
        "main.py": START.format(sizes=sizes, last=texts[-1].rstrip()),
    }


def _refuse_what_is_too_new(chunks: list[Chunk]) -> None:
    for chunk in chunks:
        for node in (each for top in chunk.nodes for each in ast.walk(top)):
            for kind, name in _TOO_NEW.items():
                if isinstance(node, kind):
                    raise ConfigError(
                        chunk.module, chunk.name, f"a micro:bit knows no {name}"
                    )
            if isinstance(node, ast.Name) and node.id == "property":
                raise ConfigError(
                    chunk.module, chunk.name, "a micro:bit knows no property"
                )


def _refuse_what_is_too_large(chunks: list[Chunk], texts: list[str]) -> None:
    for chunk, text in zip(chunks, texts, strict=True):
        if len(text) > LONGEST:
            whose = (chunk.module, chunk.name)
            raise ConfigError(
                *(("the program", "one step") if chunk.module == MAIN else whose),
                f"stripped it has {len(text)} characters, and a micro:bit compiles "
                f"{LONGEST} at once: make it shorter, with less parts or in functions",
            )
    sizes: Counter[str] = Counter()
    for chunk, text in zip(chunks, texts, strict=True):
        sizes[chunk.module] += len(text)
    if sizes.total() > LARGEST:
        parts = ", ".join(f"{name} {size}" for name, size in sizes.most_common())
        raise ConfigError(
            "the program",
            "",
            f"stripped it has {sizes.total()} characters, and a micro:bit takes "
            f"{LARGEST}: {parts}. Leave parts out, or take a larger board",
        )


def _bare(text: str) -> str:
    """Strip what a program does not need to run."""
    return python_minifier.minify(
        text,
        remove_annotations=RemoveAnnotationsOptions(
            remove_class_attribute_annotations=True
        ),
        remove_literal_statements=True,
        remove_asserts=True,
        remove_debug=True,
        combine_imports=False,
        hoist_literals=False,
        rename_locals=False,
        convert_posargs_to_args=False,
    )


def _renamed(text: str) -> str:
    return python_minifier.minify(
        text,
        rename_globals=True,
        preserve_globals=[*dir(builtins), "loop"],
        hoist_literals=False,
        combine_imports=False,
    )


def _pieces(texts: list[str]) -> Iterator[str]:
    """Yield what is compiled at once: long texts alone, short ones together."""
    piece = ""
    for text in texts:
        if piece and len(piece) + len(text) > PIECE:
            yield piece
            piece = ""
        piece += text
    yield piece


def _text(nodes: Iterable[ast.stmt]) -> str:
    tree = ast.fix_missing_locations(ast.Module(list(nodes), []))
    return python_minifier.unparse(tree) + "\n"
