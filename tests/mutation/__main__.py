"""``python -m tests.mutation``: which mistakes in the core would no test notice?

The tests are collected once. One child process runs them all and notes which lines each
one reaches, and in what time; then each mutant is a child of its own, forked from there:
the mistake is put into the functions that are loaded, and the tests that reach its line
run until one fails: those in virtual time first, of these the quick ones, those of the
same room, those that come where few come in the file and those that have found other
mistakes in it. What a test in real time finds has to be found three times: it could be the
computer that is busy. What is found once or twice is left to the other tests.

Much of ``loop`` (signals, the overseer, real-time priorities) is tested in processes of its
own, where no mistake is made: what survives there says little.

With ``--baseline`` what the tests reach is kept in a file; next time only new tests are
measured, and lines that have moved are found again.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import difflib
import gc
import os
import pickle
import random
import resource
import select
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import attrs
import coverage
import pytest
from tests.mutation.loaded import loaded_functions, put_in
from tests.mutation.mutants import Mutant, mutants_of

SOURCE = Path(__file__).parents[2] / "src/esair"
MUTATED = ["connections", "supervisors"]
"""The rooms in which mistakes are made, unless others are named."""
MEASURED = [*MUTATED, "actions", "journal", "loop", "plan", "resources"]
TESTS = [
    *(f"tests/{room}" for room in ("connections", "supervisors", "protection", "turn")),
    *(f"tests/{room}" for room in ("actions", "resources", "journal", "recording")),
    *(f"tests/{room}" for room in ("replay", "seat", "plan", "testing", "standard")),
    *(f"tests/{room}" for room in ("loop", "control", "config", "watchdog")),
    *(f"tests/{room}" for room in ("buses", "drivers")),
    *(f"tests/net/test_{it}.py" for it in ("parts", "gaps", "chains", "config")),
    "tests/placement/test_clock.py",
    "tests/minimal/test_in_std.py",
    "tests/torture/test_rules.py",
]
IN_REAL_TIME = 3
"""The exit code of a child in which a test in real time has failed; and how often it must."""
SLOWER, AT_LEAST = 10, 8
"""How many times its CPU time a test may take, and how much in any case, in seconds."""
WALL_LIMIT = 240
"""How long the tests of one mutant may take, in seconds: what hangs is noticed."""


@attrs.define
class Baseline:
    """What the tests reach, and take, without any mistake."""

    lines: dict[str, dict[int, set[str]]] = attrs.Factory(dict)
    seconds: dict[str, float] = attrs.Factory(dict)
    bad: set[str] = attrs.Factory(set)
    """Tests that fail all the same."""
    sources: dict[str, list[str]] = attrs.Factory(dict)
    """The files, line by line, as they were reached."""

    def reached_by(self, mutant: Mutant) -> set[str]:
        """Return who reaches a mistake."""
        reached = self.lines.get(_short(mutant.file), {})
        found = set(reached.get(mutant.line, ()))
        if not found:  # a default, an attribute: its line ran at the import
            first, last = mutant.scope or (0, sys.maxsize)
            for line, names in reached.items():
                if first <= line <= last:
                    found |= names
        return found

    def special(self, mutant: Mutant) -> dict[str, float]:
        """How much each test comes where few others come in the file of a mistake."""
        found: dict[str, float] = collections.defaultdict(float)
        for names in self.lines.get(_short(mutant.file), {}).values():
            for name in names:
                found[name] += 1 / len(names)
        return found

    def keep_up(self) -> None:
        """Find the lines of files that have changed since."""
        for file, before in tuple(self.sources.items()):
            if not (SOURCE / file).exists():
                del self.sources[file], self.lines[file]
                continue
            now = (SOURCE / file).read_text(encoding="utf-8").splitlines()
            match = difflib.SequenceMatcher(None, before, now, autojunk=False)
            moved = {
                old + n + 1: new + n + 1
                for old, new, size in match.get_matching_blocks()
                for n in range(size)
            }
            lines = self.lines[file]
            self.lines[file] = {
                moved[line]: names for line, names in lines.items() if line in moved
            }
            self.sources[file] = now


class Runner:
    """The plugin of pytest that has the collected tests, and runs some in children."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self.survivors: list[Mutant] = []
        self.score: collections.Counter[tuple[str, str]] = collections.Counter()
        self._failed = False
        self._killers: collections.Counter[tuple[Path, str]] = collections.Counter()
        self._told = Path(tempfile.mkdtemp())
        """Where a child writes which test has failed."""

    @property
    def killed(self) -> float:
        """How many are noticed, in percent."""
        dead = sum(n for (_, end), n in self.score.items() if end != "survived")
        return 100 * dead / max(1, self.score.total())

    def tell(self) -> None:
        """The table: files, what became of their mutants, and who survived."""
        ends = ["killed", "hangs or crashes", "survived"]
        print("\n" + "".join(f"{end:>18}" for end in ends))
        for name in sorted({name for name, _ in self.score}):
            print("".join(f"{self.score[name, end]:18}" for end in ends), name)
        print(f"\n{len(self.survivors)} survived:")
        for mutant in sorted(self.survivors, key=lambda each: (each.file, each.line)):
            print(f"  {_short(mutant.file)}:{mutant.line}: {mutant}")
        print(f"\n{self.killed:.1f} % of {self.score.total()} killed")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._failed |= report.failed

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        self._plugins = session.config.pluginmanager
        self.items = {item.nodeid: item for item in session.items}
        self._in_real_time = {
            item.nodeid
            for item in session.items
            if item.get_closest_marker("real_clock") is not None
        }
        gc.collect()
        self.functions = loaded_functions()
        gc.freeze()  # children share it; what is new in them is theirs
        mutants = self._chosen()
        baseline = self._measure()
        running: dict[int, tuple[int, Mutant, float]] = {}
        tries: collections.Counter[Mutant] = collections.Counter()
        suspects: dict[Mutant, str] = {}
        doubted: dict[Mutant, set[str]] = collections.defaultdict(set)
        while mutants or running:
            while mutants and len(running) < self.options.jobs:
                mutant = mutants.pop()
                suspect = suspects.get(mutant)
                tests = [suspect] if suspect else self._tests_of(mutant, baseline)
                tests = [each for each in tests if each not in doubted[mutant]]
                if not tests:
                    self._note(mutant, "survived", "no test comes here")
                    continue
                pid = self._fork(self._with, mutant, tests, baseline.seconds)
                running[os.pidfd_open(pid)] = (pid, mutant, time.monotonic())
            for fd in select.select(list(running), [], [], 1.0)[0]:
                pid, mutant, began = running.pop(fd)
                os.close(fd)
                end = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
                why = f"{time.monotonic() - began:.1f} s"
                told = self._told / str(pid)
                if told.exists():
                    why = told.read_text()
                    self._killers[mutant.file, why] += 1
                if end == 0 and mutant in suspects:  # let the others look
                    doubted[mutant].add(suspects.pop(mutant))
                    tries[mutant] = 0
                    mutants.append(mutant)
                    continue
                tries[mutant] += 1
                if end == IN_REAL_TIME and tries[mutant] < IN_REAL_TIME:
                    suspects[mutant] = why
                    mutants.append(mutant)
                    continue
                how = {0: "survived", 1: "killed", IN_REAL_TIME: "killed"}.get(
                    end, "hangs or crashes"
                )
                self._note(mutant, how, why)
            for pid, _, began in running.values():
                if time.monotonic() - began > WALL_LIMIT:
                    os.kill(pid, signal.SIGKILL)
        return True

    def _chosen(self) -> list[Mutant]:
        wanted = [each.partition(":") for each in self.options.where]
        found = [
            mutant
            for room in (MEASURED if wanted else self.options.rooms)
            for file in sorted((SOURCE / room).glob("*.py"))
            for mutant in mutants_of(file)
            if not wanted
            or any(
                str(file).endswith(path) and line in {"", str(mutant.line)}
                for path, _, line in wanted
            )
        ]
        chance = random.Random(self.options.seed)
        chosen = chance.sample(found, min(len(found), self.options.sample))
        print(
            f"\n{len(chosen)} of {len(found)} mutants, seed {self.options.seed}",
            flush=True,
        )
        return chosen

    def _tests_of(self, mutant: Mutant, baseline: Baseline) -> list[str]:
        """Who can notice, the most promising first, as many as there is time for.

        Those in real time come last, but have a share of it.
        """

        def promise(name: str) -> float:
            found = self._killers[mutant.file, name]
            far = 1 if name.startswith(room) else 4
            return far * baseline.seconds[name] / (1 + found) / special[name]

        special = baseline.special(mutant)
        room = f"tests/{mutant.file.parent.name}/"
        names = baseline.reached_by(mutant) & self.items.keys() - baseline.bad
        slow = names & self._in_real_time
        chosen = []
        for share, group in ((1.0, names - slow), (0.3, slow)):
            budget = share * self.options.budget
            for name in sorted(group, key=promise):
                budget -= baseline.seconds[name]
                if budget < 0:
                    break
                chosen.append(name)
        return chosen

    def _note(self, mutant: Mutant, how: str, why: str) -> None:
        self.score[mutant.file.name, how] += 1
        if how == "survived":
            self.survivors.append(mutant)
        place = f"{_short(mutant.file)}:{mutant.line}"
        print(f"{how:17} {place}: {mutant}  [{why}]", flush=True)

    def _fork(self, work: Callable[..., int], *terms: Any) -> int:
        pid = os.fork()
        if pid:
            return pid
        code = 70
        try:
            os.setpgrp()
            with contextlib.suppress(OSError):
                null = os.open(os.devnull, os.O_RDWR)
                for fd in (0, 1):
                    os.dup2(null, fd)
            code = work(*terms)
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)

    def _run(self, names: Iterable[str], before: Callable[[str], object]) -> int:
        """Run tests until one fails, and say nothing of it."""
        if self._plugins.has_plugin("terminalreporter"):
            self._plugins.unregister(name="terminalreporter")
        items = [self.items[name] for name in names]
        for item, following in zip(items, [*items[1:], None], strict=True):
            before(item.nodeid)
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if self._failed:
                (self._told / str(os.getpid())).write_text(item.nodeid)
                return IN_REAL_TIME if item.nodeid in self._in_real_time else 1
        return 0

    def _measure(self) -> Baseline:
        kept: Path = self.options.baseline
        baseline = pickle.loads(kept.read_bytes()) if kept.exists() else Baseline()
        baseline.keep_up()
        new = self.items.keys() - baseline.seconds.keys() - baseline.bad
        if new:
            os.waitpid(self._fork(self._reach, baseline, sorted(new)), 0)
            baseline = pickle.loads(kept.read_bytes())
        print(
            f"{len(baseline.seconds)} tests; without a mutant fail: {baseline.bad}\n",
            flush=True,
        )
        return baseline

    def _reach(self, baseline: Baseline, names: list[str]) -> int:
        reach = coverage.Coverage(
            None, config_file=False, source=[str(SOURCE / room) for room in MEASURED]
        )
        reach.start()
        for name in names:
            began, self._failed = time.process_time(), False
            if self._run([name], reach.switch_context):
                baseline.bad.add(name)
            else:
                baseline.seconds[name] = time.process_time() - began
        reach.stop()
        data = reach.get_data()
        for file in data.measured_files():
            lines = baseline.lines.setdefault(_short(file), {})
            for line, contexts in data.contexts_by_lineno(file).items():
                there = baseline.seconds.keys() & contexts
                lines.setdefault(line, set()).update(there)
            text = Path(file).read_text(encoding="utf-8")
            baseline.sources[_short(file)] = text.splitlines()
        self.options.baseline.write_bytes(pickle.dumps(baseline))
        return 0

    def _with(self, mutant: Mutant, tests: list[str], usual: dict[str, float]) -> int:
        def limit(name: str) -> None:
            until = int(time.process_time() + AT_LEAST + SLOWER * usual[name])
            resource.setrlimit(resource.RLIMIT_CPU, (until, resource.RLIM_INFINITY))

        try:
            put_in(mutant, self.functions)
        except Exception:
            return 1  # it cannot even be imported
        return self._run(tests, limit)


