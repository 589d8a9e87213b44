"""``python -m ldctoolkit`` is the command ``ldc``."""

import sys

from ldctoolkit.launcher import main

if __name__ == "__main__":
    sys.exit(main())
