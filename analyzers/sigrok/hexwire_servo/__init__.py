# SPDX-License-Identifier: GPL-2.0-or-later
"""The servo bus: packets of both headers and byte orders, register names, turn-around times, collisions.

Stacked on the `uart` decoder. One line (rx or tx) is a half-duplex bus; with both, requests on one and answers on
the other, or a bus whose transmitted bytes are seen on a line of their own.
"""

from .pd import Decoder as Decoder
