"""The commands of the three packages, as typed in a terminal."""

from click.testing import CliRunner

import homogenize.cli
import macro_fem.cli
import rve.cli

GROUPS = {"rve": rve.cli.main, "homogenize": homogenize.cli.main, "macro_fem": macro_fem.cli.main}


def run(package, *words, codes=(0,)):
    """How a command of a package ends, which is with one of these exit codes."""
    done = CliRunner().invoke(GROUPS[package], [str(word) for word in words])
    assert done.exit_code in codes, done.output
    return done
