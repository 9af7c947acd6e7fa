"""A board without a program, at the end of a terminal."""

import os
import pty
import subprocess
import tty
from pathlib import Path

from esair.boards import stand_in


class Machine:
    """A board without a program: a REPL, then what ``main.py`` is, on one terminal."""

    def __init__(self, program: str, folder: Path) -> None:
        self.folder = folder
        folder.mkdir()
        (folder / "machine.py").write_text(
            Path(stand_in.__file__).read_text()
            + "\n\ndef reset():\n    import sys\n    sys.exit(0)\n"
        )
        mine, other = pty.openpty()
        tty.setraw(mine)
        tty.setraw(other)
        self._ends = [mine, other]
        self.port = os.ttyname(other)
        script = (
            f'while true; do "{program}"; [ -f main.py ] && "{program}" main.py; done'
        )
        self._process = subprocess.Popen(
            ["sh", "-c", script],
            cwd=folder,
            stdin=mine,
            stdout=mine,
            stderr=mine,
            start_new_session=True,
        )

    def stop(self) -> None:
        os.killpg(self._process.pid, 9)
        self._process.wait()
        for each in self._ends:
            os.close(each)
