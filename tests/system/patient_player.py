"""A program: `hexwire WORDS...` that asks servers for a longer watchdog while it plays on several arms.

    python -m tests.system.patient_player WORDS...

A busy machine may keep it from its calls for longer than the usual second.
"""

from __future__ import annotations

from hexwire.cli.__main__ import main
from hexwire.fleet import player

if __name__ == "__main__":
    player._WATCHDOG = 10.0
    main()
