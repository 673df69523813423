"""The address of a channel in a configuration file: ``conf:///etc/ipc_msg.conf?module=NAME``, or the file's path.

Owns its parts and the choice of the channel. `hexwire.ipc.conf` reads the file, `hexwire.link` makes the link.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hexwire.errors import ConfigError, UsageError
from hexwire.wire.modules import ModuleType, module_name

from .channel import module_by_text

if TYPE_CHECKING:
    from hexwire.link.base import Link
    from hexwire.link.url import LinkUrl

    from .channel import ChannelConf

__all__ = ["channel_of", "conf_parts", "device_url", "make_conf_link"]


def conf_parts(url: LinkUrl, default: ModuleType = ModuleType.ARM_7BOT_SERIAL_TRX) -> tuple[Path, ModuleType]:
    """The file that an address names, and our module in it.

    Raises:
        UsageError: The address names no file, or an unknown module.
    """
    url.check_keys(("module",))
    file = f"{url.netloc}{url.path}"
    if not file:
        raise UsageError(f"{url.text}: the file is missing, as in conf:///etc/ipc_msg.conf")
    text = url.query.get("module")
    if text is None:
        return Path(file), default
    module = module_by_text(text)
    if module is None:
        raise UsageError(f"{url.text}: unknown module {text!r}")
    return Path(file), module


def channel_of(file: Path, module: ModuleType) -> ChannelConf:
    """The channel of a module.

    Raises:
        ConfigError: The file cannot be read, is wrong, or does not name this module.
    """
    from .conf import load_conf

    channels = load_conf(file)
    for channel in channels:
        if channel.module == module:
            return channel
    named = ", ".join(sorted({module_name(c.module) for c in channels})) or "none"
    raise ConfigError(f"there is no channel for {module_name(module)}; the file has {named}", file=str(file))


def device_url(port: str) -> LinkUrl:
    """The address of the link itself: of the channel, if `port` names one in a configuration file.

    Raises:
        UsageError: As `parse_url` and `conf_parts`.
        ConfigError: As `channel_of`.
    """
    from hexwire.link.url import parse_url

    from .channel import link_url

    url = parse_url(port)
    return parse_url(link_url(channel_of(*conf_parts(url)))) if url.scheme == "conf" else url


def make_conf_link(url: LinkUrl) -> Link:
    """Make the link of a channel; for `hexwire.link.open.make_link`.

    A bare link carries bytes both ways: a servo bus, or a board behind a gateway, is asked and answers. A `Session`
    keeps the direction itself.

    Raises:
        UsageError: As `conf_parts`.
        ConfigError: As `channel_of`, or the channel goes one way only.
    """
    from hexwire.link.open import build_link

    from .channel import link_url

    file, module = conf_parts(url)
    channel = channel_of(file, module)
    if not (channel.direction.sends and channel.direction.receives):
        raise ConfigError(
            f"{module_name(module)} is {channel.direction.value}, but what is there is asked and answers; "
            f"write {channel.direction.side}_TRX",
            file=str(file),
            line=channel.line,
            column=1,
        )
    return build_link(link_url(channel))
