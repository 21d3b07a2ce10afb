"""The commands of the three packages, as typed in a terminal, and where they run."""

import os
import signal
from contextlib import contextmanager

from click.testing import CliRunner

import homogenize.cli
import macro_fem.cli
import rve.cli
from rve.common import heard_by

GROUPS = {"rve": rve.cli.main, "homogenize": homogenize.cli.main, "macro_fem": macro_fem.cli.main}


def run(package, *words, codes=(0,)):
    """How a command of a package ends, which is with one of these exit codes."""
    done = CliRunner().invoke(GROUPS[package], [str(word) for word in words])
    assert done.exit_code in codes, done.output
    return done


@contextmanager
def cluster_that_loses_a_worker(told):
    """The address of a Dask cluster of two workers, one of which is killed as soon as progress says `told`."""
    import distributed

    killed = []
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:

        def listen(work):
            if not killed and told in work.work:
                killed.append(cluster.workers[1].pid)
                os.kill(killed[0], signal.SIGKILL)

        with heard_by(listen):
            yield cluster.scheduler_address
    assert killed
