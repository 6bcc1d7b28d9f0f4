"""`python -m cognitivedrone.cli`: the same command."""

from cognitivedrone.cli import main

main()
