"""Workers on other machines, by dask.distributed; the extra ``cluster``.

All machines must see the data, the run's folder and the store under the same paths.
"""

from concurrent.futures import Future
from typing import Any

from baselines.experiments.tasks import Outcome, Task, perform
from scenediff_classic.errors import InputError

_MISSING = 'This needs the extra "cluster": pip install "scenediff-classic[cluster]".'


class ClusterWorkers:
    """Tasks go to the workers of a dask scheduler; use as a context manager.

    A task whose worker dies is done by another one; what a lost worker had finished is on disk and
    is taken from there.
    """

    slots = 1_000_000

    def __init__(self, scheduler: Any) -> None:
        """Connect.

        Parameters
        ----------
        scheduler
            Address (``tcp://host:port``) or a cluster object of dask.

        Raises
        ------
        InputError
            If nobody answers there, or the extra is not installed.
        """
        try:
            from distributed import Client
        except ImportError as error:
            raise InputError(_MISSING) from error
        try:
            self._client: Any = Client(scheduler, timeout=20, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(f"No dask scheduler answers at {scheduler}: {error}.") from error
        self._pool = self._client.get_executor(pure=False)

    def submit(self, task: Task) -> "Future[Outcome]":
        """Do a task on whatever worker is free."""
        return self._pool.submit(perform, task)

    def __enter__(self) -> "ClusterWorkers":
        """Connected already."""
        return self

    def __exit__(self, *_: object) -> None:
        """Take back what is not done, and leave."""
        self._pool.shutdown(wait=False)
        self._client.close()


def slurm_cluster(jobs: int, **options: Any) -> Any:
    """A dask cluster whose workers are Slurm jobs.

    Parameters
    ----------
    jobs : int
        Number of workers, one task at a time each.
    options
        Of ``dask_jobqueue.SLURMCluster`` (queue, cores, memory, walltime); what is left out comes
        from dask's own configuration files.

    Raises
    ------
    InputError
        If the extra is not installed, or dask-jobqueue refuses the options.
    """
    try:
        from dask_jobqueue.slurm import SLURMCluster
    except ImportError as error:
        raise InputError(_MISSING) from error
    given = {name: value for name, value in options.items() if value is not None}
    try:
        # a worker does one task at a time, which uses the job's cores itself
        job_cpu = given.pop("cores", 1)
        cluster = SLURMCluster(processes=1, cores=1, job_cpu=job_cpu, **given)
    except (ValueError, TypeError) as error:
        raise InputError(f"The Slurm workers cannot be set up: {error}.") from error
    cluster.scale(jobs)
    return cluster
