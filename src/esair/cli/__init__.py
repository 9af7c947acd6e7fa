"""The command line: ``esair VERB``. One file for each verb.

Exit codes: 0 done; 1 not done, or ``esair check`` found an error; 2 the command line, a
file or an installation cannot be used; 3 a replay differs; 128 + n signal n ended it.
"""

from esair.cli._main import main

__all__ = ["main"]
