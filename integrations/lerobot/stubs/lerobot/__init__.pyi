"""What hexwire's plug-in uses of LeRobot 0.4.4 and 0.6.1, for the type checker: LeRobot itself needs PyTorch.

`tests/test_stubs.py` compares it with LeRobot.
"""
