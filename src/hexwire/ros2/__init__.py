"""A node of ROS 2 on the wire of rmw_zenoh, without ROS.

Owns what only ROS 2 needs. What an arm does is decided in `hexwire.control`. Only `zenoh_session` imports Zenoh.
"""
