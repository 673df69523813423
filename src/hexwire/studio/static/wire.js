// The page Wire: asks the studio for rows as fast as the browser can draw them, and for one frame when it is selected.
// Owns filter, source and pause; wire_list.js draws the rows, wire_detail.js one frame.

import { chips } from "./forms.js";
import hexwire, { required } from "./live.js";
import { ask, save, withQuery } from "./columns.js";
import { loadSheet, node, put, whyOf } from "./widgets.js";
import { Detail } from "./wire_detail.js";
import { FrameList, NUMBER, asText } from "./wire_list.js";

const PERIOD = 100; // ms between two questions for rows
const FOLLOW = "hexwire-wire-follow";
const HIDDEN = "hexwire-wire-hidden";
const PROBLEMS = "hexwire-wire-problems";
const FILTER = "hexwire-wire-filter";
// Each frame is of one kind.
const KINDS = [
  { key: "request", text: "requests" },
  { key: "answer", text: "answers" },
  { key: "report", text: "reports" },
  { key: "bad", text: "damaged" },
];
const LATE = 2000; // ms
const SLOW = 1000; // ms after an error
const SERIES = [
  ["board", "Hex7Bot, by id"],
  ["seven_bot", "7Bot"],
  ["scs", "SCS"],
  ["sts_sms", "STS, SMS"],
  ["hls", "HLS"],
];
const HELP = [
  ["servo 3", "names servo 3, also in a mask of joints; servo 3,4 one of both"],
  ["joint_move", "that command or instruction; another word, such as error, is searched for in the text"],
  ['"two words"', "searched for in the text"],
  ["bad", "no valid frame or packet; doubt also what has a remark or reports an error; problem also what was not answered"],
  ["sent, received, unanswered, frame, packet", "what they say; so do request, answer and report"],
  ["dialect 2", "frames of that dialect"],
  ["slow 20", "answers after more than 20 ms, and their requests"],
  ["bytes 0D0A", "has these bytes"],
  ["not ...", "the next condition must not hold; all others must"],
];

/**
 * @param {HTMLElement} root
 * @param {Visitor} args
 */
export async function mount(root, args) {
  root.classList.add("hw-wire");
  await Promise.all(["wire", "plots"].map((name) => loadSheet(`/static/${name}.css`)));
  new WirePage(root, args.tab);
}

/** @type {(text: string, on: () => unknown, more?: Record<string, string | boolean>) => HTMLButtonElement} */
const button = (text, on, more = {}) => node("button", { type: "button", class: "hw-button", onclick: on, ...more }, text);

class WirePage {
  source = "";
  since = 0;
  offset = 0;
  // At first without what a board sends by itself, many times a second: nothing else could be seen among it.
  hidden = (sessionStorage.getItem(HIDDEN) ?? "report").split(" ").filter(Boolean);
  paused = false;
  pause = ""; // what is said in one
  until = Infinity; // number of the newest frame that is shown in a pause
  settled = true; // all that passes the filter has been asked for
  /** @type {object | null} */
  asking = null;
  /** @type {object | null} */
  selecting = null;
  rate = { number: 0, time: 0, value: NaN };
  timer = 0;
  typing = 0;

  filterBox = node("input", {
    id: "hw-wire-filter", class: "hw-wire-input", type: "text", spellcheck: "false", autocomplete: "off", autocapitalize: "none",
    maxlength: "150", placeholder: "servo 3 joint_move", oninput: () => this.setFilter(), "aria-describedby": "hw-wire-problem",
  });
  pauseButton = button("Pause", () => this.setPaused(!this.paused), { "aria-pressed": "false" });
  followBox = node("input", { type: "checkbox", checked: true });
  followLabel = node("label", { class: "hw-wire-label" }, this.followBox, " Follow");
  problemsBox = node("input", { type: "checkbox", checked: sessionStorage.getItem(PROBLEMS) === "1", onchange: () => this.setFilter(0) });
  seriesBox = node("select");
  fileBox = node("input", { type: "file", class: "hw-wire-file", "aria-label": "Open a recording, capture or log" });
  liveButton = button("Back to the line", () => this.backToLine(), { hidden: true });
  problem = node("span", { id: "hw-wire-problem", class: "hw-wire-error", role: "alert" });
  refusal = node("span", { class: "hw-wire-error", role: "alert" });
  status = node("span", { class: "hw-wire-status" });
  note = node("p", { class: "hw-wire-note", hidden: true });
  nothingText = node("p", { role: "status" });
  allButton = button("Show all", () => this.removeFilter());
  nothing = node("div", { class: "hw-wire-nothing", hidden: true }, this.nothingText, this.allButton);
  listBox = node("div", { class: "hw-wire-list", role: "listbox", tabindex: "0", "aria-label": "Frames" });
  // On a phone a sheet, which each of its buttons closes; elsewhere its parts stand in the bar.
  sheet = node("div", { id: "hw-wire-more", popover: "auto" });
  detailBox = node("section", { class: "hw-wire-detail", "aria-label": "The selected frame" });

