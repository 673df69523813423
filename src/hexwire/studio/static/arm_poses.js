/* Poses by name on the page Move: their list, saving the present one, going to one. Owns the list and what is said of it; the
server keeps them, and plans and checks each motion. Loaded when it is about to be seen. */

import { capital, required } from "./live.js";
import { isRefused } from "./arm.js";
import { fill, html, node } from "./widgets.js";

const SURE = 4000; // ms in which a second press confirms
const WHOLE = "arm-need arm-whole"; // needs all joints

/** @param {ArmPage} page */
export function mountPoses(page) {
  fill(page.get(".arm-part[data-part=poses]"), posesMarkup(page.args.jaws));
  const list = page.get("#arm-poses");
  const form = page.get("#arm-pose-form");
  const called = required(form, 'input[name="name"]', HTMLInputElement);
  const grips = form.querySelector('input[name="gripper"]');
  const gripper = () => !(grips instanceof HTMLInputElement) || grips.checked;
  const note = page.get("#arm-pose-note");
  // The next facts do so, too.
  required(form, "[type=submit]").toggleAttribute("disabled", !page.mine || page.unready !== "");
  /** @type {Promise<unknown>} */
  let turn = Promise.resolve(); // one after the other: each answer has the list as it is then
  let looks = 0; // what was to be shown before something else was wanted is not shown any more
  /** @type {<T>(ask: () => Promise<T>) => Promise<T>} */
  const inTurn = (ask) => {
    const answer = turn.then(ask);
    turn = answer;
    return answer;
  };
  const say = (/** @type {string} */ text, level = "") => {
    note.textContent = text;
    note.dataset.level = level;
  };
  /**
   * @template {"arm.save_pose" | "arm.rename_pose" | "arm.remove_pose"} N
   * @param {N} name
   * @param {Calls[N]["args"]} values
   * @param {string} done what is said then
   */
  const change = async (name, values, done) => {
    looks += 1;
    /** @type {Pose[] | Refused} */
    const answer = await inTurn(() => page.call(name, values));
    if (isRefused(answer)) {
      say(capital(answer.error), "error");
      return false;
    }
    show(answer);
    say(done);
    return true;
  };
  const go = (/** @type {string} */ name) => {
    looks += 1;
    page.run({ what: "pose", name }).then((why) => {
      page.ghost(null);
      if (why === "arrived") say(`At ${name}.`);
      else if (why !== "released" && why !== "ended") say(capital(why), "error");
    });
  };
  const preview = async (/** @type {string} */ name) => {
    const mine = (looks += 1);
    const plan = await page.call("arm.preview", { motion: { what: "pose", name, speed: page.speed } });
    if (mine !== looks) return;
    page.get("#arm-unghost").hidden = isRefused(plan);
    if (isRefused(plan)) return say(capital(plan.error), "error");
    if (plan.known) page.ghost(plan.goal, plan.trace);
    const { refusal, unready } = plan;
    say(refusal ? capital(refusal) : `${name}: ${plan.duration.toFixed(1)} s from here${unready ? `; not now: ${unready}` : ""}`, refusal ? "error" : unready ? "warn" : "");
  };
  /** @type {(words: string, label: string, act: (element: HTMLButtonElement) => unknown, need?: string) => HTMLButtonElement} */
  const button = (words, label, act, need = "arm-need") => {
    const disabled = (need !== "" && !page.mine) || (need === WHOLE && page.unready !== "");
    const element = node("button", { type: "button", class: `hw-button arm-small ${need}`, "aria-label": label, disabled }, words);
    element.addEventListener("click", () => act(element));
    return element;
  };
  /** @type {(act: () => unknown, words: string) => (element: HTMLElement) => void} */
  const twice = (act, words) => (element) => {
    if (element.dataset.sure) {
      act();
      return;
    }
    const before = element.textContent;
    element.style.minWidth = `${element.offsetWidth}px`; // its neighbours stay where they are
    element.dataset.sure = "1";
    element.textContent = words;
    setTimeout(() => {
      delete element.dataset.sure;
      element.textContent = before;
    }, SURE);
  };
  /** @type {(row: HTMLElement, name: string) => void} */
  const rename = (row, name) => {
    const input = node("input", { type: "text", value: name, maxlength: 40, "aria-label": `New name of ${name}` });
    /** @type {HTMLFormElement} */
    const entry = node("form", { class: "hw-row" }, input, button("Keep", `Keep the new name of ${name}`, () => entry.requestSubmit()), button("Cancel", `Do not rename ${name}`, () => refresh(), ""));
    entry.addEventListener("submit", (event) => {
      event.preventDefault();
      change("arm.rename_pose", { name, new: input.value }, "Renamed.");
    });
    row.replaceChildren(entry);
    input.focus();
    input.select();
  };
  const show = (/** @type {Pose[]} */ poses) => {
    const rows = poses.map(({ name, saved }) => {
      const row = node("li", {}, node("span", { class: "arm-pose-name", title: name }, name));
      if (!saved) row.append(node("span", { class: "arm-note" }, name === "home" ? "the middle of every joint" : "from the settings"));
      row.append(button("Go", `Go to ${name}`, () => go(name), WHOLE), button("Show", `Preview ${name}`, () => preview(name), ""));
      if (saved) {
        row.append(
          button("Replace", `Replace ${name} by the present pose`, twice(() => change("arm.save_pose", { name, force: true, gripper: gripper() }, `${name} is the present pose now.`), "Sure?")),
          button("Rename", `Rename ${name}`, () => rename(row, name)),
          button("Remove", `Remove ${name}`, twice(() => change("arm.remove_pose", { name }, `${name} is removed.`), "Sure?")),
        );
      }
      return row;
    });
    list.replaceChildren(...rows);
  };
  const refresh = async () => {
    const answer = await inTurn(() => page.call("arm.poses"));
    if (isRefused(answer)) say(capital(answer.error), "error");
    else show(answer);
  };
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const name = called.value;
    if (await change("arm.save_pose", { name, gripper: gripper() }, `Saved ${name.trim()}.`)) called.value = "";
  });
  refresh();
}

/**
 * The list of poses, and saving a new one; with the gripper where there is one.
 * @param {unknown} gripper
 */
export function posesMarkup(gripper) {
  return html`<h2>Poses</h2>
  <ul class="arm-poses" id="arm-poses" aria-label="Saved poses"></ul>
  <form id="arm-pose-form" class="hw-row" autocomplete="off">
    <label class="arm-field arm-long"><span>Name</span> <input type="text" name="name" maxlength="40" required></label>
    ${gripper && html`<label><input type="checkbox" name="gripper" checked> with the gripper</label>`}
    <button class="hw-button arm-need arm-whole" type="submit">Save present pose</button>
  </form>
  <p class="arm-note" id="arm-pose-note" role="status"></p>`;
}
