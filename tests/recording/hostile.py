"""Recordings of somebody who means harm: made by hand, and by changing a sound one.

``python -m tests.recording.hostile FOLDER SOUND ROBOT VERB...`` runs verbs on each file of
a folder in this process, under a hook that sees what is imported, compiled and called.
"""

# ruff: noqa: E501 - bytes by hand

from __future__ import annotations

import contextlib
import io
import itertools
import json
import pickle
import random
import re
import struct
import sys
import time
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

MAGIC = b"\x89MCAP0\r\n"
HARM = "os.system('touch harmed')"


class Harm:
    """What a pickle would call."""

    def __reduce__(self) -> Any:
        return eval, (f"__import__('os').{HARM.removeprefix('os.')}",)


def record(kind: int, data: bytes) -> bytes:
    """Return a record of a file."""
    return struct.pack("<BQ", kind, len(data)) + data


def text(words: str | bytes) -> bytes:
    """Return a text with its length."""
    data = words if isinstance(words, bytes) else words.encode("utf-8", "surrogatepass")
    return struct.pack("<I", len(data)) + data


def table(facts: dict[str, str]) -> bytes:
    """Return a table of texts."""
    data = b"".join(text(each) for pair in facts.items() for each in pair)
    return struct.pack("<I", len(data)) + data


def chunk(
    data: bytes, packing: str = "", packed: bytes | None = None, **lies: int
) -> bytes:
    """Return a chunk; what it says of itself may be another thing."""
    packed = data if packed is None else packed
    head = struct.pack("<QQQI", 0, 0, lies.get("size", len(data)), lies.get("crc", 0))
    head += text(packing) + struct.pack("<Q", lies.get("length", len(packed)))
    return record(6, head + packed)


def topics() -> bytes:
    """Return the channels of events (1) and of turns (2), of old turns (3)."""
    schema = struct.pack("<H", 1) + text("any") + text("jsonschema") + text("{}")
    made = record(3, schema)
    for number, encoding in ((1, "json"), (2, "esair-turns-2"), (3, "esair-turns")):
        head = struct.pack("<HH", number, 1)
        made += record(4, head + text(f"/{number}") + text(encoding) + table({}))
    return made


def message(channel: int, data: bytes) -> bytes:
    """Return a message."""
    return record(5, struct.pack("<HIQQ", channel, 0, 1, 1) + data)


def event(number: int = 1, **fields: Any) -> bytes:
    """Return an event."""
    told = {"number": number, "time": float(number), "kind": "reading", "text": ""}
    told |= {"component": "sonar", "peer": "", "value": 1.0} | fields
    return message(1, json.dumps(told).encode())


def turns(data: bytes, number: int = 0) -> bytes:
    """Return turns."""
    return message(2, struct.pack("<I", number) + data)


def moment(when: float) -> bytes:
    """Return the beginning of a turn."""
    return struct.pack("<Bd", ord("M"), when)


def came(tag: Iterable[str], payload: bytes, kind: str = "A") -> bytes:
    """Return what came in with a tag, in a chunk of its own."""
    words = [each.encode() for each in tag]
    made = bytes((len(words),)) + b"".join(bytes((len(each),)) + each for each in words)
    if kind == "F":
        return struct.pack("<BHI", ord("F"), 0, len(payload)) + made + payload
    return struct.pack("<BHII", ord("A"), 0, 1, len(payload)) + made + payload


def coded(name: str, about: Any, body: bytes, tag: bytes) -> bytes:
    """Return an object of a class by its name, in the codec's bytes."""
    from esair.codec import Kinds, encode

    definition = encode((name, about), Kinds())
    return b"\x01" + tag + struct.pack("<HH", 0, len(definition)) + definition + body


class Maker:
    """Makes files whose facts are right but for what is changed."""

    def __init__(self, digest: str) -> None:
        self.replay = {
            "format": "4",
            "exact": "yes",
            "why": "",
            "clock": "real",
            "program": "",
            "file": "robot.toml",
            "sha256": digest,
            "simulated": "no",
            "script": "",
            "duration": "",
            "seat": "no",
            "options": "{}",
        }

    def file(
        self, *parts: bytes, profile: str = "esair", end: bool = True, **facts: Any
    ) -> bytes:
        """Return a file of parts."""
        told: dict[str, dict[str, str]] = {
            "robot": {"name": "it", "seed": "1", "robot.toml": ""},
            "clock": {"offset": "0.0"},
            "replay": {**self.replay, **facts.pop("replay", {})},
            **facts,
        }
        data = MAGIC + record(1, text(profile) + text("x"))
        for name, about in told.items():
            data += record(12, text(name) + table(about))
        data += topics() + b"".join(parts)
        return data + (
            record(12, text("end") + table({})) + record(2, bytes(20)) + MAGIC
            if end
            else b""
        )

    def run(self, *items: bytes, **options: Any) -> bytes:
        """Return a file with turns, each in a message of its own."""
        begin = moment(100.0)
        parts = [turns(each, number) for number, each in enumerate([begin, *items])]
        return self.file(*parts, event(), **options)


