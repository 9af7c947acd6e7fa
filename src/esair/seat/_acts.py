"""What an operator may do: one table, for the socket, for typed lines, for the page."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import attrs

from esair.actions import Request
from esair.config import fields_of
from esair.exceptions import (
    BadValueError,
    ConfigError,
    RefusedError,
    UnknownNameError,
    did_you_mean,
    hint_for,
)
from esair.messages import is_placed
from esair.recording import plain
from esair.seat._leases import SECONDS, answer_of
from esair.seat._status import settings
from esair.seat._values import as_text, axes, command_of, fitted, typed
from esair.values import check_name, check_party

if TYPE_CHECKING:
    from esair.seat._operator import Console, Session

REQUIRED: Any = object()  # Stands for a field that must be there


class Field(NamedTuple):
    """One thing that an act is about."""

    doc: str  # What it is, in a sentence
    kind: tuple[type, ...] = (str,)  # The types that its value may have
    default: Any = REQUIRED  # Its value if it is not given

    @property
    def is_required(self) -> bool:
        """Whether it must be given."""
        return self.default is REQUIRED

    @property
    def is_number(self) -> bool:
        """Whether its values are numbers."""
        return self.kind == NUMBER

    @property
    def is_table(self) -> bool:
        """Whether its values are tables, typed as words ``name=value``."""
        return self.kind == (dict,)

    def takes(self, value: Any) -> bool:
        """Tell whether a value has its type; a bool is no number."""
        if isinstance(value, bool) and not {bool, object} & set(self.kind):
            return False
        return isinstance(value, self.kind)

    def of_word(self, word: str) -> Any:
        """Return a typed word as a value: a text, or JSON if it is some."""
        return word if self.kind == (str,) else value_of(word)


Run = Callable[..., Any]  # Of the console, the session, and the fields by name

NUMBER = (int, float)
PART = Field("The behavior or device.")
GUARD = Field("The reaction that guards.")
RECEIVER = Field("The behavior.")
LEASE = Field("The number of the lease.", (int,))


@attrs.frozen
class Act:
    """One thing that an operator may do.

    Attributes:
        name: Its name.
        doc: What it does, in one line.
        run: Does it; may return an awaitable.
        fields: What it is about, in the order in which they are typed.
        looks: Whether it changes nothing: then it needs no right and is no event.
        open: Whether everybody may who may connect, whatever else they say with it.
        tells: Makes a text for people of its result.
    """

    name: str
    doc: str
    run: Run
    fields: Mapping[str, Field] = attrs.field(factory=dict)
    looks: bool = False
    open: bool = False
    tells: Callable[[Any], str] = str

    @property
    def about(self) -> str:
        """The field that names the component it is done to: the first, or none."""
        first = next(iter(self.fields), "")
        field = self.fields.get(first, LEASE)
        return first if field.kind == (str,) and field.is_required else ""

    @property
    def usage(self) -> str:
        """How it is typed."""
        words = (
            name.upper() if field.is_required else f"[{name.upper()}]"
            for name, field in self.fields.items()
        )
        return " ".join((self.name, *words))

    def checked(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the fields of an act, those left out with their defaults.

        Raises:
            BadValueError: One is unknown, missing, or of the wrong type.
        """
        if self.open:  # done whatever else was said
            given = {
                name: value
                for name, value in given.items()
                if name in self.fields and self.fields[name].takes(value)
            }
        for name in given:
            if name not in self.fields:
                hint = did_you_mean(name, self.fields) or f"; it is: {self.usage}"
                raise BadValueError(self.name, name, f"there is no such field{hint}")
        found: dict[str, Any] = {}
        for name, field in self.fields.items():
            value = given.get(name, field.default)
            if value is REQUIRED:
                raise BadValueError(self.name, name, f"it is missing: {self.usage}")
            if value is not field.default and not field.takes(value):
                kinds = " or ".join(each.__name__ for each in field.kind)
                told = f"expected {kinds}, not {value!r:.80}"
                raise BadValueError(self.name, name, told)
            found[name] = value
        if self.about and self.about != "setting":
            check_party(self.name, found[self.about])
        return found


ACTS: dict[str, Act] = {}
"""Every act, by its name."""


def _act(
    doc: str,
    *,
    looks: bool = False,
    open: bool = False,  # noqa: A002 - the word of `Act`
    tells: Callable[[Any], str] = str,
    **fields: Field,
) -> Callable[[Run], Run]:
    """Enter a function as an act of its name; see `Act`."""

    def enter(run: Run) -> Run:
        name = run.__name__.strip("_")
        ACTS[name] = Act(name, doc, run, fields, looks, open, tells)
        return run

    return enter


