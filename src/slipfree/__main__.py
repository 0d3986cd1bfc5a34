"""``python -m slipfree``, and the command ``slipfree``."""

from __future__ import annotations

import io
import os
import sys


def _leave_current_folder() -> None:
    """Take the current folder, which ``python -m`` puts first, off the path of modules.

    A file ``numpy.py`` there would be imported in place of numpy. The folder stays if slipfree
    itself comes from it.
    """
    try:
        here = os.getcwd()  # noqa: PTH109  # pathlib would be imported from there
    except OSError:  # it is gone, and was not put there
        return
    home = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))  # noqa: PTH100, PTH120
    if not sys.flags.safe_path and sys.path[:1] == [here] and here != home:
        del sys.path[0]


if __name__ == "__main__":
    _leave_current_folder()

import signal  # noqa: E402

from slipfree.threads import single  # noqa: E402

INTERRUPTED = 130  # as `slipfree.cli` has it, which takes its time to be imported


def main() -> None:
    """Run the command line; Ctrl-C ends it with a word, even while it still starts."""
    try:
        single()
        os.environ["MPLBACKEND"] = "agg"  # figures are files; a notebook's may not be installed
        _open_streams()
        from slipfree.cli import main as run

        run()
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        sys.exit(INTERRUPTED)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # nothing is left to be interrupted


def _open_streams() -> None:
    """Open standard streams that are closed on the null device, lest a result take their number.

    Characters that the encoding of stdout does not have are escaped, as on stderr.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):  # in order of number
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: PTH123, SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


if __name__ == "__main__":
    main()