NAMES = [
    *(
        "os:system",
        "posix:system",
        "subprocess:Popen",
        "builtins:eval",
        "builtins:exec",
    ),
    *(
        "harm:Harm",
        "tempfile:_TemporaryFileCloser",
        "importlib:import_module",
        "antigravity:x",
    ),
    *("pathlib:PosixPath", "esair.loop._door:Door", "esair.cli:main", "__main__:Harm"),
]


def by_hand(make: Maker) -> Iterator[tuple[str, bytes]]:
    """Yield what somebody would write who has read the source."""
    import lz4.frame  # type: ignore[import-untyped]
    import zstandard

    yield "empty", b""
    yield "text", b"motor,1\n" * 50
    yield "magic", MAGIC
    yield "another profile", make.file(event(), profile="ros2")
    whole = make.file(event())
    yield "no profile", whole.replace(b"esair", b"\xff" * 5, 1)
    for name, harm in (
        ("pickle", pickle.dumps((0, [Harm()]))),
        ("code", HARM.encode()),
    ):
        yield f"old turns {name}", make.file(message(3, harm), replay={"format": "1"})
        yield f"old turns as new {name}", make.file(message(3, harm), event())
        yield f"turns {name}", make.file(message(2, harm))
        yield f"payload {name}", make.run(came(("call", "sonar", "read"), harm, "F"))
    for place in ("file", "program", "script"):
        for what in (
            "harm.py",
            "harm:run",
            "os:system",
            "esair.demo:demo",
            "demo",
            "../harm.toml",
        ):
            yield (
                f"{place} {what}",
                make.file(
                    event(),
                    replay={
                        place: what,
                        "sha256": "",
                        "options": json.dumps({"command": HARM}),
                    },
                ),
            )
    for options in (
        '{"seed": "x"}',
        "[1]",
        "{" * 9000,
        '{"seed": 1e400}',
        '{"duration": true}',
    ):
        yield (
            f"options {options[:12]}",
            make.file(replay={"script": "demo", "options": options}),
        )
    for seconds in ("nan", "1e400", "-1", "1e308", "x" * 9999):
        yield f"duration {seconds[:9]}", make.run(replay={"duration": seconds})
        yield f"offset {seconds[:9]}", make.file(event(), clock={"offset": seconds})
    yield "seed", make.run(robot={"seed": "9" * 9999})
    yield (
        "many facts",
        make.file(
            *(record(12, text(f"f{n}") + table({"a": "b"})) for n in range(3000))
        ),
    )
    yield (
        "forged facts",
        make.run(replay={"exact": "no", "why": "x\n12:00 up\x1b[2J\u202e"}),
    )
    for name, tag in itertools.product(NAMES, (b"o", b"n", b"e", b"X")):
        about = "builtins:ValueError" if tag == b"X" else ("path", "args")
        payload = coded(name, about, b"s\x04harmtN\0\0\0", tag)
        kind = "F" if tag in b"oX" else "A"
        where = ("call", "sonar", "read") if kind == "F" else ("sonar", "pushed")
        yield f"class {name} {tag.decode()}", make.run(came(where, payload, kind))
    bomb = bytes(32 << 20)
    squeezed = zstandard.compress(bomb)
    unsized = zstandard.ZstdCompressor(write_content_size=False).compress(bomb)
    tiny = event() * 300_000
    for name, part in {
        "zstd": chunk(bomb, "zstd", squeezed),
        "zstd lies": chunk(b"", "zstd", squeezed, size=100),
        "zstd unsized": chunk(b"", "zstd", unsized, size=100),
        "zstd vast": chunk(b"", "zstd", squeezed, size=1 << 62),
        "zstd messages": chunk(tiny, "zstd", zstandard.compress(tiny)),
        "zstd many": chunk(tiny, "zstd", zstandard.compress(tiny)) * 30,
        "lz4": chunk(bomb, "lz4", lz4.frame.compress(bomb)),
        "lz4 lies": chunk(b"", "lz4", lz4.frame.compress(bomb), size=100),
        "no packing": chunk(b"x", "snappy"),
        "packed vast": chunk(event(), length=1 << 62),
        "in a chunk": chunk(chunk(event())),
        "no length": struct.pack("<BQ", 6, (1 << 64) - 2) + b"x",
        "vast": struct.pack("<BQ", 12, 1 << 40) + b"x",
        "crc": chunk(event(), crc=7),
        "tiny records": record(99, b"") * 200_000,
        "inner length": chunk(struct.pack("<BQ", 5, 1 << 60)),
    }.items():
        yield f"chunk {name}", make.file(part, event(9))
    deep = b'{"a":' * 5000 + b"1" + b"}" * 5000
    for name, data in {
        "deep": b'{"number":1,"time":1,"kind":"a","component":"a","peer":"","text":"","value":%s}'
        % deep,
        "deep list": b"[" * 100_000,
        "long number": b'{"number":1,"time":1,"kind":"a","component":"a","peer":"","text":"","value":%s}'
        % (b"9" * 90_000),
        "empty lists": b"[%s[]]" % (b"[]," * 1_300_000),
        "empty objects": b"[%s{}]" % (b"{}," * 1_300_000),
        "no object": b"7",
        "nothing": b"",
        "bytes": b"\xff\xfe",
        "utf-16": "{}".encode("utf-16-be"),
        "utf-32": "{}".encode("utf-32-le"),
        "other": b'{"esair": [1]}',
    }.items():
        yield f"event {name}", make.file(message(1, data), event(2))
    events: dict[str, dict[str, Any]] = {
        "time": {"time": 1e300}, "nan": {"time": float("nan")}, "kind": {"kind": ["x"]},
        "number": {"number": 10**30}, "negative": {"number": -5}, "escapes": {"text": "\x1b[2J\n12:00 up\u202e", "component": "a\rb", "kind": "\x1b[31m"},
        "long name": {"component": "x" * 900_000}, "formula": {"component": r"$\frac{1}{0}$"},
        "infinite": {"value": float("inf")}, "great": {"value": 10**300}, "array": {"value": {"shape": [1e99], "dtype": "\x1b", "data": 5}},
        "wide": {"value": {f"v{n}": n for n in range(20)}}, "nested": {"value": [[[[[[[[[[1]] * 8] * 8] * 8] * 8]]]]]},
    }  # fmt: skip
    for name, fields in events.items():
        yield f"event {name}", make.file(event(**{"number": 1, **fields}), event(2))
    yield (
        "many names",
        make.file(*(event(n, component=f"c{n}") for n in range(1, 20_000))),
    )
    for name, when in {
        "nan": float("nan"),
        "inf": float("inf"),
        "past": -1e300,
        "far": 1e11,
        "aeon": 8.9e9,
    }.items():
        yield f"moment {name}", make.run(moment(when), moment(101.0))
    yield "moment late", make.run(moment(3.9e9))
    for name, payload in {
        "cut": b"\x01t\xff\xff\xff\x7f", "nothing": b"", "items": b"\x01l\x40\x42\x0f\x00" + b"N" * 1_000_000,
        "sets": b"\x01l\x20\xa1\x07\x00" + b"u\0\0\0\0" * 500_000,
        "floats": b"\x01dt\xff\xff\x3f\x00" + bytes(8 * 0x3FFFFF),
        "big": b"\x01b" + struct.pack("<I", 30 << 20) + bytes(30 << 20),
        "array": b"\x01as\x03<f8t\2\0\0\0i" + struct.pack("<q", 1 << 40) + b"i" + struct.pack("<q", 1 << 40) + b"b\0\0\0\0",
        "exit": coded("builtins:SystemExit", "builtins:SystemExit", b"t\1\0\0\0i" + bytes(8) + b"t\0\0\0\0m\0\0\0\0N", b"X"),
        "decimal": b"\x01Cs\x0e1E+99999999999", "fraction": b"\x01Rs\x051e999N", "deep": b"\x01" + b"l\1\0\0\0" * 5000,
        "triple": b"\x01t\3\0\0\0FNN", "wrong": b"\x01t\3\0\0\0s\1aT\x69" + bytes(8),
    }.items():  # fmt: skip
        for words, kind in (
            (("call", "sonar", "read"), "F"),
            (("sonar", "pushed"), "A"),
            (("call", "sonar", "open"), "F"),
        ):
            yield f"payload {name} {words[-1]}", make.run(came(words, payload, kind))
    yield (
        "threads",
        make.run(*(came(("thread", f"work {n}"), b"\x01N") for n in range(400))),
    )
    yield "no tag", make.run(struct.pack("<BHII", ord("A"), 0, 1, 0) + b"\0")
    yield "long tag", make.run(came(["x" * 200] * 200, b"\x01N"))
    yield (
        "signal",
        make.run(came(("robot", "signal"), b"\x01t\1\0\0\0i" + struct.pack("<q", 9))),
    )


