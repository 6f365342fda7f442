"""``python -m stillray``: the same as the ``stillray`` command."""

import sys

from stillray.cli import main

if __name__ == "__main__":
    sys.exit(main())
