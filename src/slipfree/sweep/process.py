"""Function that a process of a sweep is sent with each task."""

from __future__ import annotations

from slipfree.sweep.task import Done, Task


def run_task(task: Task) -> Done:
    """Return the result of a task."""
    from slipfree.sweep.worker import work  # with the solvers, which the parent does not need

    return work(task)
