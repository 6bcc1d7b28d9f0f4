"""The command `cognitivedrone`, also as `python -m cognitivedrone`; Ctrl-C is no traceback from the first import on."""

from cognitivedrone.system.interrupts import leaving_at_once


def main() -> None:
    """Run the command."""
    with leaving_at_once():
        from cognitivedrone.cli import main as run

        run()


if __name__ == "__main__":
    main()