def _told_why(found: Any) -> str:
    return "\n".join(each["text"] for each in found)


def _told_set(found: Any) -> str:
    unit = f" {found['unit']}" if found["unit"] else ""
    limits = [
        f"{word} {found[key]:g}{unit}"
        for word, key in (("at least", "min"), ("at most", "max"))
        if found[key] is not None
    ]
    rest = f" ({', '.join(limits)})" if limits else ""
    return f"{found['name']} is {found['value']}{unit}{rest}"


def _told_stop(found: Any) -> str:
    return "\n".join(
        [f"halted: {found['halted']}", *(each["text"] for each in found["told"])]
    )


def _lines(found: Any) -> str:
    return "\n".join(found)


# What looks.


@_act("name every behavior and what it does", looks=True, tells=_lines)
def _list(console: Console, _: Session) -> Any:
    behaviors = console.robot.behaviors
    return [
        f"{name}: {behaviors.query(name).state.value}" for name in behaviors.names()
    ]


@_act("tell what a behavior is doing", looks=True, name=RECEIVER)
def _query(console: Console, _: Session, name: str) -> Any:
    status = console.robot.behaviors.query(name)
    detail = f" ({status.detail})" if status.detail else ""
    where = "" if status.pid is None else f", in process {status.pid}"
    told = f"{status.name}: {status.state.value}{detail}, {status.restarts} restarts"
    return f"{told}{where}"


@_act("tell what the whole robot is doing", looks=True)
def _status(console: Console, _: Session) -> Any:
    return console.status.picture()


@_act(
    "tell who holds an actuator, why, and what would free it",
    looks=True,
    tells=_told_why,
    actuator=Field("The actuator; all of them unless given.", default=None),
)
def _why(console: Console, _: Session, actuator: str | None) -> Any:
    resources = console.robot.resources
    whys = resources.why() if actuator is None else (resources.why(actuator),)
    return [plain(each) | {"text": str(each)} for each in whys]


@_act("list what can be done", looks=True, tells=_lines)
def _help(console: Console, _: Session) -> Any:
    return [f"{act.usage:<40} {act.doc}" for act in ACTS.values()]


# What changes the robot.


@_act(
    "halt: every actuator is safe and stays so until resume",
    open=True,
    tells=_told_stop,
    reason=Field("Why, for whoever looks at it.", default=""),
)
async def _stop(console: Console, _: Session, reason: str) -> Any:
    reason = reason or "the operator has stopped it"
    told = await console.robot.halt(reason, by=console.name)
    return {
        "halted": console.robot.halted,
        "told": [
            {
                "resource": each.resource,
                "command": plain(each.command),
                "safe": each.safe,
                "answered": each.answered,
                "error": each.error,
                "text": str(each),
            }
            for each in told
        ],
    }


@_act("end all halts: the next write moves")
def _resume(console: Console, _: Session) -> Any:
    console.robot.resume()
    return "the next write moves"


@_act(
    "hand data to a behavior",
    receiver=RECEIVER,
    data=Field("JSON, or a text.", (object,)),
    interval=Field("How long to try, in seconds.", NUMBER, 1.0),
)
async def _put(
    console: Console, _: Session, receiver: str, data: object, interval: float
) -> Any:
    await console.robot.behaviors.put(
        data, sender=console.name, receiver=receiver, interval=interval
    )
    return "delivered"


@_act(
    "ask a behavior to do something",
    receiver=RECEIVER,
    request=Field("The name of the request's class."),
    fields=Field("Its fields: name=value.", (dict,), {}),
    timeout=Field("How long it may wait and work, in seconds.", NUMBER, 10.0),
)
async def _ask(
    console: Console,
    _: Session,
    receiver: str,
    request: str,
    fields: dict[str, Any],
    timeout: float,
) -> Any:
    behaviors = console.robot.behaviors
    takes: dict[str, Any] = {each.__name__: each for each in behaviors.takes(receiver)}
    kind = takes.get(request)
    if kind is None:
        hint = hint_for(request, sorted(takes), "it takes")
        raise RefusedError(f"it takes no {request:.80}{hint}", receiver)
    known = fields_of(kind)
    if known is None:
        told = f"expected fields to type: write @attrs.frozen above class {request}"
        raise BadValueError(receiver, "request", told)
    fields = {
        key: as_text(value, known[key].kind) if key in known else value
        for key, value in fields.items()
    }
    made: Request[Any] = typed(fields, kind, receiver, "request")
    answer = await behaviors.ask(
        made, sender=console.name, receiver=receiver, timeout=timeout
    )
    return plain(answer)


