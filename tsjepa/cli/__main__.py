"""``python -m tsjepa.cli``."""

import sys

from tsjepa.cli import main

sys.exit(main())
