"""Readers of mutated files end in InputError or in a value: no other error, no hang, no gigabyte, nothing written.

Input i of a reader is made from the seed "reader:i", so that a failure names what repeats it. Warnings are errors here.
"""

import os
import resource
import signal
from random import Random

import pytest

from rve.common.errors import InputError
from tests.fuzz.targets import TARGETS

QUICK, SLOW = 150, 20_000
SECONDS, BYTES = 10, 1_000_000_000


class HangError(BaseException):
    """Not an Exception: no reader may take it for a damaged file."""


def _hang(*_):
    raise HangError(f"a reader takes more than {SECONDS} s")


@pytest.fixture
def bounded():
    """One gigabyte more than the process has now, for allocations too that are never touched."""
    with open("/proc/self/statm") as file:
        now = int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    before = resource.getrlimit(resource.RLIMIT_AS)
    alarm = signal.signal(signal.SIGALRM, _hang)
    resource.setrlimit(resource.RLIMIT_AS, (now + BYTES, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)
    signal.alarm(0)
    signal.signal(signal.SIGALRM, alarm)


def snapshot(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def refusal(name, folder):
    """The sentence that refuses the files of a target, None if they are read."""
    signal.alarm(SECONDS)
    try:
        TARGETS[name].read(folder)
    except InputError as error:
        return str(error)
    finally:
        signal.alarm(0)
    return None


def fuzz(name, folder, count, capfd):
    """Reads `count` mutations; how many were refused."""
    target = TARGETS[name]
    target.make(folder)
    valid = snapshot(folder)
    capfd.readouterr()  # meshio warns of its text files
    target.read(folder)
    refused = 0
    for i in range(count):
        seed = f"{name}:{i}"
        random = Random(seed)
        spoiled = random.choice(sorted(valid))
        content = target.mutate(spoiled, valid[spoiled], random)
        (folder / spoiled).write_bytes(content)
        try:
            sentence = refusal(name, folder)
        except BaseException as error:
            raise AssertionError(f"seed {seed}: {type(error).__name__}: {error}") from error
        if sentence is not None:
            refused += 1
            assert "\n" not in sentence, f"seed {seed}: more than one line: {sentence}"
            assert len(sentence) < 2000, f"seed {seed}: {len(sentence)} characters"
            assert "fit into memory" not in sentence, f"seed {seed}: {sentence}"
        assert snapshot(folder) == valid | {spoiled: content}, f"seed {seed}: something was written"
        (folder / spoiled).write_bytes(valid[spoiled])
    assert capfd.readouterr() == ("", "")
    return refused


@pytest.mark.filterwarnings("ignore::rve.common.errors.OldName")  # a mutated scene may use an old name
@pytest.mark.parametrize("name", TARGETS)
def test_mutated_files_end_in_a_sentence(name, tmp_path, bounded, capfd):
    assert fuzz(name, tmp_path, QUICK, capfd) > QUICK // 10


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::rve.common.errors.OldName")
@pytest.mark.parametrize("name", TARGETS)
def test_many_mutated_files_end_in_a_sentence(name, tmp_path, bounded, capfd):
    assert fuzz(name, tmp_path, SLOW, capfd) > SLOW // 10
