"""Robots described by a file, ``robot.toml``: checked, read and built.

Every mistake is told at once, before anything is opened or moved. The reference has the
tables and their keys.
"""

from esair.config._classes import searched_first
from esair.config._components import (
    find_module,
    is_imported,
    keywords_of,
    make_component,
)
from esair.config._load import (
    Description,
    FoundInFile,
    Report,
    build,
    check,
    check_together,
    find_robot,
    has_simulation,
    is_of_module,
    load,
    load_robot,
    robot_of,
)
from esair.config._mistakes import ConfigFileError, Lines
from esair.config._source import digest_of, tables_of
from esair.config._values import INVALID, convert, fields_of

__all__ = [
    "INVALID",
    "ConfigFileError",
    "Description",
    "FoundInFile",
    "Lines",
    "Report",
    "build",
    "check",
    "check_together",
    "convert",
    "digest_of",
    "fields_of",
    "find_module",
    "find_robot",
    "has_simulation",
    "is_imported",
    "is_of_module",
    "keywords_of",
    "load",
    "load_robot",
    "make_component",
    "robot_of",
    "searched_first",
    "tables_of",
]