@_act("add what the robot's file has of this name", name=PART)
async def _add(console: Console, _: Session, name: str) -> Any:
    part = await console.part(name)
    await console.owner_of(part).add(part)
    return f"{name} was added{_code_of(part)}"


@_act("take a behavior or device away; what it moves is safe first", name=PART)
async def _remove(console: Console, _: Session, name: str) -> Any:
    left = await console.supervisor_of(name).remove(name)
    rest = f"; {len(left)} messages were not taken" if left else ""
    return f"{name} was removed{rest}"


@_act(
    "tell which mode the robot is in, or go to another one",
    name=Field("The mode to go to.", default=None),
    reason=Field("Why, for the log.", default=""),
)
async def _mode(console: Console, _: Session, name: str | None, reason: str) -> Any:
    behaviors = console.robot.behaviors
    if name is not None:
        await behaviors.switch(name, reason or f"asked by {console.name}")
    if behaviors.mode is None:
        return "the robot has no modes"
    others = ", ".join(each for each in behaviors.modes.table if each != behaviors.mode)
    return f"{behaviors.mode} (the others: {others or 'none'})"


@_act("begin a behavior or device anew", name=PART)
async def _restart(console: Console, _: Session, name: str) -> Any:
    await console.supervisor_of(name).restart(name)
    return f"{name} was restarted"


@_act("put what the robot's file has of this name now in its place", name=PART)
async def _replace(console: Console, _: Session, name: str) -> Any:
    console.supervisor_of(name)  # the word for a name that nobody has
    part = await console.part(name)
    await console.owner_of(part).replace(name, part)
    return f"{name} was replaced{_code_of(part)}"


def _code_of(part: Any) -> str:
    """Say what is not new in what the file has now: no module is loaded twice."""
    if is_placed(part):  # its process is a new one
        return ""
    return "; its Python code is as the program has loaded it"


@_act(
    "change a setting of a device: wheels.max_speed 0.2",
    tells=_told_set,
    setting=Field("The device and its setting, with a dot between."),
    value=Field("The new value; unit and limits are the setting's.", (object,)),
)
async def _set(console: Console, _: Session, setting: str, value: object) -> Any:
    name, dot, field = setting.partition(".")
    if not dot:
        told = f"expected RESOURCE.SETTING, not {setting!r:.80}"
        raise BadValueError("set", "setting", told)
    resources = console.robot.resources
    resource = resources.get(check_name("set", name))
    if any(each["name"] == field for each in settings(resource)):
        kind = getattr(type(resource), field).type
        value = fitted(value, kind, name, field)  # a setting may be a record
    with console.right_to_configure(name) as registration:
        await resources.configure(registration, **{field: value})
    (found,) = (each for each in settings(resource) if each["name"] == field)
    return found


@_act(
    "have a device do what its driver can: home, tare, clear a fault",
    resource=Field("The device."),
    operation=Field("What it does."),
    fields=Field("What it takes: name=value.", (dict,), {}),
)
async def _operate(
    console: Console, _: Session, resource: str, operation: str, fields: dict[str, Any]
) -> Any:
    resources = console.robot.resources
    with console.right_to_configure(resource) as registration:
        known = resources.get(resource).operations.get(operation)
        for each in () if known is None else known.parameters:
            if (key := each.name) in fields:
                value = fitted(fields[key], each.type, resource, f"{operation}.{key}")
                fields = {**fields, key: value}
        return plain(await resources.operate(registration, operation, **fields))


@_act(
    "let what a guard or a blind hold keeps back pass for a while",
    name=GUARD,
    seconds=Field("For how long.", NUMBER),
    reason=Field("Why, for the log."),
)
def _mute(console: Console, _: Session, name: str, seconds: float, reason: str) -> Any:
    console.robot.behaviors.mute(name, seconds, reason)
    return f"{name} is mute for {seconds:g} s"


@_act("end the latch of a guard, after its cause is gone", name=GUARD)
def _reset(console: Console, _: Session, name: str) -> Any:
    console.robot.behaviors.reset(name)
    return f"{name} is reset"


