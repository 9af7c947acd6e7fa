"""Values that cross the layers: what readings, answers and rules are made of."""

from __future__ import annotations

import enum
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Generic, Literal, NamedTuple, Self, TypeVar

import attrs

from esair.exceptions import ConfigError, hint_for
from esair.flaws import owned
from esair.values import as_path, check_name, check_party, is_positive

if TYPE_CHECKING:
    import ssl
    from pathlib import Path

T = TypeVar("T")


class Access(enum.Flag):
    """What a behavior may do with a resource."""

    READ = enum.auto()
    """Read a sensor."""
    WRITE = enum.auto()
    """Write an actuator."""
    CONFIGURE = enum.auto()
    """Change the settings of a resource."""
    GUARD = enum.auto()
    """Guard an actuator: every command for it passes whoever has this right."""

    def __str__(self) -> str:
        return " | ".join(flag.name or "" for flag in type(self) if flag in self)


class ResourceState(enum.Enum):
    """What a resource is doing."""

    CLOSED = "closed"
    OPENING = "opening"
    READY = "ready"
    LOST = "lost"
    FAILED = "failed"
    REMOVED = "removed"


class BehaviorState(enum.Enum):
    """What a behavior or a reaction is doing."""

    STARTING = "starting"
    RUNNING = "running"
    PARKED = "parked"
    """It waits for a resource: lost, removed, or, for a reaction, stale."""
    RESTARTING = "restarting"
    RESTING = "resting"
    """It waits for a mode in which it runs."""
    FINISHED = "finished"
    FAILED = "failed"
    STOPPING = "stopping"
    REMOVED = "removed"


class SupervisorPhase(enum.Enum):
    """The phases of a supervisor."""

    INITIALIZING = "initializing"
    WAIT_REQUEST = "waiting for requests"
    HANDLING_REQUEST = "handling a request"
    STOPPED = "stopped"


class Reading(NamedTuple, Generic[T]):
    """One value of a sensor.

    Attributes:
        value: The value.
        time: When it was measured, in seconds of the event loop's monotonic clock; when
            it arrived, if the driver cannot tell.
        sequence: 1 for the first reading of a sensor, then one more each time.
    """

    value: T
    time: float
    sequence: int

    @property
    def arrived(self) -> float:
        """When it came in, on the same clock; its age counts from ``time``."""
        return self.time


class StampedReading(Reading[T]):
    """A reading whose driver knows when it was measured, if it is stamped."""

    is_stamped: bool = True
    _arrived: float

    @classmethod
    def at(cls, value: T, time: float, sequence: int, arrived: float) -> Self:
        """Make one that was measured at a time, and came in later."""
        reading = cls(value, time, sequence)
        reading._arrived = arrived
        return reading

    @property
    def arrived(self) -> float:
        """When it came in, on the same clock; its age counts from ``time``."""
        return self._arrived


class OpenReading(StampedReading[T]):
    """A reading of a value that could be changed: who asks for it gets one of their own."""

    @property
    def value(self) -> T:
        """A value that nobody else has; an array that cannot be written to."""
        return self[0]

    def __getitem__(self, place: Any) -> Any:
        return owned(super().__getitem__(place))

    def __iter__(self) -> Iterator[Any]:
        return map(self.__getitem__, range(len(self)))


@attrs.frozen
class Stamped(Generic[T]):
    """What a driver gives that knows when its device has measured a value.

    One that comes after a newer one is counted (``dropped``), and nobody gets it.

    Attributes:
        value: The value.
        time: When it was measured, in seconds of `esair.now`; or None, with an age.
        age: How long ago it was measured, in seconds.

    Example:
        >>> async def read(self) -> esair.Stamped[float]:
        ...     metres, milliseconds = await self.bus.ask(b"R?")
        ...     return esair.Stamped(metres, age=milliseconds / 1000)
    """

    value: T
    time: float | None = None
    age: float = attrs.field(default=0.0, kw_only=True)


class Answer:
    """What a write is answered with: `Written` or `Refused`."""

    __slots__ = ()


@attrs.define
class Written(Answer, Generic[T]):
    """A command that was sent; true in a condition.

    Attributes:
        command: What was really applied, which may be less than what was asked.
        asked: What was asked.
        by: The guard that let only a weaker command pass; None if none did.
    """

    command: T
    asked: T | None = None
    by: str | None = None

    def __bool__(self) -> Literal[True]:
        return True


