// Puts the page together: news of the server in, wishes of the person out.

import { by, el, say } from "./dom.js";
import { FocusCard } from "./focus.js";
import { RequestForm } from "./form.js";
import { JobCard } from "./jobs.js";
import { LiveCard } from "./live.js";
import { begin, get, news, post } from "./server.js";
import { PictureCard, listRuns } from "./shelf.js";
import { StreamCard } from "./stream.js";

const AGAIN_MS = 2000;

const form = new RequestForm(by("fields"));
const jobs = new JobCard();
const pictures = new PictureCard();
const focus = new FocusCard();
const live = new LiveCard();
const stream = new StreamCard();
let state = { here: false, visit: 0, status: null };
let begun = false; // with what the address asked for
let described = 0; // the visit of the daemon that the form was made from

/** Do something that may go wrong, and say what did. */
async function trying(action, where = by("failure")) {
  try {
    say(where, "");
    return await action();
  } catch (trouble) {
    say(where, trouble.message);
    return null;
  }
}

function buttons() {
  const ready = state.here && described === state.visit;
  // A live view gives way to whatever else its owner asks for.
  const free = state.status?.state === "idle" || state.status?.running?.kind === "live";
  for (const id of ["start", "plan", "look", "focus"]) by(id).disabled = !ready || !free;
  by("live").disabled = !live.on && (!ready || !free);
  by("stream").disabled = !stream.on && (!ready || !free);
  if (begin === "live" && !begun && !by("live").disabled) {
    begun = true;
    live.toggle();
  }
}

function showState() {
  const now = state.here ? (state.status?.state ?? "reached") : "away";
  const waiting = state.status?.queued.length ?? 0;
  by("state").textContent = state.here ? now + (waiting ? `, ${waiting} waiting` : "") : "daemon away";
  by("state").className = now;
  say(by("trouble"), state.here ? "" : `The daemon does not answer: ${state.why}`);
  jobs.state(state.status);
  buttons();
}

async function describe() {
  const visit = state.visit;
  const told = await trying(() => get("describe"));
  if (told === null || visit !== state.visit) return;
  const { rig } = told;
  by("rig").textContent = `${rig.name}${rig.mock ? " (virtual scene)" : ""}, ${rig.grid[0]} x ${rig.grid[1]} cells${rig.camera ? `, ${rig.camera.model}` : ""}`;
  form.describe(told);
  by("live-pattern").replaceChildren(...told.patterns.map((name) => el("option", { value: name, selected: name === "white" }, name)));
  described = visit;
  buttons();
}

async function runs() {
  const found = await trying(() => listRuns((job) => trying(() => pictures.show(job)), trying));
  if (found && pictures.empty) {
    const last = found.find((run) => run.entry.state === "done");
    if (last) await trying(() => pictures.show(last.job));
  }
}

async function hear(event) {
  focus.hear(event);
  const ended = jobs.hear(event);
  if (event.type === "attention" && typeof event.now === "number") {
    by("by-itself-label").hidden = false;
    if (by("by-itself").checked) proceed();
  } else if (event.type === "attention") {
    by("by-itself-label").hidden = true;
  }
  if (event.type === "converging") await trying(() => pictures.show(event.job, "running"));
  if (ended && event.folder) {
    await trying(() => pictures.show(event.job));
    await runs();
  }
}

function told(message) {
  if (message.what === "event") {
    hear(message);
    return;
  }
  const came = message.here && message.visit !== state.visit;
  state = message;
  showState();
  if (came) {
    describe();
    runs();
  }
}

function cutOff(trouble) {
  state = { ...state, here: false, status: null };
  by("state").textContent = "page cut off";
  by("state").className = "away";
  say(by("failure"), "");
  say(
    by("trouble"),
    trouble?.kind === "refused"
      ? "This address lets nobody in, or no longer: open the one that pdcd web printed last, with what stands behind the #."
      : "pdcd web does not answer. If it was started again, open the address that it printed then.",
  );
  jobs.state(null);
  buttons();
}

async function listen() {
  for (;;) {
    let why = null; // whatever it was, it is tried again
    try {
      for await (const message of news("events")) told(message);
    } catch (trouble) {
      why = trouble;
    }
    cutOff(why);
    await new Promise((again) => setTimeout(again, AGAIN_MS));
  }
}

function proceed() {
  const asked = jobs.attention;
  if (asked) trying(() => post("proceed", { job: asked.job }));
}

async function look() {
  do {
    const preview = await trying(() => post("look"), by("form-trouble"));
    if (!preview) return;
    await trying(() => pictures.show(preview.path.split("/").at(-3)));
  } while (by("looking").checked && state.here);
}

function showPlan({ rows }) {
  by("plan-answer").replaceChildren(...rows.flatMap(([name, text]) => [el("dt", {}, name), el("dd", {}, text)]));
  by("plan-answer").hidden = false;
  by("plan-answer").scrollIntoView({ block: "nearest" });
}

/** Ask for what the form says; its faults stand beside it. */
async function wish(address) {
  const trouble = by("form-trouble");
  const request = await trying(() => form.read(), trouble);
  return request && trying(() => post(address, request), trouble);
}

by("form").addEventListener("submit", (event) => {
  event.preventDefault();
  by("plan-answer").hidden = true;
  wish("capture");
});
by("plan").addEventListener("click", async () => {
  const plan = await wish("plan");
  if (plan) showPlan(plan);
});
by("form").addEventListener("input", () => say(by("form-trouble"), ""));
by("look").addEventListener("click", look);
by("cancel").addEventListener("click", () => {
  const job = state.status?.running?.job;
  if (job) trying(() => post("cancel", { job }));
});
by("focus").addEventListener("click", () => trying(() => post("calibrate", { steps: ["focus"], attended: true })));
by("proceed").addEventListener("click", proceed);
by("stream").addEventListener("click", async () => {
  const request = stream.on ? {} : await trying(() => form.read(), by("stream-trouble"));
  if (request) stream.toggle({ ...request, over: Number(by("stream-over").value) });
});
by("record").addEventListener("click", async () => {
  await stream.record();
  await runs();
});
by("live").addEventListener("click", () => live.toggle());

runs();
listen();