  /**
   * @param {HTMLElement} root
   * @param {string} tab
   */
  constructor(root, tab) {
    this.root = root;
    this.tab = tab;
    // As they were left: the page is made anew each time that somebody comes to it.
    this.filterBox.value = sessionStorage.getItem(FILTER) ?? "";
    this.build();
    this.filter = this.wanted();
    this.list = new FrameList(this.listBox, {
      onSelect: (number) => this.select(number),
      onFollow: (follow) => {
        this.followBox.checked = follow;
        sessionStorage.setItem(FOLLOW, follow ? "1" : "0");
      },
    });
    this.list.setFollow(sessionStorage.getItem(FOLLOW) !== "0");
    this.followBox.addEventListener("change", () => {
      this.list.setFollow(this.followBox.checked);
      if (this.followBox.checked && this.list.selected) this.close();
    });
    this.detail = new Detail(this.detailBox, { onSelect: (number) => this.list.select(number), onClose: () => this.close() });
    this.poll();
  }

  // -- elements ------------------------------------------------------------------------------------------

  build() {
    for (const [value, text] of SERIES) this.seriesBox.append(node("option", { value }, text));
    this.seriesBox.addEventListener("change", () => this.setSeries());
    this.fileBox.addEventListener("change", () => this.openFile(this.fileBox.files?.[0]));
    const help = node("dl", { class: "hw-wire-help" });
    for (const [word, text] of HELP) help.append(node("dt", {}, word), node("dd", {}, text));
    const shut = { popovertarget: this.sheet.id, popovertargetaction: "hide" };
    const guide = node("details", { class: "hw-wire-guide" }, node("summary", {}, "Words"), help);
    const away = (/** @type {Event} */ event) => {
      if (!this.root.isConnected) document.removeEventListener("click", away);
      else if (!(event.target instanceof Node && guide.contains(event.target))) guide.open = false;
    };
    document.addEventListener("click", away); // not when pressed: what is clicked must not move before
    guide.addEventListener("keydown", (event) => {
      if (event.key === "Escape") guide.open = false; // it stops the arm, too
    });
    const kept = { title: "All that the studio has kept of the line, at most two minutes; of a file, all of it" };
    this.sheet.append(
      guide,
      button("Clear", () => this.clear(), shut),
      node("label", { class: "hw-wire-label" }, "Register names ", this.seriesBox),
      node("label", { class: "hw-button hw-wire-open" }, "Open file", this.fileBox),
      button("Save MCAP", () => this.save("mcap"), { ...shut, ...kept }),
      button("Save pcapng", () => this.save("pcapng"), { ...shut, ...kept }),
    );
    this.root.replaceChildren(
      node("div", { class: "hw-wire-bar" },
        node("label", { class: "hw-wire-label hw-wire-grow" }, "Filter ", this.filterBox),
        node("button", { type: "button", class: "hw-button hw-wire-phone", popovertarget: this.sheet.id }, "More"),
        this.sheet),
      node("div", { class: "hw-wire-line" },
        this.liveButton, this.pauseButton, this.followLabel, this.kinds(),
        node("label", { class: "hw-wire-label" }, this.problemsBox, " Problems"), this.status, this.problem, this.refusal),
      this.note,
      node("div", { class: "hw-wire-panes" },
        node("div", { class: "hw-wire-left" },
          node("div", { class: "hw-wire-columns", "aria-hidden": "true" },
            ...["No.", "Time", "", "Frame", "Answer"].map((text) => node("span", {}, text))),
          this.nothing, this.listBox),
        this.detailBox),
    );
    this.root.addEventListener("dragover", (event) => event.preventDefault());
    this.root.addEventListener("drop", (event) => {
      event.preventDefault();
      this.openFile(event.dataTransfer?.files[0]);
    });
    hexwire.onLink((linked) => linked || this.tell("no connection to the studio"), this.root);
    this.root.addEventListener("copy", (event) => this.copied(event));
    const seen = () => (this.root.isConnected ? this.poll() : document.removeEventListener("visibilitychange", seen));
    document.addEventListener("visibilitychange", seen);
    // The panes end at the bottom of the window, whatever the header needs.
    const panes = required(this.root, ".hw-wire-panes");
    const fit = () => {
      const top = panes.getBoundingClientRect().top + window.scrollY;
      panes.style.setProperty("--height", `${Math.max(360, window.innerHeight - top - 14)}px`);
    };
    const watched = new ResizeObserver(() => (this.root.isConnected ? fit() : watched.disconnect()));
    watched.observe(document.body);
    watched.observe(this.root);
  }

