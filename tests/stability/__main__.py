"""``python tests/stability``: measure, print, write docs/stability.md."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from stability.report import main

sys.exit(main())
