"""The wire of rmw_zenoh: ROS 2 in Python without ROS.

Owns a node with publishers, subscriptions, services, actions, parameters and a life cycle, and what it needs of
ROS's bytes: interfaces as data, CDR, type descriptions and hashes, key expressions, liveliness tokens, quality of
service. Must not know arms: it imports no room of hexwire. Only `zenoh_session` imports Zenoh.
"""