  /** One click hides or shows a kind. */
  kinds() {
    const on = KINDS.map(({ key }) => key).filter((key) => !this.hidden.includes(key));
    return chips("Show", KINDS, on, (shown) => {
      this.hidden = KINDS.map(({ key }) => key).filter((key) => !shown.includes(key));
      sessionStorage.setItem(HIDDEN, this.hidden.join(" "));
      this.setFilter(0);
    });
  }

  /** What a frame must be: of a kind that is shown, and what was typed. */
  wanted() {
    return [...this.hidden.map((kind) => `not ${kind}`), ...(this.problemsBox.checked ? ["problem"] : []), this.filterBox.value].join(" ");
  }

  // -- asking the studio -----------------------------------------------------------------------------------

  // One question at a time, so that a slow browser asks less often, and nothing piles up.
  async poll() {
    clearTimeout(this.timer);
    const rests = this.paused && (this.settled || this.since >= this.until);
    if (!this.root.isConnected || rests || document.hidden || this.asking) return;
    if (!hexwire.connected) {
      this.timer = setTimeout(() => this.poll(), PERIOD);
      return;
    }
    const turn = (this.asking = {});
    let wait = PERIOD;
    const late = setTimeout(() => this.tell("the studio does not answer"), LATE);
    try {
      const page = await hexwire.call("wire.rows", { since: this.since, filter: this.filter });
      if (this.asking !== turn) return; // the answer to a question that was asked anew meanwhile
      this.take(page);
      this.fail("");
      if (page.more) wait = 0;
    } catch (error) {
      if (this.asking !== turn) return;
      if (hexwire.connected) this.fail(whyOf(error));
      wait = SLOW;
    } finally {
      clearTimeout(late);
    }
    this.asking = null;
    if (wait) this.timer = setTimeout(() => this.poll(), wait);
    else requestAnimationFrame(() => this.poll());
  }

  /** @param {WireRows} page */
  take(page) {
    if (page.id !== this.source || page.next < this.since) {
      const first = this.source === "";
      this.source = page.id;
      this.since = 0;
      if (this.paused) this.setPaused(false); // what was shown is of something else
      // What was kept before somebody looked comes in the first second, and is no rate.
      this.rate = { number: NaN, time: performance.now(), value: NaN };
      this.clear();
      if (!first) return;
    }
    this.since = Math.min(page.next, this.until);
    this.list.live = page.view === "live";
    this.offset = this.list.offset = page.offset;
    const rows = page.rows.filter((row) => row[NUMBER] <= this.until);
    this.list.push(rows, page.answers.filter(([, answer]) => answer <= this.until), page.first);
    if (!this.settled && (!page.more || this.since >= this.until)) {
      this.settled = true;
      this.list.revealSelected();
    }
    // Unless a frame would take the room of the list.
    if (page.view === "file" && !this.list.selected && this.list.rows.length && this.detailBox.clientWidth) {
      this.list.select(this.list.rows[0][NUMBER]);
    }
    this.show(page);
  }

  /** @param {WireRows} page */
  show(page) {
    const now = performance.now();
    if (now - this.rate.time > 1000) {
      this.rate.value = ((page.newest - this.rate.number) * 1000) / (now - this.rate.time);
      this.rate.number = page.newest;
      this.rate.time = now;
    }
    const kept = page.newest - page.first + 1, live = page.view === "live";
    const span = page.span >= 1 ? `${live ? "the last " : ""}${page.span.toFixed(0)} s` : "";
    const where = live ? page.name && `live: ${page.name}` : page.name;
    const rate = live && page.name && this.rate.value >= 0 ? `${this.rate.value.toFixed(0)} frames/s` : "";
    const left = page.skipped ? `${page.skipped} transfers before were not read` : "";
    const stays = live && this.list.selected && this.list.follow ? `stays at frame ${this.list.selected} until Close` : "";
    if (this.paused) this.tell(`${this.list.rows.length} frames`, this.pause);
    else this.tell(where, `${this.list.kept} of ${kept} frames`, span, rate, left, stays);
    this.nothing.hidden = this.list.rows.length > 0 || !kept || page.more;
    if (!this.nothing.hidden) {
      const asked = [this.filterBox.value && `"${this.filterBox.value}"`, this.problemsBox.checked && "a problem"].filter(Boolean).join(" and ");
      put(this.nothingText, `No frame of ${this.hidden.length ? "the kinds that are shown" : live ? "these" : "the file"}${asked && ` is ${asked}`}`);
      this.allButton.hidden = !asked;
    }
    this.note.textContent = page.note;
    this.note.hidden = !page.note;
    this.liveButton.hidden = page.view !== "file";
    // A file does not go on.
    this.pauseButton.hidden = this.followLabel.hidden = page.view === "file";
    if (document.activeElement !== this.seriesBox) this.seriesBox.value = page.series;
  }

