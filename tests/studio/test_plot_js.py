"""`static/plot.js` in a browser: what it keeps, shows and lets one measure."""

from __future__ import annotations

import base64
import functools
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import hexwire

if TYPE_CHECKING:
    from playwright.sync_api import Page

STATIC = Path(hexwire.__file__).parent / "studio" / "static"


class _Files(SimpleHTTPRequestHandler):
    def do_GET(self) -> None:
        if self.path != "/":
            super().do_GET()
            return
        head = b'<link rel="icon" href="data:,"><link rel="stylesheet" href="studio.css">'
        page = b'<!doctype html><html lang="en">' + head + b'<div id="plot"></div></html>'
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.send_header("Content-Length", str(len(page)))
        self.end_headers()
        self.wfile.write(page)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def files() -> Iterator[str]:
    """Address of a server of the static files."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Files, directory=str(STATIC)))
    thread = threading.Thread(target=server.serve_forever, args=(0.05,))
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.fixture
def page(files: str, blank: Page) -> Page:
    page = blank
    page.set_viewport_size({"width": 900, "height": 700})
    page.goto(files)
    return page


@pytest.fixture
def plot(page: Page) -> Iterator[Page]:
    """`window.plot` shows two joints and a voltage: 60 s at 50 Hz, J1 a ramp of 1 deg/s."""
    page.evaluate(
        """async () => {
          const { Plot } = await import("/plot.js");
          const series = [
            { name: "J1", quantity: "position", unit: "°", colour: 0 },
            { name: "J2", quantity: "position", unit: "°", colour: 1 },
            { name: "J1 voltage", quantity: "voltage", unit: "V", colour: 0, dash: [4, 3] },
          ];
          window.plot = new Plot(document.getElementById("plot"), { title: "Arm", series, window: 20 });
          const t = Float64Array.from({ length: 3000 }, (_, i) => i / 50);
          plot.set([t, Float32Array.from(t), Float32Array.from(t, (v) => -v), new Float32Array(3000).fill(7.4)]);
          plot._draw();
        }"""
    )
    yield page
    page.evaluate("plot.destroy()")


def _range(page: Page) -> tuple[float, float]:
    page.evaluate("plot._draw()")
    begin, end = page.evaluate("plot.range")
    return begin, end


def _box(page: Page) -> dict[str, Any]:
    box = page.locator(".u-over").first.bounding_box()
    assert box is not None
    return dict(box)


@pytest.mark.slow
def test_it_follows_until_it_is_paused(plot: Page) -> None:
    assert _range(plot) == pytest.approx((39.98, 59.98))
    plot.evaluate("plot.append(61, [61, -61, 7.4])")
    assert _range(plot) == pytest.approx((41.0, 61.0))
    plot.get_by_role("button", name="Pause").click()
    plot.evaluate("plot.append(62, [62, -62, 7.4])")
    assert _range(plot) == pytest.approx((41.0, 61.0))
    assert plot.evaluate("plot.columns.last") == 62
    plot.get_by_role("button", name="Follow the newest values").click()
    assert _range(plot) == pytest.approx((42.0, 62.0))


def test_the_value_now_is_not_one_of_a_second_ago(plot: Page) -> None:
    now = "[0, 2].map((series) => plot.columns.newest(series))"
    plot.evaluate("plot.append(60, [NaN, -60, 7.4])")
    plot.evaluate("plot.append(60.9, [NaN, -60.9, NaN])")
    # Signals that come less often than others are known in between.
    assert plot.evaluate(now) == pytest.approx([59.98, 7.4])
    plot.evaluate("plot.append(61.1, [NaN, -61.1, 7.3])")
    assert plot.evaluate(f"{now}.map((value) => (Number.isNaN(value) ? null : value))") == [
        None,
        pytest.approx(7.3),
    ]
    plot.wait_for_function("document.querySelector('.hx-plot-legend tbody td:nth-child(3)').textContent === '–'")


@pytest.mark.slow
def test_zoom_by_wheel_drag_and_keys(plot: Page) -> None:
    box = _box(plot)
    middle = box["y"] + box["height"] / 2
    plot.mouse.move(box["x"] + 400, middle)
    plot.mouse.wheel(0, -120)
    plot.wait_for_function("plot.window < 19")
    begin, end = _range(plot)
    # It still follows: the newest value stays at the right.
    assert end == pytest.approx(59.98)
    plot.mouse.move(box["x"] + 0.25 * box["width"], middle)
    plot.mouse.down()
    plot.mouse.move(box["x"] + 0.75 * box["width"], middle, steps=3)
    plot.mouse.up()
    span = end - begin
    assert _range(plot) == pytest.approx((begin + 0.25 * span, begin + 0.75 * span), abs=0.05 * span)
    assert plot.evaluate("plot.paused")
    before = _range(plot)
    plot.keyboard.press("ArrowRight")
    assert _range(plot)[0] == pytest.approx(before[0] + 0.05 * (before[1] - before[0]))
    plot.keyboard.press("-")
    assert _range(plot)[1] - _range(plot)[0] > 1.3 * (before[1] - before[0])
    plot.keyboard.press("0")
    assert _range(plot) == pytest.approx((0.0, 59.98))
    plot.keyboard.press(" ")
    assert not plot.evaluate("plot.paused")


@pytest.mark.slow
def test_cursors_measure_values_and_differences(plot: Page) -> None:
    box = _box(plot)
    begin, end = _range(plot)
    at = [begin + share * (end - begin) for share in (0.25, 0.75)]
    for share in (0.25, 0.75):
        plot.mouse.click(box["x"] + share * box["width"], box["y"] + 20)
    a, b = plot.evaluate("[plot.cursors.a, plot.cursors.b]")
    assert (a, b) == pytest.approx(at, abs=0.1)
    row = plot.get_by_role("row", name="J2")
    plot.wait_for_function("document.querySelectorAll('.hx-plot-legend tbody tr')[1].cells[5].textContent !== '–'")
    cells = [float(text.replace("−", "-")) for text in row.locator("td").all_text_contents()[2:]]
    assert cells == pytest.approx([-a, -b, a - b], abs=0.03)
    # The cursor that was set last moves with the arrows; Delete removes both.
    plot.keyboard.press("Shift+ArrowLeft")
    assert plot.evaluate("plot.cursors.b") == pytest.approx(b - 10 * (end - begin) / 400)
    plot.keyboard.press("Delete")
    assert plot.evaluate("[plot.cursors.a, plot.cursors.b]") == [None, None]


def test_units_have_panels_of_their_own_and_series_can_be_hidden(plot: Page) -> None:
    assert plot.locator(".uplot").count() == 2
    plot.get_by_role("checkbox", name="J1 voltage").uncheck()
    assert plot.locator(".uplot").count() == 1
    plot.get_by_role("checkbox", name="J1 voltage").check()
    assert plot.locator(".uplot").count() == 2


@pytest.mark.slow
def test_the_picture_is_a_png_in_the_colours_of_the_page(plot: Page) -> None:
    text = plot.evaluate(
        """async () => {
          const bytes = new Uint8Array(await (await plot.png()).arrayBuffer());
          return btoa(String.fromCharCode(...bytes.slice(0, 24)));
        }"""
    )
    head = base64.b64decode(text)
    assert head.startswith(b"\x89PNG")
    assert int.from_bytes(head[16:20]) >= 800


def test_reduction_keeps_every_peak_and_gaps(page: Page) -> None:
    found = page.evaluate(
        """async () => {
          const { Columns } = await import("/plot_data.js");
          const columns = new Columns(1, 60000);
          const n = 50000, rows = new Float32Array(n);
          rows[31234] = 5; rows[31235] = -7;
          rows.fill(NaN, 40000, 45000);
          columns.set([Float64Array.from({ length: n }, (_, i) => i / 100), rows]);
          const { data, low, high } = columns.view(0, 500, 400, [0]);
          const gap = data[1].filter((v) => v === null).length / data[1].length;
          return { points: data[0].length, low, high, gap,
            rising: data[0].every((t, i) => !i || t > data[0][i - 1]) };
        }"""
    )
    assert (found["low"], found["high"]) == (-7, 5)
    assert found["points"] <= 800
    assert found["gap"] == pytest.approx(0.1, abs=0.02)
    assert found["rising"]


@pytest.mark.slow
def test_memory_is_constant_over_an_hour(page: Page) -> None:
    before, after, kept, shown = page.evaluate(
        """async () => {
          const { Columns } = await import("/plot_data.js");
          const columns = new Columns(42, 65536);
          const row = new Float32Array(42);
          const run = (from, to) => {
            for (let i = from; i < to; i++) {
              row[0] = i;
              columns.append(i / 100, row);
              columns.trim(i / 100 - 600);
            }
          };
          run(0, 90000);
          const before = columns.bytes;
          run(90000, 360000);
          const { low, high } = columns.view(3000, 3600, 500, [0]);
          return [before, columns.bytes, columns.last - columns.first, [low, high]];
        }"""
    )
    assert after == before < 20e6
    assert 590 < kept < 700
    # A group of 128 rows begins a little before the view.
    assert 299_999 - 128 <= shown[0] <= 299_999
    assert shown[1] == 359_999
