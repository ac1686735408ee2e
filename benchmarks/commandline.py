"""Command lines of benchmarks, whose help is their module's docstring."""

from __future__ import annotations

import argparse


def documented_parser(program: str, text: str | None) -> argparse.ArgumentParser:
    """A parser whose description is a docstring's first line, and whose help ends with the rest as it is written."""
    first, _, rest = (text or "").partition("\n")
    return argparse.ArgumentParser(
        program, description=first, epilog=rest, formatter_class=argparse.RawDescriptionHelpFormatter
    )
