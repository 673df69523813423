"""The server: what it serves is behind the gate, and its port is its own."""

from __future__ import annotations

import gzip
import urllib.error
import urllib.request
from functools import partial
from typing import TYPE_CHECKING

import pytest
from tests.studio.running import Visitor

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


def test_the_page_is_compressed_for_a_browser_that_can_read_it_so(served: RunningStudio) -> None:
    owner = Visitor(served, served.studio.access.operate_token)
    _, headers, plain = owner.ask("/move", Origin="")
    assert "content-encoding" not in headers
    _, headers, packed = owner.ask("/move", Origin="", **{"Accept-Encoding": "gzip, br"})
    assert (headers["content-encoding"], headers["vary"]) == ("gzip", "accept-encoding")
    assert headers["cache-control"] == "no-store"
    # Each has the key of a tab of its own.
    assert len(gzip.decompress(packed)) == len(plain)
    assert b"{tab}" not in plain
