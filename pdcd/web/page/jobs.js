// What the running job does, out of its events.

import { by, el, say, short } from "./dom.js";

const ENDS = ["done", "failed", "cancelled"];

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
      if (by("job-stage").textContent === "queued") by("job-stage").textContent = "running";
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
    by("job-stage").textContent = event.words;
    if (event.share !== null) by("job-bar").value = event.share;
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
