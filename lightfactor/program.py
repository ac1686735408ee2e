"""How this program is started as a process of its own."""

from __future__ import annotations

import sys

PROGRAM = (sys.executable, "-c", "from lightfactor.cli import main; main()")
# The same, for who holds the other end of its standard input: it ends when that is closed, however that comes.
BOUND_PROGRAM = (sys.executable, "-c", "from lightfactor.cli import main_bound; main_bound()")
