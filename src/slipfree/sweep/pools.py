"""Pool of processes that execute the runs of a sweep.

`slipfree.sweep.cluster` contains the pool of a Dask cluster.
"""

from __future__ import annotations

from concurrent.futures import Future

from slipfree.core.errors import SlipfreeError
from slipfree.sweep.log import LOST
from slipfree.sweep.process import run_task
from slipfree.sweep.task import Done, Task, without_motion
from slipfree.system.processes import Pool as AnyPool
from slipfree.system.processes import ProcessDiedError, Processes

Pool = AnyPool[Task, Done]


class ProcessPool(Processes[Task, Done]):
    """Pool of processes with one thread each.

    Parameters
    ----------
    count : int
        Largest number of processes; they start when they are needed.
    """

    def __init__(self, count: int) -> None:
        super().__init__(count, run_task)

    def result(self, future: Future[Done], task: Task) -> Done:
        """Return the result of a future, with outcome ``lost`` if its process died.

        Raises
        ------
        SlipfreeError
            If the process could not start.
        """
        try:
            return super().result(future, task)
        except ProcessDiedError as error:
            return without_motion(task, LOST, str(error))
        except SlipfreeError as error:
            raise SlipfreeError(
                f"{error}; finished runs are kept; repeat the command to continue"
            ) from error
