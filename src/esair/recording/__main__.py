"""``python -m esair.recording FILE ...``: make cut recordings whole, in the background."""

import os
import sys

from esair.exceptions import RecordingBrokenError
from esair.recording import recover

if __name__ == "__main__":
    os.nice(19)  # a robot may be driving
    for path in sys.argv[1:]:
        try:
            found = recover(path)
        except (RecordingBrokenError, OSError) as error:
            sys.stderr.write(f"{path} is not recovered: {error}\n")
        else:
            sys.stderr.write(
                f"{path} was cut: {found.messages} messages are in {found.path.name}\n"
            )
