"""The command `cognitivedrone`, also as `python -m cognitivedrone`; Ctrl-C is no traceback from the first import on."""

import sys

from cognitivedrone.system.imports import hidden_module
from cognitivedrone.system.interrupts import leaving_at_once


def main() -> None:
    """Run the command."""
    with leaving_at_once():
        try:
            from cognitivedrone.cli import main as run
        except (ImportError, AttributeError):
            if hidden := hidden_module():
                sys.exit(f"cognitivedrone: {hidden}")
            raise
        run()


if __name__ == "__main__":
    main()
