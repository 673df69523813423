"""The chapter's `IpcHandle`: one channel of one module, named by a configuration file or a URL.

Owns the choice of the link and the modules at its two ends. `open()` opens it; creating a handle does no I/O. Must
not know frames or commands.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Self

from hexwire.errors import ConfigError, UsageError
from hexwire.link.base import Link, LinkKind, Openable
from hexwire.wire.modules import IpcType, ModuleType, module_name

if TYPE_CHECKING:
    from .channel import ChannelDirection

__all__ = ["IpcHandle"]

_TO = "to"
"""Key of the destination in an address."""
_TYPE_OF_SCHEME = {
    "serial": IpcType.SERIAL,
    "tcp": IpcType.TCP,
    "tcp-listen": IpcType.TCP,
    "tcps": IpcType.TCP,
    "tcps-listen": IpcType.TCP,
    "udp": IpcType.UDP,
    "udp-listen": IpcType.UDP,
    "mq": IpcType.QUEUE,
}


class IpcHandle(Openable):
    """A channel that has a name and is not open yet.

    Args:
        module: Our module on this channel.
        conf_file: An `ipc_msg.conf` (or its TOML form) that names the channel; read by `open`.

    Attributes:
        module: Our module id.
        destination: The module at the other end; INVALID_MODULE until a configuration file has been read.
        type: Kind of channel.
        behind_gateway: The address names one of several modules at a TCP port: a gateway opens the boards' ports.
        direction: What the record of a configuration file permits; None without a file, and before it is read.
    """

    direction: ChannelDirection | None = None
    behind_gateway = False
    _line = 0

    def __init__(self, module: ModuleType, conf_file: str | Path) -> None:
        self.module = module
        self.destination = ModuleType.INVALID_MODULE
        self.type = IpcType.SERIAL
        self._conf_file: Path | None = Path(conf_file)
        self._link: Link | None = None

    @classmethod
    def from_url(
        cls,
        url: str,
        module: ModuleType = ModuleType.ARM_7BOT_SERIAL_TRX,
        destination: ModuleType = ModuleType.ARM_7BOT_ARDUINO_TRX,
    ) -> Self:
        """A channel over the link that `url` names, such as ``serial:///dev/ttyUSB0?baud=115200``.

        If it names a configuration file, as in ``conf:///etc/ipc_msg.conf``, the destination is that in the file.
        Our module is then `module`, or the one of ``?module=NAME``. For any other link ``?to=NAME`` names the
        destination, which may be behind a gateway: ``tcp://pi.lab:15040?to=9``.

        Raises:
            UsageError: The URL is invalid; the text names the wrong part.
            ConfigError: The file that it names cannot be read, is wrong, or does not name our module.
        """
        from hexwire.link.open import make_link
        from hexwire.link.url import parse_url

        parts = parse_url(url)
        if parts.scheme == "conf":
            from .conf import conf_parts

            file, ours = conf_parts(parts, module)
            handle = cls(ours, file)
            handle._link = handle._from_conf()
            return handle
        if _TO in parts.query:
            from hexwire.wire.addresses import module_id

            from .channel import load_own_modules

            load_own_modules()
            destination = ModuleType(module_id(parts.query[_TO]))
            url = parts.without(_TO)
        handle = cls.from_link(make_link(url), module, destination)
        handle.behind_gateway = _TO in parts.query and parts.scheme in ("tcp", "tcps")
        return handle

    @classmethod
    def from_link(
        cls,
        link: Link,
        module: ModuleType = ModuleType.ARM_7BOT_SERIAL_TRX,
        destination: ModuleType = ModuleType.ARM_7BOT_ARDUINO_TRX,
    ) -> Self:
        """A channel over an existing link."""
        handle = cls.__new__(cls)
        handle.module = module
        handle.destination = destination
        handle.type = _TYPE_OF_SCHEME.get(link.url.partition(":")[0], IpcType.SERIAL)
        handle._conf_file = None
        handle._link = link
        return handle

    @property
    def link(self) -> Link:
        """The link; a configuration file is read at the first use.

        Raises:
            ConfigError: The file cannot be read, is wrong, or does not name this module.
        """
        if self._link is None:
            self._link = self._from_conf()
        return self._link

    @property
    def keeps_messages(self) -> bool:
        """Whether the link is known and preserves message boundaries."""
        return self._link is not None and self._link.kind is LinkKind.DATAGRAM

    @property
    def listens(self) -> bool:
        """Whether the link is known, and is the end that others connect to."""
        url = "" if self._link is None else self._link.url
        return url.partition("://")[0].endswith("-listen") or (url.startswith("mq:") and "role=server" in url)

    def check_sends(self, what: str) -> None:
        """Refuse to send on a channel that only receives; raises ConfigError."""
        if self.direction is not None and not self.direction.sends:
            raise self._wrong_way(f"only receives, so {what} is not sent", "TX")

    def check_receives(self) -> None:
        """Refuse to receive on a channel that only sends; raises ConfigError."""
        if self.direction is not None and not self.direction.receives:
            raise self._wrong_way("only sends, so nothing can be received", "RX")

    def _wrong_way(self, what: str, missing: str) -> ConfigError:
        assert self.direction is not None
        side = self.direction.side
        return ConfigError(
            f"{module_name(self.module)} is {self.direction.value}, which {what}; "
            f"write {side}_TRX or {side}_{missing}",
            file=str(self._conf_file),
            line=self._line,
            column=1,
        )

    def open(self) -> None:
        """Open the link; see `Link.open` for what it may raise."""
        self.link.open()

    def close(self) -> None:
        """Close the link. Harmless if it is not open."""
        if self._link is not None:
            self._link.close()

    def _from_conf(self) -> Link:
        from hexwire.link.open import make_link

        from .conf import channel_of, link_url

        if self._conf_file is None:
            raise UsageError("this handle has neither a link nor a configuration file")
        channel = channel_of(self._conf_file, self.module)
        self.destination, self.type = channel.destination, channel.interface
        self.direction, self._line = channel.direction, channel.line
        return make_link(link_url(channel))
