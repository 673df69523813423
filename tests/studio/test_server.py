"""The server: what it serves is behind the gate, and its port is its own."""

from __future__ import annotations

import urllib.error
import urllib.request
from functools import partial
from typing import TYPE_CHECKING

import pytest

from hexwire.errors import LinkBusyError
from hexwire.studio.access import Access
from hexwire.studio.app import Studio

if TYPE_CHECKING:
    from tests.studio.running import RunningStudio


@pytest.mark.parametrize("path", ["/", "/static/live.js", "/wire/save"])
def test_nothing_is_served_without_a_session(served: RunningStudio, path: str) -> None:
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(served.url + path, timeout=30)
    refused.value.close()
    assert refused.value.code == 401


def test_a_port_in_use_is_said(served: RunningStudio) -> None:
    from hexwire.studio.server import Server, make_app, url_of

    studio = Studio(Access(frozenset()))
    try:
        port = int(served.url.rpartition(":")[2])
        with pytest.raises(LinkBusyError, match=str(port)):
            Server(partial(make_app, studio), studio.access, port=port).bind()
        assert (
            url_of(Server(partial(make_app, studio), studio.access, port=9), "T") == "http://127.0.0.1:9/?token=T"
        )
    finally:
        studio.close()
