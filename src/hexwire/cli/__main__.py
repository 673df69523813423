"""`python -m hexwire.cli` is `hexwire`."""

from hexwire.cli.main import main

main()
