"""From a ``robot.toml`` to the files of a microcontroller.

`build` takes the wiring of a robot whose parts fit into ESAIR MIN and writes what is
copied to a board: ``esair/minimal.py``, the modules of the parts, and ``main.py``.
"""

from esair.firmware._build import Built, build
from esair.firmware._modules import KNOWN_MODULES

__all__ = ["KNOWN_MODULES", "Built", "build"]
