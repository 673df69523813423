import abc

from .. import Teleoperator

class BiSOLeader(Teleoperator, metaclass=abc.ABCMeta): ...
