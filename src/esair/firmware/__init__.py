"""From a ``robot.toml`` to the files of a microcontroller.

`build` takes the wiring of a robot whose parts fit into ESAIR MIN and writes what is
copied to a board: ``esair/minimal.py``, the modules of the parts, and ``main.py``.
"""

from esair.firmware._boards import BOARDS, Board
from esair.firmware._build import Built, build
from esair.firmware._deploy import Deployed, deploy, monitor
from esair.firmware._fit import mistakes_in, uneven_on_boards
from esair.firmware._micropython import Trial, find_micropython, run_folder
from esair.firmware._modules import KNOWN_MODULES

__all__ = [
    "BOARDS",
    "KNOWN_MODULES",
    "Board",
    "Built",
    "Deployed",
    "Trial",
    "build",
    "deploy",
    "find_micropython",
    "mistakes_in",
    "monitor",
    "run_folder",
    "uneven_on_boards",
]