@_act(
    "take the right to drive an actuator by hand",
    actuator=Field("The actuator."),
    seconds=Field("How long it lasts without fresh input.", NUMBER, SECONDS),
)
def _lease(console: Console, session: Session, actuator: str, seconds: float) -> Any:
    if not session.drives:
        raise ConfigError("lease", "", "only a client that is told beats can drive")
    lease = console.leases.take(actuator, seconds, session)
    resource = console.robot.resources.get(lease.actuator)
    return {
        "lease": lease.number,
        "seconds": lease.seconds,
        "axes": axes(resource),  # type: ignore[arg-type]
        "beat": console.leases.beats.next(),
    }


@_act(
    "drive with fresh input",
    lease=LEASE,
    beat=Field("The beat that it answers.", (int,)),
    command=Field("The command.", (object,)),
)
async def _drive(
    console: Console, session: Session, lease: int, beat: int, command: object
) -> Any:
    answer = await console.leases.drive(
        lease, session, beat, lambda actuator: command_of(actuator, command)
    )
    return answer_of(answer)


@_act("give a lease back", lease=LEASE)
def _release(console: Console, session: Session, lease: int) -> Any:
    for each in console.leases:
        if each.number == lease and each.owner is session:
            console.leases.end(each)
            return "released"
    raise UnknownNameError("lease", str(lease), ())


def words_of(text: object) -> list[str]:
    """Return the words of a typed line.

    Raises:
        ConfigError: It is none, or a quote is left open.
    """
    if not isinstance(text, str):
        raise ConfigError("command", "", f"expected a line of text, not {text!r:.80}")
    try:
        return shlex.split(text)
    except ValueError as error:
        raise ConfigError("command", "", f"{error}: {text!r:.80}") from None


class Coming(NamedTuple):
    """What a typed line brings that names a class: only who types in the program may."""

    act: Act
    instead_of: str | None
    driver: str  # module:Class
    values: dict[str, Any]


def coming_of(text: str) -> Coming | None:
    """Return what ``add module:Class key=value`` or ``replace NAME module:Class`` bring."""
    verb, *rest = words_of(text) or [""]
    words = [word for word in rest if "=" not in word]
    if verb not in {"add", "replace"} or not words or ":" not in words[-1]:
        return None
    if len(words) != (1 if verb == "add" else 2):
        told = "expected: add module:Class [KEY=VALUE], replace NAME module:Class [...]"
        raise ConfigError("command", verb, told)
    old = words[0] if verb == "replace" else None
    return Coming(ACTS[verb], old, words[-1], table_of(w for w in rest if "=" in w))


def act_of(text: str) -> tuple[Act, dict[str, Any]]:
    """Return the act that a line means, and what it is about.

    Raises:
        ConfigError: The line is not understood.
    """
    words = words_of(text)
    if not words or words[0] not in ACTS:
        verb = words[0] if words else ""
        told = f"it is not known{hint_for(verb, ACTS)}"
        raise ConfigError("command", f"{verb!r:.80}", told)
    act = ACTS[words[0]]
    return act, fields_of_words(act, words[1:])


def fields_of_words(act: Act, words: list[str]) -> dict[str, Any]:
    """Return the fields of an act from the words after its name, in their order.

    A field that takes a table gets the words ``name=value`` that are left.
    """
    fields: dict[str, Any] = {}
    single = {name: each for name, each in act.fields.items() if not each.is_table}
    for table in act.fields.keys() - single.keys():
        fields[table] = table_of(word for word in words if "=" in word)
        words = [word for word in words if "=" not in word]
    least = sum(each.is_required for each in single.values())
    if not least <= len(words) <= len(single):
        raise ConfigError("command", act.name, f"expected: {act.usage}")
    for (name, field), word in zip(single.items(), words, strict=False):
        fields[name] = field.of_word(word)
    return fields


def table_of(words: Iterable[str]) -> dict[str, Any]:
    """Return what words ``name=value`` say."""
    pairs = (word.partition("=") for word in words)
    return {name: value_of(value) for name, _, value in pairs}


def value_of(word: str) -> Any:
    """Return a typed word as a value: JSON, else a text; raise for JSON that is none."""
    try:
        return json.loads(word)
    except (ValueError, RecursionError) as error:
        if word[:1] not in {"{", "[", '"'}:
            return word
        told = f"it begins as JSON, and is none: {error}"
        raise ConfigError("command", f"{word!r:.80}", told) from None
