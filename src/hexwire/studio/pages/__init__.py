"""The pages of the studio, one file each.

Owns their list: address, title, and where their builder is. Must not know what a page shows.

How to write a page
===================

Its file has ``build(studio)``, which is called in the loop of the server each time that somebody goes to the page,
and creates NiceGUI elements for that tab. Only the part of the page below the header is the page's.

* `studio.tab()` is the tab; `studio.source` what is open. `source.mode` is ``arm``, ``bus``, ``opening`` or
  ``none``; `source.arm` has the `ControlledArm`, the `SharedArm`, the settings and the driver. A page says
  something sensible in each.
* What may wait runs in a thread: ``await studio.run(lambda: arm.shared.resume(arm.order(tab)), control=True)``. It
  returns the result, or `FAILED` after it has shown the one line of the error. ``control=True`` is for whatever
  changes the arm or its servos; the check is on the server, a hidden button protects nothing.
* An order to the arm carries its sender: ``arm.shared.torque(arm.order(tab), True, names)``.
* Values at frame rate never go through NiceGUI. Put an ES module into ``static/NAME.js`` and let it take over an
  element: ``mount("NAME.js", element, **args)`` of `hexwire.studio.layout` calls its export::

      import hexwire from "/static/live.js";
      export function mount(element, args) {
        hexwire.onFrame((frame) => draw(frame.position[0]), element);  // ends when the element is gone
        hexwire.onFacts((facts) => show(facts.torque), element);
        hexwire.onHello((model) => setUp(model.joints), element);      // at once, and when the arm changes
      }

  A frame has ``time`` (s), ``joints`` (names), the arrays ``position``, ``velocity``, ``load``, ``current``,
  ``voltage``, ``temperature``, ``goal``, ``age``, ``flags``, and ``stopped``, ``connected``, ``held``, ``stops``.
  Values are in SI units, NaN where unknown.
* Motion lasts while somebody holds it. ``hexwire.hold("joint", {directions: {J1: 1}, speed: 0.3})`` begins it at
  pointerdown; ``hexwire.release()`` ends it at pointerup, pointercancel and lostpointercapture;
  ``hexwire.update(args)`` changes it, for a drag. Kinds: ``joint`` (directions: -1..1 by joint), ``space`` (tool:
  six deflections -1..1, base frame), ``drag`` (goals: radians by joint). ``hexwire.holdButton(element, kind,
  args)`` does all of it for a button, for the keyboard too; ``args`` may be a function. `hexwire.hold` returns a
  promise for the reason of its end.
* A page adds its own kind on the server, once, with ``studio.holds.add("goto", begin)`` (see `holds.py`):
  ``begin`` runs in a thread, starts the motion, and calls ``arm.hold_to_run.begun(entry, finish)``; ``finish(why)``
  must end it at once and must not wait. For a motion that needs no pressed button but must end with its page
  (playing a recording): ``hexwire.hold(kind, args, {attended: true})``, which ends when the page is hidden, closed
  or frozen.
* Look: ``static/studio.css`` has the custom properties (``--hw-...``) and the few classes; Tailwind is off. A
  page's own rules go to ``static/NAME.css``, which its module loads.
* Every control has a label, works by keyboard and shows its focus. Every value is checked again on the server.
* Its test is ``tests/studio/pages/test_NAME.py``. ``tests/studio/conftest.py`` has `studio` (in this process, on
  an emulated arm), `page` (a Playwright page that shows it) and `operator` (one that has control).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hexwire.studio.app import Studio

__all__ = ["PAGES", "PageRow", "load"]


@dataclass(frozen=True, slots=True)
class PageRow:
    """A page.

    Attributes:
        path: Its address.
        title: Its name in the navigation.
        module: Its module in this package.
    """

    path: str
    title: str
    module: str


PAGES = (
    PageRow("/", "Connect", "start"),
    PageRow("/arm", "Arm", "arm"),
    PageRow("/servos", "Servos", "servos"),
    PageRow("/plots", "Plots", "plots"),
    PageRow("/wire", "Wire", "wire"),
    PageRow("/recordings", "Recordings", "recordings"),
    PageRow("/fleet", "Fleet", "fleet"),
)


def load(path: str) -> Callable[[Studio], None]:
    """The builder of a page."""
    row = next(row for row in PAGES if row.path == path)
    build: Callable[[Studio], None] = import_module(f"{__name__}.{row.module}").build
    return build
