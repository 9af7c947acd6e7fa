"""Verbs that steer a robot which runs on this computer: an act each, from their table."""

from __future__ import annotations

import concurrent.futures
import contextlib
import inspect
import json
import threading
from collections.abc import Callable
from typing import Annotated, Any, Final

from cyclopts import Parameter

from esair.cli._errors import CANNOT_USE, NOT_DONE, show, tell
from esair.cli._options import AsJson, Which
from esair.exceptions import ConfigError, describe
from esair.seat import ACTS, Field, connect, robots, table_of
from esair.values import printable

VERBS: Final = (
    *("why", "stop", "resume", "put", "ask", "operate", "set"),
    *("mode", "add", "remove", "replace", "restart", "mute", "reset"),
)
"""The acts that are verbs."""

_PATIENCE: Final = {"operate": 600.0}
"""How long an answer may take beside what the act's own fields say, in s; else 15."""

SILENT: Final = 1.0
"""After how long it is told that nobody answers a stop, in seconds; it is waited for on."""

LONGEST: Final = 500
"""How many characters a reason for a halt has at most; what is beyond is left out."""

_OPTIONS: Final[dict[str, Any]] = {"robot": Which, "machine": AsJson}
_OF_STOP: Final[dict[str, Any]] = {
    "everyone": Annotated[
        bool, Parameter("--all", help="Halt every robot of this user on this computer.")
    ]
}


def verb_of(name: str) -> Callable[..., int]:
    """Make the verb of an act.

    What the act is about is typed as words, in its order; a number that may be left out
    is an option.
    """
    act = ACTS[name]
    options = _OPTIONS | (_OF_STOP if name == "stop" else {})
    signature = inspect.Signature(
        [
            *(_parameter(*each, of=name) for each in act.fields.items()),
            *(
                inspect.Parameter(
                    each, inspect.Parameter.KEYWORD_ONLY, annotation=kind, default=None
                )
                for each, kind in options.items()
            ),
        ]
    )

    def verb(*words: str, **given: Any) -> int:
        bound = signature.bind(*words, **given)
        bound.apply_defaults()
        said = {each: bound.arguments.pop(each) for each in options}
        fields = bound.arguments
        try:
            for each, field in act.fields.items():
                fields[each] = _value(fields[each], field, of=name)
        except ConfigError as error:
            tell(printable(str(error)))
            return CANNOT_USE
        if said.get("everyone") and (names := [*robots()]):
            return _do_all(names, name, fields, said["machine"])
        # None of no name tells that no robot runs.
        return _do(said["robot"], name, fields, said["machine"])

    verb.__name__, verb.__doc__ = name, f"{act.doc[0].upper()}{act.doc[1:]}."
    if name == "stop":
        verb.__doc__ += "\n\nExit code 0 says that every actuator has answered."
    verb.__annotations__ = {n: p.annotation for n, p in signature.parameters.items()}
    vars(verb)["__signature__"] = signature
    return verb


def _value(typed: Any, field: Field, *, of: str) -> Any:
    """Return the value of a field as it was typed.

    Raises:
        ConfigError: It is none.
    """
    if of == "stop":
        return _sentence(typed) or field.default
    if not field.is_table:
        return typed if field.is_number else field.of_word(typed)
    wrong = next((word for word in typed if "=" not in word), None)
    if wrong is not None:
        raise ConfigError("command", of, f"expected name=value, not {wrong}")
    return table_of(typed)


def _sentence(words: tuple[str, ...]) -> str:
    """Return why somebody halts, whatever was typed: no halt fails for its reason."""
    return " ".join(words).encode("utf-8", "replace").decode()[:LONGEST]


def _parameter(name: str, field: Field, *, of: str) -> inspect.Parameter:
    kind: Any = float if field.is_number else str
    where: Any = inspect.Parameter.POSITIONAL_ONLY
    default = field.default
    if field.is_required or field.is_table:
        default = inspect.Parameter.empty
    elif field.is_number:
        where = inspect.Parameter.KEYWORD_ONLY
    if field.is_table or of == "stop":
        default, where = inspect.Parameter.empty, inspect.Parameter.VAR_POSITIONAL
    # A reason that begins as an option does is none that keeps a robot from halting.
    how = Parameter(help=field.doc, allow_leading_hyphen=of == "stop")
    kind = Annotated[kind | None if default is None else kind, how]
    return inspect.Parameter(name, where, annotation=kind, default=default)


def _do_all(robots: list[str], name: str, fields: dict[str, Any], as_json: bool) -> int:
    """Do one act to several robots at once: who does not answer holds up nobody."""

    def do(robot: str) -> int:
        try:
            return _do(robot, name, dict(fields), as_json)
        except Exception as error:
            tell(printable(str(error) or describe(error)))
            return NOT_DONE

    with concurrent.futures.ThreadPoolExecutor(len(robots)) as pool:
        return max(pool.map(do, robots))


def _do(robot: str | None, name: str, fields: dict[str, Any], as_json: bool) -> int:
    """Do one act and print its result."""
    wait = _PATIENCE.get(name, 15.0)
    wait += sum(fields.get(each, 0.0) for each in ("timeout", "interval"))
    with connect(robot) as client, contextlib.ExitStack() as over:
        if name == "stop":
            unheard = f"robot {client.name!r} does not answer"
            unheard += "; use its own switch if it moves"
            silent = threading.Timer(SILENT, tell, [printable(unheard)])
            over.callback(silent.cancel)
            silent.start()
        result = client.do(name, fields, timeout=wait)
    shown = json.dumps(result) if as_json else ACTS[name].tells(result)
    with contextlib.suppress(BrokenPipeError):  # the exit code counts all the same
        for line in shown.splitlines():
            show(printable(line))
    told = result["told"] if name == "stop" else ()
    return 0 if all(each["answered"] for each in told) else NOT_DONE
