/* Motions to a goal of the page Move: the form Go to, the gripper, and poses by name. Asks for a preview after each change,
shows it, and begins the motion. Owns the fields and the list of poses; the server keeps these, plans and checks. */

import { branchWords, degrees, fixed, isRefused, radians, showPlan, tipValues } from "./arm.js";
import hexwire, { all, capital, required } from "./live.js";
import { html, node, whyOf } from "./widgets.js";

/**
 * @typedef {ReturnType<ArmPage["positions"]>} Positions
 */

const PAUSE = 150; // ms after the last change before a preview is asked for
const FOLLOW = 400; // ms between two looks at where the arm is, until somebody has changed a value
const STILL = 0.002; // radians, more than one step of a servo: an arm that moves less has not moved
const SURE = 4000; // ms in which a second press confirms
const WHOLE = "arm-need arm-whole"; // needs all joints

/** @param {ArmPage} page */
export function mountGoto(page) {
  const form = page.get("#arm-goto", HTMLFormElement);
  const told = page.get("#arm-plan");
  const unghost = page.get("#arm-unghost"), here = page.get("#arm-here", HTMLButtonElement);
  const go = page.get("#arm-go", HTMLButtonElement);
  const find = (/** @type {string} */ name) => form.elements.namedItem(name);
  const input = (/** @type {string} */ name) => required(form, `input[name="${CSS.escape(name)}"]`, HTMLInputElement);
  const flag = (/** @type {string} */ name) => input(name).checked;
  const select = (/** @type {string} */ name) => required(form, `select[name="${name}"]`, HTMLSelectElement);
  const value = (/** @type {string} */ name) => (input(name).value.trim() === "" ? NaN : Number(input(name).value));
  const what = () => required(form, 'input[name="what"]:checked', HTMLInputElement).value;
  let timer = 0;
  let asking = false;
  let again = false;
  let touched = false;
  let changes = 0; // an answer to what was asked before the last one is not shown any more
  let followed = 0;
  let refused = false;
  /** @type {Positions} */
  let where = null; // the arm when a preview was asked for, or when it last moved

  /** The motion that the form asks for; throws what is missing, in words. */
  const wanted = () => {
    /** @type {(name: string, words: string) => number} */
    const need = (name, words) => {
      const number = value(name);
      if (!Number.isFinite(number)) throw new Error(`${words} is not a number`);
      return number;
    };
    if (what() === "joints") {
      /** @type {Record<string, number>} */
      const goals = {};
      for (const { name } of page.args.joints) {
        const written = input(`joint:${name}`);
        // Values that were not touched keep all their digits.
        goals[name] = written.dataset.exact && written.value === written.dataset.shown ? Number(written.dataset.exact) : radians(need(`joint:${name}`, name));
      }
      return { what: "joints", goals };
    }
    const aim = select("aim").value;
    /** @type {Record<string, unknown>} */
    const motion = { what: "place", aim, position: ["x", "y", "z"].map((axis) => need(axis, axis) / 1000) };
    motion.relative = flag("relative");
    motion.straight = flag("straight");
    if (aim === "rpy") motion.rpy = ["roll", "pitch", "yaw"].map((name) => radians(need(name, name)));
    if (aim === "pitch") {
      motion.pitch = radians(need("pitch", "pitch"));
      motion.roll = radians(need("roll", "roll"));
    }
    if (!motion.straight && select("branch").value) motion.branch = select("branch").value;
    return motion;
  };

  /**
   * What is refused cannot be begun, until something else is entered or the arm is where it is allowed.
   * @param {boolean} so
   */
  const refuse = (so) => {
    refused = so;
    go.disabled = so || !page.mine || page.unready !== "";
  };
  page.on("need", () => refuse(refused));

  /** @param {string} [words] */
  const hide = (words) => {
    page.plan = null;
    refuse(false);
    page.ghost(null);
    unghost.hidden = true;
    if (words !== undefined) {
      told.textContent = words;
      told.dataset.level = "";
    }
  };

  const solutions = (/** @type {Branch[]} */ branches) => {
    const choice = find("branch");
    if (!(choice instanceof HTMLSelectElement)) return;
    const holder = page.get("#arm-branch-field");
    const chosen = choice.value;
    holder.hidden = branches.filter((branch) => !branch.why).length < 2 && !chosen;
    const rows = [["", "nearest"], ...branches.map((branch) => [branch.name, branch.why ? `${branchWords(branch.name)} (outside the limits)` : branchWords(branch.name)])];
    if (chosen && !branches.some((branch) => branch.name === chosen)) rows.push([chosen, branchWords(chosen)]);
    choice.replaceChildren(...rows.map(([name, words]) => new Option(words, name, false, name === chosen)));
  };

  const preview = async () => {
    timer = 0;
    if (asking) {
      again = true;
      return;
    }
    let motion;
    try {
      motion = wanted();
    } catch (error) {
      hide();
      told.textContent = whyOf(error);
      told.dataset.level = "error";
      refuse(true);
      return;
    }
    asking = true;
    where = page.positions();
    const asked = changes;
    const plan = await page.call("arm.preview", { motion: { speed: page.speed, ...motion } });
    asking = false;
    if (again) {
      again = false;
      preview();
      return;
    }
    if (asked !== changes) return;
    page.plan = plan;
    // An error is no refusal: the studio may have been busy.
    refuse(!isRefused(plan) && plan.refusal !== "");
    showPlan(told, plan);
    if (!isRefused(plan)) solutions(plan.branches);
    const shown = isRefused(plan) || !plan.known ? null : plan;
    page.ghost(shown && shown.goal, shown && shown.trace);
    unghost.hidden = !shown;
  };
  const soon = () => {
    if (page.unready) return;
    clearTimeout(timer);
    timer = setTimeout(preview, PAUSE);
  };

  const arrange = () => {
    for (const part of page.all("#arm-goto [data-for]")) part.hidden = part.dataset.for !== what();
    if (!find("aim")) return;
    for (const part of page.all("#arm-goto [data-aim]")) {
      part.hidden = part.dataset.aim !== select("aim").value;
      for (const input of part.querySelectorAll("input")) input.disabled = part.hidden;
    }
    if (flag("straight")) page.get("#arm-branch-field").hidden = true;
  };

  const take = () => {
    const positions = page.positions();
    if (!positions || page.unready) return;
    touched = false;
    /** @type {(name: string, number: number) => void} */
    const put = (name, number) => {
      if (find(name)) input(name).value = Number.isFinite(number) ? String(Number(number.toFixed(1))) : "";
    };
    page.args.joints.forEach(({ name }, i) => {
      put(`joint:${name}`, degrees(positions[i]));
      const written = input(`joint:${name}`);
      written.dataset.exact = String(positions[i]);
      written.dataset.shown = written.value;
    });
    const { geometry, turns } = page.args;
    if (geometry) {
      const tip = tipValues({ geometry, turns }, positions);
      const relative = flag("relative");
      for (const axis of ["x", "y", "z"]) put(axis, relative ? 0 : 1000 * tip[axis]);
      for (const name of ["roll", "pitch", "yaw"]) {
        if (turns && name === "yaw") continue;
        put(name, degrees(turns ? tip[`tool${name}`] : tip[name]));
      }
      select("branch").value = "";
    }
  };
  const moved = () => {
    const before = where;
    const now = page.positions();
    if (!now) return false;
    const same = now.every((angle, i) => Object.is(angle, before?.[i]) || Math.abs(angle - (before?.[i] ?? NaN)) <= STILL);
    if (!same) where = now;
    return !same;
  };
  /** Something else is shown from now on: previews of before do not come any more. */
  const renew = () => {
    clearTimeout(timer);
    timer = 0;
    again = false;
    changes += 1;
    return changes;
  };
  const restart = () => {
    renew();
    take();
    const why = page.unready;
    hide(why ? `${capital(why)}.` : "These are the present values. Change one to see a preview.");
    if (why) told.dataset.level = "error";
  };

  form.addEventListener("input", (event) => {
    const name = event.target instanceof HTMLElement ? event.target.getAttribute("name") : null;
    if (name === "relative") {
      restart();
      return;
    }
    arrange();
    if (name === "what") {
      // What was not touched must not be where the arm was some time ago.
      restart();
      return;
    }
    touched = true;
    changes += 1;
    refuse(false);
    soon();
  });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    if (!page.mine || page.unready || refused) return;
    let motion;
    try {
      motion = wanted();
    } catch (error) {
      told.textContent = whyOf(error);
      told.dataset.level = "error";
      return;
    }
    const begun = renew();
    page.run(motion).then((why) => {
      // Somebody has entered the next goal meanwhile: its values and its preview stay.
      if (begun !== changes) return;
      if (why === "arrived") {
        hide("Arrived.");
        touched = false;
      } else if (why !== "released" && why !== "ended") {
        told.textContent = why;
        told.dataset.level = "error";
      }
    });
  });
  here.addEventListener("click", restart);
  unghost.addEventListener("click", () => {
    renew();
    hide("The preview is hidden.");
  });
  let unready = "", stopped = "";
  page.on("facts", (facts) => {
    // What a stop had refused is looked at again when it has ended.
    if (stopped && !facts.stopped && touched) soon();
    stopped = facts.stopped ?? "";
    if (page.unready === unready) return;
    unready = page.unready;
    here.disabled = unready !== "";
    restart();
  });
  page.on("speed", () => page.plan && soon());
  arrange();
  page.on("draw", () => {
    if (refused && page.plan && moved()) soon();
    const now = performance.now();
    if (touched || now - followed < FOLLOW || (followed && form.contains(document.activeElement))) return;
    followed = now;
    take();
  });
}

