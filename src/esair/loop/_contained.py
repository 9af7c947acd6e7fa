"""Functions of others, called where what they raise may end nothing."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any


def contained(
    loop: asyncio.AbstractEventLoop, function: Callable[..., object], *arguments: Any
) -> None:
    """Call a function; what it raises is told to the loop, as of any timer."""
    try:
        function(*arguments)
    except Exception as error:
        message = f"{function!r:.200} raised at its moment"
        loop.call_exception_handler({"message": message, "exception": error})
