"""Function that a process of a sweep executes for each task."""

from __future__ import annotations

from slipfree.sweep.task import Done, Task


def run_task(task: Task) -> Done:
    """Execute a task with `slipfree.sweep.worker.work`, and return its result."""
    from slipfree.sweep.worker import work  # imports the solvers, which the parent does not need

    return work(task)
