"""A page of one's own: joint angles, live, and a button that stops the arm.

    python examples/own_page.py [PORT]

Then open http://127.0.0.1:8000. Needs `hexwire[studio]`. `hexwire studio` is the page for everything else.
"""

import math
import os
import sys

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route

import hexwire

port = sys.argv[1] if len(sys.argv) > 1 else "sim://hex7bot"
arm = hexwire.connect(port)
PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>my arm</title>
<button id="stop">STOP</button><table>{rows}</table>
<script>
document.getElementById("stop").onclick = () => fetch("/stop", {{method: "POST"}});
setInterval(async () => {{
  const angles = await (await fetch("/angles")).json();
  for (const [name, text] of Object.entries(angles)) document.getElementById(name).textContent = text;
}}, 100);
</script></html>"""


def page(request: Request) -> Response:
    """What a browser shows."""
    return HTMLResponse(PAGE.format(rows="".join(f"<tr><td>{n}<td id={n}>" for n in arm.model.names)))


def angles(request: Request) -> Response:
    """The joint angles, in words."""
    state = arm.read()
    words = [f"{math.degrees(joint.position):.1f}" for joint in state]
    known = [joint.name not in state.silent for joint in state]
    told = [text if there else "no answer" for text, there in zip(words, known, strict=True)]
    return JSONResponse(dict(zip(state.names, told, strict=True)))


def stop(request: Request) -> Response:
    """Stop the arm, latched until `hexwire resume`; only for a page from here, not for another site's."""
    if request.headers.get("origin") != f"http://{request.headers.get('host')}":
        return Response("not from here", 403)
    arm.stop()
    return Response("stopped")


routes = [Route("/", page), Route("/angles", angles), Route("/stop", stop, methods=["POST"])]
number = int(os.environ.get("PAGE_PORT", "8000"))
try:
    uvicorn.run(Starlette(routes=routes), host="127.0.0.1", port=number, log_level="warning")
finally:
    arm.detach()
