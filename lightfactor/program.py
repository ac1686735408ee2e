"""How this program is started as a process of its own."""

from __future__ import annotations

import sys

PROGRAM = (sys.executable, "-c", "from lightfactor.cli import main; main()")