  /** @param {string[]} words */
  tell(...words) {
    put(this.status, words.filter(Boolean).join(", "));
  }

  /** @param {string} text */
  fail(text) {
    if (this.problem.textContent !== text) this.problem.textContent = text;
    if (text) {
      this.nothing.hidden = true;
      this.tell();
    }
    this.filterBox.setAttribute("aria-invalid", text ? "true" : "false");
  }

  /** @param {number} number */
  async select(number) {
    const turn = (this.selecting = {});
    try {
      const data = await hexwire.call("wire.frame", { number });
      if (this.selecting !== turn) return;
      this.detail.show(data, this.offset);
      if (this.list.selected !== number) this.list.select(number, { quiet: true });
    } catch (error) {
      if (this.selecting === turn) this.detail.clear(whyOf(error));
    }
  }

  /**
   * What is copied while nothing is marked: the row, the bytes or the field that has the focus.
   * @param {ClipboardEvent} event
   */
  copied(event) {
    const row = this.list.find(this.list.selected);
    const text = event.target === this.listBox ? row && asText(row, this.offset) : this.detail.copied(event.target);
    if (!text || document.getSelection()?.type === "Range") return;
    event.clipboardData?.setData("text/plain", text);
    event.preventDefault();
  }

  // -- what one does ---------------------------------------------------------------------------------------

  setFilter(wait = 150) {
    clearTimeout(this.typing);
    sessionStorage.setItem(FILTER, this.filterBox.value);
    sessionStorage.setItem(PROBLEMS, this.problemsBox.checked ? "1" : "0");
    this.typing = setTimeout(() => {
      this.filter = this.wanted();
      this.again();
    }, wait);
  }

  removeFilter() {
    this.filterBox.value = "";
    this.problemsBox.checked = false;
    this.setFilter(0);
    this.filterBox.focus();
  }

  /** What is shown passes another filter, so it is asked for anew; in a pause, up to where it began. */
  again() {
    this.since = 0;
    this.settled = false;
    this.asking = null;
    const selected = this.list.selected;
    this.list.clear();
    this.list.selected = selected;
    this.poll();
  }

  clear() {
    this.selecting = null;
    this.list.clear();
    this.detail.clear();
  }

  /** Show no frame: the list has all the room. */
  close() {
    this.selecting = null;
    this.detail.clear();
    this.list.select(0, { quiet: true });
    this.listBox.focus();
  }

  /** @param {boolean} paused */
  setPaused(paused) {
    this.paused = paused;
    this.until = paused ? this.since : Infinity;
    this.pause = `paused at ${new Date().toLocaleTimeString()}: the traffic goes on, and Save takes what the studio has by then`;
    if (paused) this.tell(this.pause);
    this.pauseButton.textContent = paused ? "Go on" : "Pause";
    this.pauseButton.setAttribute("aria-pressed", paused ? "true" : "false");
    this.poll();
  }

  /** @param {() => Promise<unknown>} call */
  async act(call) {
    this.refusal.textContent = "";
    try {
      await call();
    } catch (error) {
      this.refusal.textContent = whyOf(error);
      return;
    }
    this.asking = null;
    this.poll();
  }

  /** @param {File} [file] */
  async openFile(file) {
    if (!file) return;
    this.sheet.hidePopover();
    const address = withQuery("/wire/open", { tab: this.tab, name: file.name, series: this.seriesBox.value });
    this.setPaused(false);
    await this.act(() => ask(address, { method: "POST", body: file }));
    this.fileBox.value = "";
  }

  backToLine() {
    this.setPaused(false);
    return this.act(() => hexwire.call("wire.line"));
  }

  setSeries() {
    return this.act(() => hexwire.call("wire.series", { series: this.seriesBox.value }));
  }

  /** @param {string} form */
  save(form) {
    return this.act(() => save("/wire/save", { tab: this.tab, form }));
  }
}
