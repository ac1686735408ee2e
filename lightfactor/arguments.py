"""Errors and notes that name options of the command, said with the arguments of the functions."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

# The function's names where they aren't the option's without its dashes.
_RENAMED = {"set": "photoset", "source": "sources", "format": "form"}


def naming_arguments(function: Callable[P, R]) -> Callable[P, R]:
    """The function, whose ValueErrors name its arguments: `rotate_light` in place of `--rotate-light`."""

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except ValueError as error:
            raise ValueError(with_arguments(str(error))) from error

    return call


def with_arguments(text: str) -> str:
    """A text with arguments in place of options."""
    return re.sub(r"(?<![\w-])--([a-z][a-z-]*)", _argument, text)


def _argument(option: re.Match[str]) -> str:
    name = option[1].replace("-", "_")
    return _RENAMED.get(name, name)