@attrs.frozen
class Refused(Answer):
    """A command that was not sent, and why; false in a condition.

    Attributes:
        holder: Who holds the actuator: a writer, one that is blind, or a guard.
        priority: The priority of the holder.
        rule: The rule that refused the command, in words.
        since: Since when it has been held, on the event loop's clock (seconds).
        until: When the hold ends unless it is renewed, on the same clock; None if
            that is not a matter of time.
    """

    holder: str
    priority: int
    rule: str
    since: float
    until: float | None

    def __bool__(self) -> Literal[False]:
        return False


class Why(NamedTuple):
    """Who holds an actuator, by which rule, and what would free it.

    Attributes:
        resource: The actuator.
        state: What the actuator is doing.
        holder: Who holds it; None if nobody does.
        priority: The priority of the holder.
        rule: The rule by which it is held, in words.
        since: Since when, on the event loop's clock (seconds).
        until: When the hold ends unless it is renewed, on the same clock; None if
            that is not a matter of time.
        frees: What would free it, in words.
        last: The last command that the device was told.
        writers: Who may write it, with which priority, and what happens when each is
            blind, in words; the highest priority first.
        guards: Who guards it, and how each of them stands, in words.
        dies: What becomes of it when this process dies, and when this computer does.
        resting: Who would write it in another mode than this one, in words.
    """

    resource: str
    state: ResourceState
    holder: str | None = None
    priority: int | None = None
    rule: str = "nobody holds it"
    since: float | None = None
    until: float | None = None
    frees: str = "it is free"
    last: object = None
    writers: tuple[str, ...] = ()
    guards: tuple[str, ...] = ()
    dies: str = ""
    resting: tuple[str, ...] = ()

    def __str__(self) -> str:
        held, frees = f", held by {self.holder} ({self.rule})", f"freed by {self.frees}"
        if self.holder is None:
            is_there = self.state is ResourceState.READY
            held, frees = f"{', and free' if is_there else ''}: {self.rule}", ""
        told = f"{self.resource} is {self.state.value}{held}"
        lines = [told, frees, *self.guards, *self.writers, *self.resting, self.dies]
        return "\n  ".join(line for line in lines if line)


@attrs.frozen
class Placement:
    """A component lives in a process of its own, with these limits.

    Attributes:
        stall: How long it may work without a word, in seconds; then it hangs, is killed,
            and started again as after any other failure.
        memory: How much address space its process may have, in MiB; None for no limit.
        nice: How much less than the robot it gets of a busy computer, 0 to 19.

    Example:
        >>> class Detect(esair.Behavior):
        ...     placement = esair.Placement(stall=2.0, nice=5)
    """

    stall: float = 5.0
    memory: int | None = None
    nice: int = 0

    def __attrs_post_init__(self) -> None:
        if not is_positive(self.stall):
            told = f"expected seconds > 0, not {self.stall!r:.80}"
            raise ConfigError("Placement", "stall", told)
        if self.memory is not None and (
            type(self.memory) is not int or self.memory < 1
        ):
            told = f"expected MiB > 0 or None, not {self.memory!r:.80}"
            raise ConfigError("Placement", "memory", told)
        if type(self.nice) is not int or not 0 <= self.nice <= 19:
            told = f"expected 0 to 19, not {self.nice!r:.80}"
            raise ConfigError("Placement", "nice", told)


Place = Literal["task", "process"] | Placement | None
"""Where a component lives: in the robot's process, or in one of its own."""


def is_placed(component: Any) -> bool:
    """Tell whether a component lives in a process of its own."""
    return component.placement not in {None, "task"}


def placement_of(place: object) -> Placement | None:
    """Return the limits of the process that a component lives in; None for the robot's.

    Raises:
        ValueError: It is not where a component can live.
    """
    if place is None or place == "task":
        return None
    if place == "process":
        return Placement()
    if isinstance(place, Placement):
        return place
    raise ValueError(
        f"expected 'process', 'task' or an esair.Placement, not {place!r:.80}"
    )