def changed(sound: bytes, make: Maker, count: int) -> Iterator[tuple[str, bytes]]:
    """Yield files that differ from a sound one: bytes, places, and within its chunks."""
    import zstandard

    dice = random.Random(23)
    for number in range(count):
        data = bytearray(sound)
        how = number % 4
        if how == 3:  # what is packed, so that it comes through
            place = data.find(b"zstd")
            size = struct.unpack_from("<Q", data, place + 4)[0]
            begin = place + 12
            packed = bytes(data[begin : begin + size])
            inner = bytearray(zstandard.decompress(packed, 1 << 24))
            for _ in range(dice.randint(1, 20)):
                inner[dice.randrange(len(inner))] = dice.randrange(256)
            yield (
                f"inside {number}",
                make.file(chunk(bytes(inner), crc=zlib.crc32(inner))),
            )
            continue
        for _ in range(dice.randint(1, 30)):
            at = dice.randrange(len(data))
            if how == 0:
                data[at] = dice.randrange(256)
            elif how == 1:
                del data[at : at + dice.randrange(9)]
            else:
                data[at:at] = data[dice.randrange(len(data)) :][: dice.randrange(90)]
        yield f"changed {number}", bytes(data)


def corpus(sound: bytes, digest: str, more: int = 100) -> dict[str, bytes]:
    """Return all of them by name."""
    make = Maker(digest)
    return dict(itertools.chain(by_hand(make), changed(sound, make, more)))


