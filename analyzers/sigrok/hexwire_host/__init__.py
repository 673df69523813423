# SPDX-License-Identifier: GPL-2.0-or-later
"""The host link: session headers, command frames of both dialects, and the servo packets inside.

Stacked on the `uart` decoder, with the host's line as one of rx and tx and the board's as the other.
"""

from .pd import Decoder as Decoder
