"""Workers of dask.distributed, one of which is killed while it works."""

import os
import signal
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from baselines.experiments.cluster import ClusterWorkers, slurm_cluster
from baselines.experiments.config import read_config
from baselines.experiments.running import run_experiment
from baselines.experiments.showing import Show
from scenediff_classic.errors import InputError
from tests.baselines.experiments.fakes import done, read, write_config

distributed = pytest.importorskip("distributed", reason="needs the extra cluster")


class KillOne(Show):
    """Kills the first worker as soon as two cells are finished."""

    def __init__(self, cluster: Any, folder: Path) -> None:
        super().__init__()
        self._cluster, self._folder, self.killed = cluster, folder, 0

    def finished(self, task: Any, outcome: Any) -> None:
        super().finished(task, outcome)
        if not self.killed and len(done(self._folder)) >= 2:
            self.killed = next(iter(self._cluster.workers.values())).pid
            os.kill(self.killed, signal.SIGKILL)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # what dask and tornado say of a worker that is gone
def test_a_killed_worker_loses_nothing(tmp_path: Path) -> None:
    config = read_config(write_config(tmp_path, count=4, other="takes_s = 0.3"))
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None,
        local_directory=str(tmp_path / "dask"),
    ) as cluster:  # fmt: skip
        show = KillOne(cluster, tmp_path)
        report = run_experiment(
            config, tmp_path / "run", tmp_path / "store",
            lambda show: ClusterWorkers(cluster.scheduler_address), show,
        )  # fmt: skip
    assert show.killed
    assert (report.cells, report.failed) == (8, 0)
    cells = read(tmp_path / "run" / "cells.json")
    assert len({(c["method"], c["pair"]) for c in cells}) == len(cells) == 8
    for cell in cells:
        assert (tmp_path / "run" / cell["output"] / "changes.json").is_file()
    # a finished cell is never done again; only the one that was under way may be in twice
    assert sum(Counter(done(tmp_path)).values()) <= 9


def test_nobody_answers(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No dask scheduler answers at nonsense"):
        ClusterWorkers("nonsense://")


def test_slurm_jobs_get_what_was_asked_for() -> None:
    pytest.importorskip("dask_jobqueue", reason="needs the extra cluster")
    with pytest.raises(InputError, match="Slurm workers cannot be set up"):
        slurm_cluster(1, cores=2)  # without memory
