"""`python -m hexwire`: the same program as `hexwire`. Owns nothing."""

from hexwire.cli.__main__ import main

if __name__ == "__main__":
    main()
