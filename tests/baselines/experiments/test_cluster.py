"""Workers of dask.distributed, one of which is killed while it works."""

import os
import signal
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from baselines.experiments.__main__ import main
from baselines.experiments.cluster import ClusterWorkers
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


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # as above, when the job ends
def test_slurm_jobs_do_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("dask_jobqueue", reason="needs the extra cluster")
    path = write_config(tmp_path, count=1)
    stand_in = tmp_path / "bin"  # for Slurm: a job is a process of this machine
    stand_in.mkdir()
    # of its own copy: the script that is handed in is deleted as soon as this returns
    submit = '#!/bin/sh\ncp "$1" {0}/job.sh\n(exec sh {0}/job.sh >{0}/job.log 2>&1) &\n'
    submit += "echo $! >{0}/pid\n"
    (stand_in / "sbatch").write_text(submit.format(tmp_path) + "echo Submitted batch job $!\n")
    (stand_in / "scancel").write_text("#!/bin/sh\nkill $1\n")
    for program in stand_in.iterdir():
        program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{stand_in}:{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[3]))
    monkeypatch.chdir(tmp_path)
    arguments = ["run", str(path), "-o", str(tmp_path / "run"), "--slurm"]
    options = ["--slurm-options.cores", "3", "--slurm-options.memory", "4GB"]
    assert main([*arguments, *options]) == 0
    cells = read(tmp_path / "run" / "cells.json")
    assert [c["status"] for c in cells] == ["done", "done"]
    job = (tmp_path / "job.sh").read_text()
    assert "--cpus-per-task=3" in job
    assert "--nthreads 1" in job
