"""Limits that fuzz tests set to their own process."""

import os
import resource
from contextlib import contextmanager

import pytest


@pytest.fixture
def bounded_memory():
    """A context in which the process may take this many bytes more, touched or not."""

    @contextmanager
    def bounded(more):
        with open("/proc/self/statm") as file:
            now = int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        before = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (now + more, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_AS, before)

    return bounded
