"""`python -m cognitivedrone`: the same as the `cognitivedrone` command."""

from cognitivedrone.cli import main

main()
