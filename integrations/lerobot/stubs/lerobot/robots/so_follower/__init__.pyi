import abc

from .. import Robot

class SOFollower(Robot, metaclass=abc.ABCMeta): ...
