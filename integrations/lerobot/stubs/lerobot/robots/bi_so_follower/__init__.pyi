import abc

from .. import Robot

class BiSOFollower(Robot, metaclass=abc.ABCMeta): ...
