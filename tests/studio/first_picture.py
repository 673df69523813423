"""What the first picture of the page Move takes; for the tests and the benchmark, which so count the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Page, Response

__all__ = ["FirstPicture", "first_picture"]


@dataclass(frozen=True, slots=True)
class FirstPicture:
    """What a browser that was never here asks for.

    Attributes:
        requests: Number of requests; the first one only leads on from the address with the key.
        sent: Bytes of their answers on the wire, with the heads.
        raw: Bytes of the files, as they are before they are compressed.
    """

    requests: int
    sent: int
    raw: int


def first_picture(page: Page, address: str) -> FirstPicture:
    """Open the page Move with an empty cache, and count all that it asks for until it asks for nothing more.

    Args:
        page: A page of a new context, as large as the window that counts.
        address: The studio's, with the key.
    """
    asked: list[Response] = []
    page.on("response", lambda response: asked.append(response))
    page.goto(address.replace("/?", "/move?"))
    page.locator("#arm-view canvas").wait_for()
    page.locator("#arm-poses li").first.wait_for(state="attached")
    page.wait_for_load_state("networkidle")
    sizes = [response.request.sizes() for response in asked]
    return FirstPicture(
        len(asked),
        sum(size["responseBodySize"] + size["responseHeadersSize"] for size in sizes),
        sum(len(response.body()) for response in asked[1:]),
    )
