"""The command line: ``esair VERB``. One file for each verb.

Exit codes: 0 done; 1 not done, or ``esair check`` found an error; 2 the command line, a
file or an installation cannot be used; 3 a replay differs; 128 + n signal n ended it.
"""

import sys
from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one verb and end the process with its exit code.

    Args:
        arguments: The words after ``esair``; those of this process unless given.
    """
    try:
        from esair.cli import _main  # it takes a moment, in which Ctrl-C may come

        _main.main(arguments)
    except KeyboardInterrupt:  # before the verb has taken care of it, or once more
        sys.exit(130)  # 128 and the number of SIGINT
