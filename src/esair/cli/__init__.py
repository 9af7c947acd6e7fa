"""The command line: ``esair VERB``. One file for each verb.

Exit codes: 0 all is well; 1 the robot ended with an error, or ``esair check`` found
one; 2 the command line, a file or an installation cannot be used.
"""

from esair.cli._main import main

__all__ = ["main"]
