"""`python -m legibility`, the same as the command `legibility`."""

import sys

from .cli import main

if __name__ == "__main__":
    sys.exit(main())
