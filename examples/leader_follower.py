"""One arm follows another, which you move by hand, until Ctrl-C.

    python examples/leader_follower.py [LEADER FOLLOWER]

Without addresses both are emulated SO-101. Move the leader from another terminal:

    hexwire sim hand shoulder_pan +30 --port "sim://so101?name=leader"
"""

import sys

import hexwire

ports = sys.argv[1:3] if len(sys.argv) > 2 else ("sim://so101?leader=1&name=leader", "sim://so101?name=follower")

with hexwire.connect(ports[0], "so101") as leader, hexwire.connect(ports[1], "so101") as follower:
    # The follower first meets the leader, slowly; it holds when this program ends.
    print("move the leader", flush=True)
    follower.follow(leader)
    off = max(abs(leader.read().positions[name] - angle) for name, angle in follower.read().positions.items())
    print(f"the follower holds, {off:.3f} rad from the leader at most")
