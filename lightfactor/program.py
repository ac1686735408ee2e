"""How this program is started as a process of its own."""

from __future__ import annotations

import os
import sys
from threading import Thread

PROGRAM = (sys.executable, "-c", "from lightfactor.cli import main; main()")
# The same, for who holds the other end of its standard input: it ends when that is closed, however that comes.
BOUND_PROGRAM = (sys.executable, "-c", "from lightfactor.program import bound; bound()")


def bound() -> None:
    """Run the command until whoever started it is gone."""
    from lightfactor.cli import main

    Thread(target=_end_with_input, daemon=True).start()
    main()


def _end_with_input() -> None:
    # Not by `sys.stdin`, which waits for its reader when the program ends.
    while os.read(0, 1):
        pass
    # What isn't finished the next run clears away.
    os._exit(1)
