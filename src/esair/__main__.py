"""``python -m esair``: the same as ``esair``."""

from esair.cli import main

if __name__ == "__main__":
    main()
