/* The form Go to of the page Arm: asks for a preview after each change, shows it, and begins the motion. Owns the
fields; the server plans and checks. */

import { capital, degrees, radians, showPlan } from "/static/arm.js";
import { tipValues } from "/static/arm_tip.js";

const PAUSE = 150; // ms after the last change before a preview is asked for
const FOLLOW = 400; // ms between two looks at where the arm is, until somebody has changed a value

export function mountGoto(page) {
  const form = page.find("#arm-goto");
  const told = page.find("#arm-plan");
  const unghost = page.find("#arm-unghost");
  const field = (name) => form.elements[name];
  const value = (name) => (field(name).value.trim() === "" ? NaN : Number(field(name).value));
  const what = () => form.querySelector('input[name="what"]:checked').value;
  let timer = 0;
  let asking = false;
  let again = false;
  let touched = false;
  let changes = 0; // an answer to what was asked before the last one is not shown any more
  let followed = 0;

  /** The motion that the form asks for; throws what is missing, in words. */
  const wanted = () => {
    const need = (name, words) => {
      const number = value(name);
      if (!Number.isFinite(number)) throw new Error(`${words} is not a number`);
      return number;
    };
    if (what() === "joints") {
      const goals = {};
      for (const { name } of page.args.joints) {
        const written = field(`joint:${name}`);
        // Values that were not touched keep all their digits.
        goals[name] = written.dataset.exact && written.value === written.dataset.shown ? Number(written.dataset.exact) : radians(need(`joint:${name}`, name));
      }
      return { what: "joints", goals };
    }
    const aim = field("aim").value;
    const motion = { what: "place", aim, position: ["x", "y", "z"].map((axis) => need(axis, axis) / 1000) };
    motion.relative = field("relative").checked;
    motion.straight = field("straight").checked;
    if (aim === "rpy") motion.rpy = ["roll", "pitch", "yaw"].map((name) => radians(need(name, name)));
    if (aim === "pitch") {
      motion.pitch = radians(need("pitch", "pitch"));
      motion.roll = radians(need("roll", "roll"));
    }
    if (!motion.straight && field("branch").value) motion.branch = field("branch").value;
    return motion;
  };

  const hide = (words) => {
    page.plan = null;
    page.ghost(null);
    unghost.hidden = true;
    if (words !== undefined) {
      told.textContent = words;
      told.dataset.level = "";
    }
  };

  const solutions = (branches) => {
    const select = field("branch");
    if (!select) return;
    const holder = page.find("#arm-branch-field");
    const chosen = select.value;
    holder.hidden = branches.filter((branch) => !branch.why).length < 2 && !chosen;
    const rows = [["", "nearest"], ...branches.map((branch) => [branch.name, branch.why ? `${branch.name} (outside the limits)` : branch.name])];
    if (chosen && !branches.some((branch) => branch.name === chosen)) rows.push([chosen, chosen]);
    select.replaceChildren(...rows.map(([name, words]) => new Option(words, name, false, name === chosen)));
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
      told.textContent = error.message;
      told.dataset.level = "error";
      return;
    }
    asking = true;
    const asked = changes;
    const plan = await page.call("preview", { speed: page.speed, ...motion });
    asking = false;
    if (again) {
      again = false;
      preview();
      return;
    }
    if (asked !== changes) return;
    page.plan = plan;
    showPlan(told, plan);
    if (plan.branches) solutions(plan.branches);
    const show = !plan.error && plan.known;
    page.ghost(show ? plan.goal : null, show ? plan.trace : null);
    unghost.hidden = !show;
  };
  const soon = () => {
    if (page.unready) return;
    clearTimeout(timer);
    timer = setTimeout(preview, PAUSE);
  };

  const arrange = () => {
    for (const part of page.all("#arm-goto [data-for]")) part.hidden = part.dataset.for !== what();
    if (!field("aim")) return;
    for (const part of page.all("#arm-goto [data-aim]")) {
      part.hidden = part.dataset.aim !== field("aim").value;
      for (const input of part.querySelectorAll("input")) input.disabled = part.hidden;
    }
    if (field("straight").checked) page.find("#arm-branch-field").hidden = true;
  };

  const take = () => {
    const positions = page.positions();
    if (!positions || page.unready) return;
    touched = false;
    const put = (name, number, digits = 1) => {
      if (field(name)) field(name).value = Number.isFinite(number) ? String(Number(number.toFixed(digits))) : "";
    };
    page.args.joints.forEach(({ name }, i) => {
      put(`joint:${name}`, degrees(positions[i]));
      const input = field(`joint:${name}`);
      input.dataset.exact = positions[i];
      input.dataset.shown = input.value;
    });
    if (page.args.geometry) {
      const tip = tipValues(page.args, positions);
      const relative = field("relative").checked;
      for (const axis of ["x", "y", "z"]) put(axis, relative ? 0 : 1000 * tip[axis]);
      for (const name of ["roll", "pitch", "yaw"]) {
        if (page.args.turns && name === "yaw") continue;
        put(name, degrees(page.args.turns ? tip[`tool${name}`] : tip[name]));
      }
      field("branch").value = "";
    }
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
    const name = event.target.name;
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
    soon();
  });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    if (!page.mine || page.unready) return;
    let motion;
    try {
      motion = wanted();
    } catch (error) {
      told.textContent = error.message;
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
  page.find("#arm-here").addEventListener("click", restart);
  unghost.addEventListener("click", () => {
    renew();
    hide("The preview is hidden.");
  });
  let unready = "";
  page.on("facts", () => {
    if (page.unready === unready) return;
    unready = page.unready;
    page.find("#arm-here").disabled = unready !== "";
    restart();
  });
  page.on("speed", () => page.plan && soon());
  arrange();
  page.on("draw", () => {
    const now = performance.now();
    if (touched || now - followed < FOLLOW || (followed && form.contains(document.activeElement))) return;
    followed = now;
    take();
  });
}
