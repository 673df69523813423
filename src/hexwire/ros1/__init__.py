"""The ROS 1 front: a node that offers a robot as topics, services and actions.

Only `node` imports rospy; only `messages` and `message_files` import genpy.
"""
