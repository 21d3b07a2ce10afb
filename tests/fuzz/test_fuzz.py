"""Readers of mutated files end in InputError or in a value: no other error, no hang, nothing written.

Input i of a reader is made from the seed "reader:i", so that a failure names what repeats it. Warnings are errors here.
"""

import re
import resource
import signal
from random import Random

import pytest

from rve.common.errors import InputError
from tests.fuzz.targets import TARGETS

QUICK, SLOW, SECONDS = 40, 1_000, 10
WORDS = [
    "0",
    "-1",
    "1e308",
    "1e400",
    "nan",
    "-Infinity",
    "4294967295",
    "1_0",
    "true",
    "null",
    "[]",
    "{}",
    '"',
    "=",
    "<",
]
WORDS += ["1" * 5000, "[" * 3000, '{"a":' * 3000, "a." * 300, "\x00", "\U0001f642"]
NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")


class HangError(BaseException):
    """Not an Exception: no reader may take it for a damaged file."""


def mutated(content: bytes, random: Random) -> bytes:
    """One to four changes: bits flipped, bytes cut, doubled or put in, numbers replaced."""
    for _ in range(random.choice((1, 1, 2, 4))):
        place, length = random.randrange(len(content) + 1), random.choice((1, 4, 50, 1000))
        word, numbers = random.choice(WORDS).encode(), list(NUMBER.finditer(content))
        kind = random.randrange(8)
        if kind == 0:
            content = content[:place]
        elif kind == 1:
            content = content[:place] + content[place + length :]
        elif kind == 2:
            content = content[:place] + content[place : place + length] * 3 + content[place + length :]
        elif kind == 3 or not numbers:
            content = content[:place] + word + content[place:]
        elif kind == 4:
            flipped = bytes(one ^ 1 << random.randrange(8) for one in content[place : place + 1])
            content = content[:place] + flipped + content[place + 1 :]
        else:
            one = random.choice(numbers)
            content = content[: one.start()] + word + content[one.end() :]
    return content


@pytest.fixture
def alarm():
    def hang(*_):
        raise HangError(f"a reader takes more than {SECONDS} s")

    before = signal.signal(signal.SIGALRM, hang)
    limit = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (8_000_000_000, limit[1]))
    yield signal.alarm
    signal.alarm(0)
    resource.setrlimit(resource.RLIMIT_AS, limit)
    signal.signal(signal.SIGALRM, before)


def fuzz(name, folder, count, alarm):
    """Reads `count` mutations; how many were refused."""
    target, refused = TARGETS[name], 0
    target.make(folder)
    valid = {path.name: path.read_bytes() for path in folder.iterdir()}
    target.read(folder)
    for i in range(count):
        seed = f"{name}:{i}"
        random = Random(seed)
        spoiled = random.choice(sorted(valid))
        content = mutated(valid[spoiled], random)
        (folder / spoiled).write_bytes(content)
        alarm(SECONDS)
        sentence = ""
        try:
            target.read(folder)
        except InputError as error:
            sentence = str(error)
        except (Exception, HangError) as error:
            raise AssertionError(f"seed {seed}: {type(error).__name__}: {error}") from error
        refused += bool(sentence)
        assert "\n" not in sentence, f"seed {seed}: {sentence}"
        assert len(sentence) < 2000, f"seed {seed}: {len(sentence)} characters"
        found = {path.name: path.read_bytes() for path in folder.iterdir()}
        assert found == valid | {spoiled: content}, f"seed {seed}: something was written"
        (folder / spoiled).write_bytes(valid[spoiled])
    return refused


@pytest.mark.parametrize("name", TARGETS)
def test_mutated_files_end_in_a_sentence(name, tmp_path, alarm):
    assert fuzz(name, tmp_path, QUICK, alarm) > QUICK // 10


@pytest.mark.slow
@pytest.mark.parametrize("name", TARGETS)
def test_many_mutated_files_end_in_a_sentence(name, tmp_path, alarm):
    assert fuzz(name, tmp_path, SLOW, alarm) > SLOW // 10
