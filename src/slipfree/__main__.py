"""``python -m slipfree``, and the command ``slipfree``."""

from __future__ import annotations

import signal
import sys

from slipfree.threads import single

INTERRUPTED = 130  # as `slipfree.cli` has it, which takes its time to be imported


def main() -> None:
    """Run the command line; Ctrl-C ends it with a word, even while it still starts."""
    try:
        single()
        from slipfree.cli import main as run

        run()
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        sys.exit(INTERRUPTED)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # nothing is left to be interrupted


if __name__ == "__main__":
    main()
