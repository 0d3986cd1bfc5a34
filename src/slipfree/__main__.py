"""Entry point of ``python -m slipfree`` and of the command ``slipfree``."""

from __future__ import annotations

import gc
import io
import os
import sys


def _leave_current_folder() -> None:
    """Remove the current folder from ``sys.path``, where ``python -m`` inserts it first.

    A file ``numpy.py`` in that folder would be imported instead of numpy. The folder is not removed
    if slipfree itself is in it.
    """
    try:
        here = os.getcwd()  # noqa: PTH109  # a file pathlib.py there would be imported
    except OSError:  # the folder was deleted, so Python did not insert it
        return
    home = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))  # noqa: PTH100, PTH120
    if not sys.flags.safe_path and sys.path[:1] == [here] and here != home:
        del sys.path[0]


if __name__ == "__main__":
    _leave_current_folder()

import signal  # noqa: E402

from slipfree.system.interrupt import interrupt_arrived, interrupt_at_signals, interrupted  # noqa: E402

INTERRUPTED = 130  # exit code; that of `slipfree.core.trajectory`, whose import would be slow
# Expressions are up to a million objects without cycles: Python's default of 700 new objects for
# each search for cycles would take up to a twelfth of the time of a plan.
OBJECTS = 100_000


def main() -> None:
    """Run the command line; Ctrl-C, SIGTERM and SIGHUP end it with exit code 130."""
    try:
        try:
            _run()
        finally:
            interrupt_arrived()
            gc.freeze()  # at exit the system frees all memory, in a tenth of the time
            for name in ("SIGINT", "SIGTERM", "SIGHUP"):  # no traceback from a signal at exit
                if hasattr(signal, name):
                    signal.signal(getattr(signal, name), signal.SIG_IGN)
    except (KeyboardInterrupt, Exception) as error:
        # An extension module whose import is interrupted raises another error.
        if not isinstance(error, KeyboardInterrupt) and not interrupted():
            raise
        interrupt_arrived()
        sys.stderr.write("interrupted\n")
        sys.exit(INTERRUPTED)


def _run() -> None:
    """Run the command line, after set-up that must precede the import of numpy."""
    interrupt_at_signals()
    from slipfree.system.forks import single_thread

    single_thread()
    gc.set_threshold(OBJECTS)
    # a notebook's backend may not be installed here; plugins are searched in all packages
    os.environ.update(MPLBACKEND="agg", PYDANTIC_DISABLE_PLUGINS="1")
    _open_streams()
    from slipfree.cli import main as run

    run()


def _open_streams() -> None:
    """Connect closed standard streams to the null device.

    Otherwise the next opened file would get their file descriptor and receive what is printed.
    Characters that the encoding of stdout lacks are escaped, as on stderr.
    """
    # in the order of their file descriptors 0, 1, 2
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: PTH123, SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


if __name__ == "__main__":
    main()