def _short(file: Path | str) -> str:
    return str(Path(file).relative_to(SOURCE))


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.mutation", description=__doc__
    )
    parser.add_argument(
        "where", nargs="*", help="files, such as _calls.py or _calls.py:96"
    )
    parser.add_argument(
        "--rooms", nargs="+", choices=MEASURED, default=MUTATED, help="in which rooms"
    )
    parser.add_argument("--sample", type=int, default=300, help="how many mutants")
    parser.add_argument("--seed", type=int, default=1, help="which ones")
    parser.add_argument("--jobs", type=int, default=2, help="how many at a time")
    parser.add_argument(
        "--budget", type=float, default=20.0, help="CPU seconds of tests for each"
    )
    parser.add_argument(
        "--baseline",
        type=Path,
        default=Path(tempfile.mkdtemp()) / "baseline",
        help="a file that keeps what the tests reach, for the next time",
    )
    parser.add_argument("--tests", nargs="+", default=TESTS, help="which to try")
    parser.add_argument("--min", type=float, default=92.0, help="percent to be killed")
    runner = Runner(parser.parse_args())
    arguments = ["-q", "-p", "no:cacheprovider"]
    end = pytest.main([*arguments, *runner.options.tests], plugins=[runner])
    if end:
        return int(end)
    runner.tell()
    return int(runner.killed < runner.options.min)


if __name__ == "__main__":
    sys.exit(main())
