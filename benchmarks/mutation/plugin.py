"""Pytest plugin of the mutation sample: records which test executes which line, or runs some tests in a given order.

Environment: MUTATION_RECORD = file to write the record to; MUTATION_RUN = file with [[node id, limit in s], ...].
"""

from __future__ import annotations

import functools
import gc
import json
import os
import resource
import signal
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

PACKAGES = ("rve", "homogenize", "macro_fem")
MEMORY = 8 << 30
"""Bytes a run may ask for: a mutant that asks for more fails in its own process."""


class Recorder:
    """Lines per test. Fixtures shared by tests and cached answers count for every test that uses them."""

    def __init__(self, out: Path) -> None:
        import coverage

        self.out, self.context = out, ""
        self.coverage = coverage.Coverage(data_file=None, source=list(PACKAGES), config_file=False)
        self.seconds: dict[str, float] = defaultdict(float)
        self.fixtures: dict[str, set[str]] = {}
        self.failed: set[str] = set()
        self.coverage.start()

    def switch(self, context: str) -> None:
        self.context = context
        self.coverage.switch_context(context)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: Any) -> Iterator[None]:
        for cached in [x for x in gc.get_objects() if isinstance(x, functools._lru_cache_wrapper)]:
            if str(getattr(cached, "__module__", "")).split(".")[0] in (*PACKAGES, "tests", "benchmarks", "examples"):
                cached.cache_clear()
        known = item._fixtureinfo.name2fixturedefs
        self.fixtures[item.nodeid] = {_shared(d) for defs in known.values() for d in defs if d.scope != "function"}
        self.switch(item.nodeid)
        yield
        self.switch("")

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Iterator[None]:
        if fixturedef.scope == "function":
            return (yield)
        before, began = self.context, time.perf_counter()
        self.switch(_shared(fixturedef))
        result = yield
        self.switch(before)
        self.seconds[_shared(fixturedef)] += time.perf_counter() - began
        return result

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.seconds[report.nodeid] += report.duration
        if report.failed:
            self.failed.add(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        self.coverage.stop()
        data = self.coverage.get_data()
        users = defaultdict(set)
        for test, shared in self.fixtures.items():
            for context in (test, *shared):
                users[context].add(test)
        lines: dict[str, dict[int, list[str]]] = {}
        for path in data.measured_files():
            contexts = data.contexts_by_lineno(path).items()
            name = str(Path(path).relative_to(Path.cwd()))
            lines[name] = {line: sorted(set().union(*(users[c] for c in found))) for line, found in contexts}
        seconds = {test: sum(self.seconds[part] for part in (test, *shared)) for test, shared in self.fixtures.items()}
        self.out.write_text(json.dumps({"seconds": seconds, "failed": sorted(self.failed), "lines": lines}))


def _shared(fixture: Any) -> str:
    return f"fixture {fixture.baseid}::{fixture.argname}"


class Runner:
    """The listed tests in the listed order, each under its time limit; the last one begun is named in `<file>.last`."""

    def __init__(self, path: Path) -> None:
        self.limits = dict(json.loads(path.read_text()))
        self.last = Path(f"{path}.last")
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        signal.signal(signal.SIGALRM, signal.SIG_DFL)  # ends the process even inside compiled code

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        place = {name: i for i, name in enumerate(self.limits)}
        items[:] = sorted((i for i in items if i.nodeid in place), key=lambda item: place[item.nodeid])

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: Any) -> Iterator[None]:
        self.last.write_text(item.nodeid)
        signal.setitimer(signal.ITIMER_REAL, self.limits[item.nodeid])
        yield
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def pytest_configure(config: Any) -> None:
    """Register what the environment asks for."""
    if record := os.environ.get("MUTATION_RECORD"):
        config.pluginmanager.register(Recorder(Path(record)))
    if run := os.environ.get("MUTATION_RUN"):
        config.pluginmanager.register(Runner(Path(run)))
