"""A board without a program, at the end of a terminal."""

import os
import pty
import select
import subprocess
import termios
import threading
import tty
from pathlib import Path

from esair.boards import stand_in


class Machine:
    """A board without a program: a REPL, then what ``main.py`` is, on one terminal.

    Args:
        program: The native MicroPython.
        folder: What it has for a flash memory; it is made.
        ctrl_c: Whether a program is interrupted by Ctrl-C, as on a board unless it
            takes the byte for itself, as the link does.
    """

    def __init__(self, program: str, folder: Path, *, ctrl_c: bool = False) -> None:
        self.folder = folder
        folder.mkdir()
        (folder / "machine.py").write_text(
            Path(stand_in.__file__).read_text()
            + "\n\ndef reset():\n    import sys\n    sys.exit(0)\n"
        )
        mine, other = pty.openpty()
        tty.setraw(other)
        self.port = os.ttyname(other)
        self._ends = [mine, other]
        self._relay: threading.Thread | None = None
        run = f'while true; do "{program}"; [ -f main.py ] && "{program}" main.py; done'
        if ctrl_c:
            run = f"trap : INT; exec <>{self._between()} >&0 2>&0; {run}"
        self._process = subprocess.Popen(
            ["sh", "-c", run],
            cwd=folder,
            stdin=mine,
            stdout=mine,
            stderr=mine,
            start_new_session=True,
        )

    def _between(self) -> str:
        """Open a second terminal, which makes a signal of Ctrl-C; return its name."""
        near, far = pty.openpty()
        how = termios.tcgetattr(far)
        how[0] &= ~termios.ICRNL
        how[1] &= ~termios.OPOST
        how[3] &= ~(termios.ICANON | termios.ECHO)
        termios.tcsetattr(far, termios.TCSANOW, how)
        ends = {self._ends[0]: near, near: self._ends[0]}
        end, self._over = os.pipe()
        self._ends += [near, far, end, self._over]

        def relay() -> None:
            while True:
                ready = select.select([*ends, end], [], [])[0]
                if end in ready:
                    return
                for each in ready:
                    os.write(ends[each], os.read(each, 4096))

        self._relay = threading.Thread(target=relay)
        self._relay.start()
        return os.ttyname(far)

    def stop(self) -> None:
        os.killpg(self._process.pid, 9)
        self._process.wait()
        if self._relay is not None:
            os.write(self._over, b"x")
            self._relay.join()
        for each in self._ends:
            os.close(each)
