"""Who this program is, in words for other computers.

Owns the words. They prove nothing: rights come from certificates.
"""

from __future__ import annotations

import getpass
import os
import socket
import sys
from pathlib import Path

from hexwire.system import user_id

__all__ = ["whoami"]


def whoami() -> str:
    """This program, for display at other computers."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):
        user = f"user {user_id()}"
    program = Path(sys.argv[0] or "python").name
    text = f"{user}@{socket.gethostname()} ({program}, process {os.getpid()})"
    # A name out of a file system may have bytes that are no text.
    return text.encode(errors="replace").decode()