// -- the gripper -----------------------------------------------------------------------------------------------------

/** @param {ArmPage} page */
export function mountGripper(page) {
  const form = page.find("#arm-grip");
  const jaws = page.args.jaws;
  if (!form || !jaws) return;
  const bar = page.get("#arm-grip-bar", HTMLMeterElement);
  const value = page.get("#arm-grip-value"), wanted = required(form, 'input[name="share"]', HTMLInputElement);
  const place = page.args.joints.findIndex((joint) => joint.name === jaws.joint);
  const set = (/** @type {number} */ share) => page.run({ what: "grip", share }).then((why) => {
    if (!["arrived", "released", "ended"].includes(why)) hexwire.say(why);
  });
  for (const button of all(form, "[data-share]")) {
    button.addEventListener("click", () => set(Number(button.dataset.share)));
  }
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    if (page.mine) set(Number(wanted.value) / 100);
  });
  let shown = "";
  page.on("draw", () => {
    const share = ((page.positions()?.[place] ?? NaN) - jaws.closed) / (jaws.opened - jaws.closed);
    const text = `${fixed(100 * share, 0)} % open`;
    if (text === shown) return;
    shown = text;
    value.textContent = text;
    bar.value = Number.isFinite(share) ? Math.min(1, Math.max(0, share)) : 0;
  });
}

