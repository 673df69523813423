"""ROS 2 in Python without ROS, on the wire of rmw_zenoh.

Owns a node with publishers, subscriptions, services, actions, parameters and a life cycle, and what it needs of
ROS's bytes: interfaces as data, CDR, type descriptions and hashes, key expressions, liveliness tokens, quality of
service. Only `zenoh_session` imports Zenoh. The names here are public; those of the modules may change.
"""

from __future__ import annotations

from . import type_descriptions
from .action_server import ActionServer, GoalHandle
from .bag import BagWriter
from .callbacks import Inbox
from .distributions import NO_TYPE_HASH, Distribution
from .errors import (
    LocalProtocolError,
    ProtocolError,
    RemoteProtocolError,
    RosError,
    RouterNotFoundError,
    ServiceTimeoutError,
    SessionClosedError,
    SessionError,
    UsageError,
)
from .goals import CancelCode, GoalStatus
from .graph import Graph
from .keys import MOST_DOMAIN, Endpoint, Role, domain_of
from .lifecycle import Change, Lifecycle, State
from .names import Kind, Remap, check_node_name, full_name, logger_name, parse_remap, remap_node
from .node import Client, Deferred, Node, NodeOptions, Publisher, Service, Subscription
from .parameters import Descriptor, ParameterServer
from .qos import DEFAULT, LATCHED, SENSOR_DATA, SERVICES, Durability, History, Qos, Reliability
from .times import nanoseconds_of, seconds_of, time_fields
from .types import ActionType, Message, MessageType, ServiceType, Types
from .zenoh_session import LISTEN, ZenohSettings, endpoints_in, load_zenoh

__all__ = [
    "DEFAULT",
    "LATCHED",
    "LISTEN",
    "MOST_DOMAIN",
    "NO_TYPE_HASH",
    "SENSOR_DATA",
    "SERVICES",
    "ActionServer",
    "ActionType",
    "BagWriter",
    "CancelCode",
    "Change",
    "Client",
    "Deferred",
    "Descriptor",
    "Distribution",
    "Durability",
    "Endpoint",
    "GoalHandle",
    "GoalStatus",
    "Graph",
    "History",
    "Inbox",
    "Kind",
    "Lifecycle",
    "LocalProtocolError",
    "Message",
    "MessageType",
    "Node",
    "NodeOptions",
    "ParameterServer",
    "ProtocolError",
    "Publisher",
    "Qos",
    "Reliability",
    "Remap",
    "RemoteProtocolError",
    "Role",
    "RosError",
    "RouterNotFoundError",
    "Service",
    "ServiceTimeoutError",
    "ServiceType",
    "SessionClosedError",
    "SessionError",
    "State",
    "Subscription",
    "Types",
    "UsageError",
    "ZenohSettings",
    "check_node_name",
    "domain_of",
    "endpoints_in",
    "full_name",
    "load_zenoh",
    "logger_name",
    "nanoseconds_of",
    "parse_remap",
    "remap_node",
    "seconds_of",
    "time_fields",
    "type_descriptions",
]
