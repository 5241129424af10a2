// What the running job does, out of its events.

import { by, el, say, short } from "./dom.js";

const ENDS = ["done", "failed", "cancelled"];

/** What an event says of the progress: a text, and a share of 1 or null where nobody knows. */
function stage(event) {
  switch (event.type) {
    case "queued": return [event.ahead ? `waits behind ${event.ahead}` : "begins", null];
    case "planning": return [`planning: ${event.stage}`, event.done / event.total];
    case "started": return [`has the rig: ${event.goal}`, null];
    case "learning": return [`looks at ${event.photos} photos`, null];
    case "armed": return [`${event.shot}: ready`, null];
    case "shutter_open": return [`${event.shot}: shutter open`, null];
    case "progress": return [
      `${event.shot}: ${event.frame} of ${event.frames} refreshes${event.missed ? `, ${event.missed} late` : ""}`,
      event.frames ? event.frame / event.frames : null];
    case "shutter_closed": return [`${event.shot}: shutter closed`, null];
    case "discarded": return [`${event.shot}: taken again, ${event.cause}`, null];
    case "converging": return [`part ${event.part}: sigma ${event.rms_sigma === null ? "unknown" : short(100 * event.rms_sigma)} %, wanted ${short(100 * event.target)} %`, null];
    case "step_begun": return [`${event.step}: step ${event.number} of ${event.steps}`, null];
    case "attention": return ["waits for you", null];
    case "step_ended": return [`${event.step}: ${event.verdict}`, null];
    case "decoding": return ["makes the pictures", null];
    case "decoded": return ["makes the pictures", event.done / event.total];
    case "archived": return ["writes the folder", null];
    default: return [event.type, null];
  }
}

/** The lines that remain when a job has ended. */
function notes(event) {
  const found = [];
  if (event.error) found.push([event.error.device, event.error.message].filter(Boolean).join(": "));
  if (event.error?.hint) found.push(event.error.hint);
  const quality = event.summary?.quality;
  if (quality) found.push(`quality: ${quality.verdict}`, ...quality.reasons, ...quality.remarks);
  return [...found, ...(event.warnings ?? [])];
}

/** The card that shows one job: the one that runs, else the last that ended. */
export class JobCard {
  #job = null;
  #kinds = new Map();
  #attention = null;

  /** Jobs that run now, or null; a job that ended while nobody listened is forgotten. */
  state(status) {
    const running = status?.running ?? null;
    for (const each of [running, ...(status?.queued ?? [])]) {
      if (each) this.#kinds.set(each.job, `${each.kind} ${each.goal} by ${each.owner.user}`);
    }
    by("cancel").disabled = running === null;
    if (running) {
      if (this.#job !== running.job) this.#begin(running.job);
      this.#name();
    } else {
      this.#ask(null);
      if (!ENDS.some((end) => by("job-stage").classList.contains(end))) by("job-bar").value = 0;
    }
  }

  /** One event of any job; returns whether it was the end of one. */
  hear(event) {
    const ended = ENDS.includes(event.type);
    if (event.type === "queued" && event.ahead) return false;
    if (this.#job !== event.job) this.#begin(event.job);
    if (ended) {
      this.#ask(null);
      const shot = event.summary?.exposure_s;
      by("job-stage").textContent = event.type + (shot ? `, ${short(shot)} s exposed` : "");
      by("job-stage").classList.add(event.type);
      by("job-bar").value = event.type === "done" ? 1 : 0;
      by("job-notes").replaceChildren(...notes(event).map((text) => el("li", {}, text)));
      return true;
    }
    const [text, share] = stage(event);
    by("job-stage").textContent = text;
    if (share !== null) by("job-bar").value = share;
    if (event.type === "attention") this.#ask(event);
    else if (event.type !== "decoded") this.#ask(null);
    return false;
  }

  /** The job that is shown. */
  get job() {
    return this.#job;
  }

  /** What somebody is asked to do, or null. */
  get attention() {
    return this.#attention;
  }

  #begin(job) {
    this.#job = job;
    by("job-stage").className = "";
    by("job-stage").textContent = "";
    by("job-bar").value = 0;
    by("job-notes").replaceChildren();
    this.#ask(null);
    this.#name();
  }

  #name() {
    by("job-name").textContent = [this.#kinds.get(this.#job), this.#job].filter(Boolean).join(", ");
  }

  #ask(event) {
    this.#attention = event;
    by("attention").hidden = event === null;
    say(by("attention-text"), event?.text);
  }
}