# In the process that is watched.

FORBIDDEN = (
    "os.system",
    "os.exec",
    "os.posix_spawn",
    "subprocess.Popen",
    "pickle.find_class",
    "marshal.loads",
    "exec",
    "compile",
    "import",
    "os.fork",
)


def peak_of_this_process() -> int:
    """Return how many MiB it has had at most; the usage of resource is its parent's too."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (found,) = (line for line in lines if line.startswith("VmHWM:"))
    return int(found.split()[1]) >> 10


def watched(folder: Path, sound: Path, verbs: list[str]) -> None:
    """Run verbs on each file of a folder; write what was seen, a line for each."""
    import logging

    from esair.cli import main

    seen: list[str] = []
    usual: set[str] = set()  # such as what a library compiles for each of its classes
    is_on = True

    def hook(name: str, args: tuple[Any, ...]) -> None:
        if is_on and name in FORBIDDEN:
            if name == "import" and args[0] in sys.modules:
                return
            told = re.sub("0x[0-9a-f]+", "", f"{name} {str(args)[:80]}")
            if told not in usual:
                seen.append(told)

    def run(verb: str, file: Path) -> tuple[Any, str, str]:
        out, told = io.StringIO(), io.StringIO()
        words = verb.split()
        code: Any = None
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(told):
            try:
                main([words[0], str(file), *words[1:]])
            except SystemExit as ended:
                code = ended.code
            except BaseException as error:
                code = repr(error)[:200]
        logging.disable(logging.NOTSET)
        return code, out.getvalue(), told.getvalue()

    "\x1b".encode("unicode_escape")  # the codec is loaded when it is first used
    sys.addaudithook(hook)
    for verb in verbs:
        run(verb, sound)  # what is needed for a sound one is imported now
        run(verb, Path(__file__))  # and for one that is none
    usual.update(seen)
    for file in sorted(folder.glob("*.mcap")):
        for verb in verbs:
            seen.clear()
            is_on = True
            began = time.process_time()
            code, out, told = run(verb, file)
            took = time.process_time() - began
            is_on = False
            peak = peak_of_this_process()
            line = {
                "file": file.name,
                "verb": verb,
                "code": code,
                "peak": peak,
                "seen": seen[:3],
                "took": took,
            }
            raw = not (out + told).replace("\n", "").isprintable()
            lines = [each for each in told.splitlines() if each]
            sys.__stdout__.write(
                json.dumps(
                    {**line, "told": lines[:4], "out": out.count("\n"), "raw": raw}
                )
                + "\n"
            )  # type: ignore[union-attr]
            sys.__stdout__.flush()  # type: ignore[union-attr]


if __name__ == "__main__":
    watched(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
