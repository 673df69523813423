import abc

from .. import Teleoperator

class SOLeader(Teleoperator, metaclass=abc.ABCMeta): ...
