"""`python -m torchbrdf`, which is `torchbrdf`."""

import sys

from torchbrdf.cli import main

if __name__ == "__main__":
    sys.exit(main())
