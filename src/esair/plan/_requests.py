"""Which requests a behavior takes: is each a class of requests, and taken once?"""

from __future__ import annotations

from typing import Any

from esair import abc
from esair.actions import declared_requests, is_request
from esair.exceptions import ConfigError


def mistakes_in_requests(action: abc.Action) -> list[ConfigError]:
    """Return what is wrong with the requests that an action takes."""
    found: list[ConfigError] = []
    by_type: dict[Any, str] = {}
    for attribute, each in declared_requests(type(action)).items():
        if isinstance(each, ConfigError):
            found.append(ConfigError(action.name, each.field, _text(each)))
            continue
        if not is_request(each.type):
            message = (
                f"expected a class derived from esair.Request, not {each.type!r:.80}"
            )
        elif type(each.queue) is not int or each.queue < 1:
            message = f"expected a queue of 1 or more, not {each.queue!r:.80}"
        elif type(each.newest) is not bool:
            message = f"expected newest=True or False, not {each.newest!r:.80}"
        elif each.type in by_type:
            message = f"{each.type.__name__} is taken by {by_type[each.type]!r} already"
        else:
            by_type[each.type] = attribute
            continue
        found.append(ConfigError(action.name, attribute, message))
    return found


def _text(error: ConfigError) -> str:
    return str(error).split(": ", 2)[-1]