class BehaviorStatus(NamedTuple):
    """The answer to a query.

    Attributes:
        name: The name of the behavior or reaction.
        state: What it is doing.
        can_receive: Whether a put would be delivered at once.
        can_send: Whether a get would be answered without waiting for its state.
        restarts: How often it has been restarted.
        error: Its last error; None if it had none.
        detail: Why it is in this state, if there is more to say.
        steps: How many steps a reaction has done.
        late: How many steps a reaction has skipped because they were late.
        waiting: How many puts wait for room in its inbox.
        overruns: How many steps of a reaction have taken longer than its budget.
        requests: How many requests wait that it has not taken yet.
        working: How many requests it works on.
        dropped: How much data its boxes have dropped, by their policy.
        placement: ``process`` if it lives in a process of its own, else ``task``.
        pid: The number of that process; None if there is none now.
    """

    name: str
    state: BehaviorState
    can_receive: bool
    can_send: bool
    restarts: int = 0
    error: BaseException | None = None
    detail: str = ""
    steps: int = 0
    late: int = 0
    waiting: int = 0
    overruns: int = 0
    requests: int = 0
    working: int = 0
    dropped: int = 0
    placement: str = "task"
    pid: int | None = None


class ResourceStatus(NamedTuple):
    """The answer to a query for a resource.

    Attributes:
        name: The name of the resource.
        state: What it is doing.
        error: Why it is not READY; None if it is.
        losses: How often the device was lost since the start.
        faults: How often the device or its driver was at fault.
        users: The behaviors that are registered for it.
        settings: The current settings by name.
        placement: ``process`` if its driver lives in a process of its own, else ``task``.
        pid: The number of that process; None if there is none now.
    """

    name: str
    state: ResourceState
    error: BaseException | None
    losses: int
    faults: int
    users: tuple[str, ...]
    settings: Mapping[str, object]
    placement: str = "task"
    pid: int | None = None


def _positive(
    instance: object, attribute: attrs.Attribute[float], value: float
) -> None:
    if not is_positive(value):
        raise ConfigError(
            type(instance).__name__, attribute.name, f"expected > 0, not {value!r}"
        )