// -- poses by name ------------------------------------------------------------------------------------------------

/** @param {ArmPage} page */
export function mountPoses(page) {
  const list = page.get("#arm-poses");
  const form = page.get("#arm-pose-form");
  const called = required(form, 'input[name="name"]', HTMLInputElement);
  const grips = form.querySelector('input[name="gripper"]');
  const gripper = () => !(grips instanceof HTMLInputElement) || grips.checked;
  const note = page.get("#arm-pose-note");
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

// -- what is drawn -----------------------------------------------------------------------------------------------

/** @type {(name: string, words: string, unit: string) => object} */
const numberField = (name, words, unit) => html`<label class="arm-field"><span>${words} <span class="arm-unit">${unit}</span></span>
  <input type="number" inputmode="decimal" step="any" name="${name}"></label>`;

/**
 * The form: to a place if the arm's geometry is known (`space`, its joints without a gripper), to joint angles always.
 * @param {JointRange[]} joints
 * @param {number | null} space
 */
export function gotoMarkup(joints, space) {
  /** @type {(value: string, words: string, checked: boolean) => object} */
  const kind = (value, words, checked) => html`<label><input type="radio" name="what" value="${value}" ${checked && "checked"}> ${words}</label>`;
  return html`<section class="arm-part" data-part="goto" aria-labelledby="arm-goto-title">
  <form id="arm-goto" class="arm-form" autocomplete="off">
    <div class="arm-head"><h2 id="arm-goto-title">Go to</h2><div class="arm-choices" role="radiogroup" aria-label="Kind of goal">
      ${space && kind("place", "Place of the tip", true)}${kind("joints", "Joint angles", !space)}</div></div>
    ${space && placeMarkup(space === 5)}
    <div class="arm-fields" data-for="joints" ${space && "hidden"}>${joints.map(({ name }) => numberField(`joint:${name}`, name, "°"))}</div>
    <div class="arm-going">
      <p class="arm-plan" id="arm-plan" role="status">These are the present values. Change one to see a preview.</p>
      <div class="hw-row">
        <button class="hw-button arm-primary arm-need arm-whole" type="submit" id="arm-go">Go</button>
        <button class="hw-button" type="button" id="arm-here">Take present values</button>
        <button class="hw-button" type="button" id="arm-unghost" hidden>Hide preview</button>
      </div>
    </div>
  </form>
  <p class="arm-note">A motion runs while this page is in sight. It ends with STOP, Escape or End motion, and when
  the page is hidden, closed, or loses its connection.</p>
</section>`;
}

/** @param {boolean} five whether the tool has a pitch and a roll only */
function placeMarkup(five) {
  const turns = five ? ["Pitch", "Roll"] : ["Roll", "Pitch", "Yaw"];
  return html`<div data-for="place" class="arm-form">
    <div class="hw-row">
      <div class="arm-fields arm-three">${["x", "y", "z"].map((axis) => numberField(axis, axis, "mm"))}</div>
      <div class="arm-choices">
        <label><input type="checkbox" name="relative"> from the present tip</label>
        <label><input type="checkbox" name="straight"> on a straight line</label>
      </div>
    </div>
    <div class="hw-row">
      <label class="arm-field arm-long"><span>The tool</span><select name="aim">
        <option value="arm">keeps its angle to the arm</option><option value="space">keeps its direction</option>
        <option value="down">points straight down</option>
        ${five ? html`<option value="pitch">has a pitch and a roll</option>` : html`<option value="rpy">has roll, pitch and yaw</option>`}
      </select></label>
      <div class="arm-fields arm-three" data-aim="${five ? "pitch" : "rpy"}" hidden>${turns.map((words) => numberField(words.toLowerCase(), words, "°"))}</div>
      <label class="arm-field arm-long" id="arm-branch-field" hidden><span>Solution</span>
        <select name="branch"><option value="">nearest</option></select></label>
    </div>
  </div>`;
}

export function gripperMarkup() {
  return html`<section class="arm-part" data-part="grip" aria-labelledby="arm-grip-title">
  <div class="arm-head"><h2 id="arm-grip-title">Gripper</h2>
    <meter id="arm-grip-bar" min="0" max="1" value="0" aria-label="Opening"></meter><output id="arm-grip-value">–</output></div>
  <form id="arm-grip" class="hw-row" autocomplete="off">
    <button class="hw-button arm-need" type="button" data-share="0">Close</button>
    <button class="hw-button arm-need" type="button" data-share="1">Open</button>
    <label class="arm-inline"><input type="number" inputmode="decimal" name="share" min="0" max="100" step="any" value="50" aria-label="Opening, percent"> %</label>
    <button class="hw-button arm-need" type="submit">Set</button>
  </form>
  <p class="arm-note">Closing stops at an object and holds it.</p>
</section>`;
}

/**
 * The list of poses, and saving a new one; with the gripper where there is one.
 * @param {unknown} gripper
 */
export function posesMarkup(gripper) {
  return html`<section class="arm-part" data-part="poses" aria-labelledby="arm-poses-title">
  <h2 id="arm-poses-title">Poses</h2>
  <ul class="arm-poses" id="arm-poses" aria-label="Saved poses"></ul>
  <form id="arm-pose-form" class="hw-row" autocomplete="off">
    <label class="arm-field arm-long"><span>Name</span> <input type="text" name="name" maxlength="40" required></label>
    ${gripper && html`<label><input type="checkbox" name="gripper" checked> with the gripper</label>`}
    <button class="hw-button arm-need arm-whole" type="submit">Save present pose</button>
  </form>
  <p class="arm-note" id="arm-pose-note" role="status"></p>
</section>`;
}
