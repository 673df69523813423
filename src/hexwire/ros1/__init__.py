"""The ROS 1 edge: a node that gives a robot ROS's names. Only `node` imports rospy, only `messages` genpy."""
