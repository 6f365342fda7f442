"""``python -m stillray.oidn``: the command `oidnDenoise`."""

import sys

from stillray.oidn.command import main

sys.exit(main())
