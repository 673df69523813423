"""A node of ROS 2 on the wire of rmw_zenoh, without ROS.

Owns what only ROS 2 needs of an arm; `rmw` has the wire. What an arm does is decided in `hexwire.control`.
"""