def _count(instance: object, attribute: attrs.Attribute[int], value: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ConfigError(
            type(instance).__name__,
            attribute.name,
            f"expected 0 or more, not {value!r}",
        )


@attrs.frozen(kw_only=True)
class Restart:
    """How often, and how fast, a crashed component is started again.

    The restarts of the budget are spread over its window: a network or disk that is away
    for some seconds does not spend it.

    Attributes:
        max: How many restarts within the window; one more and it is FAILED.
        within: The window, in seconds.
        delay: The pause before the first restart, in seconds; those after it double, and
            are four fifths of ``within / max`` at least.
        max_delay: The longest pause, in seconds.
        retry: When the budget is spent: try again after this many seconds, for ever,
            with one line in the log each time. None: it is FAILED.
    """

    max: int = attrs.field(default=3, validator=_count)
    within: float = attrs.field(default=30.0, validator=_positive)
    delay: float = attrs.field(default=0.1, validator=_positive)
    max_delay: float = attrs.field(default=10.0, validator=_positive)
    retry: float | None = attrs.field(
        default=None, validator=attrs.validators.optional(_positive)
    )


@attrs.frozen
class BehaviorsPolicy:
    """Which behaviors may manage others; made by `Policy.behaviors`.

    Attributes:
        allow: ``"manage"`` for each that may; ``"*"`` stands for all.
    """

    allow: Mapping[str, Literal["manage"]] = attrs.field(factory=dict)

    def __attrs_post_init__(self) -> None:
        if not isinstance(self.allow, Mapping):
            told = f"expected a dict, not {self.allow!r:.80}"
            raise ConfigError("policy of behaviors", "allow", told)
        for behavior, right in self.allow.items():
            if behavior != "*":
                check_party("policy of behaviors: allow", behavior)
            if right != "manage":
                raise ConfigError(
                    "policy of behaviors",
                    f"allow.{behavior}",
                    f'expected "manage", not {right!r:.80}',
                )


@attrs.frozen
class Policy:
    """Who may do what with a resource, and at which level.

    Where a resource has a policy, only what it allows is allowed. ``"*"`` stands
    for everybody who is not named.

    Attributes:
        resource: The name of the resource.
        allow: For each behavior, what it may do.
        exclusive: Only one behavior at a time may be registered to write.
        max_priority: For each behavior, the highest priority it may write with.

    Example:
        >>> Policy("wheels", allow={"wander": Access.WRITE, "*": Access.READ})
    """

    resource: str
    allow: Mapping[str, Access] = attrs.field(factory=dict)
    exclusive: bool = attrs.field(default=False, kw_only=True)
    max_priority: Mapping[str, int] = attrs.field(factory=dict, kw_only=True)

    @staticmethod
    def behaviors(*, allow: Mapping[str, Literal["manage"]]) -> BehaviorsPolicy:
        """Say which behaviors may add, remove, replace and restart others.

        Example:
            >>> Policy.behaviors(allow={"captain": "manage"})
        """
        return BehaviorsPolicy(allow)

    def __attrs_post_init__(self) -> None:
        for field, value in (
            ("allow", self.allow),
            ("max_priority", self.max_priority),
        ):
            if not isinstance(value, Mapping):
                raise self._mistake(field, f"expected a dict, not {value!r:.80}")
            for behavior in value:
                if behavior != "*":
                    check_party(f"policy of {self.resource!r}: {field}", behavior)
        for behavior, access in self.allow.items():
            if not isinstance(access, Access):
                raise self._mistake(
                    f"allow.{behavior}", f"expected an esair.Access, not {access!r}"
                )
        if not isinstance(self.exclusive, bool):
            raise self._mistake(
                "exclusive", f"expected True or False, not {self.exclusive!r:.80}"
            )

    def _mistake(self, field: str, message: str) -> ConfigError:
        return ConfigError(f"policy of {self.resource!r}", field, message)


def _kept(names: Sequence[str]) -> Sequence[str]:
    """Keep a list as it is now."""
    return tuple(names) if isinstance(names, list) else names


@attrs.frozen
class Mode:
    """Behaviors that take their turn together, and what follows them.

    Attributes:
        behaviors: The names of the behaviors, reactions and guards that run in it.
        then: The mode that follows when all its behaviors have ended.
        on_failure: The mode that follows when one of its behaviors or reactions is
            FAILED.
    """

    behaviors: Sequence[str] = attrs.field(converter=_kept)
    then: str | None = attrs.field(default=None, kw_only=True)
    on_failure: str | None = attrs.field(default=None, kw_only=True)

    def __attrs_post_init__(self) -> None:
        given = self.behaviors
        if isinstance(given, str) or not isinstance(given, Sequence):
            told = f"expected a list of names, not {given!r:.80}"
            raise ConfigError("mode", "behaviors", told)
        for behavior in given:
            check_party("mode: behaviors", behavior)


@attrs.frozen
class Modes:
    """The modes of a robot: who runs when.

    Attributes:
        table: The modes by name; none in a robot whose behaviors all run always.
        first: The mode that it begins in.
    """

    table: Mapping[str, Mode] = attrs.field(factory=dict)
    first: str | None = None

    @classmethod
    def of(cls, modes: Mapping[str, Mode | Sequence[str]], mode: str | None) -> Self:
        """Make them of what a script gives: modes, or lists of names."""
        if not isinstance(modes, Mapping):
            raise ConfigError("robot", "modes", f"expected a dict, not {modes!r:.80}")
        return cls(
            {
                check_name("mode", name): each if isinstance(each, Mode) else Mode(each)
                for name, each in modes.items()
            },
            mode,
        )

    def of_behavior(self, name: str) -> list[str]:
        """Return the modes that list a behavior; it always runs if none does."""
        return [mode for mode, each in self.table.items() if name in each.behaviors]

    def runs(self, name: str, mode: str | None) -> bool:
        """Tell whether a behavior runs in a mode."""
        listed = self.of_behavior(name)
        return not listed or mode in listed

    def meet(self, one: str, other: str) -> bool:
        """Tell whether two behaviors run at the same time in any mode."""
        ours, theirs = self.of_behavior(one), self.of_behavior(other)
        return not ours or not theirs or not set(ours).isdisjoint(theirs)


NO_MODES = Modes()
"""Those of a robot whose behaviors all run always."""

OPERATOR = "operator"
"""In whose name an operator acts; no component has this name."""

PEOPLE = ("user", OPERATOR)
"""In whose names people ask behaviors."""

ACTS = (
    *("list", "query", "status", "why", "help", "stop", "resume", "put", "ask", "add"),
    *("remove", "mode", "restart", "replace", "set", "operate", "mute", "reset"),
    *("lease", "drive", "release"),
)
"""What an operator can do; `esair.seat` has how."""


@attrs.frozen(kw_only=True)
class Operator:
    """What an operator may do from outside: at the socket, the terminal, the page.

    Looking, and stopping the robot, is for everybody who may connect.

    Attributes:
        priority: With which priority an operator writes: above every blind hold, never
            above a guard.
        allow: The acts that are allowed, such as ``"set"``, ``"drive"``, ``"resume"``;
            ``"*"`` stands for all.
    """

    priority: int = 1000
    allow: tuple[str, ...] = ("*",)

    def __attrs_post_init__(self) -> None:
        if type(self.priority) is not int:
            told = f"expected a whole number, not {self.priority!r:.80}"
            raise ConfigError(OPERATOR, "priority", told)
        if not isinstance(self.allow, tuple) or not all(
            isinstance(each, str) for each in self.allow
        ):
            told = f"expected names of acts, not {self.allow!r:.80}"
            raise ConfigError(OPERATOR, "allow", told)
        wrong = [each for each in self.allow if each not in ("*", *ACTS)]
        if wrong:
            hint = hint_for(wrong[0], ACTS)
            told = f"there is no act {', no act '.join(map(repr, wrong)):.300}{hint}"
            raise ConfigError(OPERATOR, "allow", told)

    def may(self, act: str) -> bool:
        """Tell whether an act is allowed; who may drive may take a lease for it."""
        wanted = "drive" if act in {"lease", "release"} else act
        return "*" in self.allow or wanted in self.allow


@attrs.frozen(kw_only=True)
class Page:
    """Where the page of a robot is served, and for whom; needs ``esair[page]``.

    Who operates shows a token, on this computer, too: whoever works on it reaches the
    same address. It is made anew at each start and kept in a file of this user, unless
    given. Another address than one of this computer needs TLS as well, or an explicit
    ``insecure``.

    Attributes:
        host: The address.
        port: The port; 0 for any that is free.
        token: What a browser must show, of at least 22 characters (128 bit), no %.
        certificate: The file with the certificate, for TLS.
        key: The file with its key.
        insecure: Whether another address may be without TLS.
    """

    host: str = "127.0.0.1"
    port: int = 8740
    token: str | None = attrs.field(default=None, repr=False)
    certificate: Path | None = None
    key: Path | None = None
    insecure: bool = False

    def __attrs_post_init__(self) -> None:
        if type(self.port) is not int or not 0 <= self.port < 65536:
            raise ConfigError("page", "port", f"expected 0 to 65535, not {self.port!r}")
        if self.token is not None and (len(self.token) < 22 or "%" in self.token):
            raise ConfigError("page", "token", "expected 22 characters or more, no %")
        if (self.certificate is None) != (self.key is None):
            raise ConfigError("page", "key", "expected a certificate and its key")
        if not (self.is_local or self.certificate or self.insecure):
            told = (
                f"{self.host} is not of this computer alone: expected certificate and "
                "key for TLS, or insecure = true"
            )
            raise ConfigError("page", "host", told)

    def tls(self) -> ssl.SSLContext | None:
        """Return how it speaks TLS; None if it does not.

        Raises:
            ConfigError: Its files are not there, or no certificate and its key.
        """
        if self.certificate is None or self.key is None:
            return None
        import ssl  # only for those who need it

        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        for field in ("certificate", "key"):
            if not (file := getattr(self, field)).is_file():
                raise ConfigError("page", field, f"there is no file {str(file)!r}")
        try:  # a passphrase is asked of nobody
            context.load_cert_chain(self.certificate, self.key, password=lambda: "")
        except (OSError, ValueError) as error:
            told = f"expected a certificate in PEM, and its key without a passphrase: {error}"
            raise ConfigError("page", "certificate", told) from None
        return context

    @property
    def is_local(self) -> bool:
        """Whether only this computer can reach it."""
        return self.host in {"127.0.0.1", "::1", "localhost"}


@attrs.frozen
class Recording:
    """What a robot records, and within which bounds.

    Attributes:
        path: The file, if it is named ``.mcap``; else a folder, made if it is not there,
            which gets one named by robot and time.
        max_bytes: How many bytes all segments of a run may have; the oldest goes. What
            earlier runs have left stays.
        min_free: How many bytes stay free on the disk; the oldest segment goes first.
        segment: How many bytes one segment may have.
    """

    path: Path = attrs.field(converter=as_path)
    max_bytes: int = attrs.field(default=1 << 30, kw_only=True)
    min_free: int = attrs.field(default=1 << 28, kw_only=True)
    segment: int = attrs.field(default=1 << 26, kw_only=True)

    def __attrs_post_init__(self) -> None:
        for name in ("max_bytes", "min_free", "segment"):
            value = getattr(self, name)
            if (
                type(value) is not int
                or value < 0
                or (name != "min_free" and not value)
            ):
                raise ConfigError(
                    "recording", name, f"expected a number of bytes, not {value!r:.80}"
                )
